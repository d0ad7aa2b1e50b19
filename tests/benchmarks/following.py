"""Measures `follow` and `auto` on recordings of moving contacts, and a step's start.

    python tests/benchmarks/following.py [--seconds 60] [--contacts 1 3] [--out FILE]

The start is `make_step` in processes of their own: first with an empty cache of JAX's, then
with the cache that the first left. In the recordings, contacts go round over a rig of our
own model, written a second at a time. `reconstruct` runs in a process of its own, with
programs kept by a run before. `follow` takes each slot of scans of 64, `auto` each scan of
two slots. Prints slots a second, with start and without (from two lengths), and the most
memory held, as JSON.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from itertools import product
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

RATE = 10_000  # slots a second
# By method: grounds of a scan (of eight along a diagonal `follow` sees one contact alone),
# and scans that a position holds: 77 and 5 ms, to the next 1.4 mm.
KINDS = {"follow": (tuple(range(64)), 12), "auto": ((0, 63), 24)}


def start(method: str) -> None:
    """A row, printed: in a process of its own."""
    begin = time.perf_counter()
    import jax  # noqa: F401

    imported = time.perf_counter()
    import numpy as np

    import tomojax as tx

    sensor = tx.Sensor.grid(dtype=np.float32)
    ready = time.perf_counter()
    step = tx.make_step(sensor, method)
    made = time.perf_counter()
    step(step.state, np.zeros(64), 0)
    row = {"jax_s": imported - begin, "tomojax_s": ready - imported}
    row |= {"make_s": made - ready, "first_s": time.perf_counter() - made}
    print(json.dumps(row))


def starts(method: str) -> dict:
    with tempfile.TemporaryDirectory() as cache:
        more = {"JAX_COMPILATION_CACHE_DIR": cache, "TF_CPP_MIN_LOG_LEVEL": "3"}
        more["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
        command = [sys.executable, __file__, "--start", method]
        rows = []
        for _ in range(3):  # cold, and warm twice
            out = subprocess.run(
                command, env=os.environ | more, stdout=subprocess.PIPE, check=True
            ).stdout
            rows.append(json.loads(out.splitlines()[-1]))
    return {"method": method, "cold": rows[0], "warm": rows[1:]}


def make_recording(path: Path, seconds: float, contacts: int, method: str) -> None:
    """Writes a second at a time: codes of a table of positions, with noise."""
    grounds, hold = KINDS[method]
    import h5py
    import numpy as np
    import recordings

    import tomojax as tx

    sensor = tx.Sensor.grid(divisions=(64, 64), dtype=np.float32)
    table, turn = [], np.linspace(0, 2 * np.pi, 200, endpoint=False)
    for angle in turn:
        # Not the corners of one triangle: three alike on a circle look like a cup's rim.
        each = angle + 2 * np.pi * np.array([0, 0.3, 0.62])[:contacts]
        out = np.array([0.045, 0.035, 0.055])[:contacts, None]
        places = 0.08 + out * np.stack([np.cos(each), np.sin(each)], 1)
        scene = tx.Scene(*(tx.Disc(place, 0.006, 1.0) for place in places))
        table.append(np.asarray(tx.voltages(sensor, scene, list(grounds))))
    codes = np.stack(table) * (32768 / 5)
    slots = len(grounds)
    scans, rng = int(seconds * RATE / slots), np.random.default_rng(41)
    recordings.write(path, np.zeros((1, slots, 64), np.int16), np.array(grounds))
    with h5py.File(path, "a") as file:
        for name in ("v", "ground", "t0"):
            del file[name]
        v = file.create_dataset("v", (scans, slots, 64), np.int16)
        file["ground"] = np.broadcast_to(np.array(grounds, np.uint8), (scans, slots))
        file["t0"] = np.arange(scans) * slots / RATE
        for first in range(0, scans, RATE // slots):
            which = np.arange(first, min(first + RATE // slots, scans)) // hold
            noise = rng.normal(0, 2, (len(which), slots, 64)).astype(np.float32)
            v[first : first + len(which)] = np.round(codes[which % len(turn)] + noise)


def reconstructed(path: Path, contacts: int, seconds: float, method: str) -> dict:
    """A row of a run in a process of its own."""
    out = path.with_suffix(".out.h5")
    command = [sys.executable, "-c", "from tomojax.cli import main; main()"]
    command += [
        "reconstruct",
        str(path),
        "--method",
        method,
        "--contacts",
        "3",
        "--no-images",
        "-o",
        str(out),
    ]
    begin = time.perf_counter()
    env = os.environ | {"XDG_CACHE_HOME": str(path.parent)}
    command.append("--overwrite")
    child = subprocess.Popen(command, env=env, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    spent = time.perf_counter() - begin
    assert status == 0
    import h5py
    import numpy as np

    with h5py.File(out) as file:
        counts = np.bincount(file["contact_count"][:]).tolist()
    slots = sum(counts) * (1 if method == "follow" else len(KINDS[method][0]))
    return {
        "method": method,
        "contacts": contacts,
        "seconds_recorded": seconds,
        "slots": slots,
        "seconds_spent": spent,
        "slots_per_s": slots / spent,
        "cpu_seconds": used.ru_utime + used.ru_stime,
        "peak_memory_GB": used.ru_maxrss * 1024 / 1e9,
        "rows_by_contacts": counts,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--contacts", type=int, nargs="*", default=[1, 3])
    parser.add_argument("--steps", nargs="*", default=["follow", "source"])
    parser.add_argument("--methods", nargs="*", choices=KINDS, default=list(KINDS))
    parser.add_argument("--start")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.start:
        start(options.start)
        return
    found: dict = {"starts": [starts(method) for method in options.steps]}
    found["recordings"] = rows = []
    with tempfile.TemporaryDirectory() as folder:
        for method, contacts in product(options.methods, options.contacts):
            pair = []
            # The first, short one compiles; a long one what long ones need beside it.
            for seconds in (1.0, options.seconds / 4, options.seconds / 4, options.seconds):
                path = Path(folder) / "rec.h5"
                make_recording(path, seconds, contacts, method)
                pair.append(reconstructed(path, contacts, seconds, method))
            slots, spent = (pair[3][k] - pair[2][k] for k in ("slots", "seconds_spent"))
            # Without the start, which does not grow with the recording.
            long = pair[3]
            long["slots_per_s_later"] = later = slots / spent
            left = (3600 - options.seconds) * RATE
            long["hour_s"] = long["seconds_spent"] + left / later
            rows += pair
    text = json.dumps(found, indent=1)
    print(text)
    if options.out:
        options.out.write_text(text + "\n")


if __name__ == "__main__":
    main()
