"""What files name is in the repository: a folder that git ignores is lost on a clean clone.

`site/` in `.gitignore` once matched `tests/site`: its tests passed where they lay, and CI,
on a clean clone, ran none of them. `tests/README.md` lists the files of tests: a file that
goes, goes with its line.
"""

import ast
import importlib.util
import re
import subprocess
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import listed
import pytest

ROOT = Path(__file__).parents[2]
SOURCES = ("tomojax", "kernels", "hardware", "tests", "notebooks", ".ci")
# What the code writes in a source folder.
GENERATED = re.compile(
    r"(^|/)__pycache__/|^notebooks/jupyter_execute/"
    r"|^notebooks/reference/(api/|commands\.md|flags\.md|python\.md)"
)
CONFIGURED = ("pyproject.toml", ".ci/run", ".ci/audit", "CONTRIBUTING.md", "README.md")
_PATH = re.compile(
    r"(?<![\w/.~-])((?:tests|notebooks|tomojax|hardware|kernels|\.ci)/[\w./\[\]*-]*[\w\]*])"
    r"|(?<![\w/.])([\w.]+\.(?:md|toml|cff|txt|in))(?![\w])"
)
# Where an installed package has them.
INSTALLED = ("tomojax/kernels", "tomojax/hardware")
# A fuzzer that no extra brings.
BY_HAND = ("atheris", "shapely", "triangle")
ROWS = re.findall(r"^\| `(\S+\.py)`", listed.PAGE.read_text(), re.M)


def git(*words: str) -> list[str]:
    try:
        run = subprocess.run(
            ["git", *words], cwd=ROOT, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no git, or no checkout of it: nobody can tell what is tracked")
    return run.stdout.splitlines()


@cache
def tracked() -> frozenset[str]:
    if not (ROOT / ".git").exists():
        pytest.skip("a copy without git: nobody can tell what is tracked")
    return frozenset(git("ls-files"))


@cache
def folders() -> frozenset[str]:
    return frozenset(str(folder) for one in tracked() for folder in Path(one).parents)


def holds(path: str) -> bool:
    """Whether the repository has a file, or files of a folder or of a pattern."""
    if any(mark in path for mark in "*["):
        found = (str(one.relative_to(ROOT)) for one in ROOT.glob(path))
        return any(one in tracked() for one in found)
    return path in tracked() or path.rstrip("/") in folders()


def named(path: str) -> bool:
    """Whether a path, or a name without its folder, is of the repository."""
    bare = "/" not in path and any(Path(one).name == path for one in tracked())
    return bare or path in INSTALLED or holds(path)


def configuration() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_no_source_is_ignored() -> None:
    assert tracked()
    words = ("ls-files", "--others", "--ignored", "--exclude-standard", "--", *SOURCES)
    ignored = [one for one in git(*words) if not GENERATED.search(one)]
    assert not ignored
    # What would be, were it added today.
    assert not git("ls-files", "--cached", "--ignored", "--exclude-standard")


def test_what_configurations_name_is_there() -> None:
    wrong = [
        f"{name}: {path}"
        for name in CONFIGURED
        for found in _PATH.finditer((ROOT / name).read_text())
        if not named(path := found[0])
    ]
    assert not wrong


def named_by_pyproject() -> Iterator[str]:
    config = configuration()
    project, tool = config["project"], config["tool"]
    yield project["readme"]
    yield from project["license-files"]
    pytest_options = tool["pytest"]["ini_options"]
    yield from pytest_options["testpaths"]
    yield from (one for one in pytest_options["pythonpath"] if one != ".")
    yield from tool["ruff"]["lint"]["per-file-ignores"]
    own = tool["setuptools"]["package-dir"]
    for package in tool["setuptools"]["packages"]:
        yield f"{folder_of(package, own)}/__init__.py"
    for package, patterns in tool["setuptools"]["package-data"].items():
        yield from (f"{folder_of(package, own)}/{one}" for one in patterns)


def folder_of(package: str, own: dict[str, str]) -> str:
    """The folder of a package, by the longest name that has one of its own."""
    near = max((one for one in own if f"{package}.".startswith(f"{one}.")), key=len)
    return own[near] + package.removeprefix(near).replace(".", "/")


def test_what_pyproject_names_is_there() -> None:
    told = list(named_by_pyproject())
    assert len(told) > 40
    assert not [one for one in told if not holds(one)]


def imports(path: Path) -> Iterator[str]:
    """The modules that a file imports."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module


def ours(name: str, own: dict[str, str]) -> bool:
    """Whether a module of the package is a file that is tracked."""
    path = folder_of(name, own)
    found = (f"{path}.py", f"{path}/__init__.py")
    return any(one in tracked() for one in found)


@cache
def installed(name: str) -> bool:
    """Whether a module comes from outside the checkout's own folders."""
    found = importlib.util.find_spec(name)
    if found is None:
        return False
    places = [found.origin] if found.has_location else found.submodule_search_locations
    if places is None:
        return True  # built in
    relative = [Path(one).relative_to(ROOT) for one in places if ROOT in Path(one).parents]
    return all(one.parts[0] == ".venv" for one in relative)


def test_what_tests_and_notebooks_import_is_there() -> None:
    packages = configuration()["tool"]["setuptools"]["package-dir"]
    places = configuration()["tool"]["pytest"]["ini_options"]["pythonpath"]
    wrong = []
    for path in sorted(
        one for one in tracked() if re.match(r"(tests|notebooks)/.*\.py", one)
    ):
        here = str(Path(path).parent)
        for module in imports(ROOT / path):
            first = module.partition(".")[0]
            if first == "tomojax":
                fine = ours(module, packages)
            else:
                near = [str(Path(place, *module.split("."))) for place in (here, *places)]
                fine = any(holds(f"{one}.py") or holds(one) for one in near)
                fine = fine or first in BY_HAND or installed(first)
            wrong += [] if fine else [f"{path}: {module}"]
    assert not wrong


def test_every_file_of_tests_is_listed_and_every_listed_file_is_there() -> None:
    there, told = set(listed.files()), set(ROWS)
    assert not told - there, "tests/README.md lists files that are not there"
    assert not there - told, "python tests/listed.py lists files that are new"
    assert len(ROWS) == len(told)


def test_a_listed_file_has_tests() -> None:
    for name in ROWS:
        assert re.search(r"^def test_", (ROOT / "tests" / name).read_text(), re.M), name
