"""`tomojax check`: checks a new rig from a recording of rest, a rub and two touches."""

import sys
import time
from itertools import accumulate
from pathlib import Path
from typing import Any

import click

from tomojax._require import naming, require
from tomojax.cli import entry
from tomojax.cli.recordings import (
    check_pairs,
    is_pairs,
    layout_option,
    opened,
    stretch,
)
from tomojax.cli.rigs._session import session

_PAUSE = 2.0  # s, between the parts of a recording

# Names of sources that are no files.
_SOURCES = ("serial:", "udp://", "ni:", "virtual")


_WORDS = {"auto": "auto", "none": None}
_CORNERS = entry.Pair(int, "A,B", "two electrodes as 0,7, or none", words=_WORDS)


@click.command(cls=entry.Command)
@click.argument("source", metavar="SOURCE|REC")
@click.option(
    "--corners",
    type=_CORNERS,
    default="auto",
    show_default=False,
    help="The two electrodes at the corners that were touched in the end, as 0,7, or "
    "none. [default: 0 and the last of row 0]",
)
@entry.out_option(
    entry.OutputFile("recording"),
    "Keep the recording of SOURCE here. [default: check-DATE-TIME.h5]",
)
@click.option(
    "--write",
    type=entry.OutputFile("order"),
    help="Write the corrected order of wires here, for --config of `tomojax live`; "
    "replaces an earlier order.",
)
@entry.picture_option("the sheet and its faults")
@entry.json_option("the faults")
@click.option(
    "--like", type=entry.InputFile(), help="Expect as many channels as this recording."
)
@click.option(
    "--quiet",
    type=entry.AMOUNT,
    default=4.0,
    help="Record SOURCE untouched for this time, s.",
)
@click.option(
    "--rub",
    type=entry.AMOUNT,
    default=20.0,
    help="Record a rub on SOURCE for this time, s.",
)
@click.option(
    "--touch",
    type=entry.AMOUNT,
    default=3.0,
    help="Record each touch on SOURCE for this time, s.",
)
@entry.wire_options
@layout_option
@entry.stretch_options
def check(source: str, corners: Any, like: Path | None, **options: Any) -> int:
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

    A recording of pairs needs presses anywhere, one at a time: electrodes that say nothing,
    and exchanged or reversed wires are named.

    Exit status: 0 no fault, 1 faults, 2 nothing could be said.
    """
    path = Path(source)
    if is_pairs(path):
        return check_pairs(path, options["json_path"])
    if source.startswith(_SOURCES) and not path.is_file():
        path = options["out"] or Path(time.strftime("check-%Y%m%d-%H%M%S.h5"))
        _record(source, path, corners, options | {"like": like})

    with opened(path, **stretch(options)) as recording:
        if like is not None:
            count, (_, _, wanted) = recording.electrodes, entry.sheet_of(like)
            expected = f"{wanted}, as {like} has"
            require(count == wanted, f"{path}: v", f"{count} channels", expected)
        from tomojax import bringup  # imports JAX, without which a bad file is told

        with entry.Progress() as progress, naming(path):
            found = bringup.check(recording, corners, progress=progress.say)
    print(bringup.text(found))
    if write := options["write"]:
        bringup.write_order(found, write)
        print(f"order of channels and grounds: {write}; use it with --config {write}")
    if options["picture"]:
        entry.save_picture(bringup.picture(found), options["picture"])
    entry.write_report(options["json_path"], **bringup.summary(found))
    return 1 if found.faults else 0


def _record(source: str, out: Path, corners: Any, options: dict[str, Any]) -> None:
    """Records a source while the user is told what to do."""
    first = "the corner of electrode 0 (x and y least)"
    second = "the corner at the end of row 0 (x least, y most)"
    if corners not in ("auto", None):
        first, second = (f"the corner of electrode {c}" for c in corners)
    words = [
        (options["quiet"], "leave the sheet alone"),
        (options["rub"], "rub the sheet anywhere, all over"),
        (_PAUSE, "lift off"),
    ]
    for corner in () if corners is None else (first, second):
        words.append((options["touch"], f"touch {corner} and hold still"))
        words.append((_PAUSE, "lift off"))
    starts = list(accumulate((seconds for seconds, _ in words), initial=0.0))
    due = list(zip(starts, words))

    def tell(seconds: float) -> None:
        while due and seconds >= due[0][0]:
            length, text = due.pop(0)[1]
            print(f"{text} ({length:g} s)", file=sys.stderr, flush=True)

    options |= {
        "speed": None, "view": "none", "rrd": None, "since": None, "until": None,
        "seconds": starts[-1], "file_seconds": 1e6,
    }  # fmt: skip
    prepare = lambda sensor: list(range(sensor.condition_count))  # noqa: E731
    with session(source, out, options, prepare) as (opened, asked):
        opened.source.set_grounds(asked)
        opened.run(None, tell=tell)
