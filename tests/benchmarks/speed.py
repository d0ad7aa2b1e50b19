"""Measures frames a second of `points` and `auto`, beside an older commit.

    git worktree add /tmp/older COMMIT
    python tests/benchmarks/speed.py --beside /tmp/older [--scenes 96] [--seed 7]

A resistor network makes the scenes (tests/rig.py; a new sheet for every eight), with noise
and zeros. Nominal values alone are told. Both commits get the same frames in the same
batches, one after the other, each in a process of its own. The first call, with everything
that it compiles, has its own column. Writes speed.json and speed.png; parts that --only
leaves out stay in them. Takes an hour.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from itertools import permutations
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
KINDS = ("one", "two30", "two20", "three", "bar", "ring")
# By name: method, slots (of 64), frames of a call.
JOBS = {
    "points, two slots": ("points", (0, 63), 1024),
    "points, 64 slots": ("points", tuple(range(64)), 128),
    "auto, two slots": ("auto", (0, 63), 1000),
}
# A day's frames: nothing, and kinds.
MIX = {"nothing": 0.7, "one": 0.2, "two30": 0.03, "two20": 0.03, "three": 0.02}
MIX |= {"bar": 0.01, "ring": 0.01}
WORDS = {"one": "one contact", "two30": "two, 30 mm apart", "two20": "two, 20 mm apart"}
WORDS |= {"three": "three contacts", "bar": "a bar", "ring": "a ring", "mix": "a day's mix"}
# Calls of each row, unless they take longer.
CALLS, SECONDS = 5, 40.0


def scenes(count: int, seed: int, path: Path) -> None:
    """Voltages and places of each kind, saved."""
    sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
    from benchmarks.contacts import scene
    from rig import Rig

    rng, saved = np.random.default_rng(seed), {}
    for kind in KINDS:
        volts, places = [], []
        for k in range(count):
            if k % 8 == 0:
                rig = Rig(rng)
            if kind in ("three", "ring"):
                exact, truth = rig.scene(*_more(kind, rig, rng))
                v = rig.measure(exact)
            else:
                v, truth, _ = scene(kind, rig, rng)
            volts.append(np.asarray(v, np.float32))
            places.append([place for place, _ in truth])
        saved |= {f"{kind}_volts": np.stack(volts), f"{kind}_xy": np.array(places)}
    np.savez(path, **saved)


def _more(kind: str, rig, rng: np.random.Generator) -> list:
    if kind == "ring":
        place, radius = rng.uniform(0.05, 0.11, 2), rng.uniform(0.02, 0.035)
        rim = rig.disc(place, radius) & ~rig.disc(place, radius - 0.006)
        return [(rim, 10 ** rng.uniform(-2, 1))]
    apart = 0.0
    while apart < 0.035:
        places = rng.uniform(0.015, 0.145, (3, 2))
        apart = min(np.hypot(*(places[i] - places[j])) for i, j in ((0, 1), (0, 2), (1, 2)))
    return [
        (rig.disc(p, rng.uniform(0.003, 0.008)), 10 ** rng.uniform(-4.5, -3.5))
        for p in places
    ]


def child(job: str, path: Path) -> None:
    """Rows of one job, printed, by the tomojax that this process finds."""
    import tomojax as tx

    name, grounds, frames = JOBS[job]
    sensor, data = tx.Sensor.grid(dtype=np.float32), np.load(path)
    method = tx.method(sensor, name, 32)
    batch = tx.Batch(method, method.choose_lambda([]), contacts=3, images=False)
    kinds = ("mix",) if name == "auto" else KINDS
    for kind in kinds:
        volts, true = _frames(data, kind, np.array(grounds), frames)
        under = np.tile(grounds, (len(volts), 1))
        spent = []
        while len(spent) < 2 or (len(spent) <= CALLS and sum(spent) < SECONDS):
            start = time.perf_counter()
            rows = batch(volts, under)
            spent.append(time.perf_counter() - start)
        each = 1e3 * np.array(spent[1:]) / len(volts)
        row = {"job": job, "scene": kind, "ms": float(np.median(each))}
        row |= {"ms_least": each.min(), "ms_most": each.max(), "first_s": spent[0]}
        print(json.dumps(row | _judged(rows, true)), flush=True)


def _frames(data, kind: str, grounds: np.ndarray, frames: int) -> tuple:
    if kind != "mix":
        volts = data[f"{kind}_volts"][:, grounds]
        return np.resize(volts, (frames, *volts.shape[1:])), data[f"{kind}_xy"]
    rng = np.random.default_rng(0)
    volts = []
    for drawn in rng.choice(list(MIX), frames, p=list(MIX.values())):
        if drawn == "nothing":
            volts.append(rng.normal(0, 3e-4, (len(grounds), 64)))
        else:
            some = data[f"{drawn}_volts"]
            volts.append(some[rng.integers(len(some))][grounds])
    return np.array(volts, np.float32), None


def _judged(rows, true: np.ndarray | None) -> dict:
    """How many counts are right, and of those the farthest contact's error, mm."""
    if true is None:
        return {}
    error, count = [], true.shape[1]
    for k, places in enumerate(true[: len(rows.contact_count)]):
        found = rows.contact_xy[k, :count]
        ways = (
            np.hypot(*(found[list(p)] - places).T).max() for p in permutations(range(count))
        )
        right = int(rows.contact_count[k]) == count
        error.append(1e3 * min(ways) if right else np.nan)
    error = np.array(error)
    told = error[np.isfinite(error)]
    counted = {"frames": len(error), "count_right": float(np.isfinite(error).mean())}
    if not len(told):
        return counted
    return counted | {
        "median_mm": float(np.median(told)),
        "p90_mm": float(np.quantile(told, 0.9)),
        "max_mm": float(told.max()),
    }


