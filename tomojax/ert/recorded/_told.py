"""Describes recordings of pairs in a few lines; loads no JAX."""

from pathlib import Path
from typing import Any

import numpy as np

from tomojax.ert.recorded._recording import PairRecording

_TOLD = 20  # readings that never change, by name


def summary(recording: PairRecording) -> dict[str, Any]:
    """Describes a recording, with units in the keys."""
    volts, times = recording.voltages, recording.t0
    n, c, r = volts.shape
    still = np.argwhere((volts == volts[:1]).all(0) & (n > 1)).tolist()
    return {
        "frames": n,
        "injections": c,
        "readings_of_each": r,
        "electrodes": len(recording.electrode_xy),
        "places_known": int(recording.known.sum()),
        "duration_s": float(times[-1] - times[0] + c / recording.f_switch),
        "outline": recording.outline.kind,
        "size_m": list(recording.box),
        "units": recording.units,
        "magnitude": bool(recording.magnitude),
        "notes": recording.notes,
        "readings_that_are_no_numbers": int(recording.bad.sum()),
        "readings_that_never_change": len(still),
        "injection_and_reading_of_these": still[:_TOLD],
        "apart_with_exchanged_roles_percent": _reciprocity(recording),
    }


def _reciprocity(recording: PairRecording) -> float | None:
    """Computes the median disagreement of readings with exchanged roles, %."""
    c, r, d, s, sign = recording.pairs.exchanged().T
    one, other = recording.voltages[:, c, r], recording.voltages[:, d, s] * sign
    if recording.magnitude:
        one, other = abs(one), abs(other)
    size = (abs(one) + abs(other)) / 2
    return quantile(100 * abs(one - other)[size > 0] / size[size > 0], 0.5)


def info_text(path: Path, found: dict[str, Any]) -> str:
    """Formats the description for people: a line for each entry."""
    lines = [f"{path}: can be read; current between pairs of electrodes"]
    for name, value in found.items():
        if value not in (None, "", []):
            shown = f"{value:.6g}" if isinstance(value, float) else str(value)
            lines.append(f"  {name.replace('_', ' ')}: {shown}")
    return "\n".join(lines)


def quantile(values: np.ndarray, part: float) -> float | None:
    """Returns a quantile, or None of no values."""
    return float(np.quantile(values, part)) if len(values) else None
