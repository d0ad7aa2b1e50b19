"""A command that checks its paths before it works, and says what it left when stopped."""

import os
from pathlib import Path
from typing import Any

import click

from tomojax.cli.entry._paths import check_paths, paths_read, paths_written, Written

# Of the command that runs: what it writes, and what was there before.
_running: list[tuple[Written, Any]] = []


class Command(click.Command):
    """A click command that never writes a file it reads, nor one file twice.

    **Raises:** `ValueError` before any work.
    """

    def __init__(self, *args: Any, **given: Any):
        super().__init__(*args, **given)
        for one in self.params:  # every default is shown but that of a plain flag
            value = getattr(one, "default", None)
            if isinstance(one, click.Option) and isinstance(value, int | float | str):
                if one.show_default is None:
                    one.show_default = bool(one.secondary_opts) or not one.is_flag

    def invoke(self, ctx: click.Context) -> Any:
        read, written = paths_read(ctx), paths_written(ctx)
        names = "overwrite", "resume"
        check_paths(read, written, *(ctx.params.get(name) for name in names))
        _running[:] = [(one, _state(one.path)) for one in written]
        try:
            return super().invoke(ctx)
        except EOFError as error:  # click takes it for Ctrl-C
            names = ", ".join(map(str, read)) or "standard input"
            told = f"{names}: ends too early: {error or 'nothing left to read'}"
            raise ValueError(told) from None


def stopped() -> str:
    """Returns one line on what a stopped command leaves."""
    for one, _ in _running:
        partial = one.path.with_name(one.path.name + ".partial")
        if one.kind == "results" and partial.exists():
            return f"tomojax: stopped; --resume goes on with {one.path}"
    for one, _ in _running:
        if one.goes_on:
            return f"tomojax: stopped; the same command goes on in {one.folder}"
    left = [one for one, before in _running if _state(one.path) == before]
    names = list(dict.fromkeys(str(one.folder or one.path) for one in left))
    return "tomojax: stopped" + (f"; not written: {', '.join(names)}" if names else "")


def _state(path: Path) -> Any:
    try:
        about = os.stat(path)
    except OSError:
        return None
    return about.st_ino, about.st_mtime_ns, about.st_size