def draw(rows: list[dict], path: Path) -> None:
    """Milliseconds of a frame, older and now."""
    import matplotlib

    matplotlib.use("Agg")
    from benchmarks.start import COMMITS
    from matplotlib import pyplot as plt

    from tomojax._pictures import plain

    names = list(dict.fromkeys((r["job"], r["scene"]) for r in rows))
    figure, axes = plt.subplots(figsize=(9, 0.34 * len(names) + 1.6), layout="constrained")
    for k, (commit, look) in enumerate(COMMITS.items()):
        mine = {(r["job"], r["scene"]): r["ms"] for r in rows if r["commit"] == commit}
        at = [i + 0.4 * k for i, name in enumerate(names) if name in mine]
        ms = [mine[name] for name in names if name in mine]
        bars = axes.barh(at, ms, 0.38, **look)
        axes.bar_label(bars, [f"{v:.2g}" if v < 10 else f"{v:.0f}" for v in ms],
                       padding=2, fontsize=8)  # fmt: skip
    labels = [f"{job}: {WORDS[scene]}" for job, scene in names]
    axes.set_yticks([i + 0.2 for i in range(len(names))], labels)
    axes.set(xscale="log", xlabel="time of a frame in a batch, ms")
    axes.set_xlim(right=2 * max(r["ms"] for r in rows))
    axes.set_ylim(len(names) - 0.2, -0.4)
    axes.set_title("Time of a frame by method, slots and scene", loc="left")
    plain(axes.xaxis)
    axes.legend(loc="upper right")
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=96)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--beside", type=Path, help="Checkout of an older commit.")
    parser.add_argument("--only", nargs="*", choices=JOBS, default=list(JOBS))
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    parser.add_argument("--child", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        return child(options.child[0], Path(options.child[1]))
    commits = {"now": HERE.parents[1]}
    if options.beside:
        commits = {"older": options.beside.resolve()} | commits
    rows, settings = [], {"scenes": options.scenes, "seed": options.seed}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scenes.npz"
        scenes(options.scenes, options.seed, path)
        for job in options.only:
            for commit, root in commits.items():
                command = [sys.executable, "-P", __file__, "--child", job, str(path)]
                found = subprocess.run(
                    command,
                    stdout=subprocess.PIPE,
                    check=True,
                    text=True,
                    env=os.environ | {"PYTHONPATH": str(root)},
                )
                for line in found.stdout.splitlines():
                    rows.append({"commit": commit, **settings, **json.loads(line)})
                    print(json.dumps(rows[-1]), flush=True)
    sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
    from benchmarks.physics import environment

    path = options.out / "speed.json"
    before = json.loads(path.read_text())["rows"] if path.exists() else []
    kept = [r for r in before if r["job"] not in options.only]
    rows = sorted(kept + rows, key=lambda r: list(JOBS).index(r["job"]))
    report = {"environment": environment(), "rows": rows}
    path.write_text(json.dumps(report, indent=1) + "\n")
    draw(rows, options.out / "speed.png")


if __name__ == "__main__":
    main()
