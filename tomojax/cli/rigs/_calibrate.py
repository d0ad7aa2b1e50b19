"""`tomojax calibrate`: finds out what a rig really is from a rub."""

from pathlib import Path
from typing import Any

import click

from tomojax._require import naming, require
from tomojax.cli import entry
from tomojax.cli.recordings import (
    calibrate_pairs,
    is_pairs,
    layout_option,
    opened,
    stretch,
)

_FRAMES = 1000


@click.command(cls=entry.Command)
@click.argument("rec", type=entry.InputFile())
@click.argument("places", type=entry.InputFile(), required=False)
@entry.out_option(
    entry.OutputFile("calibration", lambda given: _calibration_of(given["rec"])),
    "Write the calibration here. [default: REC.calibration.json; "
    "REC.response.h5 of a recording of kind conductivity]",
)
@click.option(
    "--older", "before", type=entry.InputFile(), help="Begin with this older calibration."
)
@click.option(
    "--frames",
    type=int,
    help="Use this many frames at most, of ten slots each. [default: 1000; all of a "
    "recording of kind conductivity]",
)
@click.option(
    "--response",
    is_flag=True,
    help="Learn the response from place to voltages: what is done with a recording of kind "
    "conductivity.",
)
@click.option(
    "--places",
    "known",
    metavar="N|none|all",
    help="Use the first N of the places that a recording of kind conductivity has. "
    "[default: all]",
)
@click.option("--overwrite", is_flag=True, help="Replace the calibration that is there.")
@entry.picture_option("the sheet and electrodes")
@entry.json_option("the printed figures")
@layout_option
@entry.stretch_options
def calibrate(
    rec: Path, places: Path | None, out: Path, frames: int | None, **options: Any
) -> None:
    """Calibrate the rig from REC, a recording of a rub.

    Rub the whole sheet with one finger or a blunt pen. The finger's places need not be
    known. The command finds places, gains, zeros, the sheet, the ground paths and the
    electrodes' places together.

    PLACES, where you have them, gives x and y in metres of each slot or each scan. PLACES
    is a .csv file, or an .npz file that holds `xy`. `tomojax reconstruct --calibration`
    uses the result.

    A recording of kind conductivity teaches its response, with known places or without.
    """
    if out.exists() and not options["overwrite"]:
        raise ValueError(f"{out}: is there already; give another -o, or --overwrite")
    if frames is not None and frames < 16:
        raise ValueError(f"frames: got {frames}, expected 16 or more")
    if is_pairs(rec):
        return calibrate_pairs(rec, places, out, frames, options)
    for name in ("response", "known"):
        wanted = f"{rec}, of kind 'contact'", "a recording of kind 'conductivity'"
        require(not options[name], f"--{name.replace('known', 'places')}", *wanted)

    with opened(rec, **stretch(options)) as recording:
        # JAX is imported from here on: what is wrong with REC is told without.
        from tomojax import calibration as room
        from tomojax.sensor import Calibration

        sensor = recording.rig.sensor()
        told = room.read_places(places) if places else None
        before = options["before"]
        older = Calibration.load(before, recording.electrodes) if before else None
        with entry.Progress() as progress, naming(rec):
            found = room.calibrated_recording(
                recording, told, frames or _FRAMES, calibration=older, progress=progress.say
            )
    found.calibration.save(out)
    print(room.text(sensor, found))
    print(f"calibration: {out}")
    if options["picture"]:
        entry.save_picture(room.picture(sensor, found), options["picture"])
    row = room.summary(sensor, found)
    entry.write_report(options["json_path"], rows=[row], summary=row)


def _calibration_of(rec: Path) -> Path:
    ending = ".response.h5" if is_pairs(rec) else ".calibration.json"
    return rec.with_name(rec.stem + ending)
