"""`tomojax info`: prints what a recording holds, and its faults."""

from pathlib import Path
from typing import Any

import click

from tomojax._require import naming
from tomojax.cli import entry
from tomojax.cli.recordings._opened import layout_option, opened, stretch
from tomojax.cli.recordings._pairs import info_pairs, is_pairs


@click.command(cls=entry.Command)
@click.argument("rec", type=entry.InputFile())
@click.option(
    "--calibration",
    type=entry.InputFile(),
    help="Say how old this calibration is, and whether REC still fits it.",
)
@entry.json_option("the faults and a summary")
@layout_option
@entry.stretch_options
def info(
    rec: Path, calibration: Path | None, json_path: Path | None, **options: Any
) -> None:
    """Print what the recording REC holds, and its faults.

    The command also looks for signs of wrong wiring.
    """
    if is_pairs(rec):
        return info_pairs(rec, json_path)
    from tomojax.bringup.signs import find_signs
    from tomojax.recordings import info

    known = fit = None
    with opened(rec, **stretch(options)) as recording:
        if calibration is not None:
            from tomojax.sensor import Calibration  # imports JAX: REC alone needs none

            known = Calibration.load(calibration, recording.electrodes)
        summary = info.summary(recording)
        with entry.Progress("info", "chunks") as progress:
            rows = info.faults(recording, progress)
        signs = find_signs(recording)
        rows += [{"fault": s.text, "scans": None, "where": []} for s in signs]
        if known is not None:
            from tomojax.calibration import still_fits

            with naming(calibration):
                fit = still_fits(recording, known)
    print(info.text(rec, summary, rows))
    if fit is not None:
        from tomojax.calibration import fit_text

        print(fit_text(fit))
        summary["calibration"] = {"file": str(calibration), **fit}
    entry.write_report(json_path, rows=rows, summary=summary)
