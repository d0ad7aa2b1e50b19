"""Options of the commands that run a session: `record` and `live`."""

from pathlib import Path
from typing import Any

import click

from tomojax.cli import entry


def _config(context: click.Context, parameter: Any, paths: tuple[Path, ...]) -> None:
    """Takes options' defaults from TOML files; a key is an option's name."""
    for path in paths:
        _read_config(context, path)


def _read_config(context: click.Context, path: Path) -> None:
    from tomojax.files import read_toml

    try:
        found = read_toml(path, "no options in TOML")
    except ValueError as error:
        raise click.BadParameter(str(error)) from None
    keys = {}
    for key, value in found.items():
        name = key.replace("-", "_")
        known = {p.name for p in context.command.params} - {"config"}
        if name not in known:
            expected = ", ".join(sorted(n.replace("_", "-") for n in known if n))
            raise click.BadParameter(f"{path}: got {key}, expected one of {expected}")
        keys[name] = value
    context.default_map = {**(context.default_map or {}), **keys}


class Numbers(click.ParamType):
    """Whole numbers: a list in a TOML file, or numbers with commas on the command line."""

    name = "numbers"

    def convert(self, value: Any, param: Any, ctx: Any) -> list[int]:
        try:
            parts = value.split(",") if isinstance(value, str) else value
            return [entry.whole_number(part) for part in parts]
        except (TypeError, ValueError):
            self.fail(f"got {value!r}, expected whole numbers with commas", param, ctx)


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
