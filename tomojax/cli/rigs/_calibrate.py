"""`tomojax calibrate`: finds out what a rig really is from a rub."""

from pathlib import Path
from typing import Any

import click

from tomojax._require import naming
from tomojax.cli import entry
from tomojax.cli.recordings import layout_option, opened, stretch


@click.command(cls=entry.Command)
@click.argument("rec", type=entry.InputFile())
@click.argument("places", type=entry.InputFile(), required=False)
@click.option(
    "-o",
    "--out",
    type=entry.OutputFile("calibration", lambda given: _calibration_of(given["rec"])),
    help="Write the calibration here. [default: REC.calibration.json]",
)
@click.option(
    "--older", "before", type=entry.InputFile(), help="Begin with this older calibration."
)
@click.option(
    "--frames",
    type=int,
    default=1000,
    help="Use this many frames of ten slots at most.",
)
@click.option("--overwrite", is_flag=True, help="Replace the calibration that is there.")
@entry.picture_option("the sheet and electrodes")
@entry.json_option("the printed figures")
@layout_option
@entry.stretch_options
def calibrate(
    rec: Path, places: Path | None, out: Path, frames: int, **options: Any
) -> None:
    """Calibrate the rig from REC, a recording of a rub.

    Rub the whole sheet with one finger or a blunt pen. The finger's places need not be
    known. The command finds places, gains, zeros, the sheet, the ground paths and the
    electrodes' places together.

    PLACES, where you have them, gives x and y in metres of each slot or each scan. PLACES
    is a .csv file, or an .npz file that holds `xy`. `tomojax reconstruct --calibration`
    uses the result.
    """
    if out.exists() and not options["overwrite"]:
        raise ValueError(f"{out}: is there already; give another -o, or --overwrite")
    if frames < 16:
        raise ValueError(f"frames: got {frames}, expected 16 or more")

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
                recording, told, frames, calibration=older, progress=progress.say
            )
    found.calibration.save(out)
    print(room.text(sensor, found))
    print(f"calibration: {out}")
    if options["picture"]:
        entry.save_picture(room.picture(sensor, found), options["picture"])
    row = room.summary(sensor, found)
    entry.write_report(options["json_path"], rows=[row], summary=row)


def _calibration_of(rec: Path) -> Path:
    return rec.with_name(rec.stem + ".calibration.json")
