"""Commands that find out what a rig really is: `tomojax calibrate` and `check`."""

import json
import sys
import time
from pathlib import Path
from typing import Any

import click

from tomojax._whole import whole, write_text
from tomojax.cli.entry import (
    AMOUNT,
    Command,
    COUNT,
    InputFile,
    OutputFile,
    stages,
    stretch_options,
)
from tomojax.cli.recordings import layout_option, opened


@click.command(cls=Command)
@click.argument("rec", type=InputFile())
@click.argument("places", type=InputFile(), required=False)
@click.option(
    "-o",
    "--out",
    type=OutputFile("calibration", lambda given: _calibration_of(given["rec"])),
    help="Write the calibration here. [default: REC.calibration.json]",
)
@click.option(
    "--older", "before", type=InputFile(), help="Begin with this older calibration."
)
@click.option(
    "--frames",
    type=int,
    default=1000,
    show_default=True,
    help="Use this many frames of ten slots at most.",
)
@click.option("--overwrite", is_flag=True, help="Replace the calibration that is there.")
@click.option(
    "--picture",
    type=OutputFile("picture"),
    help="Draw the sheet and electrodes here (PNG); replaces a picture.",
)
@click.option(
    "--json",
    "json_path",
    type=OutputFile("report"),
    help="Write the printed figures here; replaces an earlier report.",
)
@layout_option
@stretch_options
def calibrate(
    rec: Path,
    places: Path | None,
    out: Path,
    before: Path | None,
    frames: int,
    overwrite: bool,
    picture: Path | None,
    json_path: Path | None,
    layout: dict,
    since: float | None,
    until: float | None,
) -> None:
    """Calibrate the rig from REC, a recording of a rub.

    Rub the whole sheet with one finger or a blunt pen. The finger's places need not be
    known. The command finds places, gains, zeros, the sheet, the ground paths and the
    electrodes' places together.

    PLACES, where you have them, gives x and y in metres of each slot or each scan. PLACES
    is a .csv file, or an .npz file that holds `xy`. `tomojax reconstruct --calibration`
    uses the result.
    """
    if out.exists() and not overwrite:
        raise ValueError(f"{out}: is there already; give another -o, or --overwrite")
    if frames < 16:
        raise ValueError(f"frames: got {frames}, expected 16 or more")

    say = stages()
    with opened(rec, layout, since, until) as recording:
        # JAX is imported from here on: what is wrong with REC is told without.
        from tomojax import calibration as room
        from tomojax.sensor import Calibration

        sensor = recording.rig.sensor()
        told = room.read_places(places) if places else None
        older = Calibration.load(before, recording.electrodes) if before else None
        try:
            found = room.calibrated_recording(
                recording, told, frames, calibration=older, progress=say
            )
        except ValueError as error:
            say("")
            raise ValueError(f"{rec}: {error}") from None
    say("")
    found.calibration.save(out)
    print(room.text(sensor, found))
    print(f"calibration: {out}")
    if picture:
        with whole(picture) as part:
            room.picture(sensor, found).savefig(part, dpi=110)
        print(f"picture: {picture}")
    if json_path:
        from tomojax._environment import environment

        row = room.summary(sensor, found)
        report = {"rows": [row], "summary": row, "environment": environment()}
        write_text(json_path, json.dumps(report, indent=1) + "\n")


def _calibration_of(rec: Path) -> Path:
    return rec.with_name(rec.stem + ".calibration.json")


# Names of sources that are no files.
_SOURCES = ("serial:", "udp://", "ni:", "virtual")


class _Corners(click.ParamType):
    """Two electrodes, or none."""

    name = "A,B"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if not isinstance(value, str) or value == "auto":
            return value
        if value == "none":
            return None
        parts = value.split(",")
        if len(parts) != 2 or not all(part.strip().isdigit() for part in parts):
            self.fail(f"got {value!r}, expected two electrodes as 0,7, or none", param, ctx)
        return int(parts[0]), int(parts[1])


