"""Tells two contacts from one long one: pairs by distance, ellipses, and what is doubted.

    python tests/benchmarks/two.py [--rigs 4] [--each 10] [--seed N]

Rigs are drawn by default: every second one is a resistor network, every other one of finite
elements (`bench.rigs`). Each scene is a pair of discs (radii of 0.15 to 0.3 pitches, one up
to three times as strong) or one ellipse (0.3 to 0.6 pitches in the mean of its half-axes,
2 : 1 or 3 : 1), of 0.03 to 30 times the conductance of a square. Soft bars are ellipses
5 : 1 of 0.03 to 1 times that conductance. `points` has ten slots or
64, and nominal values or a blind calibration by 100 lone contacts. A pair is told where two
are found, each within half their distance of its own. The default seed is for judging: no
threshold was set on it. Writes two.json and two.png.
"""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

from benchmarks.calibration import scene, ten_of  # noqa: E402

RESULTS = HERE.parents[1] / "notebooks" / "results"
APART, RATIOS = (10, 15, 20, 30), (2, 3)  # mm; of half-axes
LONG = 5
TOUCHES, SLOTS, KNOWN = 100, (10, 64), ("nominal", "calibrated")


def scenes_of(sensor: Any, rng: np.random.Generator, each: int) -> list[tuple[str, list]]:
    """Pairs and ellipses, by what they are called."""
    from bench.rigs import Touch

    pitch, size = sensor.mean_pitch, np.asarray(sensor.size, float)
    square = 1 / float(np.mean(np.asarray(sensor.sheet_resistance)))

    def long_one(rng: np.random.Generator, ratio: int, most: float) -> Touch:
        axes = rng.uniform(0.3, 0.6) * pitch * np.array([ratio**0.5, ratio**-0.5])
        middle = rng.uniform(axes[0] + 0.05 * pitch, size - axes[0] - 0.05 * pitch)
        g = square * 10 ** rng.uniform(-1.5, most)
        return Touch(middle, (float(axes[0]), float(axes[1])), _turn(rng), g)

    found = []
    for _ in range(each):
        for apart in APART:
            middle, turn = rng.uniform(1.25 * pitch, size - 1.25 * pitch), _turn(rng)
            half = apart / 2000 * np.array([np.cos(turn), np.sin(turn)])
            radii = rng.uniform(0.15, min(0.3, 0.42 * apart / 20), 2) * pitch
            both, ratio = square * 10 ** rng.uniform(-1.5, 1.5), 10 ** rng.uniform(0, 0.5)
            each_one = both / (1 + ratio), both * ratio / (1 + ratio)
            pair = [
                Touch(middle + s * half, (a, a), 0.0, g)
                for s, a, g in zip((1, -1), radii, each_one)
            ]
            found.append((f"two {apart} mm apart", pair))
        for ratio in RATIOS:
            found.append((f"ellipse {ratio} : 1", [long_one(rng, ratio, 1.5)]))
    bars = rng.spawn(1)[0]  # whose draws leave all others as they are
    return found + [
        (f"soft bar {LONG} : 1", [long_one(bars, LONG, 0)]) for _ in range(each)
    ]


def _turn(rng: np.random.Generator) -> float:
    return float(rng.uniform(0, np.pi))


def drawn(number: int, seed: int, each: int) -> dict[str, Any]:
    """Voltages of all grounds on one rig, first of lone contacts that calibrate it."""
    import tomojax as tx
    from bench.rigs import draw_rig, draw_touch, Elements, network_of

    rng = np.random.default_rng([seed, number])
    sensor = tx.Sensor.grid(dtype=np.float32)
    rig = draw_rig(sensor, rng)
    exact = (Elements if number % 2 else network_of)(rig)
    rubbed = [("rub", [draw_touch(sensor, "usual", rng)]) for _ in range(TOUCHES)]
    scenes = rubbed + scenes_of(sensor, rng, each)
    volts = [rig.chain.read(scene(exact, made), rng) for _, made in scenes]
    return {"number": number, "volts": np.array(volts, np.float32), "scenes": scenes}


