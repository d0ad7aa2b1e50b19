"""Reconstructs a folder of 100 recordings, two of them broken; stops a run and resumes.

    python tests/benchmarks/folder.py [--count 100] [--scans 200] [--json FILE]

Makes the recordings on rigs of another model (tests/rig.py), and reconstructs the folder.
Kills a second run in the middle, goes on with that run, and compares the bytes.
"""

import argparse
import csv
import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

from recordings import write  # noqa: E402
from rig import Rig  # noqa: E402

TOMOJAX = [sys.executable, "-c", "from tomojax.cli import main; main()"]


def make(folder: Path, count: int, scans: int) -> None:
    """Each with a touch of its own place in the middle third; two are cut off."""
    rng = np.random.default_rng(5)
    rig = Rig(rng)
    for k in range(count):
        place = rng.uniform(0.03, 0.13, 2)
        volts = rig.scene((rig.disc(place, 0.006), 1e-4))[0][[0, 63]]
        codes = rng.normal(0, 2, (scans, 2, 64))
        codes[scans // 3 : 2 * scans // 3] += volts / (5 / 32768)
        write(folder / f"r{k:03d}.h5", np.round(codes).astype(np.int16), [0, 63])
    for k in (count // 3, count // 2):
        path = folder / f"r{k:03d}.h5"
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])


def run(folder: Path, out: Path, *more: str) -> tuple[int, list[str], float]:
    began = time.monotonic()
    command = [*TOMOJAX, "reconstruct", str(folder), "-o", str(out), *more]
    done = subprocess.run(command, capture_output=True, text=True)
    return done.returncode, done.stderr.splitlines(), time.monotonic() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--scans", type=int, default=200)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, one, two = (Path(name) / n for n in ("rec", "one", "two"))
        folder.mkdir()
        make(folder, given.count, given.scans)
        status, lines, whole = run(folder, one)
        with (one / "table.csv").open() as file:
            table = list(csv.DictReader(file))
        command = [*TOMOJAX, "reconstruct", str(folder), "-o", str(two)]
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        while len(list(two.glob("*.results.h5"))) < given.count // 2:
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
        process.wait()
        status_two, lines_two, rest = run(folder, two, "--resume")
        made = {p.name: p.read_bytes() for p in one.glob("*.h5")}
        again = {p.name: p.read_bytes() for p in two.glob("*.h5")}
        done = [row for row in table if row["status"] == "done"]
        found = {
            "recordings": given.count,
            "results": len(made),
            "rows_of_table": len(table),
            "done": len(done),
            "with_one_touch": sum(row["touches"] == "1" for row in done),
            "status": status,
            "lines_on_stderr": len(lines),
            "seconds": round(whole, 1),
            "median_seconds_a_file": float(np.median([float(r["took_s"]) for r in done])),
            "killed_after": given.count // 2,
            "status_of_the_resumed": status_two,
            "lines_of_the_resumed": len(lines_two),
            "seconds_of_the_resumed": round(rest, 1),
            "same_bytes": made == again,
            "left_over": sorted(p.name for p in two.iterdir() if p.name not in made),
        }
    print(json.dumps(found, indent=1))
    if given.json:
        given.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
