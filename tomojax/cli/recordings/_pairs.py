"""What the commands do with recordings of pairs: kind "conductivity"."""

from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from tomojax._require import naming, require
from tomojax.cli import entry


def is_pairs(rec: Path) -> bool:
    """Tells whether a file is a recording of current between pairs of electrodes."""
    from tomojax.recordings import kind_of

    return rec.is_file() and kind_of(rec) == "conductivity"


def only(*names: str) -> None:
    """Refuses the command's other options. **Raises:** `ValueError` that names one."""
    context = click.get_current_context()
    for one in context.command.params:
        given = context.get_parameter_source(one.name or "") == ParameterSource.COMMANDLINE
        if given and one.name not in names:
            told = max(one.opts, key=len)
            raise ValueError(f"{told}: recordings of kind conductivity do not take it")


def info_pairs(rec: Path, json_path: Path | None) -> None:
    """Prints what a recording of pairs holds."""
    from tomojax import ert

    only("rec", "json_path")
    found = ert.summary(ert.load(rec))
    print(ert.info_text(rec, found))
    rows = [{"fault": "never changes", "reading": cr} for cr in found["never_change"]]
    entry.write_report(json_path, rows=rows, summary=found)


def reconstruct_pairs(rec: Path, out: Path, options: dict[str, Any]) -> None:
    """Locates the press of each frame, by a response or by the nominal sheet."""
    from tomojax import ert

    only("rec", "out", "calibration", "overwrite", "json_path")
    recording, given = ert.load(rec), options["calibration"]
    with naming(given or rec):
        response = ert.Response.load(given) if given else ert.nominal(recording)
    with naming(rec):
        found = response.locate(recording.voltages)
    ert.write_results(recording, found, out, given, options["overwrite"])
    told = ert.summary_located(recording, found)
    print(ert.located_text(told, out))
    entry.write_report(options["json_path"], rows=[told], summary=told)


def calibrate_pairs(
    rec: Path, places: Path | None, out: Path, frames: int | None, options: dict[str, Any]
) -> None:
    """Learns a rig's response from presses, and writes the response."""
    import numpy as np

    from tomojax import ert
    from tomojax.calibration import read_places

    only("rec", "places", "out", "frames", "known", "response", "overwrite", "json_path")
    recording = ert.load(rec)
    with naming(rec), entry.Progress("calibrate") as progress:
        if options["known"] not in (None, "all"):
            recording = recording.knowing(_count(options["known"]))
        told = None if places is None else read_places(places)
        given = {"known": told, "frames": frames, "progress": progress.say}
        response = ert.learn(recording, **given)
        found = response.locate(recording.voltages)
    response.save(out)
    known = recording.known if told is None else np.isfinite(told).all(1)
    row = {
        "frames": min(len(recording.voltages), frames or len(recording.voltages)),
        "places_known": int(known.sum()),
        "deviation_median_mm": ert.summary_located(recording, found)["deviation_median_mm"],
    }
    told = "not told" if row["deviation_median_mm"] is None else ""
    told = told or f"{row['deviation_median_mm']:.3g} mm in the median"
    print(f"response of {row['frames']} frames, {row['places_known']} at known places")
    print(f"stated deviation of a place: {told}")
    print(f"calibration: {out}")
    entry.write_report(options["json_path"], rows=[row], summary=row)


def _count(text: str) -> int:
    if text == "none":
        return 0
    require(text.isdecimal(), "--places", repr(text), "a number, none or all")
    return int(text)
