"""Shows the live loop in rerun's viewer, or writes it to rerun's file, beside the loop."""

import sys
from pathlib import Path

import numpy as np

from tomojax._require import require_library
from tomojax.hardware.loop._real_time import begun
from tomojax.hardware.loop._ring import SlotRing
from tomojax.hardware.loop._told import shades

_EVERY = 0.1  # s


def watch(ring: SlotRing, path: Path | None) -> None:
    """Logs the ring until the ring is done, to the file at `path` or a new viewer."""
    import rerun as rr

    rr.init("tomojax", spawn=path is None)
    if path is not None:
        rr.save(path)
    for rows, _ in ring.follow(_EVERY, 0):
        if len(rows):
            _log(rr, ring, rows)
    rr.disconnect()


def _log(rr, ring: SlotRing, rows: np.ndarray) -> None:
    """Logs the last of some slots, and the latencies."""
    rr.set_time("time", duration=float(rows["time"][-1]))
    rr.log("slots/each_second", rr.Scalars(len(rows) / _EVERY))
    rr.log("slots/lost", rr.Scalars(float(rows["lost"].sum())))
    rr.log("image", rr.Image((255 * shades(ring.head["image"])).astype(np.uint8)))
    worked = rows[np.isfinite(rows["latency"])]
    if not len(worked):
        return
    rr.log("latency_us", rr.Scalars(1e6 * float(np.median(worked["latency"]))))
    last = worked[-1]
    there = slice(int(last["count"]))
    labels = [f"{1e6 * g:.1f} µS" for g in last["conductance"][there]]
    rr.log("contacts_mm", rr.Points2D(1e3 * last["xy"][there], radii=3.0, labels=labels))


def main() -> None:
    given = begun(__doc__, "ring", "--rrd")
    try:
        require_library("rerun", "rerun")
    except ValueError as error:
        sys.exit(f"tomojax: {error}")
    watch(SlotRing(given.ring, writable=False), given.rrd and Path(given.rrd))


if __name__ == "__main__":
    main()
