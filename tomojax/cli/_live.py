"""Commands on rigs: `tomojax record` and `tomojax live`."""

import json
import math
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from tomojax.cli._session import session
from tomojax.cli.entry import (
    AMOUNT,
    check_name,
    Command,
    COUNT,
    FIXED,
    ground_numbers,
    InputFile,
    METHODS,
    OutputFile,
    POLICIES,
    stretch_options,
    whole_number,
)

# While JAX is imported and compiles, nothing else is seen.
_COMPILING = (
    "compiling the step: up to half a minute the first time; later runs start in seconds"
)


def _config(context: click.Context, parameter: Any, paths: tuple[Path, ...]) -> None:
    """Values of TOML files as defaults: the same keys as the options have names."""
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
    """Whole numbers: a list in a TOML file, or with commas on the command line."""

    name = "numbers"

    def convert(self, value: Any, param: Any, ctx: Any) -> list[int]:
        try:
            parts = value.split(",") if isinstance(value, str) else value
            return [whole_number(part) for part in parts]
        except (TypeError, ValueError):
            self.fail(f"got {value!r}, expected whole numbers with commas", param, ctx)


def _shared(command: Any) -> Any:
    """Options that both commands have."""
    for option in (
        click.option(
            "--config",
            type=InputFile(empty=True),
            is_eager=True,
            expose_value=False,
            callback=_config,
            multiple=True,
            help="A TOML file with these options' values by name; may be repeated.",
        ),
        click.option(
            "--view",
            type=click.Choice(["terminal", "web", "rerun", "none"]),
            default="terminal",
            show_default=True,
        ),
        click.option(
            "--rrd",
            type=OutputFile("view"),
            help="With --view rerun: a file, no viewer; replaces an earlier one.",
        ),
        click.option("--seconds", type=AMOUNT, help="[default: until Ctrl-C]"),
        click.option(
            "--file-seconds",
            type=AMOUNT,
            default=3600.0,
            show_default=True,
            help="A new file of the recording after so long.",
        ),
        click.option("--baud", type=COUNT, help="Of a serial line. [default: 4000000]"),
        click.option(
            "--bind", help="Address to listen at over UDP. [default: 127.0.0.1, local]"
        ),
        click.option("--speed", type=AMOUNT, help="Of a recording; 1 is its own."),
        click.option(
            "--like",
            type=InputFile(),
            help="A recording of this rig: its sheet and electrodes.",
        ),
        click.option(
            "--channels",
            type=Numbers(),
            help="The electrode that each channel reads: a key in what `tomojax check "
            "--write` leaves for --config.",
        ),
        click.option(
            "--grounds",
            type=Numbers(),
            help="The electrode that each ground line switches, -1: none; likewise.",
        ),
    ):
        command = option(command)
    return click.argument("source")(stretch_options(command))


@click.command(cls=Command)
@_shared
@click.option(
    "-o",
    "--out",
    type=OutputFile("recording", also=(".calibration.json",)),
    required=True,
    help="The recording.",
)
@click.option(
    "--pattern",
    default="all",
    show_default=True,
    help="Ground conditions, over and over: a pattern's name, or electrodes as 0,7,14.",
)
@click.option(
    "--calibrate",
    is_flag=True,
    help="Show which squares of the sheet were touched, and calibrate at the end.",
)
def record(source: str, out: Path, pattern: str, calibrate: bool, **options: Any) -> None:
    """Record the slots of SOURCE: serial:PORT, udp://HOST:PORT, or virtual.

    A scan of the recording is one slot. What is on the disk stays readable whatever
    happens; a full disk or a crash begins a new file, OUT-1, OUT-2, ….
    With --calibrate rub the whole sheet with one finger: a map fills, lines say how well
    each part is known. Ctrl-C ends the rub; then OUT.calibration.json is made of it.
    """

    def check(electrodes: int) -> list[int] | None:
        return ground_numbers("--pattern", pattern, electrodes)

    if ground_numbers("--pattern", pattern) is None:
        check_name("--pattern", pattern, FIXED, ", or electrodes with commas: 0,7,14")

    def grounds(sensor: Any) -> list[int]:
        import numpy as np

        from tomojax.paper import pattern as patterns_pattern

        own = check(sensor.electrode_count)
        return own or np.asarray(patterns_pattern(sensor, pattern)).tolist()

    made = out.with_name(out.stem + ".calibration.json")
    if calibrate and made.exists():
        raise ValueError(f"{made}: is there already; give another -o")
    with session(source, out, options, grounds, check) as (opened, asked):
        opened.source.set_grounds(asked)
        if calibrate:
            opened.beside("loop.calibrating", str(out))
        opened.run(None)
    if calibrate:
        _calibrated(out, made)


def _calibrated(rec: Path, made: Path) -> None:
    """Makes a calibration of a rub and prints how well it is known, as `calibrate` does."""
    from tomojax.calibration import calibrated_recording, text
    from tomojax.recordings import open_recording

    print("calibrating …", file=sys.stderr)
    with open_recording(rec) as recording:
        try:
            found = calibrated_recording(recording)
        except ValueError as error:
            raise ValueError(f"{rec}: {error}") from None
        print(text(recording.rig.sensor(), found))
    found.calibration.save(made)
    print(f"calibration: {made}")


