"""Shows the live loop in rerun's viewer, or writes it to rerun's file, beside the loop."""

import argparse
import signal
import sys
import time
from pathlib import Path

import numpy as np

from tomojax.hardware.loop._real_time import beside
from tomojax.hardware.loop._ring import SlotRing

_EVERY = 0.1  # s


def watch(ring: SlotRing, path: Path | None) -> None:
    """Logs the ring until the ring is done, to the file at `path` or a new viewer."""
    import rerun as rr

    rr.init("tomojax", spawn=path is None)
    if path is not None:
        rr.save(path)
    row, done = 0, False
    while not done:
        done = ring.done
        rows, row, _ = ring.since(row)
        if len(rows):
            _log(rr, ring, rows)
        time.sleep(0 if done else _EVERY)
    rr.disconnect()


def _log(rr, ring: SlotRing, rows: np.ndarray) -> None:
    """Logs the last of some slots, and the latencies."""
    rr.set_time("time", duration=float(rows["time"][-1]))
    rr.log("slots/each_second", rr.Scalars(len(rows) / _EVERY))
    rr.log("slots/lost", rr.Scalars(float(rows["lost"].sum())))
    rr.log("image", rr.Image((255 * _shades(ring.head["image"])).astype(np.uint8)))
    worked = rows[np.isfinite(rows["latency"])]
    if not len(worked):
        return
    rr.log("latency_us", rr.Scalars(1e6 * float(np.median(worked["latency"]))))
    last = worked[-1]
    there = slice(int(last["count"]))
    labels = [f"{1e6 * g:.1f} µS" for g in last["conductance"][there]]
    rr.log("contacts_mm", rr.Points2D(1e3 * last["xy"][there], radii=3.0, labels=labels))


def _shades(image: np.ndarray) -> np.ndarray:
    """Scales an image to 0 to 1, y upwards."""
    top = max(float(np.nanmax(image, initial=0)), 1e-30)
    return np.nan_to_num(np.clip(image / top, 0, 1)).T[::-1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ring", type=Path)
    parser.add_argument("--rrd", type=Path)
    given = parser.parse_args()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the live loop's
    beside()
    try:
        watch(SlotRing(given.ring, writable=False), given.rrd)
    except ModuleNotFoundError as error:
        mend = "pip install 'tomojax[rerun]' brings it"
        sys.exit(f"tomojax: {error.name} is not installed; {mend}")


if __name__ == "__main__":
    main()
