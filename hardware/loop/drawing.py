"""Draws the live view's image by `shape`: a process that reads the ring and writes into it.

The loop waits for nothing. An image uses the latest slot of each of a few grounds.
"""

import json
import sys
import time
from typing import Any

import numpy as np

from tomojax.hardware.loop._real_time import begun
from tomojax.hardware.loop._ring import SIDE, SlotRing
from tomojax.recordings import rig_of

_EVERY = 0.1  # s between images
_SLOTS = 10, 2, 1  # of an image: as many as there are grounds
_BACK = 256  # slots in which these are looked for
_OLD = 0.1  # s that a slot may be old: what touches moves
_NICE = 5  # it gives way to the loop


def latest(rows: np.ndarray) -> np.ndarray:
    """Returns the latest row of each of ten, two or one grounds, the oldest row first."""
    rows = rows[-_BACK:]
    rows = rows[(rows["ground"] >= 0) & (rows["time"] >= rows["time"][-1] - _OLD)]
    _, first = np.unique(rows["ground"][::-1], return_index=True)
    places = np.sort(len(rows) - 1 - first)
    count = next((n for n in _SLOTS if n <= len(places)), 0)
    return rows[places[len(places) - count :]]


def draw(ring: SlotRing, told: dict[str, Any], path: str) -> int:
    """Draws images until the ring is done, and one of its end; returns their number."""
    from tomojax.methods import Batch, method
    from tomojax.sensor import Calibration

    known = Calibration.load(path) if path else None
    sensor = rig_of(told).sensor()
    batch = Batch(method(sensor, "shape", SIDE, known), 1.0, contacts=1)
    drawn, row, done = 0, 0, False
    while not done:
        done, started = ring.done, time.monotonic()
        first = int(ring.head["rows"]) - _BACK
        rows, row, _ = ring.since(max(0 if done else row, first))
        some = latest(rows) if len(rows) else rows
        if len(some):
            volts = some["codes"].astype(np.float32) * told["scale"] + told["offset"]
            volts = volts * ring.trim[0] + ring.trim[1]
            volts = volts if known is None else known.voltages(volts)
            under = some["ground"].astype(int)
            found = batch(volts[None].astype(np.float32), under[None])
            if found.touch is not None:
                ring.head["image"][...] = found.touch[0]
                drawn += 1
        time.sleep(0 if done else max(0.0, _EVERY - (time.monotonic() - started)))
    return drawn


def main() -> None:
    given = begun(__doc__, "ring", "told", "calibration", nice=_NICE)
    try:
        count = draw(SlotRing(given.ring), json.loads(given.told), given.calibration)
    except (OSError, ValueError) as error:
        sys.exit(f"tomojax: drawing: {error}")
    print(f"{count} images of what touches", flush=True)


if __name__ == "__main__":
    main()
