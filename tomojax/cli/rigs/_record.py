"""`tomojax record`: records the slots of a rig."""

import sys
from pathlib import Path
from typing import Any

import click

from tomojax._require import naming
from tomojax.cli import entry
from tomojax.cli.rigs._options import session_options
from tomojax.cli.rigs._session import session


@click.command(cls=entry.Command)
@session_options
@entry.out_option(
    entry.OutputFile("recording", also=(".calibration.json",)),
    "Write the recording to this file.",
    required=True,
)
@click.option(
    "--pattern",
    default="all",
    help="Ground these electrodes in turn, over and over: a pattern's name (all, boundary, "
    "edge, v_line, random_16, random_8), or electrodes as 0,7,14. Rows of a rig's table.",
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

    def check(electrodes: int, conditions: int) -> list[int] | None:
        return entry.ground_numbers("--pattern", pattern, conditions)

    if entry.ground_numbers("--pattern", pattern) is None:
        entry.check_name(
            "--pattern", pattern, entry.FIXED, ", or electrodes with commas: 0,7,14"
        )

    def grounds(sensor: Any) -> list[int]:
        import numpy as np

        from tomojax.paper import pattern as pattern_named

        own = check(sensor.electrode_count, sensor.condition_count)
        return own or np.asarray(pattern_named(sensor, pattern)).tolist()

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
    with open_recording(rec) as recording:
        with entry.Progress() as progress, naming(rec):
            found = calibrated_recording(recording, progress=progress.say)
        print(text(recording.rig.sensor(), found))
    found.calibration.save(made)
    print(f"calibration: {made}")
