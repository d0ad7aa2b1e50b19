"""The reference lists each public name, command, option and flag; none is left out."""

import importlib
import importlib.util
import inspect
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import click
import pytest
from pages import GENERATED, page, SITE

import tomojax as tx
from tomojax.cli.app import app

# Rooms without a page of names, and where a reader finds what they are for.
ELSEWHERE = {
    "tomojax.cli": "its names are commands",
    "tomojax.files": "a floor below the formats, which the page of formats describes",
    "tomojax.hardware.web": "the pages that `live --view web` serves",
    "tomojax.kernels": "its rooms have pages; its flags are on the page of flags",
    "tomojax.kernels.flags": "on the page of flags",
    "tomojax.kernels.levels": "constants of the methods",
}
HALLS = ("tomojax", "tomojax.hardware", "tomojax.kernels")


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Path:
    """The pages that the site's configuration writes."""
    spec = importlib.util.spec_from_file_location("_reference", SITE / "_reference.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    folder = tmp_path_factory.mktemp("reference")
    module.write(folder)
    return folder


def rooms() -> Iterator[str]:
    """The package, and all that its halls have."""
    yield "tomojax"
    for hall in HALLS:
        paths = importlib.import_module(hall).__path__
        names = {found.name for found in pkgutil.iter_modules(paths)}
        # A checkout's root is on the package's path.
        yield from (f"{hall}.{name}" for name in sorted(names - {"tomojax"}))


def faces() -> list[ModuleType]:
    names = [name for name in rooms() if not name.rpartition(".")[2].startswith("_")]
    assert set(ELSEWHERE) <= set(names)
    return [importlib.import_module(name) for name in names if name not in ELSEWHERE]


def test_every_room_has_a_page(written) -> None:
    missing = [
        room.__name__
        for room in faces()
        if not (written / "api" / f"{room.__name__.removeprefix('tomojax.')}.md").is_file()
    ]
    assert not missing
    listed = (written / "python.md").read_text()
    assert not [r.__name__ for r in faces() if f"[`{r.__name__}`]" not in listed]


def test_every_name_of_a_room_has_a_place(written) -> None:
    wrong, count = [], 0
    for room in faces():
        path = written / "api" / f"{room.__name__.removeprefix('tomojax.')}.md"
        told = set(re.findall(r"^:+\{py:\w+\} (\w+)", path.read_text(), re.M))
        for name in getattr(room, "__all__", ()):
            if inspect.ismodule(thing := getattr(room, name)):
                # A room within a room is a page of its own.
                fine = (written / "api" / _file_of(thing)).is_file()
            else:
                fine = name in told
            count += 1
            wrong += [] if fine else [f"{room.__name__}.{name}"]
    assert count > 150 and not wrong


def _file_of(room: ModuleType) -> str:
    return f"{room.__name__.removeprefix('tomojax.')}.md"


def test_pages_that_are_written_are_in_the_reference(written) -> None:
    made = {path.relative_to(written).parts[0] for path in written.rglob("*.md")}
    assert made == set(GENERATED)
    told = {said.text for said in page("notebooks/reference/index.md").directives()}
    assert made - {"api"} <= told
    contents = set(re.findall(r"^api/(\S+)$", (written / "python.md").read_text(), re.M))
    assert contents == {path.stem for path in (written / "api").iterdir()}


def test_every_flag_has_a_row(written) -> None:
    rows = (written / "flags.md").read_text().splitlines()
    for flag in tx.Flag:
        (row,) = (
            row for row in rows if row.startswith(f"| `{flag.name}` | {flag.value} |")
        )
        assert flag.meaning in row and flag.advice in row
        assert len(flag.meaning) > 10 and len(flag.advice) > 3
    linked = [said.text for said in page("notebooks/how/flags.md").links()]
    assert "../reference/flags.md" in linked


def test_every_command_and_option_is_listed_and_has_a_help(written) -> None:
    """sphinx-click lists all that is not hidden, with its help."""
    text = (written / "commands.md").read_text()
    assert ".. click:: tomojax.cli.app:app" in text and ":nested: full" in text
    wrong = []
    for name, command in app.commands.items():
        if command.hidden or not command.help:
            wrong.append(f"tomojax {name}")
        for option in command.params:
            if isinstance(option, click.Option) and (option.hidden or not option.help):
                wrong.append(f"tomojax {name} {option.opts[0]}")
    assert len(app.commands) >= 12 and not wrong
