"""Types of options that are paths: files to read, files and folders to write."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import click

from tomojax._require import require
from tomojax._whole import refuse_held
from tomojax.cli.entry._kinds import KINDS, PICTURES

# Where a context keeps what it was told to read.
_READ = "tomojax.read"

# What a results file has beside it while it is made.
_BESIDE = (".partial", ".partial.new", ".partial.done", ".partial.lock")
_BESIDE += (".partial.state", ".partial.state.new")

Beside = Callable[[dict[str, Any]], Path | None]


class InputFile(click.Path):
    """A file that the command reads and never writes; the file may be empty if `empty`."""

    def __init__(self, empty: bool = False):
        super().__init__(path_type=Path)
        self.empty = empty

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if not self.empty and not path.exists():
            self.fail(f"{path}: no such file", param, ctx)
        if not self.empty and path.is_file() and path.stat().st_size == 0:
            expected = "expected one with something in it"
            self.fail(f"{path}: got an empty file, {expected}", param, ctx)
        if ctx is not None:
            ctx.meta.setdefault(_READ, []).append(path)
        return path


class OutputFile(click.Path):
    """A file that the command writes.

    - `kind`: a key of `KINDS`; an existing file is replaced only if it is of this kind.
      "results" and "recording" have their own rules.
    - `beside`: makes the default name from the other options' values.
    - `also`: suffixes of companion files that may be written beside the file.
    - `makes`: whether the command makes the file's folder.
    - `unless`: tells from the other options' values whether the command itself checks the
      path.
    """

    def __init__(
        self,
        kind: str,
        beside: Beside | None = None,
        also: tuple[str, ...] = (),
        makes: bool = False,
        unless: Callable[[dict[str, Any]], bool] = lambda given: False,
    ):
        super().__init__(path_type=Path)
        self.kind, self.beside, self.also, self.makes = kind, beside, also, makes
        self.unless = unless


class OutputFolder(click.Path):
    """A folder, and the names of files that the command writes there.

    `goes_on`: whether the same command goes on with files that are in the folder.
    """

    def __init__(self, *names: str, goes_on: bool = False):
        super().__init__(file_okay=False, path_type=Path)
        self.names, self.goes_on = names, goes_on


class Written(NamedTuple):
    """A file that a command will write."""

    path: Path
    option: str
    kind: str
    makes: bool
    beside: tuple[Path, ...]  # what the work itself needs beside it
    folder: Path | None = None  # of all its files, where the option names that
    goes_on: bool = False


def paths_read(context: click.Context) -> list[Path]:
    """Lists the files that the command was told to read; a source may be one."""
    found = list(context.meta.get(_READ, ()))
    source = context.params.get("source")
    if isinstance(source, str) and Path(source).is_file():
        found.append(Path(source))
    return found


def paths_written(context: click.Context) -> list[Written]:
    """Lists the files that the command will write, and fills in default names."""
    found = []
    for parameter in context.command.params:
        kind, name = parameter.type, parameter.name
        if not isinstance(kind, OutputFile | OutputFolder) or name is None:
            continue
        value = context.params.get(name)
        if isinstance(kind, OutputFile) and kind.unless(context.params):
            continue
        if value is None and isinstance(kind, OutputFile) and kind.beside:
            value = context.params[name] = kind.beside(context.params)
        if value is not None:
            found += _files(kind, max(parameter.opts, key=len), value)
    return found


def _files(kind: OutputFile | OutputFolder, option: str, path: Path) -> Iterator[Written]:
    if isinstance(kind, OutputFolder):
        for name in kind.names:
            what = {".png": "picture", ".gif": "picture", ".h5": "results"}
            of = what.get(Path(name).suffix, "")
            yield Written(path / name, option, of, True, (), path, kind.goes_on)
        return
    beside = [path.with_name(path.stem + suffix) for suffix in kind.also]
    if kind.kind == "results":
        beside += [path.with_name(path.name + suffix) for suffix in _BESIDE]
    yield Written(path, option, kind.kind, kind.makes, tuple(beside))


def check_paths(
    read: list[Path],
    written: list[Written],
    overwrite: bool | None = None,
    resume: bool | None = None,
) -> None:
    """Checks that the command can write its files, and that no file is destroyed.

    `overwrite` and `resume` are the values of the command's options, or None without them.
    **Raises:** `ValueError` where the command would destroy a file, or could not keep its
    work.
    """
    known = {_identity(path): f"read from {path}" for path in read}
    for one in written:
        for path in (one.path, *one.beside):
            other = known.get(_identity(path))
            told = f"a file that is {other}"
            require(other is None, f"{one.option}: {path}", told, "another name")
        for path in (one.path, *one.beside):
            known[_identity(path)] = f"written by {one.option}"
        _check_place(one)
        _check_replaced(one, overwrite)
        if one.kind == "results" and overwrite is False and not resume:
            _check_fresh(one, goes_on=resume is not None)


def _check_fresh(one: Written, goes_on: bool) -> None:
    """Results are begun where there are none; the command itself looks again later."""
    require(not one.path.exists(), f"{one.path}", "a file", "a new name, or --overwrite")
    begun = one.path.with_name(one.path.name + ".partial")
    refuse_held(one.path.with_name(f"{one.path.name}.partial.lock"))
    mend = "--resume to go on with it, or --overwrite"
    require(not (goes_on and begun.exists()), f"{begun}", "work begun there", mend)


def _identity(path: Path) -> Any:
    """Returns the same value for two names of one file, even before the file exists."""
    try:
        about = path.stat()
    except OSError:
        return os.path.normcase(os.path.realpath(path))
    return about.st_dev, about.st_ino


def _check_place(one: Written) -> None:
    path, folder = one.path, one.path.parent
    require(not path.is_dir(), f"{one.option}: {path}", "a folder", "a file's name")
    if one.kind == "picture":
        names = ", ".join(PICTURES)
        fine = path.suffix.lower() in (*PICTURES, ".gif")
        require(fine, f"{one.option}: {path}", repr(path.suffix), f"a name with {names}")
    if one.makes:
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
    if not folder.is_dir():
        raise ValueError(f"{path}: no such folder; make it, or give another")
    may = os.access(folder, os.W_OK) or (path.exists() and not path.is_file())
    require(may, f"{one.option}: {path}", "no permission", "a folder that can be written")


def _check_replaced(one: Written, overwrite: bool | None) -> None:
    """Checks that an existing file is replaced only by a file of its own kind."""
    words, is_one = KINDS.get(one.kind, ("", None))
    path = one.path
    # Without --overwrite the command itself says that a file is there.
    refused = overwrite is False and one.kind == "calibration"
    if is_one is None or refused or not path.is_file() or not path.stat().st_size:
        return
    told, mend = "a file that is there already and is something else", f"{words} to replace"
    require(is_one(path), f"{one.option}: {path}", told, f"a new name, or {mend}")
