"""What a results file says in a few lines."""
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportCallIssue=false, reportOptionalMemberAccess=false, reportOperatorIssue=false
# (h5py does not say whether a name is a group or a dataset)

from pathlib import Path

import h5py
import numpy as np

from tomojax.kernels.flags import DOUBT, Flag, NO_ANSWER

_ROWS = 1 << 20  # read at once


def summary(path: Path) -> dict:
    """Counts of contacts and of flags, units in the keys; `rows` has the stretches."""
    with h5py.File(path, "r") as file:
        n = len(file["t"])
        counts, bits = np.zeros(256, int), np.zeros(32, int)
        stretches, previous, residual = [], 0, []
        doubted = silent = 0
        for start in range(0, n, _ROWS):
            part = slice(start, min(start + _ROWS, n))
            count, flags = file["contact_count"][part], file["flags"][part]
            counts += np.bincount(count, minlength=256)
            bits += [int((flags >> b & 1).sum()) for b in range(32)]
            none = flags & int(NO_ANSWER) > 0
            silent += int(none.sum())
            doubted += int(((flags & int(DOUBT) > 0) & ~none).sum())
            residual.append(
                np.nanmedian(file["residual"][part][count > 0]) if count.any() else 0
            )
            _collect(stretches, count, file, part, previous)
            previous = int(count[-1])
        seconds = float(file["t"][-1] - file["t"][0])
        return {
            "rows": stretches,
            "rows_in_all": n,
            "duration_s": seconds,
            "method": str(file.attrs["method"]),
            "lam": float(file.attrs["lam"]),
            "lam_relative": float(file.attrs["lam_relative"]),
            "rows_by_contacts": {str(k): int(c) for k, c in enumerate(counts) if c},
            "rows_doubted": doubted,
            "rows_without_answer": silent,
            "rows_by_flag": {
                f.name: int(bits[f.value.bit_length() - 1])
                for f in Flag
                if bits[f.value.bit_length() - 1]
            },
            "residual_median_V": float(np.median(residual)),
            "images": "image" in file,
        }


def _collect(stretches: list, count, file, part: slice, previous: int, most=12) -> None:
    """The first stretches with contact: when, and where the strongest was on average."""
    if len(stretches) >= most:
        return
    touched = np.concatenate([[previous > 0], count > 0])
    starts = np.flatnonzero(touched[1:] & ~touched[:-1])
    for start in starts[: most - len(stretches)]:
        ends = np.flatnonzero(~touched[1 + start :])
        stop = start + (ends[0] if ends.size else len(count) - start)
        rows = slice(part.start + start, part.start + stop)
        xy, current = file["contact_xy"][rows, 0], file["contact_current"][rows, 0]
        stretches.append(
            {
                "from_s": float(file["t"][rows.start]),
                "to_s": float(file["t"][rows.stop - 1]),
                "contacts": int(count[start:stop].max()),
                "x_mm": 1e3 * float(np.nanmedian(xy[:, 0])),
                "y_mm": 1e3 * float(np.nanmedian(xy[:, 1])),
                "current_uA": 1e6 * float(np.nanmedian(current)),
            }
        )


def text(found: dict, path: Path) -> str:
    """For people."""
    lines = [
        f"{found['rows_in_all']} rows over {found['duration_s']:.4g} s, {found['method']}, "
        f"λ = {found['lam']:.3g} ({found['lam_relative']:.1e}·σ₁²), "
        f"residual {1e3 * found['residual_median_V']:.3g} mV",
        "contacts  rows",
        *(f"{k:>8s}  {c}" for k, c in found["rows_by_contacts"].items()),
    ]
    lines.append(
        f"{found['rows_doubted']} rows in doubt, {found['rows_without_answer']} without "
        "an answer"
    )
    if found["rows_by_flag"]:
        lines.append("flag                        rows  what it takes from them")
    for name, count in found["rows_by_flag"].items():
        level = Flag[name].level.name.lower().replace("_", " ")
        lines.append(f"{name:22s}  {count:8d}  {level}")
    if found["rows"]:
        lines.append("first stretches of contact, the strongest one's median")
        lines.append("  from s     to s  contacts   x mm   y mm   current µA")
    for row in found["rows"]:
        lines.append(
            f"{row['from_s']:8.3f} {row['to_s']:8.3f}  {row['contacts']:8d} "
            f"{row['x_mm']:6.1f} {row['y_mm']:6.1f} {row['current_uA']:12.2f}"
        )
    return "\n".join([*lines, f"results: {path}"])
