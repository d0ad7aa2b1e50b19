"""Writes located presses as results, version 1, and sums them up."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._environment import environment
from tomojax.ert._changes import Changes
from tomojax.ert._locator import Located
from tomojax.ert.recorded._recording import PairRecording
from tomojax.ert.recorded._told import quantile
from tomojax.kernels.flags import DOUBT, Flag, NO_ANSWER
from tomojax.methods import empty_rows, fields_of_rows
from tomojax.results import Dataset, report, write_rows


def write_results(
    recording: PairRecording,
    found: Located | Changes,
    out: Path,
    response: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Writes a row for each frame: places, covariances, strengths, residual and flags.

    Places are as the recording has them. `contact_strength` is relative, or S·m² of
    `Changes`, and `residual` counts standard deviations. A row without a contact, or
    without an answer, has NaN.

    **Raises:** `ValueError` where OUT cannot be made, or is there already.
    """
    there = found_contact(found)
    xy, covariance, strength = _by_contact(found)
    rows = empty_rows(len(xy), {"C": there.shape[1]})
    rows.contact_count[:] = there.sum(1)
    rows.contact_xy[there] = xy[there]
    rows.contact_covariance[there] = covariance[:, :, [0, 1, 0], [0, 1, 1]][there]
    rows.residual[:], rows.flags[:] = found.residual, found.flags
    units = {n: field.unit for n, field in fields_of_rows().items()} | {"residual": "1"}
    strength = np.where(there, strength, np.nan).astype(np.float32)
    values = {"t": recording.t0, "contact_strength": strength}
    values |= {n: v for n, v in rows._asdict().items() if v is not None and n != "rung"}
    units |= {"t": "s", "contact_strength": "1"}
    columns = {n: (Dataset(v.shape, v.dtype.str, units[n]), v) for n, v in values.items()}
    origin = recording.origin
    lines = recording.outline.lines(recording.box)
    if not recording.outline.loops:
        lines = [line + origin for line in lines]
    told = {"calibration": response and str(response), "frames": len(found.xy)}
    lone = "response" if response else "nominal"
    attributes = {
        "method": "changes" if isinstance(found, Changes) else lone,
        "rate": "scan",
        "kind": "conductivity",
        "size": recording.box,
        "origin": origin,
        "electrode_xy": recording.electrode_xy,
        "outline": json.dumps([line.tolist() for line in lines]),
        "recording": recording.path.name,
        "recording_sha256": recording.digest(),
        "versions": json.dumps(environment()),
        "configuration": json.dumps(told, sort_keys=True),
    }
    write_rows(out, columns, attributes, overwrite)


def _by_contact(found: Located | Changes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns places (n, C, 2), covariances and strengths; C is 1 for lone presses."""
    n = len(found.xy)
    moments = found.covariance.reshape(n, -1, 2, 2)
    return found.xy.reshape(n, -1, 2), moments, found.strength.reshape(n, -1)


def found_contact(found: Located | Changes) -> np.ndarray:
    """Tells which of C contacts each frame has: (n, C)."""
    none = (found.flags & int(Flag.NO_CONTACT | NO_ANSWER)) > 0
    return ~none[:, None] & np.isfinite(_by_contact(found)[0]).all(2)


def summary_located(recording: PairRecording, found: Located | Changes) -> dict[str, Any]:
    """Counts contacts and flags; with known places, tells how far off they are.

    The strongest contact of a row counts. Numbers without a row to tell them are None.
    """
    there, flags = found_contact(found)[:, 0], np.asarray(found.flags)
    xy, covariance, _ = _by_contact(found)
    xy, covariance = xy[:, 0], covariance[:, 0]
    silent = (flags & int(NO_ANSWER)) > 0
    by_flag = {f.name: int(((flags & f.value) > 0).sum()) for f in Flag}
    deviations = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))  # of x and y
    places = np.nan * xy if recording.places is None else recording.places
    off = (xy - places)[judged := there & recording.known]
    error = 1e3 * np.sqrt((off**2).sum(1))
    stated = 1e3 * np.sqrt((deviations[there] ** 2).mean(1))
    return {
        "rows_in_all": len(there),
        "rows_with_contact": int(there.sum()),
        "rows_doubted": int((((flags & int(DOUBT)) > 0) & ~silent).sum()),
        "rows_without_answer": int(silent.sum()),
        "rows_by_flag": {name: count for name, count in by_flag.items() if count},
        "deviation_median_mm": quantile(stated, 0.5),
        "residual_median": quantile(found.residual[there], 0.5),
        "places_judged": int(judged.sum()),
        "place_error_median_mm": quantile(error, 0.5),
        "place_error_p90_mm": quantile(error, 0.9),
        "within_deviation": float((abs(off) <= deviations[judged]).mean())
        if len(off)
        else None,
    }


def located_text(told: dict[str, Any], out: Path) -> str:
    """Formats the summary for people."""
    lines = [f"{told['rows_in_all']} rows, {told['rows_with_contact']} with a contact"]
    if told["rows_with_contact"]:
        mm, left = told["deviation_median_mm"], told["residual_median"]
        stated = f"stated deviation {mm:.3g} mm, residual {left:.3g} deviations"
        lines.append(f"in the median: {stated}")
    if told["places_judged"]:
        median, most = told["place_error_median_mm"], told["place_error_p90_mm"]
        lines.append(
            f"places known of {told['places_judged']}: off by {median:.2f} mm in the "
            f"median, 90 % within {most:.2f} mm; {100 * told['within_deviation']:.0f} % "
            "of coordinates within their deviation"
        )
    return "\n".join([*lines, *report.flag_lines(told), f"results: {out}"])
