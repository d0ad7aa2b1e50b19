"""Commands that find out what a rig really is: `tomojax calibrate`."""

import json
import sys
from pathlib import Path

import click

from tomojax.cli._recordings import tdms_option

_FILE = click.Path(path_type=Path)
_REPORT = click.Path(dir_okay=False, path_type=Path)


@click.command()
@click.argument("rec", type=_FILE)
@click.argument("places", type=_REPORT, required=False)
@click.option("-o", "--out", type=_REPORT, help="[default: REC.calibration.json]")
@click.option("--from", "before", type=_FILE, help="An older calibration to begin with.")
@click.option(
    "--frames", type=int, default=1000, show_default=True, help="At most, of ten slots."
)
@click.option("--overwrite", is_flag=True, help="Replace the calibration that is there.")
@click.option("--picture", type=_REPORT, help="Draw sheet and electrodes here (PNG).")
@click.option("--json", "json_path", type=_REPORT, help="Write the printed figures here.")
@tdms_option
def calibrate(
    rec: Path,
    places: Path | None,
    out: Path | None,
    before: Path | None,
    frames: int,
    overwrite: bool,
    picture: Path | None,
    json_path: Path | None,
    tdms: dict,
) -> None:
    """Calibrate the rig from REC: rub the whole sheet with one finger or a blunt pen.

    Where the contact is need not be known: places, gains, zeros, the sheet, the ground
    paths and the electrodes' places are found together.
    PLACES, where you have them, has x and y in metres, of each slot or of each scan: `xy`
    in an .npz file, or a .csv file. `tomojax reconstruct --calibration` uses the result.
    """
    from tomojax import calibration as room
    from tomojax.recordings import open_recording
    from tomojax.sensor import Calibration

    out = out or rec.with_name(rec.stem + ".calibration.json")
    if out.exists() and not overwrite:
        raise ValueError(f"{out}: is there already; give another -o, or --overwrite")
    if frames < 16:
        raise ValueError(f"frames: got {frames}, expected 16 or more")

    def say(text: str) -> None:
        if sys.stderr.isatty():
            end = "" if text else "\r"
            print(f"\r\033[K{text}", end=end, file=sys.stderr, flush=True)

    with open_recording(rec, **tdms) as recording:
        sensor = recording.rig.sensor()
        told = room.read_places(places) if places else None
        older = Calibration.load(before) if before else None
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
        room.picture(sensor, found).savefig(picture, dpi=110)
        print(f"picture: {picture}")
    if json_path:
        from tomojax._environment import environment

        row = room.summary(sensor, found)
        report = {"rows": [row], "summary": row, "environment": environment()}
        json_path.write_text(json.dumps(report, indent=1) + "\n")
