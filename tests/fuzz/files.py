"""Damaged files of every format, through the commands that read them.

By hand: `python tests/fuzz/files.py --count 5000 --seed 1 [--only recording,…]`. Each file
must be read, its faults flagged, or be refused in one line with status 2; within 10 s and
2 GB; no bytes of another file may come out. What does not is kept in `--keep FOLDER`.
A seeded excerpt runs with the tests.
"""

import argparse
import contextlib
import io
import json
import os
import re
import resource
import select
import subprocess
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]

import mutate
import seeds

_SECONDS, _BYTES = 10.0, 2 << 30


class Outcome(NamedTuple):
    """What became of one file."""

    kind: str
    verdict: str  # "read", "refused", or what must not be
    seconds: float
    megabytes: float
    words: str


# ---- the process that reads ----------------------------------------------------------


def _command(*words: str) -> int:
    """A command of `tomojax` as a user gives it; its exit status."""
    from tomojax.cli.app import run

    sys.argv = ["tomojax", *words]
    try:
        run()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def _loader(load: Callable[[], Any]) -> int:
    """A loader where its command would compute for long; errors as `run` has them."""
    try:
        load()
    except (OSError, ValueError) as error:
        print(f"tomojax: {error}", file=sys.stderr)
        return 2
    return 0


def read(kind: str, path: str, folder: Path) -> int:
    """Reads a file of that kind as its command does."""
    out = str(folder / "out.h5")
    forms = ("recording_csv", "recording_npz", "recording_mcap")
    if kind in ("recording", "swmr", "matlab", "demo", *forms):
        return _command("info", path)
    if kind == "tdms":
        return _command("info", path, "--tdms", "slots=2")
    if kind == "results":
        return _command("track", path, "-o", out, "--overwrite")
    if kind == "resumed":
        words = "--no-images", "--method", "linear", "--grid", "8", "--resume"
        return _command("reconstruct", str(folder / "seed.h5"), "-o", path, *words)
    if kind == "sidecar":
        beside = folder / "beside.csv"
        beside.write_bytes((folder / "seed.csv").read_bytes())
        beside.with_suffix(".toml").write_bytes(Path(path).read_bytes())
        return _command("info", str(beside))
    if kind == "config":
        return _command("live", "--config", path)
    import tomojax as tx

    if kind == "calibration":
        return _loader(lambda: tx.Calibration.load(path, 64))
    if kind == "policy":
        sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
        return _loader(lambda: tx.step.load_policy(path, sensor))
    return _loader(lambda: tx.calibration.read_places(Path(path)))


def work() -> None:
    """Answers each line of standard input, a kind and a path, with a line of JSON."""
    answers, folder = os.fdopen(os.dup(1), "w"), Path(sys.argv[2])
    os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"
    for line in sys.stdin:
        kind, path = json.loads(line)
        spoken, error, began = io.StringIO(), io.StringIO(), time.monotonic()
        with contextlib.redirect_stdout(spoken), contextlib.redirect_stderr(error):
            try:
                status: Any = read(kind, path, folder)
            except BaseException:
                status = "traceback"
                traceback.print_exc(file=error)
        told = {"status": status, "seconds": time.monotonic() - began}
        told["megabytes"] = _peak()
        told["out"], told["error"] = spoken.getvalue(), error.getvalue()
        print(json.dumps(told), file=answers, flush=True)


def _peak() -> float:
    """The most memory that this process had, MB; its parent's counts in `getrusage`."""
    status = Path("/proc/self/status")
    if not status.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    found = re.search(r"VmHWM:\s+(\d+) kB", status.read_text())
    return int(found[1]) / 1e3 if found else 0.0


