"""Measures how long to rub for a calibration, and where: place errors after many rubs.

    python tests/benchmarks/rubs.py [--rigs 4] [--seed N]

Every second rig is a resistor network, every other one is of finite elements
(`bench.rigs`), drawn by default. A finger wanders over the sheet at about 0.1
m/s, and presses now more, now less. Ten times a second, a frame of ten slots is read: two
corners and eight other grounds. The finger hardly moves within a frame. Five minutes have
600 frames.

Rubs over the whole sheet last 2 s to 5 min. Rubs of 30 s stay in one quarter, have pauses,
or have a second finger half of the time. In a rub with pauses, the finger stays where it is
for half of the time. Other lone contacts, in other slots, are for judging. Nothing was set
on the default seed. Writes rubs.json and rubs.png.
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
RESULTS = HERE.parents[1] / "notebooks" / "results"
SECONDS = (2, 5, 10, 20, 30, 60, 300)
PATHS = ("one quarter", "with pauses", "two fingers")
OFTEN, MOST, JUDGED = 10, 600, 40


def wandering(n: int, often: float, rng: np.random.Generator) -> np.ndarray:
    """Places (n, 2) within (0, 1)², at about half a side a second."""
    # There and back, so that the margins are reached as often as the middle.
    rate = rng.uniform(0.3, 0.5, 2) * np.exp(0.3 * rng.normal(size=(n, 2)))
    way = rng.uniform(0, 2, 2) + np.cumsum(rate / often, 0)
    return np.abs(way % 2 - 1)


def finger(sensor: Any, unit: np.ndarray, rng: np.random.Generator) -> list[Any]:
    """Contacts of one finger that goes through places of the unit square."""
    from bench.rigs import Touch

    pitch, size = sensor.mean_pitch, np.asarray(sensor.size, float)
    square = 1 / float(np.mean(np.asarray(sensor.sheet_resistance)))
    edge = 0.3 * pitch
    places = edge + unit * (size - 2 * edge)
    n = np.arange(len(unit))
    press = np.sin(n / 7 + rng.uniform(0, 6)) + np.sin(n / 23 + rng.uniform(0, 6))
    usual = rng.uniform(0.2, 0.3) * pitch
    radii, g = usual * np.exp(0.1 * press), square * 10 ** (0.4 * press)
    turns = rng.uniform(0, np.pi, len(n))
    return [Touch(p, (a, 0.85 * a), t, c) for p, a, t, c in zip(places, radii, turns, g)]


def rubs_of(sensor: Any, rng: np.random.Generator) -> dict[str, list[list[Any]]]:
    """The contacts of each frame, for each kind of rub."""
    n = 30 * OFTEN
    longest = [s for s in SECONDS if s * OFTEN <= MOST][-1]
    once = finger(sensor, wandering(longest * OFTEN, OFTEN, rng), rng)
    found = {f"{s} s": [[t] for t in once[: s * OFTEN]] for s in SECONDS if s <= longest}
    for s in SECONDS:
        if s > longest:
            path = wandering(MOST, MOST / s, rng)
            found[f"{s} s"] = [[t] for t in finger(sensor, path, rng)]
    quarter = finger(sensor, 0.5 * wandering(n, OFTEN, rng), rng)
    found["one quarter"] = [[t] for t in quarter]
    found["with pauses"] = [[once[k]] for k in _paused(n)]
    other = finger(sensor, wandering(n, OFTEN, rng), rng)
    both = [[a, b] if k % 60 < 30 else [a] for k, (a, b) in enumerate(zip(once, other))]
    apart = 1.5 * sensor.mean_pitch
    found["two fingers"] = [
        f if len(f) == 1 or np.hypot(*(f[0].xy - f[1].xy)) > apart else f[:1] for f in both
    ]
    return found


def _paused(n: int) -> np.ndarray:
    """Frames of the way that is shown: two seconds here, two seconds on the way."""
    k = np.arange(n)
    return np.where(k % 40 < 20, k - k % 40, k)


def planned(number: int, seed: int) -> tuple[Any, dict[str, list], dict[str, np.ndarray]]:
    """One rig, and the contacts and grounds of each kind of rub and of what is judged."""
    import tomojax as tx
    from bench.rigs import draw_rig, draw_touch

    rng = np.random.default_rng([seed, number])
    sensor = tx.Sensor.grid(dtype=np.float32)
    rig = draw_rig(sensor, rng)
    kinds = rubs_of(sensor, rng)
    kinds["judged"] = [[draw_touch(sensor, "usual", rng)] for _ in range(JUDGED)]
    some = (rng.choice(np.arange(1, 63), 8, replace=False) for _ in range(MOST))
    every = np.array([[0, 63, *others] for others in some])
    # A finger that stays is read under the same grounds again.
    at = {kind: np.arange(len(frames)) for kind, frames in kinds.items()}
    at["with pauses"] = _paused(len(kinds["with pauses"]))
    return rig, kinds, {kind: every[k] for kind, k in at.items()}


def _key(frame: list[Any], grounds: np.ndarray) -> tuple:
    return *(id(t) for t in frame), *grounds


def part(number: int, seed: int, k: int, parts: int) -> list[np.ndarray]:
    """Exact voltages of one of `parts` shares of a rig's frames, repeated ones once."""
    from benchmarks.calibration import scene

    from bench.rigs import Elements, network_of

    rig, kinds, grounds = planned(number, seed)
    exact = (Elements if number % 2 else network_of)(rig)
    each = {
        _key(frame, under): (frame, under)
        for kind, frames in kinds.items()
        for frame, under in zip(frames, grounds[kind])
    }
    return [scene(exact, *made) for made in list(each.values())[k::parts]]


