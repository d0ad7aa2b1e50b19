"""Options of the commands that run a session: `record` and `live`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from tomojax.cli import entry


def _config(context: click.Context, parameter: Any, paths: tuple[Path, ...]) -> None:
    """Takes options' defaults from TOML files; a key is an option's name."""
    from tomojax.files import read_toml

    known = {str(p.name) for p in context.command.params} - {"config"}
    keys = dict(context.default_map or {})
    for path in paths:
        try:
            found = read_toml(path, "no options in TOML")
        except ValueError as error:
            raise click.BadParameter(str(error)) from None
        for key, value in found.items():
            name = key.replace("-", "_")
            if name not in known:
                expected = ", ".join(sorted(n.replace("_", "-") for n in known))
                raise click.BadParameter(f"{path}: got {key}, expected one of {expected}")
            keys[name] = value
    context.default_map = keys


class Numbers(click.ParamType):
    """Whole numbers: a list in a TOML file, or numbers with commas on the command line."""

    name = "numbers"

    def convert(self, value: Any, param: Any, ctx: Any) -> list[int]:
        try:
            parts = value.split(",") if isinstance(value, str) else value
            return [entry.whole_number(part) for part in parts]
        except (TypeError, ValueError):
            self.fail(f"got {value!r}, expected whole numbers with commas", param, ctx)


def check_step(method: str, cheaper: str | None, policies: Sequence[str]) -> None:
    """Checks the names that a step is made of. **Raises:** `ValueError`."""
    for option, name in (("--method", method), ("--cheaper", cheaper)):
        entry.check_name(option, name or method, ("follow", *entry.METHODS))
    more = ", electrodes with commas: 0,7,14, or a table, .npz"
    for name in policies:
        if name.endswith(".npz"):
            if not Path(name).is_file():
                raise ValueError(f"--policy: {name}: no such file")
        elif entry.ground_numbers("--policy", name) is None:
            entry.check_name("--policy", name, entry.POLICIES, more)


step_options = entry.grouped(
    click.option(
        "--method",
        default="follow",
        help="Find contacts by this method: follow, or one that sees each slot alone.",
    ),
    click.option("--cheaper", help="Method for slots that are late. [default: the same]"),
    click.option(
        "--contacts", type=entry.COUNT, default=2, help="Find this many contacts at most."
    ),
)


session_options = entry.grouped(
    click.argument("source"),
    entry.stretch_options,
    click.option(
        "--config",
        type=entry.InputFile(empty=True),
        is_eager=True,
        expose_value=False,
        callback=_config,
        multiple=True,
        help="Read these options' values, by name, from a TOML file. May be repeated.",
    ),
    click.option(
        "--view",
        type=click.Choice(["terminal", "web", "rerun", "none"]),
        default="terminal",
        help="Show the session here: in the terminal, a browser (web), Rerun, or not.",
    ),
    click.option(
        "--rrd",
        type=entry.OutputFile("view"),
        help="Write the view of --view rerun to this file and open no viewer; "
        "replaces an earlier view.",
    ),
    click.option(
        "--seconds",
        type=entry.AMOUNT,
        help="Stop after this time, s. [default: until Ctrl-C]",
    ),
    click.option(
        "--file-seconds",
        type=entry.AMOUNT,
        default=3600.0,
        help="Begin a new file of the recording after this time, s.",
    ),
    entry.wire_options,
    click.option(
        "--speed",
        type=entry.AMOUNT,
        help="Replay a recording this many times as fast as measured. [default: "
        "as fast as it is read]",
    ),
    entry.like_option,
    click.option(
        "--channels",
        type=Numbers(),
        help="The electrode that each channel reads, as numbers with commas. "
        "`tomojax check --write` writes this list for --config. [default: "
        "channel k reads electrode k]",
    ),
    click.option(
        "--grounds",
        type=Numbers(),
        help="The electrode that each ground line switches, -1 for none, as numbers "
        "with commas. `tomojax check --write` writes this list for --config. "
        "[default: line k switches electrode k]",
    ),
)
