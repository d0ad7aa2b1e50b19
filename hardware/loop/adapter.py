"""Follows zeros and gains that drift: a process that reads the ring and trims it.

The loop waits for nothing. The loop reads the ring's `trim` a few times a second. Once a
minute, a log beside the recording takes the zeros and gains.
"""
# pyright: reportArgumentType=false

import json
import sys
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tomojax._whole import whole
from tomojax.hardware.loop._real_time import begun
from tomojax.hardware.loop._ring import SlotRing
from tomojax.recordings import rig_of

_EVERY = 1.0  # s between looks at the ring
_LOG = 60.0  # s between entries of the log
_NICE = 10  # it gives way to the loop


class Log:
    """Zeros and gains over time, in an HDF5 file if there is a path."""

    def __init__(self, path: Path | None):
        self._path, self._entries, self._due = path, [], 0.0

    def add(self, adapter: Any, last: bool = False) -> None:
        """Adds an entry if a minute has passed, or at the end."""
        if np.isnan(adapter.time) or not (last or time.monotonic() > self._due):
            return
        self._due = time.monotonic() + _LOG
        self._entries.append((adapter.time, adapter.offset, adapter.gain))
        if self._path is None:
            return
        with whole(self._path) as new, h5py.File(new, "w") as file:
            names = zip(("t", "zero", "gain"), ("s", "V", "1"), zip(*self._entries))
            for name, unit, values in names:
                file[f"adapted_{name}"] = np.array(values)
                file[f"adapted_{name}"].attrs["unit"] = unit


def follow(ring: SlotRing, told: dict[str, Any], path: str, out: Path | None) -> str:
    """Follows the drift until the ring is done; returns a line on what has changed."""
    from tomojax.calibration import Adapter
    from tomojax.sensor import Calibration

    known = Calibration.load(path) if path else Calibration()
    adapter = Adapter(rig_of(told).sensor(), known, age=known.age_hours())
    log = Log(out)
    zero = np.broadcast_to(np.asarray(known.offset, float), ring.electrodes)
    gain = np.broadcast_to(np.asarray(known.gain, float), ring.electrodes)
    for rows, _ in ring.follow(_EVERY, int(ring.head["rows"])):
        if len(rows):
            places = _places(rows)
            volts = rows["codes"].astype(np.float32) * told["scale"] + told["offset"]
            under = rows["ground"].astype(int)[:, None]
            adapter.observe(rows["time"], volts[:, None].astype(np.float32), under, places)
            factor = gain / adapter.gain
            ring.trim[...] = factor, zero - adapter.offset * factor
            log.add(adapter)
    log.add(adapter, last=True)
    moved = np.std(adapter.offset - zero), np.std(adapter.gain / gain)
    text = f"adapted: zeros moved by {1e3 * moved[0]:.2f} mV rms, gains by "
    text += f"{100 * moved[1]:.2f} %; from {adapter.counts[0]} stretches of silence and "
    text += f"{adapter.counts[1]} contacts"
    for channel in np.flatnonzero(adapter.doubtful)[:8]:
        text += f"; channel {channel} is as far off as it may be: have a look"
    return text


def _places(rows: np.ndarray) -> np.ndarray:
    """Returns places of lone contacts, NaN elsewhere.

    A slot that was not worked on takes the place of the last slot that was.
    """
    worked = np.isfinite(rows["latency"])
    last = np.maximum.accumulate(np.where(worked, np.arange(len(rows)), -1))
    alone = (last >= 0) & (rows["count"][last] == 1)
    return np.where(alone[:, None], rows["xy"][last, 0].astype(float), np.nan)


def main() -> None:
    given = begun(__doc__, "ring", "told", "calibration", "out", nice=_NICE)
    out = Path(given.out) if given.out else None
    ring = SlotRing(given.ring)
    try:
        print(follow(ring, json.loads(given.told), given.calibration, out), flush=True)
    except (OSError, ValueError) as error:
        sys.exit(f"tomojax: adapter: {error}")


if __name__ == "__main__":
    main()