def drawn(number: int, seed: int, parts: list[list[np.ndarray]]) -> dict[str, Any]:
    """What one rig reads during each kind of rub, and under the contacts for judging."""
    rig, kinds, grounds = planned(number, seed)
    rng = np.random.default_rng([seed, number, 1])
    found: dict[str, Any] = {"place": [f[0].centre for f in kinds["judged"]]}
    known: dict[tuple, np.ndarray] = {}
    for kind, frames in kinds.items():
        volts = []
        for key in map(_key, frames, grounds[kind]):
            n = len(known)
            if key not in known:
                known[key] = parts[n % len(parts)][n // len(parts)]
            volts.append(known[key])
        found[kind] = rig.chain.read(np.array(volts), rng), grounds[kind]
    return found


def judged(number: int, seed: int, rig: dict[str, Any]) -> list[dict[str, Any]]:
    """Place errors after each kind of rub."""
    import tomojax as tx

    sensor = tx.Sensor.grid(dtype=np.float32)
    v, under = rig["judged"]
    rows = []
    for kind in ("nominal", *(f"{s} s" for s in SECONDS), *PATHS):
        start, known, error = time.perf_counter(), tx.Calibration(), ""
        if kind != "nominal":
            try:
                known = tx.calibration.calibrate(sensor, *rig[kind])
            except ValueError as failed:
                error = str(failed)
        row = {"rig": number, "model": ("network", "elements")[number % 2]}
        row |= {"seed": seed, "rub": kind, "seconds": time.perf_counter() - start}
        row |= {"frames": len(rig[kind][0]) if kind in rig else 0, "error": error}
        batch = tx.Batch(tx.method(sensor, "points", 32, known), 1.0, 2, images=False)
        found = batch(known.voltages(v).astype(np.float32), under)
        off = 1e3 * np.hypot(*(found.contact_xy[:, 0] - rig["place"]).T)
        off = np.where(found.contact_count == 1, off, np.inf)
        row |= {"median_mm": float(np.median(off))}
        row |= {"p90_mm": float(np.quantile(off, 0.9, method="lower"))}
        rows.append(row)
        print(json.dumps(row), flush=True)
    return rows


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Place errors by the length of the rub, and of the paths of 30 s beside it."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    from tomojax._pictures import plain, style

    figure, axes = plt.subplots(1, 2, figsize=(12, 4.8), layout="constrained", sharey=True)
    figure.suptitle("Place of a lone contact after a rub that calibrates; a mark each rig")
    parts = {"median_mm": (style(0), "median"), "p90_mm": (style(1), "nine in ten")}
    labels = [f"{s} s" for s in SECONDS], ("nominal", "30 s", *PATHS)
    titles = "How long: rubs of the whole sheet", "Where: rubs of 30 s"
    for axis, names, title in zip(axes, labels, titles):
        for name, (look, label) in parts.items():
            colour = look["color"]
            each = [[r[name] for r in rows if r["rub"] == n] for n in names]
            for k, values in enumerate(each):
                dots = look | {"linestyle": "none", "alpha": 0.6}
                axis.plot([k] * len(values), values, **dots)
            middle = [float(np.median(values)) for values in each]
            if axis is axes[0]:
                line = look | {"marker": "none"}
                axis.plot(range(len(names)), middle, **line, label=f"{label}, middle rig")
            else:
                axis.plot(range(len(names)), middle, "_", color=colour, ms=18, mew=3)
        shown = ["whole sheet" if n == "30 s" and axis is axes[1] else n for n in names]
        axis.set_xticks(range(len(names)), shown)
        axis.set(yscale="log", title=title)
        axis.grid(alpha=0.3)
        plain(axis.yaxis)
    axes[0].set(ylabel="place error, mm", xlabel="length of the rub")
    axes[1].set(xlabel="what was rubbed")
    axes[0].legend(loc="center right")
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1000051)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    cores, seed = len(os.sched_getaffinity(0)), options.seed
    numbers = range(options.rigs)
    start = multiprocessing.get_context("spawn")  # JAX's threads do not survive a fork
    with ProcessPoolExecutor(cores, start) as pool:
        each = [
            [pool.submit(part, k, seed, i, cores) for i in range(cores)] for k in numbers
        ]
        rigs = [drawn(k, seed, [p.result() for p in each[k]]) for k in numbers]
    # A calibration itself works on several cores.
    with ProcessPoolExecutor(max(1, cores // 4), start) as pool:
        found = list(pool.map(judged, numbers, [seed] * len(numbers), rigs))
    rows = [row for rows in found for row in rows]
    from tomojax._environment import environment

    report = {"environment": environment(), "rows": rows}
    (options.out / "rubs.json").write_text(json.dumps(report, indent=1) + "\n")
    draw(rows, options.out / "rubs.png")


if __name__ == "__main__":
    main()