class Worker:
    """A process that reads; another one where it dies or does not come back."""

    def __init__(self, folder: Path):
        self._folder = folder
        self._process: Any = None

    def _started(self) -> Any:
        command = [sys.executable, __file__, "--work", str(self._folder)]
        root = str(Path(__file__).parents[2])
        environment = os.environ | {"PYTHONPATH": root, "OPENBLAS_NUM_THREADS": "1"}
        # What readers and commands say beside their answers is not for the console.
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=environment,
        )

    def __call__(self, kind: str, path: Path, patience: float) -> dict[str, Any]:
        if self._process is None:
            self._process = self._started()
        self._process.stdin.write(json.dumps([kind, str(path)]) + "\n")
        self._process.stdin.flush()
        ready, _, _ = select.select([self._process.stdout], [], [], patience)
        line = self._process.stdout.readline() if ready else ""
        if line:
            return json.loads(line)
        verdict = "crash" if ready else "hang"
        self.close()
        return {
            "status": verdict,
            "seconds": patience,
            "megabytes": 0.0,
            "error": "",
            "out": "",
        }

    def close(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


# ---- the process that mutates --------------------------------------------------------


def judged(kind: str, told: dict[str, Any], written: bytes) -> Outcome:
    """What an answer means."""
    error, status = told["error"], told["status"]
    lines = [line for line in error.splitlines() if line.strip()]
    if status == 2 and len(lines) == 1 and lines[0].startswith("tomojax: "):
        verdict = "refused"
    elif status == 0:
        verdict = "read"
    elif status in ("crash", "hang", "traceback"):
        verdict = str(status)
    else:
        verdict = f"status {status} with {len(lines)} lines"
    numbers = ", ".join(map(str, mutate.CANARY))
    if numbers in told["out"] + error or mutate.CANARY * 4 in written:
        verdict = "another file's bytes"
    if told["seconds"] > _SECONDS:
        verdict = "over 10 s"
    if told["megabytes"] > _BYTES / 1e6:
        verdict = "over 2 GB"
    return Outcome(kind, verdict, told["seconds"], told["megabytes"], error[-1500:])


def fuzz(
    folder: Path, kinds: list[str], count: int, seed: int, keep: Path | None = None
) -> dict[str, dict[str, Any]]:
    """Reads `count` damaged files of each kind; counts by verdict, the worst of each."""
    canary = folder / "canary"
    canary.write_bytes(mutate.CANARY * (1 << 16))
    seeds.canary_recording(canary.with_suffix(".h5"), mutate.CANARY)
    table, worker = {}, Worker(folder)
    for kind in kinds:
        good = seeds.seed(kind, folder)
        mutation, rng = (
            mutate.mutations(kind, canary),
            np.random.default_rng([seed, len(kind)]),
        )
        path = folder / f"mutant{good.suffix}"
        path.write_bytes(good.read_bytes())
        # The first of a kind compiles, which no limit is for.
        first = worker(kind, path, 300.0)
        assert first["status"] == (2 if kind == "config" else 0), first
        found, verdicts, examples = [], Counter(), {}
        for number in range(count):
            path.write_bytes(mutation(good.read_bytes(), rng))
            out = folder / "out.h5"
            out.unlink(missing_ok=True)
            told = worker(kind, path, _SECONDS + 5)
            written = out.read_bytes() if out.exists() else b""
            outcome = judged(kind, told, written)
            found.append(outcome)
            verdicts[outcome.verdict] += 1
            if outcome.verdict not in ("read", "refused"):
                examples.setdefault(outcome.verdict, outcome.words[-400:])
                if keep is not None:
                    keep.mkdir(exist_ok=True, parents=True)
                    name = f"{kind}-{seed}-{number}{good.suffix}"
                    (keep / name).write_bytes(path.read_bytes())
        table[kind] = {
            "files": count,
            **verdicts,
            "seconds_max": round(max((o.seconds for o in found), default=0.0), 2),
            "megabytes_max": round(max((o.megabytes for o in found), default=0.0)),
            **({"examples": examples} if examples else {}),
        }
        print(json.dumps({kind: table[kind]}), file=sys.stderr, flush=True)
    worker.close()
    return table


def main() -> None:
    import tempfile

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=5000, help="Files of each format.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default=",".join(seeds.KINDS), help="Formats.")
    parser.add_argument("--keep", type=Path, help="Keep there what must not be.")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        kinds = given.only.split(",")
        found = fuzz(Path(folder), kinds, given.count, given.seed, given.keep)
    print(json.dumps({"seed": given.seed, "formats": found}, indent=1))


if __name__ == "__main__":
    work() if sys.argv[1:2] == ["--work"] else main()
