"""Measures what a slot costs each method, for `AbstractMethod.seconds_per_slot`.

`python tests/benchmarks/costs.py points source linear auto shape`

Results of 2026-11-26, two cores shared with other work, ms a frame. Recording drag_around,
a slot each: shape 29, auto 0.3. Its scans of ten slots: shape 110, auto 1.5, linear 0.9,
source 0.2. Recording
bounce_spanner_copline, a slot each: points 0.26, auto 0.29, source and linear 0.01.
"""

import sys
import time
from pathlib import Path

import tomojax as tx
from tomojax.recordings import open_recording, read_chunk
from tomojax.results import Settings

DATA = Path(__file__).parents[3] / "shared" / "data"


def measure(path: Path, name: str, rate: str) -> str:
    """One line: a method on some frames of a recording, compiled before."""
    with open_recording(path) as recording:
        settings = Settings(method=name, rate=rate)
        method = tx.method(recording.rig.sensor(), name, settings.pixels)
        scans = 400 if rate == "scan" else max(1, 2560 // recording.slots)
        start = recording.scans // 2
        chunk = read_chunk(recording, start, min(recording.scans, start + scans), rate)
    batch = tx.Batch(method, method.choose_lambda([]), 4, rate == "scan")
    given = chunk.voltages, chunk.grounds, chunk.good
    batch(*given)
    began = time.perf_counter()
    batch(*given)
    each = 1e3 * (time.perf_counter() - began) / len(chunk.voltages)
    return f"{path.stem} {rate} {name}: {each:.3f} ms a frame of {given[1].shape[1]} slots"


if __name__ == "__main__":
    for path in (DATA / "drag_around.h5", DATA / "bounce_spanner_copline.h5"):
        for rate in ("slot", "scan"):
            for name in sys.argv[1:]:
                print(measure(path, name, rate), flush=True)
