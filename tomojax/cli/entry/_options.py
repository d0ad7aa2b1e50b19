"""Options that several commands have."""

from collections.abc import Callable
from typing import Any

import click

from tomojax.cli.entry._amounts import AMOUNT, COUNT, NUMBER
from tomojax.cli.entry._paths import InputFile


def grouped(*options: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Returns a decorator that adds options, in this order."""

    def wrapped(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return wrapped


since_option = click.option(
    "--from",
    "since",
    type=NUMBER,
    help="Read from this time on, s after the file's first row. [default: 0]",
)

# The stretch of a file that a command reads: `since` and `until`, s, or None.
stretch_options = grouped(
    since_option,
    click.option(
        "--to",
        "until",
        type=AMOUNT,
        help="Read up to this time, s after the file's first row. [default: the end]",
    ),
)

# How a source is reached.
wire_options = grouped(
    click.option("--baud", type=COUNT, help="Serial baud rate. [default: 4000000]"),
    click.option(
        "--bind", help="Listen here over UDP. [default: 127.0.0.1, this machine only]"
    ),
)

like_option = click.option(
    "--like",
    type=InputFile(),
    help="Take the sheet and electrodes from this recording of the rig. [default: "
    "the paper's sensor]",
)

calibration_option = click.option(
    "--calibration", type=InputFile(), help="Apply this calibration of the rig."
)
