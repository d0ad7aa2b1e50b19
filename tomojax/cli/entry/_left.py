"""Files that several commands leave: reports and pictures."""

import json
from pathlib import Path
from typing import Any

import click

from tomojax._whole import whole, write_text
from tomojax.cli.entry._paths import OutputFile


def json_option(what: str, makes: bool = False) -> Any:
    """Returns the option `--json`; `what` names the things that it writes.

    `makes`: whether the command makes the file's folder.
    """
    words = f"Write {what} here; replaces an earlier report."
    kind = OutputFile("report", makes=makes)
    return click.option("--json", "json_path", type=kind, help=words)


def out_option(kind: click.Path, words: str, **more: Any) -> Any:
    """Returns the option `--out`; its help is `words`."""
    return click.option("-o", "--out", type=kind, help=words, **more)


def picture_option(what: str) -> Any:
    """Returns the option `--picture`; `what` names the things that it draws."""
    words = f"Draw {what} here (PNG); replaces a picture."
    return click.option("--picture", type=OutputFile("picture"), help=words)


def write_report(path: Path | None, **report: Any) -> None:
    """Writes a report with rows, a summary and the environment, if there is a path."""
    if path is None:
        return
    from tomojax._environment import environment

    told = json.dumps({**report, "environment": environment()})
    known = json.loads(told, parse_constant=lambda nan: None)  # JSON has no NaN
    write_text(path, json.dumps(known, indent=1) + "\n")


def save_picture(figure: Any, path: Path) -> None:
    """Saves a figure, whole or not at all, and names the file."""
    with whole(path) as part:
        figure.savefig(part, dpi=110)
    print(f"picture: {path}")
