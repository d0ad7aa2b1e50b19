"""Measures large mats: memory, time of preparation and of a frame.

    python tests/benchmarks/mats.py [--mat 12x32 ...] [--method source ...] [--out FOLDER]

Mats as pressure-imaging people have them, electrodes 8 mm apart, each measured with ten
grounds. The scene has two discs as wide as half the distance of electrodes; noise is
0.3 mV. Each mat and method is a process of its own: its largest memory is what the system
counts. Times of the first frame hold tracing and compiling; then the median of ten frames,
one after the other. Writes mats.json.
"""

import argparse
import json
import math
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

from bench.memory import peak_mb  # noqa: E402

MATS = ("12x32", "32x32", "32x64")
PITCH, GROUNDS, NOISE = 0.008, 10, 3e-4
LIMIT = 1800  # s that one may take


def measured(mat: str, method: str) -> dict:
    import numpy as np

    import tomojax as tx

    nx, ny = map(int, mat.split("x"))
    begin = time.perf_counter()
    # Four elements and more between electrodes.
    cells = math.ceil(4.5 * nx), math.ceil(4.3 * ny)
    small = PITCH / 4
    sensor = tx.Sensor.grid(
        nx, ny, pitch=PITCH, electrode_diameter=small, divisions=cells, dtype=np.float32
    )
    grounds = np.linspace(0, nx * ny - 1, GROUNDS).astype(int)
    places = np.array([[0.31, 0.42], [0.66, 0.71]]) * [nx * PITCH, ny * PITCH]
    rng = np.random.default_rng(5)
    scene = tx.Scene(*(tx.Disc(place, small, 0.5) for place in places))
    volts = np.asarray(tx.voltages(sensor, scene, grounds))
    frames = volts + rng.normal(0, NOISE, (11, *volts.shape))
    times = {"sensor_and_scene_s": time.perf_counter() - begin}
    begin = time.perf_counter()
    batch = tx.Batch(tx.method(sensor, method), contacts=2, images=False)
    times["method_s"] = time.perf_counter() - begin
    found, spent = np.zeros((0, 2)), []
    for frame in frames.astype(np.float32):
        begin = time.perf_counter()
        rows = batch(frame[None], grounds[None])
        found = rows.contact_xy[0, : int(rows.contact_count[0])]
        spent.append(time.perf_counter() - begin)
    away = np.linalg.norm(found[:, None] - places, axis=-1).min(0, initial=np.inf)
    return {
        "mat": mat, "electrodes": nx * ny, "method": method, "found": len(found), **times,
        "first_frame_s": spent[0], "frame_s": float(np.median(spent[1:])),
        "place_mm": [round(1e3 * float(a), 3) for a in away],
        "memory_GB": peak_mb() / 1024,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mat", choices=MATS, action="append")
    parser.add_argument("--method", choices=("source", "points"), action="append")
    parser.add_argument("--here", action="store_true", help="Measure one, in this process.")
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    given = parser.parse_args()
    if given.here:
        print(json.dumps(measured(given.mat[0], given.method[0])))
        return
    rows = []
    for mat in given.mat or MATS:
        for method in given.method or ("source", "points"):
            words = [sys.executable, __file__, "--here", "--mat", mat, "--method", method]
            try:
                done = subprocess.run(
                    words, capture_output=True, text=True, timeout=LIMIT, check=False
                )
            except subprocess.TimeoutExpired:
                rows.append({"mat": mat, "method": method, "over_s": LIMIT})
                continue
            told = done.stdout.splitlines()
            if done.returncode:
                last = (done.stderr.splitlines() or ["killed"])[-1]
                row = {"mat": mat, "method": method, "failed": last[:300]}
            else:
                row = json.loads(told[-1])
            rows.append(row)
            print(json.dumps(row), flush=True)
    from benchmarks.physics import environment

    content = {"environment": environment(), "rows": rows}
    (given.out / "mats.json").write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
