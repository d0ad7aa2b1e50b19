"""Describes recordings of pairs, and what was located, in a few lines."""

from pathlib import Path
from typing import Any

import numpy as np

from tomojax.ert._recording import PairRecording
from tomojax.ert._response import Located
from tomojax.ert._results import found_contact
from tomojax.kernels.flags import DOUBT, Flag, NO_ANSWER

_TOLD = 20  # readings of a fault that are named


def summary(recording: PairRecording) -> dict[str, Any]:
    """Describes a recording, with units in the keys."""
    volts, times = recording.voltages, recording.t0
    n, c, r = volts.shape
    still = (volts == volts[:1]).all(0) & (n > 1)
    return {
        "frames": n,
        "conditions": c,
        "readings": r,
        "electrodes": len(recording.electrode_xy),
        "places_known": int(recording.known.sum()),
        "duration_s": float(times[-1] - times[0] + c / recording.f_switch),
        "f_switch_Hz": recording.f_switch,
        "outline": recording.outline.kind,
        "size_m": list(recording.box),
        "electrode_diameter_m": recording.electrode_diameter,
        "units": recording.units,
        "magnitude": bool(recording.magnitude),
        "notes": recording.notes,
        "never_change": np.argwhere(still).tolist(),
        "bad_readings": int(recording.bad.sum()),
        "reciprocity": _reciprocity(recording),
    }


def _reciprocity(recording: PairRecording) -> float | None:
    """Computes the median relative disagreement of readings with exchanged roles."""
    c, r, d, s, sign = recording.pairs.exchanged().T
    if not len(c):
        return None
    one, other = recording.voltages[:, c, r], recording.voltages[:, d, s] * sign
    if recording.magnitude:
        one, other = abs(one), abs(other)
    size = (abs(one) + abs(other)) / 2
    fine = np.isfinite(size) & (size > 0)
    return float(np.median(abs(one - other)[fine] / size[fine])) if fine.any() else None


def info_text(path: Path, found: dict[str, Any]) -> str:
    """Formats the description for people."""
    width, height = (1e3 * side for side in found["size_m"])
    again = "magnitude" in found["units"] or not found["magnitude"]
    apart, still = found["reciprocity"], [f"{c}/{r}" for c, r in found["never_change"]]
    lines = [
        f"{path}: can be read; current between pairs of electrodes",
        f"  {found['frames']} frames of {found['conditions']} injections × "
        f"{found['readings']} readings, {found['electrodes']} electrodes, "
        f"{found['duration_s']:.6g} s at {found['f_switch_Hz']:g} injections/s",
        f"  sheet: {found['outline']} of {width:g} mm × {height:g} mm; readings in "
        f"{found['units']}" + ("" if again else ", of the magnitude"),
        f"  places are known of {found['places_known']} frames",
        f"  notes: {found['notes']}" if found["notes"] else "",
        "  no readings have exchanged roles: reciprocity is not told"
        if apart is None
        else f"  readings with exchanged roles are {100 * apart:.3g} % apart in the median",
    ]
    if found["bad_readings"]:
        lines.append(f"  {found['bad_readings']} readings are no numbers")
    if still:
        more = " …" if len(still) > _TOLD else ""
        told = ", ".join(still[:_TOLD]) + more
        lines.append(f"  {len(still)} readings never change (injection/reading): {told}")
    if not still and not found["bad_readings"]:
        lines.append("  no faults")
    return "\n".join(filter(None, lines))


def summary_located(recording: PairRecording, found: Located) -> dict[str, Any]:
    """Counts contacts and flags; with known places, tells how far off they are."""
    there = found_contact(found)
    silent = (found.flags & int(NO_ANSWER)) > 0
    doubted = ((found.flags & int(DOUBT)) > 0) & ~silent
    variance = np.trace(found.covariance, axis1=1, axis2=2) / 2
    by_flag = {f.name: int(((found.flags & f.value) > 0).sum()) for f in Flag}
    told = {
        "rows_in_all": len(there),
        "rows_with_contact": int(there.sum()),
        "rows_doubted": int(doubted.sum()),
        "rows_without_answer": int(silent.sum()),
        "rows_by_flag": {name: count for name, count in by_flag.items() if count},
        "deviation_median_mm": _quantile(1e3 * np.sqrt(variance[there]), 0.5),
        "residual_median": _quantile(found.residual[there], 0.5),
    }
    judged = there & recording.known
    if not judged.any():
        return told
    assert recording.places is not None
    off = found.xy[judged] - recording.places[judged]
    axes = np.sqrt(np.diagonal(found.covariance[judged], axis1=1, axis2=2))
    error = 1e3 * np.sqrt((off**2).sum(1))
    return told | {
        "places_judged": int(judged.sum()),
        "place_error_median_mm": _quantile(error, 0.5),
        "place_error_p90_mm": _quantile(error, 0.9),
        "within_deviation": float((abs(off) <= axes).mean()),
    }


def _quantile(values: np.ndarray, part: float) -> float | None:
    return float(np.quantile(values, part)) if len(values) else None


def located_text(told: dict[str, Any], out: Path) -> str:
    """Formats the summary for people."""
    from tomojax.results import report

    lines = [f"{told['rows_in_all']} rows, {told['rows_with_contact']} with a contact"]
    if told["rows_with_contact"]:
        lines[0] += (
            f", stated deviation {told['deviation_median_mm']:.3g} mm, "
            f"residual {told['residual_median']:.3g} deviations (medians)"
        )
    lines += report.flag_lines(told)
    if "places_judged" in told:
        lines.append(
            f"places known of {told['places_judged']}: off by "
            f"{told['place_error_median_mm']:.2f} mm in the median, 90 % within "
            f"{told['place_error_p90_mm']:.2f} mm; {100 * told['within_deviation']:.0f} % "
            "of coordinates within their deviation"
        )
    return "\n".join([*lines, f"results: {out}"])
