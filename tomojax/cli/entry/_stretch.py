"""`--from` and `--to`: the stretch of a file that a command reads."""

from typing import Any

import click

from tomojax.cli.entry._amounts import AMOUNT, NUMBER


def stretch_options(command: Any) -> Any:
    """Adds both options; the command gets `since` and `until`, s, or None."""
    for option in (
        click.option(
            "--to",
            "until",
            type=AMOUNT,
            help="Read up to this time, s after the file's first row. [default: the end]",
        ),
        click.option(
            "--from",
            "since",
            type=NUMBER,
            help="Read from this time on, s after the file's first row. [default: 0]",
        ),
    ):
        command = option(command)
    return command