@click.command(cls=Command)
@click.argument("source", metavar="SOURCE|REC")
@click.option(
    "--corners",
    type=_Corners(),
    default="auto",
    help="The two electrodes at the corners that were touched in the end, as 0,7, or "
    "none. [default: 0 and the last of row 0]",
)
@click.option(
    "-o",
    "--out",
    type=OutputFile("recording"),
    help="Keep the recording of SOURCE here. [default: check-DATE-TIME.h5]",
)
@click.option(
    "--write",
    type=OutputFile("order"),
    help="Write the corrected order of wires here, for --config of `tomojax live`; "
    "replaces an earlier order.",
)
@click.option(
    "--picture",
    type=OutputFile("picture"),
    help="Draw the sheet and its faults here (PNG); replaces a picture.",
)
@click.option(
    "--json",
    "json_path",
    type=OutputFile("report"),
    help="Write the faults here; replaces an earlier report.",
)
@click.option("--like", type=InputFile(), help="Expect as many channels as this recording.")
@click.option(
    "--quiet",
    type=AMOUNT,
    default=4.0,
    show_default=True,
    help="Record SOURCE untouched for this time, s.",
)
@click.option(
    "--rub",
    type=AMOUNT,
    default=20.0,
    show_default=True,
    help="Record a rub on SOURCE for this time, s.",
)
@click.option(
    "--touch",
    type=AMOUNT,
    default=3.0,
    show_default=True,
    help="Record each touch on SOURCE for this time, s.",
)
@click.option("--baud", type=COUNT, help="Speed of a serial line, baud. [default: 4000000]")
@click.option("--bind", help="Listen here over UDP. [default: 127.0.0.1, this machine]")
@layout_option
@stretch_options
def check(
    source: str,
    corners: Any,
    out: Path | None,
    write: Path | None,
    picture: Path | None,
    json_path: Path | None,
    like: Path | None,
    quiet: float,
    rub: float,
    touch: float,
    baud: int | None,
    bind: str | None,
    layout: dict,
    since: float | None,
    until: float | None,
) -> int:
    """Check a new rig: wires, grounds, noise, places and sheet.

    The command also judges the drive and the gains. REC is judged, or SOURCE (serial:PORT,
    udp://HOST:PORT, ni:INPUTS,LINES, or virtual) is recorded first. While SOURCE is
    recorded, the command says what to do in turn.

    REC begins with some seconds of nothing, and some of rubbing anywhere with a finger or a
    blunt pen. REC ends with two touches that hold still, with pauses before and after.
    Touch the corner of electrode 0 first (x and y least), then the corner at the end of row
    0 (x least, y most). Nothing else tells a mirrored or a turned array. The report names
    each part that REC lacks, and does not judge that part.

    Electrode e is row·columns + column; rows run along x, columns along y. The best ground
    conditions are all (`tomojax record --pattern all`).

    Exit status: 0 no fault, 1 faults, 2 nothing could be said.
    """
    path = Path(source)
    if source.startswith(_SOURCES) and not path.is_file():
        if min(quiet, rub, touch) <= 0:
            raise ValueError(f"seconds: got {min(quiet, rub, touch)}, expected above 0")
        path = out or Path(time.strftime("check-%Y%m%d-%H%M%S.h5"))
        _record(source, path, like, quiet, rub, touch, corners, baud=baud, bind=bind)

    say = stages()
    with opened(path, layout, since, until) as recording:
        if like is not None:
            _same_sensor(path, recording, like)
        from tomojax import bringup  # imports JAX, without which a bad file is told

        try:
            found = bringup.check(recording, corners, progress=say)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        finally:
            say("")
    print(bringup.text(found))
    if write:
        bringup.write_order(found, write)
        print(f"order of channels and grounds: {write}; use it with --config {write}")
    if picture:
        with whole(picture) as part:
            bringup.picture(found).savefig(part, dpi=110)
        print(f"picture: {picture}")
    if json_path:
        from tomojax._environment import environment

        report = bringup.summary(found) | {"environment": environment()}
        write_text(json_path, json.dumps(report, indent=1) + "\n")
    return 1 if found.faults else 0


def _same_sensor(path: Path, recording: Any, like: Path) -> None:
    """Checks that two recordings have as many channels.

    **Raises:** `ValueError` where the numbers of channels differ.
    """
    from tomojax.recordings import open_recording

    with open_recording(like) as other:
        here, there = recording.electrodes, other.electrodes
    if here != there:
        raise ValueError(f"{path}: v: got {here} channels, expected {there}, as {like} has")


def _record(
    source: str,
    out: Path,
    like: Path | None,
    quiet: float,
    rub: float,
    touch: float,
    corners: Any,
    **given: Any,
) -> None:
    """Records a source while the user is told what to do."""
    import numpy as np

    from tomojax.cli._session import session

    first = "the corner of electrode 0 (x and y least)"
    second = "the corner at the end of row 0 (x least, y most)"
    if corners not in ("auto", None):
        first, second = (f"the corner of electrode {c}" for c in corners)
    pause = 2.0
    words = [
        (quiet, "leave the sheet alone"),
        (rub, "rub the sheet anywhere, all over"),
        (pause, "lift off"),
    ]
    if corners is not None:
        words += [
            (touch, f"touch {first} and hold still"),
            (pause, "lift off"),
            (touch, f"touch {second} and hold still"),
            (pause, "lift off"),
        ]
    starts = np.cumsum([0.0, *(seconds for seconds, _ in words)]).tolist()
    said = iter(zip(starts, words))
    due = [next(said)]

    def tell(seconds: float) -> None:
        while due and seconds >= due[0][0]:
            length, text = due.pop()[1]
            print(f"{text} ({length:g} s)", file=sys.stderr, flush=True)
            due.extend([one] if (one := next(said, None)) else [])

    options = given | {
        "like": like, "speed": None, "view": "none", "rrd": None, "since": None,
        "until": None, "seconds": starts[-1], "file_seconds": 1e6,
    }  # fmt: skip
    prepare = lambda sensor: list(range(sensor.electrode_count))  # noqa: E731
    with session(source, out, options, prepare) as (opened, asked):
        opened.source.set_grounds(asked)
        opened.run(None, tell=tell)
