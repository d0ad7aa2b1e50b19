"""Reads recordings as NumPy's .npz: arrays with the names of recording version 1."""

from pathlib import Path
from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.files import read_npz
from tomojax.recordings._described import KEYS, sidecar
from tomojax.recordings.formats._memory import MemoryRecording

_NEEDED = ("v", "ground")
_MORE = ("t0", "gaps", *sorted(KEYS - {"notes", "units", "schema"}))


def open_npz(path: Path, told: dict[str, Any]) -> MemoryRecording:
    """Opens the recording in an .npz file.

    `v` (scans, slots, M) has volts, or codes where there is a `scale`; `ground` is (scans,
    slots) or (slots,). `t0` (scans,), s, and `gaps` (n, 2) are optional. Other numbers have
    the names of recording version 1's attributes.
    **Raises:** `ValueError` for arrays that do not fit each other.
    """
    try:
        found = read_npz(path, "no recording", _NEEDED, _MORE)
    except ValueError as error:
        text = str(error).removeprefix(f"{path}: ")
        raise ValueError(f"file: {text}") from None
    v, ground = found.pop("v"), found.pop("ground")
    require(v.ndim == 3, "v", f"shape {v.shape}", "(scans, slots, electrodes)")
    scans, slots, m = v.shape
    fits = ground.shape in ((scans, slots), (slots,))
    require(fits, "ground", f"shape {ground.shape}", f"({scans}, {slots}) or ({slots},)")
    ground = np.broadcast_to(ground, (scans, slots))
    t0, gaps = found.pop("t0", None), found.pop("gaps", None)
    told = {**found, **sidecar(path), **told, "slots": slots}
    t = None
    if t0 is not None:
        require(t0.shape == (scans,), "t0", f"shape {t0.shape}", f"({scans},)")
        # Of the first slot of each scan alone: others are not told, nor needed.
        t = np.full((scans, slots), np.nan)
        t[:, 0] = t0
        if "f_switch" not in told:
            step = float(np.median(np.diff(t0))) if scans > 1 else 0.0
            require(step > 0, "f_switch", "none", "slots a second, or t0 of more scans")
            told["f_switch"] = slots / step
        t = t.ravel()
    return MemoryRecording(path, told, v.reshape(-1, m), ground.ravel(), t, gaps=gaps)
