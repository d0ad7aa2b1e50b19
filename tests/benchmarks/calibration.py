"""Calibrations of rigs that are not ours: nominal, with contacts' places told, and blind.

    python tests/benchmarks/calibration.py [--rigs 6] [--touches 120] [--seed N]

Every second rig is a resistor network, every other one is of finite elements
(`tomojax.studies.rigs`), drawn by default: sheet uneven by 2 %, electrodes off by 3 % of
their diameter, gains, zeros, noise. Half of the rigs have electrodes that are off by 10 %.
One lone contact for each frame of ten slots, two corners and eight others, drawn anew;
other contacts, with all 64 grounds, are for judging. Zeros are not tared. Judging seeds by
default: nothing was set on them. Writes calibration.json and calibration.png.
"""

import argparse
import json
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
SLOTS = (1, 2, 10, 64)
JUDGED = 25  # contacts
KINDS = ("nominal", "placed", "blind")
COLOURS = {"nominal": "0.6", "placed": "C1", "blind": "C0"}


def drawn(number: int, seed: int, touches: int) -> dict[str, np.ndarray]:
    """Voltages of all grounds under each contact of one rig, and what was true."""
    import tomojax as tx
    from tomojax.studies.rigs import draw_rig, draw_touch, Elements, network_of

    rng = np.random.default_rng([seed, number])
    sensor = tx.Sensor.grid(dtype=np.float32)
    rig = draw_rig(sensor, rng, off=0.1 if number // 2 % 2 else 0.03)
    exact = (Elements if number % 2 else network_of)(rig)
    volts, places = [], []
    for _ in range(touches + JUDGED):
        touch = draw_touch(sensor, "usual", rng)
        volts.append(rig.chain.read(exact.touched(touch, np.arange(64)), rng))
        places.append(touch.centre)
    axis = (np.arange(32) + 0.5) * 0.005
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    chain = {"gain": rig.chain.gain, "zero": rig.chain.zero, "electrodes": rig.place}
    sheet = rig.sheet(grid)
    found = {"volts": volts, "places": places, "grid": grid, "sheet": sheet / sheet.mean()}
    return {name: np.array(a) for name, a in (found | chain).items()}


def judged(number: int, seed: int, rig: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """Rows of one rig: each calibration, from each number of slots."""
    import tomojax as tx

    sensor, rng = tx.Sensor.grid(dtype=np.float32), np.random.default_rng([seed, number, 1])
    volts, places = rig["volts"], rig["places"]
    some = [rng.choice(np.arange(1, 63), 8, replace=False) for _ in volts]
    grounds = np.array([[0, 63, *each] for each in some])
    ten = np.take_along_axis(volts, grounds[..., None], 1)
    n = len(volts) - JUDGED
    rows = []
    for kind in KINDS:
        start, known = time.perf_counter(), tx.Calibration()
        if kind != "nominal":
            told = places[:n] if kind == "placed" else None
            known = tx.calibration.calibrate(sensor, ten[:n], grounds[:n], told)
        about = {"rig": number, "model": ("network", "elements")[number % 2]}
        about |= {"seed": seed, "touches": n, "kind": kind}
        about["seconds"] = time.perf_counter() - start
        about |= _values(sensor, known, rig)
        method = tx.method(sensor, "points", 32, known)
        batch = tx.Batch(method, 1.0, contacts=2, images=False)
        for slots in SLOTS:
            under = (
                grounds[n:, :slots] if slots < 64 else np.tile(np.arange(64), (JUDGED, 1))
            )
            v = np.take_along_axis(volts[n:], under[..., None], 1)
            found = batch(known.voltages(v).astype(np.float32), under)
            off = found.contact_xy[:, 0] - places[n:]
            lone = found.contact_count == 1
            stated = np.sqrt(found.contact_covariance[:, 0, :2])
            mm = np.where(lone, 1e3 * np.hypot(*off.T), np.inf)
            row = {
                "slots": slots,
                "median_mm": np.median(mm),
                "p90_mm": np.quantile(mm, 0.9),
            }
            row["within_sigma"] = (np.abs(off) < stated)[lone].mean()
            row |= {"count_right": lone.mean(), "flagged": (found.flags != 0).mean()}
            row["conductance_known"] = float(
                np.isfinite(found.contact_conductance[:, 0]).mean()
            )
            rows.append(about | {k: float(a) for k, a in row.items()})
            print(json.dumps(rows[-1]), flush=True)
    return rows


def _values(sensor, known, rig: dict[str, np.ndarray]) -> dict[str, float]:
    """Compares calibrated values with the rig's, and their errors with 1 σ as stated."""
    xy = np.asarray(sensor.electrode_xy, float)
    off = np.broadcast_to(known.electrodes, xy.shape) + xy - rig["electrodes"]
    gain = np.asarray(known.gain) - rig["gain"]
    sheet = known.sheet_factor(rig["grid"], np.asarray(sensor.size, float)) - rig["sheet"]
    found = {
        "electrodes_mm": 1e3 * np.sqrt((off**2).mean()),
        "gain_percent": 100 * gain.std(),
    }
    found["sheet_percent"] = 100 * sheet.std()
    if known.deviation:
        stated = np.asarray(known.deviation["electrodes"])
        found["electrodes_within_sigma"] = (np.abs(off) < stated).mean()
        found["electrodes_stated_mm"] = 1e3 * np.sqrt((stated**2).mean())
        found["gain_within_sigma"] = (np.abs(gain) < known.deviation["gain"]).mean()
    return {name: float(value) for name, value in found.items()}


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Place errors by slots, of each rig; electrodes' places that are left."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    for k, kind in enumerate(KINDS):
        mine = [r for r in rows if r["kind"] == kind]
        for slots in SLOTS:
            each = [r["median_mm"] for r in mine if r["slots"] == slots]
            at = SLOTS.index(slots) + 0.22 * (k - 1)
            left.plot([at] * len(each), each, ".", color=COLOURS[kind], ms=5)
            label = kind if slots == 1 else None
            left.plot(
                at, np.median(each), "_", color=COLOURS[kind], ms=18, mew=3, label=label
            )
        ten = [r for r in mine if r["slots"] == 10]
        x = [f"{r['model']} {r['rig']}" for r in ten]
        right.plot(
            x, [r["electrodes_mm"] for r in ten], "o", color=COLOURS[kind], label=kind
        )
    left.set_xticks(range(len(SLOTS)), [str(s) for s in SLOTS])
    left.set(xlabel="slots", ylabel="place error of a contact, median, mm", yscale="log")
    left.legend(title="a dot for each rig")
    right.set(ylabel="electrodes off the places told, mm rms", yscale="log")
    right.tick_params(axis="x", rotation=60)
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=6)
    parser.add_argument("--touches", type=int, default=120)
    parser.add_argument("--seed", type=int, default=1000021)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    # Two processes of as many threads as cores would wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    numbers = range(options.rigs)
    with ProcessPoolExecutor(2) as pool:
        given = [options.seed] * options.rigs, [options.touches] * options.rigs
        rigs = list(pool.map(drawn, numbers, *given))
    rows = [row for k in numbers for row in judged(k, options.seed, rigs[k])]
    from benchmarks.physics import environment

    report = {"environment": environment(), "rows": rows}
    (options.out / "calibration.json").write_text(json.dumps(report, indent=1) + "\n")
    draw(rows, options.out / "calibration.png")


if __name__ == "__main__":
    main()
