"""What the commands do with recordings of pairs: kind "conductivity"."""

from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from tomojax._require import naming, require
from tomojax.cli import entry


def is_pairs(rec: Path) -> bool:
    """Tells whether a file is a recording of current between pairs of electrodes."""
    from tomojax.files import readers

    if rec.suffix.lower() not in (".csv", ".npz", ".tsv", ".txt"):
        readers.begin()  # while this process imports what it needs itself
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
    entry.write_report(json_path, rows=[found], summary=found)


def reconstruct_pairs(rec: Path, out: Path, options: dict[str, Any]) -> None:
    """Locates the press of each frame, by a response or by the nominal sheet.

    With --contacts, one or two presses, by the nominal sheet.
    """
    from tomojax import ert

    taken = "contacts", "out", "overwrite", "json_path", "picture", "rec"
    recording, given = ert.load(rec), options["calibration"]
    source = click.get_current_context().get_parameter_source("contacts")
    if source == ParameterSource.COMMANDLINE:
        only(*taken)
        with naming(rec):
            found = ert.changes(recording, options["contacts"])
    else:
        only(*taken, "calibration")
        with naming(given or rec):
            response = ert.Response.load(given) if given else ert.nominal(recording)
        with naming(rec):
            found = response.locate(recording.voltages)
    ert.write_results(recording, found, out, given, options["overwrite"])
    told = ert.summary_located(recording, found)
    print(ert.located_text(told, out))
    entry.write_report(options["json_path"], rows=[told], summary=told)
    if options["picture"]:
        from tomojax.results.plots import timeline

        entry.save_picture(timeline(out), options["picture"])


def calibrate_pairs(
    rec: Path, places: Path | None, out: Path, frames: int | None, options: dict[str, Any]
) -> None:
    """Learns a rig's response from presses, and writes the response."""
    from tomojax import ert
    from tomojax.calibration import read_places

    only("rec", "places", "out", "frames", "known", "response", "overwrite", "json_path")
    recording, known = ert.load(rec), options["known"] or "all"
    with naming(rec), entry.Progress("calibrate") as progress:
        if places is not None:
            recording = replace(recording, places=read_places(places))
        if known != "all":
            fits = known == "none" or known.isdecimal()
            require(fits, "--places", repr(known), "a number, none or all")
            recording = recording.knowing(0 if known == "none" else int(known))
        response = ert.learn(recording, frames=frames, progress=progress.say)
        found = ert.summary_located(recording, response.locate(recording.voltages))
    response.save(out)
    row = {
        "frames": min(found["rows_in_all"], frames or found["rows_in_all"]),
        "places_known": response.known,
        "deviation_median_mm": found["deviation_median_mm"],
    }
    known = f"{row['places_known']} at known places"
    print(f"response of the presses of {row['frames']} frames, {known}")
    print(f"stated deviation of a place: {row['deviation_median_mm'] or nan:.3g} mm")
    print(f"calibration: {out}")
    entry.write_report(options["json_path"], rows=[row], summary=row)


def check_pairs(rec: Path, json_path: Path | None) -> int:
    """Prints what is wrong with a rig that reads pairs; returns the exit status."""
    from tomojax import ert

    only("source", "json_path")
    recording = ert.load(rec)
    with naming(rec):
        faults = ert.check(recording)
    print(f"{len(faults)} fault{'s'[: len(faults) != 1]}" if faults else "no fault found")
    for fault in faults:
        print(f"- {fault.kind}: {fault.text}\n  mend: {fault.mend}")
    rows = [fault._asdict() for fault in faults]
    entry.write_report(json_path, rows=rows, summary={"faults": len(faults)})
    return 1 if faults else 0