def judged(rig: dict[str, Any], seed: int, method: str = "points") -> list[dict[str, Any]]:
    """A row for each scene, each number of slots, nominal and calibrated."""
    import tomojax as tx

    sensor, volts, scenes = tx.Sensor.grid(dtype=np.float32), rig["volts"], rig["scenes"]
    ten = ten_of(seed, rig["number"], len(scenes))
    rubs = np.take_along_axis(volts, ten[..., None], 1)[:TOUCHES]
    known = rig.get("known") or tx.calibration.calibrate(sensor, rubs, ten[:TOUCHES])
    rows = []
    for kind, calibration in zip(KNOWN, (tx.Calibration(), known)):
        made = tx.method(sensor, method, 32, calibration)
        batch = tx.Batch(made, made.choose_lambda([]), contacts=3, images=False)
        for slots in SLOTS:
            under = ten if slots == 10 else np.tile(np.arange(64), (len(scenes), 1))
            v = np.take_along_axis(volts, under[..., None], 1)[TOUCHES:]
            v = calibration.voltages(v).astype(np.float32)
            found = batch(v, under[TOUCHES:])
            for k, (name, touches) in enumerate(scenes[TOUCHES:]):
                off = _off(found.contact_xy[k], touches)
                level = tx.Flag(int(found.flags[k])).level
                rows.append(
                    {
                        "rig": rig["number"], "known": kind, "slots": slots, "scene": name,
                        "found": int(found.contact_count[k]), "mm": 1e3 * off,
                        "doubt": bool(level >= 1), "flags": int(found.flags[k]),
                    }
                )  # fmt: skip
    return rows


def _off(xy: np.ndarray, touches: list[Any]) -> float:
    """Returns the larger of the places' errors, m; NaN where nothing was found."""
    true, xy = np.array([t.centre for t in touches]), xy[: len(touches)]
    return float(min(np.hypot(*(xy[::way] - true).T).max() for way in (1, -1)))


def summed(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Parts told as two and as one, and how many of the wrong ones without a doubt."""
    table = []
    for name in dict.fromkeys(r["scene"] for r in rows):
        true = 2 if name.startswith("two") else 1
        for known in KNOWN:
            for slots in SLOTS:
                some = [
                    r for r in rows
                    if (r["scene"], r["known"], r["slots"]) == (name, known, slots)
                ]  # fmt: skip
                near = float(name.split()[1]) / 2 if true == 2 else np.inf
                right = np.array([r["found"] == true and r["mm"] < near for r in some])
                two = np.array([r["found"] >= 2 for r in some])
                doubt = np.array([r["doubt"] for r in some])
                mm = np.array([r["mm"] for r in some])[right]
                table.append(
                    {
                        "scene": name, "known": known, "slots": slots, "scenes": len(some),
                        "right": right.mean(), "told_as_two": two.mean(),
                        "two_without_doubt": (two & ~doubt).mean(),
                        "wrong_without_doubt": (~right & ~doubt).mean(),
                        "right_in_doubt": (right & doubt).mean(),
                        "median_mm": float(np.median(mm)) if len(mm) else None,
                    }
                )  # fmt: skip
    return table


def line(row: dict[str, Any]) -> str:
    return (
        f"{row['scene']:16} {row['known']:10} {row['slots']:2} slots: "
        f"right {row['right']:4.0%}, two {row['told_as_two']:4.0%}, wrong without a doubt "
        f"{row['wrong_without_doubt']:4.0%}, right in doubt {row['right_in_doubt']:4.0%}, "
        f"{row['median_mm'] or np.nan:.2f} mm"
    )


def draw(table: list[dict[str, Any]], path: Path) -> None:
    """Draws each kind of scene: told as two, and the part of it that is in doubt."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from tomojax._pictures import BLUE, SKY

    figure, grid = plt.subplots(1, 4, figsize=(11, 3.2), sharey=True)
    for axes, (known, slots) in zip(grid, [(k, s) for k in KNOWN for s in SLOTS]):
        some = [r for r in table if (r["known"], r["slots"]) == (known, slots)][::-1]
        at, names = np.arange(len(some)), [r["scene"] for r in some]
        axes.barh(at, [100 * r["told_as_two"] for r in some], color=SKY)
        axes.barh(at, [100 * r["two_without_doubt"] for r in some], color=BLUE)
        axes.set(xlim=(0, 100), title=f"{known}, {slots} slots", xlabel="told as two, %")
        axes.set_yticks(at, names)
    figure.suptitle("Two contacts or one long one: told as two, the pale part in doubt")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=4)
    parser.add_argument("--each", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1000071)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    rigs = [drawn(k, options.seed, options.each) for k in range(options.rigs)]
    write([row for rig in rigs for row in judged(rig, options.seed)], options)


def write(each: list[dict[str, Any]], options: argparse.Namespace) -> None:
    from tomojax._environment import environment

    rows = summed(each)
    print("\n".join(line(row) for row in rows))
    told = {name: getattr(options, name) for name in ("rigs", "each", "seed")}
    report = {"environment": environment(), "options": told, "rows": rows}
    (options.out / "two.json").write_text(json.dumps(report, indent=1) + "\n")
    draw(rows, options.out / "two.png")


if __name__ == "__main__":
    main()
