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
    stages,
    stretch_options,
    whole_number,
)

# While JAX is imported and compiles, nothing else is seen.
_COMPILING = (
    "compiling the step: up to half a minute the first time; later runs start in seconds"
)


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
            return [whole_number(part) for part in parts]
        except (TypeError, ValueError):
            self.fail(f"got {value!r}, expected whole numbers with commas", param, ctx)


def _shared(command: Any) -> Any:
    """Adds the options that both commands have."""
    for option in (
        click.option(
            "--config",
            type=InputFile(empty=True),
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
            show_default=True,
            help="Show the session here: in the terminal, a browser (web), Rerun, or not.",
        ),
        click.option(
            "--rrd",
            type=OutputFile("view"),
            help="Write the view of --view rerun to this file and open no viewer; "
            "replaces an earlier view.",
        ),
        click.option(
            "--seconds",
            type=AMOUNT,
            help="Stop after this time, s. [default: until Ctrl-C]",
        ),
        click.option(
            "--file-seconds",
            type=AMOUNT,
            default=3600.0,
            show_default=True,
            help="Begin a new file of the recording after this time, s.",
        ),
        click.option("--baud", type=COUNT, help="Serial baud rate. [default: 4000000]"),
        click.option(
            "--bind", help="Listen here over UDP. [default: 127.0.0.1, this machine only]"
        ),
        click.option(
            "--speed",
            type=AMOUNT,
            help="Replay a recording this many times as fast as measured. [default: "
            "as fast as it is read]",
        ),
        click.option(
            "--like",
            type=InputFile(),
            help="Take the sheet and electrodes from this recording of the rig. "
            "[default: the paper's sensor]",
        ),
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
    help="Write the recording to this file.",
)
@click.option(
    "--pattern",
    default="all",
    show_default=True,
    help="Ground these electrodes in turn, over and over: a pattern's name (all, boundary, "
    "edge, v_line, random_16, random_8), or electrodes as 0,7,14.",
)
@click.option(
    "--calibrate",
    is_flag=True,
    help="Show which squares of the sheet were touched, and calibrate at the end.",
)
def record(source: str, out: Path, pattern: str, calibrate: bool, **options: Any) -> None:
    """Record the slots of SOURCE.

    SOURCE is serial:PORT, udp://HOST:PORT, ni:INPUTS,LINES, or virtual, a simulated rig. A
    scan of the recording is one slot. Slots on the disk stay readable whatever happens.
    After a crash or a full disk a new file begins: OUT-1, OUT-2, ….

    For --calibrate, rub the whole sheet with one finger. A map fills, and lines say how
    well each part is known. Ctrl-C ends the rub and makes OUT.calibration.json.
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

    print("calibrating: one to two minutes the first time …", file=sys.stderr)
    say = stages()
    with open_recording(rec) as recording:
        try:
            found = calibrated_recording(recording, progress=say)
        except ValueError as error:
            raise ValueError(f"{rec}: {error}") from None
        say("")
        print(text(recording.rig.sensor(), found))
    found.calibration.save(made)
    print(f"calibration: {made}")


@click.command(cls=Command)
@_shared
@click.option(
    "--method",
    default="follow",
    show_default=True,
    help="Find contacts by this method: follow, or one that sees each slot alone.",
)
@click.option(
    "--policy",
    default="around_contacts",
    show_default=True,
    help="Choose the next grounds by this policy: a name of tomojax.step.POLICIES, "
    "electrodes as 0,7,14, or a table of `tomojax design --policy`.",
)
@click.option("--cheaper", help="Method for slots that are late. [default: the same]")
@click.option(
    "--budget", type=AMOUNT, help="A slot older than this is late, s. [default: one slot]"
)
@click.option(
    "--contacts",
    type=COUNT,
    default=2,
    show_default=True,
    help="Find this many contacts at most.",
)
@click.option("--calibration", type=InputFile(), help="Apply this calibration of the rig.")
@click.option(
    "--adapt",
    is_flag=True,
    help="Follow zeros and gains that drift slowly. If --record OUT is given, "
    "OUT.adapted.h5 logs them.",
)
@click.option(
    "--shapes",
    is_flag=True,
    help="Let a separate process draw the view's image by the method shape.",
)
@click.option(
    "--record",
    "out",
    type=OutputFile("recording", also=(".adapted.h5",)),
    help="Write the slots to this recording as well. [default: no recording]",
)
@click.option(
    "--send",
    multiple=True,
    metavar="KIND:WHERE",
    help="Send contacts, touch-downs and lift-offs to udp://HOST:PORT, jsonl:FILE (- is "
    "standard output), osc://HOST:PORT, lsl:NAME or foxglove:PORT. Add ?rate=100 "
    "for at most 100 rows a second. May be repeated.",
)
@click.option(
    "--radius",
    type=AMOUNT,
    help="Radius of the tip that presses, m. --send then includes forces. Needs a "
    "--calibration with a law of pressure.",
)
@click.option(
    "--real-time",
    is_flag=True,
    help="Answer sooner: one core, one compiled function, no garbage collection, "
    "SCHED_FIFO where the system allows.",
)
def live(source: str, method: str, policy: str, out: Path | None, **options: Any) -> None:
    """Find the contacts in each slot of SOURCE as the slot comes.

    SOURCE is serial:PORT, udp://HOST:PORT, ni:INPUTS,LINES, a recording, or virtual, a
    simulated rig. The command sends the next grounds back to SOURCE.
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
    """Returns c, k and the contact's area, m², which turn conductances into forces."""
    if radius is None:
        return None
    law = None if calibration is None else calibration.pressure
    if law is None:
        raise ValueError(
            "--radius: got no law of pressure, expected --calibration with one"
        )
    return *law, math.pi * radius**2
