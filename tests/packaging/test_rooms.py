"""Rooms are entered by their faces; import-linter holds the layers, see .ci/run."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import tomojax as tx

ROOT = Path(__file__).parents[2]
BENCH = ROOT / "tests" / "benchmarks" / "bench"
INSIDE = {
    "tomojax": "tomojax",
    "kernels": "tomojax.kernels",
    "hardware": "tomojax.hardware",
    "tests/benchmarks/bench": "bench",
}
# Rooms that have rooms.
HALLS = ("tomojax.kernels", "tomojax.hardware")
# The rooms of `bench`, from the top floor down: each imports those below it.
FLOORS = ("cli", "stability", "frontier", "skins attacked", "rigs", "network plots memory")


def room_of(module: str) -> str:
    hall = any(module.startswith(f"{name}.") for name in HALLS)
    return ".".join(module.split(".")[: 3 if hall else 2])


def imported(path: Path) -> Iterator[str]:
    """The modules of ours that a file imports, by their whole names."""
    ours = ("tomojax", "bench")
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [a.name for a in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{a.name}" for a in node.names]
        else:
            continue
        yield from (name for name in names if name.partition(".")[0] in ours)


def private(name: str) -> bool:
    return any(part.startswith("_") for part in name.split(".")[2:])


def modules() -> Iterator[tuple[str, Path]]:
    for folder, package in INSIDE.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            yield ".".join([package, *parts]).removesuffix(".__init__"), path


def test_no_room_imports_what_another_keeps_to_itself() -> None:
    # `tomojax._checks` and the like belong to all.
    wrong = [
        f"{module} imports {name}"
        for module, path in modules()
        for name in imported(path)
        if private(name) and room_of(name) != room_of(module)
    ]
    assert not wrong


# A parser that commands reach through files alone is fuzzed by itself.
_BY_ITSELF = "parser_files.py"


@pytest.mark.parametrize("folder", ["tests", "notebooks"])
def test_tests_and_notebooks_use_faces(folder) -> None:
    wrong = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in sorted((ROOT / folder).rglob("*.py"))
        for name in imported(path)
        if private(name) and path.name != _BY_ITSELF and BENCH not in path.parents
    ]
    assert not wrong


def test_bench_imports_downwards_and_is_not_imported() -> None:
    floors = {room: i for i, rooms in enumerate(FLOORS) for room in rooms.split()}
    for module, path in modules():
        for name in imported(path):
            if name.startswith("bench."):
                assert module.startswith("bench"), f"{module} imports {name}"
                above, below = (one.split(".")[1] for one in (module, name))
                assert above == below or floors[above] < floors[below], (module, name)


def test_rooms_have_few_modules_and_say_what_they_are_for() -> None:
    sizes: dict[str, int] = {}
    for module, path in modules():
        if path.name == "__init__.py":
            text = ast.get_docstring(ast.parse(path.read_text())) or ""
            assert text.count(".") >= 2 or module.count(".") == 0, module
        else:
            room = module.rpartition(".")[0]
            sizes[room] = sizes.get(room, 0) + 1
    assert max(sizes.values()) <= 12, sizes


def test_the_root_is_small() -> None:
    assert len(tx.__all__) <= 31
    assert all(hasattr(tx, name) for name in tx.__all__)
