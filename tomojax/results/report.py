"""Summarizes a results file in a few lines."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Integer

from tomojax._require import require
from tomojax.kernels.flags import DOUBT, Flag, NO_ANSWER
from tomojax.results.loading import LoadedResults

_ROWS = 1 << 20  # read at once
_STRETCHES = 12  # with contact, that are told

# Why there is no `contact_force`; a live session says the same.
NO_FORCE = (
    "no forces: they need --calibration with presses of known force, "
    "see tomojax.calibration.calibrate_presses"
)


def summary(path: Path) -> dict:
    """Counts contacts and flags, with units in the keys; `rows` has the stretches."""
    with LoadedResults(path) as file:
        for name in ("contact_count", "flags", "residual", "contact_xy", "contact_current"):
            require(name in file.names, f"{path}: {name}", "none", "this dataset")
        t, count = file.read("t"), file.read("contact_count")
        by_flag, residual = dict.fromkeys(Flag, 0), []
        doubted = silent = 0
        for block in file.blocks(("contact_count", "flags", "residual"), _ROWS):
            some, flags, left = block.values()
            for flag in Flag:
                by_flag[flag] += int((flags & flag.value > 0).sum())
            none = flags & int(NO_ANSWER) > 0
            silent += int(none.sum())
            doubted += int(((flags & int(DOUBT) > 0) & ~none).sum())
            residual.append(np.nanmedian(left[some > 0]) if some.any() else 0)
        by_count = enumerate(np.bincount(count).tolist())
        return {
            "rows": _stretches(file, t, count),
            "rows_in_all": file.rows,
            "duration_s": float(t[-1] - t[0]),
            "method": str(file.attributes.get("method")),
            "lam": file.number("lam"),
            "lam_relative": file.number("lam_relative"),
            "rows_by_contacts": {str(k): rows for k, rows in by_count if rows},
            "rows_doubted": doubted,
            "rows_without_answer": silent,
            "rows_by_flag": {f.name: rows for f, rows in by_flag.items() if rows},
            "residual_median_V": float(np.median(residual)),
            "images": "image" in file.names,
            "forces": "contact_force" in file.names,
        }


def _stretches(
    file: LoadedResults, t: Float[np.ndarray, " n"], count: Integer[np.ndarray, " n"]
) -> list[dict[str, Any]]:
    """Finds the first stretches with contact: times, and the median of the strongest."""
    edges = np.flatnonzero(np.diff(count > 0, prepend=False, append=False))
    found = []
    for start, stop in edges[: 2 * _STRETCHES].reshape(-1, 2):
        xy, current = (
            file.stretch(name, start, stop)[:, 0]
            for name in ("contact_xy", "contact_current")
        )
        told = {
            "from_s": float(t[start]),
            "to_s": float(t[stop - 1]),
            "contacts": int(count[start:stop].max()),
            "x_mm": 1e3 * float(np.nanmedian(xy[:, 0])),
            "y_mm": 1e3 * float(np.nanmedian(xy[:, 1])),
            "current_uA": 1e6 * float(np.nanmedian(current)),
        }
        found.append(told)
    return found


def text(found: dict, path: Path) -> str:
    """Formats a summary for people."""
    lines = [
        f"{found['rows_in_all']} rows over {found['duration_s']:.4g} s, {found['method']}, "
        f"λ = {found['lam']:.3g} ({found['lam_relative']:.1e}·σ₁²), "
        f"residual {1e3 * found['residual_median_V']:.3g} mV",
        "contacts  rows",
        *(f"{k:>8s}  {c}" for k, c in found["rows_by_contacts"].items()),
    ]
    lines += flag_lines(found)
    if found["rows_by_contacts"].get("0", 0) == 0 < found["rows_doubted"]:
        lines.append(
            "no row is without a contact: where some should be, zeros are off, and a "
            "higher --threshold, V, lets --adapt follow them"
        )
    if not found["forces"]:
        lines.append(NO_FORCE)
    if found["rows"]:
        lines.append("first stretches of contact, the strongest one's median")
        lines.append("  from s     to s  contacts   x mm   y mm   current µA")
    for row in found["rows"]:
        lines.append(
            f"{row['from_s']:8.3f} {row['to_s']:8.3f}  {row['contacts']:8d} "
            f"{row['x_mm']:6.1f} {row['y_mm']:6.1f} {row['current_uA']:12.2f}"
        )
    return "\n".join([*lines, f"results: {path}"])


def flag_lines(found: dict) -> list[str]:
    """Formats how many rows are in doubt, and by which flags."""
    silent = found["rows_without_answer"]
    lines = [f"{found['rows_doubted']} rows in doubt, {silent} without an answer"]
    if found["rows_by_flag"]:
        lines.append("flag                        rows  what it takes from them")
    for name, count in found["rows_by_flag"].items():
        flag = Flag[name]
        level = flag.level.name.lower().replace("_", " ")
        lines.append(f"{name:22s}  {count:8d}  {level}")
        lines.append(f"    {flag.explanation}")
    return lines