@click.command(cls=Command)
@_shared
@click.option("--method", default="follow", show_default=True)
@click.option(
    "--policy",
    default="around_contacts",
    show_default=True,
    help="A policy's name, electrodes as 0,7,14, or a table of `tomojax design --policy`.",
)
@click.option("--cheaper", help="A method that answers slots that are late.")
@click.option(
    "--budget", type=AMOUNT, help="A slot that is older is late, s. [default: one slot]"
)
@click.option("--contacts", type=COUNT, default=2, show_default=True, help="At most.")
@click.option("--calibration", type=InputFile(), help="A calibration file of this rig.")
@click.option(
    "--adapt",
    is_flag=True,
    help="Follow zeros and gains that drift, slowly; with --record OUT their log is "
    "OUT.adapted.h5.",
)
@click.option(
    "--shapes",
    is_flag=True,
    help="Draw what touches in the view by the method shape, in a process of its own.",
)
@click.option(
    "--record",
    "out",
    type=OutputFile("recording", also=(".adapted.h5",)),
    help="Record here as well.",
)
@click.option(
    "--send",
    multiple=True,
    metavar="KIND:WHERE",
    help="Send contacts, touch-down and lift-off: udp://HOST:PORT, jsonl:FILE (- is "
    "standard output), osc://HOST:PORT, lsl:NAME, foxglove:PORT. With ?rate=100 so many "
    "rows a second at most. May be repeated.",
)
@click.option(
    "--radius",
    type=AMOUNT,
    help="Of what presses, m: then --send has forces, where --calibration has presses.",
)
@click.option(
    "--real-time",
    is_flag=True,
    help="One core, one function, no garbage collection, SCHED_FIFO.",
)
def live(source: str, method: str, policy: str, out: Path | None, **options: Any) -> None:
    """Contacts of the slots of SOURCE as they come, and its next grounds back.

    SOURCE: serial:PORT, udp://HOST:PORT, a recording, or virtual: a rig in a process.
    """
    from tomojax.hardware.sinks import check_all

    for option, name in (("--method", method), ("--cheaper", options["cheaper"])):
        check_name(option, name or method, ("follow", *METHODS))
    own = policy.endswith(".npz")
    if own and not Path(policy).is_file():
        raise ValueError(f"--policy: {policy}: no such file")
    if not own and ground_numbers("--policy", policy) is None:
        more = ", electrodes with commas: 0,7,14, or a table, .npz"
        check_name("--policy", policy, POLICIES, more)
    sinks = check_all(options["send"], out)
    # What is read line by line has no pictures of a terminal in between.
    lines = any((one.kind, one.path) == ("jsonl", "-") for one in sinks)
    if lines and options["view"] != "none":
        raise ValueError("--send jsonl:-: got a view as well, expected --view none")
    path, calibration, law = options["calibration"], None, None

    def check(electrodes: int) -> None:
        nonlocal calibration, law
        if not own:
            ground_numbers("--policy", policy, electrodes)
        if path is not None:
            from tomojax.sensor import Calibration

            calibration = Calibration.load(path, electrodes)
        law = _law(calibration, options["radius"])
        print(_COMPILING, file=sys.stderr)

    def compiled(sensor: Any) -> Any:
        from tomojax.step import load_policy, make_step

        step = make_step(
            sensor,
            method,
            policy,
            tables={policy: load_policy(policy, sensor)} if own else None,
            contacts=options["contacts"],
            cheaper=options["cheaper"],
            calibration=calibration,
        )
        # The view's image is compiled here as well: in the loop slots would wait for it.
        if not options["shapes"]:
            step.image(step.state).block_until_ready()
        return step

    with ExitStack() as stack:
        if options["real_time"]:
            from tomojax.hardware import real_time

            allowed = stack.enter_context(real_time())
            print(f"real time: {', '.join(allowed)}", file=sys.stderr)
        opened, step = stack.enter_context(session(source, out, options, compiled, check))
        if options["adapt"]:
            log = "" if out is None else str(out.with_name(out.stem + ".adapted.h5"))
            opened.beside("loop.adapter", str(path or ""), log)
        if options["shapes"]:
            opened.beside("loop.drawing", str(path or ""))
        for name in options["send"]:
            opened.beside("sinks.run", name, json.dumps(law))
        opened.words = sys.stderr if lines else sys.stdout
        opened.run(step, options["budget"], images=not options["shapes"])


def _law(calibration: Any, radius: float | None) -> tuple[float, ...] | None:
    """What makes forces of conductances: c, k and the contact's area, m²."""
    if radius is None:
        return None
    law = None if calibration is None else calibration.pressure
    if law is None:
        raise ValueError(
            "--radius: got no law of pressure, expected --calibration with one"
        )
    return *law, math.pi * radius**2
