"""Compares calibrations of rigs: nominal, with contacts' places told, and blind.

    python tests/benchmarks/calibration.py [--rigs 10] [--touches 100] [--seed N]

Every second rig is a resistor network, every other one is of finite elements
(`bench.rigs`). Rigs are drawn by default: sheet uneven by 2 %, electrodes off by
3 % of their diameter, gains, zeros, noise. Half of the rigs have electrodes that are off by
10 %. Each frame has one lone contact in ten slots: two corners and eight others, drawn
anew. Other lone contacts, pairs and bars, with all 64 grounds, are for judging. Zeros are
not tared.

The default seeds are for judging: nothing was set on them. The errors that are left stand
beside those of rigs whose faults are switched off one by one. For these rigs, nominal
values are told as if they were calibrated. Writes calibration.json, calibration.png and
calibration_maps.png.
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

from tomojax._pictures import BLUE, GREEN, ORANGE, plain, SIGNED  # noqa: E402

RESULTS = HERE.parents[1] / "notebooks" / "results"
SLOTS = (1, 2, 10, 64)
LONE, PAIRS, BARS = 30, 10, 10  # that are judged; pairs at each distance, pitches
APART = (0.75, 1.0)
KINDS = ("nominal", "placed", "blind")
LABELS = dict(zip(KINDS, ("nominal values", "places told", "places unknown")))
COLOURS = {"nominal": "0.55", "placed": ORANGE, "blind": BLUE}
MARKERS = {"nominal": "s", "placed": "^", "blind": "o"}
NONE = {"uneven": 0.0, "off": 0.0, "gain": 0.0}
QUIET = {"noise": 1e-7, "bits": 24}
# What a rig has not, and which part of nominal errors a method is told.
OFF = {
    "all errors": ({}, 1.0),
    "sheet even": ({"uneven": 0.0}, 1.0),
    "electrodes exact": ({"off": 0.0}, 1.0),
    "gains exact": ({"gain": 0.0}, 1.0),
    "no noise": (QUIET, 1.0),
    "none of these": (NONE | QUIET, 1.0),
    "none, and told": (NONE | QUIET, 0.1),
}


def scene(exact: Any, touches: list[Any], grounds: Any = None) -> np.ndarray:
    """Exact voltages of contacts at once, under each ground or some."""
    if grounds is None:
        grounds = np.arange(exact.rig.sensor.electrode_count)
    if hasattr(exact, "scene"):
        return exact.scene(touches, grounds)
    contacts = [(exact.weights(t), t.conductance) for t in touches]
    return exact.network.under(grounds, *contacts)


def judged_scenes(sensor: Any, rng: np.random.Generator) -> list[tuple[str, list[Any]]]:
    """Lone contacts, pairs and bars, by what they are for."""
    from bench.rigs import draw_touch, Touch

    pitch, size = sensor.mean_pitch, np.asarray(sensor.size, float)
    square = 1 / float(np.mean(np.asarray(sensor.sheet_resistance)))

    def conductance() -> float:
        return square * 10 ** rng.uniform(-1.5, 1.5)

    scenes = [("lone", [draw_touch(sensor, "usual", rng)]) for _ in range(LONE)]
    for apart in APART:
        for _ in range(PAIRS):
            middle, turn = rng.uniform(pitch, size - pitch), rng.uniform(0, np.pi)
            half = apart * pitch / 2 * np.array([np.cos(turn), np.sin(turn)])
            radii = rng.uniform(0.15, 0.3, 2) * pitch
            both, ratio = conductance(), 10 ** rng.uniform(-0.25, 0.25)
            pair = [
                Touch(middle + s * half, (a, a), 0.0, both * ratio**s)
                for s, a in zip((1, -1), radii)
            ]
            scenes.append((f"pair {1e3 * apart * pitch:.0f} mm", pair))
    for _ in range(BARS):
        middle, turn = rng.uniform(2 * pitch, size - 2 * pitch), rng.uniform(0, np.pi)
        axes = rng.uniform(1.2, 1.8) * pitch, 0.15 * pitch
        scenes.append(("bar", [Touch(middle, axes, turn, conductance())]))
    return scenes


def drawn(number: int, seed: int, touches: int) -> dict[str, Any]:
    """Voltages of all grounds under each contact of one rig, and what was true."""
    import tomojax as tx
    from bench.rigs import draw_rig, draw_touch, Elements, network_of

    rng = np.random.default_rng([seed, number])
    sensor = tx.Sensor.grid(dtype=np.float32)
    rig = draw_rig(sensor, rng, off=0.1 if number // 2 % 2 else 0.03)
    exact = (Elements if number % 2 else network_of)(rig)
    rubbed = [("rub", [draw_touch(sensor, "usual", rng)]) for _ in range(touches)]
    scenes = rubbed + judged_scenes(sensor, rng)
    volts = [rig.chain.read(scene(exact, made), rng) for _, made in scenes]
    axis = (np.arange(32) + 0.5) / 32
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    grid = grid * np.asarray(sensor.size)
    sheet = rig.sheet(grid)
    chain = {"gain": rig.chain.gain, "zero": rig.chain.zero, "electrodes": rig.place}
    found = {"volts": np.array(volts), "scenes": scenes, "grid": grid}
    return found | chain | {"sheet": sheet / sheet.mean()}


def ten_of(seed: int, number: int, count: int) -> np.ndarray:
    """Two corners and eight other grounds, for each scene others."""
    rng = np.random.default_rng([seed, number, 1])
    some = [rng.choice(np.arange(1, 63), 8, replace=False) for _ in range(count)]
    return np.array([[0, 63, *each] for each in some])


def judged(number: int, seed: int, rig: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of one rig: each calibration, each kind of scene, each number of slots."""
    import tomojax as tx

    sensor = tx.Sensor.grid(dtype=np.float32)
    volts, scenes = rig["volts"], rig["scenes"]
    n = sum(kind == "rub" for kind, _ in scenes)
    grounds = ten_of(seed, number, len(scenes))
    ten = np.take_along_axis(volts, grounds[..., None], 1)
    rows = []
    for kind in KINDS:
        start, known = time.perf_counter(), tx.Calibration()
        if kind != "nominal":
            told = np.array([made[0].centre for _, made in scenes[:n]])
            told = told if kind == "placed" else None
            known = tx.calibration.calibrate(sensor, ten[:n], grounds[:n], told)
        about = {"rig": number, "model": ("network", "elements")[number % 2]}
        about |= {"seed": seed, "touches": n, "kind": kind}
        about["seconds"] = time.perf_counter() - start
        about |= _values(sensor, known, rig)
        batch = tx.Batch(tx.method(sensor, "points", 32, known), 1.0, 3, images=False)
        names = [name for name, _ in scenes]
        for name in dict.fromkeys(names[n:]):
            which = np.flatnonzero(np.array(names) == name)
            made = [scenes[k][1] for k in which]
            for slots in SLOTS:
                under = grounds[which, :slots]
                if slots == 64:
                    under = np.tile(np.arange(64), (len(which), 1))
                v = np.take_along_axis(volts[which], under[..., None], 1)
                found = batch(known.voltages(v).astype(np.float32), under)
                row = {"scene": name, "slots": slots} | _beside(found, made)
                rows.append(
                    about
                    | {k: a if isinstance(a, str) else float(a) for k, a in row.items()}
                )
                print(json.dumps(rows[-1]), flush=True)
    return rows


def _beside(found: Any, made: list[Any]) -> dict[str, float]:
    """What was found beside the truth; a scene that is counted wrong is infinitely off."""
    count = len(made[0])
    long = made[0][0].half_axes[0] > 1.5 * made[0][0].half_axes[1]
    right = found.contact_count == count
    places = np.array([[t.centre for t in touches] for touches in made])
    xy = found.contact_xy[:, :count]
    stated = np.sqrt(found.contact_covariance[:, :count, :2])
    off = xy - places
    if count == 2:
        crossed = xy[:, ::-1] - places
        worse = (off**2).sum((1, 2)) > (crossed**2).sum((1, 2))
        off[worse], stated[worse] = crossed[worse], stated[worse][:, ::-1]
    mm = np.where(right, 1e3 * np.hypot(*np.moveaxis(off, -1, 0)).max(1), np.inf)
    row = {"median_mm": np.median(mm), "p90_mm": np.quantile(mm, 0.9, method="lower")}
    if count == 1 and right.all():
        row["relative_mm"] = 1e3 * np.median(_relative(xy[:, 0], places[:, 0]))
    row["count_right"] = right.mean()
    row["flagged"] = (found.flags != 0).mean()
    if right.any():
        row["within_sigma"] = (np.abs(off) < stated)[right].mean()
    if count == 1 and not long:
        true = np.array([touches[0].conductance for touches in made])
        ratio = np.abs(np.log(found.contact_conductance[:, 0] / true))
        soft = true < 1e-4  # a square of the sheet: of metal its size is told
        row["conductance_off"] = np.median(
            np.where(right & np.isfinite(ratio), ratio, 3)[soft]
        )
    if long:
        turn = found.contact_angle[:, 0] - np.array([t[0].angle for t in made])
        turn = np.abs((np.degrees(turn) + 90) % 180 - 90)
        row["angle_deg"] = np.median(np.where(np.isfinite(turn), turn, 90))
    return row


def _relative(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Place errors, m, once the best shift, turn and stretch of all places is taken off."""
    z, w = (np.asarray(a, float) @ [1, 1j] for a in (found, true))
    columns = np.stack([np.ones(len(z)), z], 1)  # w = a + b·z
    inner = np.abs(w - z) < 4 * np.median(np.abs(w - z))
    fit = np.linalg.lstsq(columns[inner], w[inner], rcond=None)[0]
    return np.abs(w - columns @ fit)


def switched_off(number: int, seed: int) -> list[dict[str, Any]]:
    """Places on rigs without some of their errors, told as if they were calibrated."""
    import tomojax as tx
    from bench.rigs import draw_rig, draw_touch, Elements, network_of

    sensor = tx.Sensor.grid(dtype=np.float32)
    rows = []
    for label, (words, part) in OFF.items():
        known = tx.Calibration(error=part, own=part)
        batch = tx.Batch(tx.method(sensor, "points", 32, known), 1.0, 2, images=False)
        rng = np.random.default_rng([seed, number, 2])
        exact = (Elements if number % 2 else network_of)(draw_rig(sensor, rng, **words))
        touches = [draw_touch(sensor, "usual", rng) for _ in range(LONE)]
        volts = np.array([exact.rig.chain.read(scene(exact, [t]), rng) for t in touches])
        under = ten_of(seed, number, len(touches))
        v = np.take_along_axis(volts, under[..., None], 1).astype(np.float32)
        found = batch(v, under)
        soft = np.array([t.conductance < 1e-4 for t in touches])
        off = 1e3 * np.hypot(*(found.contact_xy[:, 0] - [t.centre for t in touches]).T)
        row = {"rig": number, "model": ("network", "elements")[number % 2], "left": label}
        row |= {"median_mm": np.median(off), "p90_mm": np.quantile(off, 0.9)}
        row |= {
            "soft_median_mm": np.median(off[soft]),
            "metal_median_mm": np.median(off[~soft]),
        }
        rows.append(
            {k: a if isinstance(a, str | int) else float(a) for k, a in row.items()}
        )
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


def _by_slots(axes: Any, rows: list[dict[str, Any]], scene: str) -> None:
    """Place errors by slots; where most are miscounted a dot lies on the upper frame."""
    each = [r["median_mm"] for r in rows if r["scene"] == scene]
    top = 1.3 * max(a for a in each if a is not None and np.isfinite(a))
    for k, kind in enumerate(KINDS):
        own = [r for r in rows if r["kind"] == kind and r["scene"] == scene]
        for at, slots in enumerate(SLOTS):
            each = [r["median_mm"] for r in own if r["slots"] == slots]
            each = [a if a is not None and np.isfinite(a) else top for a in each]
            x = at + 0.22 * (k - 1)
            look = {"color": COLOURS[kind], "marker": MARKERS[kind], "ls": "none"}
            axes.plot([x] * len(each), each, **look, ms=4, alpha=0.8)
            axes.plot(x, np.median(each), "_", color=COLOURS[kind], ms=16, mew=3)
    axes.set_xticks(range(len(SLOTS)), [str(slots) for slots in SLOTS])
    axes.set(xlabel="slots", ylabel="place error, mm (median)", yscale="log")
    axes.grid(alpha=0.3)
    plain(axes.yaxis)


def draw(rows: list[dict[str, Any]], errors: list[dict[str, Any]], path: Path) -> None:
    """Place errors by slots, electrodes that are left, and rigs without some errors."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(12, 8.4), layout="constrained")
    figure.suptitle(
        "What a calibration gives: a mark for each rig, a bar for the middle one"
    )
    (left, right), (pairs, off) = axes
    _by_slots(left, rows, "lone")
    _by_slots(pairs, rows, "pair 20 mm")
    for kind in KINDS:
        ten = [r for r in rows if r["kind"] == kind and r["slots"] == 10]
        ten = [r for r in ten if r["scene"] == "lone"]
        x = [f"{r['model']} {r['rig']}" for r in ten]
        y = [r["electrodes_mm"] for r in ten]
        look = {"color": COLOURS[kind], "marker": MARKERS[kind], "ls": "none"}
        right.plot(x, y, **look, label=LABELS[kind])
    left.set_title("Lone contacts")
    pairs.set_title("Pairs 20 mm apart, the worse place (top: miscounted)")
    figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    right.set(ylabel="electrodes off the places told, mm rms", yscale="log")
    right.set_title("Electrodes' places, ten slots")
    right.tick_params(axis="x", rotation=60)
    right.grid(alpha=0.3)
    plain(right.yaxis)
    for n, label in enumerate(OFF):
        each = [r for r in errors if r["left"] == label]
        for shift, key, look, words in (
            (-0.1, "median_mm", "ko", "all contacts"),
            (0.1, "soft_median_mm", "D", "soft contacts"),
        ):
            values = [r[key] for r in each]
            more = {} if "k" in look else {"color": GREEN}
            label = words if n == 0 else None
            off.plot([n + shift] * len(each), values, look, ms=5, label=label, **more)
    off.set_xticks(range(len(OFF)), list(OFF), rotation=30, ha="right")
    off.set(ylabel="place error, mm (median)", yscale="log")
    off.set_title("Two rigs without some of their errors")
    off.grid(alpha=0.3)
    off.legend(loc="lower left", fontsize=9)
    plain(off.yaxis)
    figure.savefig(path, dpi=120)


def draw_maps(rigs: dict[int, dict[str, Any]], seed: int, path: Path) -> None:
    """Sheet and electrodes of two rigs, and how a calibration without places finds them."""
    from matplotlib.figure import Figure

    import tomojax as tx

    sensor = tx.Sensor.grid(dtype=np.float32)
    xy, size = np.asarray(sensor.electrode_xy, float), np.asarray(sensor.size, float)
    figure = Figure(figsize=(12, 7.2), layout="constrained")
    figure.suptitle(
        "Sheets and electrodes as they are, and as a rub without places finds them"
    )
    axes = figure.subplots(2, 3)
    for row, (number, rig) in zip(axes, rigs.items()):
        n = sum(kind == "rub" for kind, _ in rig["scenes"])
        grounds = ten_of(seed, number, len(rig["scenes"]))[:n]
        volts = np.take_along_axis(rig["volts"][:n], grounds[..., None], 1)
        known = tx.calibration.calibrate(sensor, volts, grounds)
        found = known.sheet_factor(rig["grid"], size)
        sheets = {"the sheet": rig["sheet"], "as it was found": found / found.mean()}
        for axis, (name, factor) in zip(row, sheets.items()):
            percent = 100 * (factor.reshape(32, 32).T - 1)
            extent = (0, 1e3 * size[0], 0, 1e3 * size[1])
            words = {"cmap": SIGNED, "vmin": -6, "vmax": 6, "extent": extent}
            drawn_as = axis.imshow(percent, origin="lower", **words)
            axis.set(xlabel="x, mm", ylabel="y, mm", title=f"Rig {number}: {name}")
        label = "sheet resistance beside its mean, %"
        figure.colorbar(drawn_as, ax=list(row[:2]), label=label)
        true = 1e3 * (rig["electrodes"] - xy)
        off = 1e3 * np.broadcast_to(known.electrodes, xy.shape)
        row[2].plot(true.ravel(), off.ravel(), ".", color=BLUE)
        most = 1.1 * np.abs(true).max()
        row[2].plot([-most, most], [-most, most], color="0.6", lw=0.8)
        left = np.sqrt(((true - off) ** 2).mean())
        rms = np.sqrt((true**2).mean())
        title = f"Rig {number}: electrodes {rms:.2f} mm off,\n{left:.2f} mm left"
        row[2].set(xlabel="truly off by, along x or y, mm", ylabel="found, mm", title=title)
        row[2].set_aspect("equal")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="Number of the first rig.")
    parser.add_argument("--touches", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1000041)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    cores, seed = len(os.sched_getaffinity(0)), options.seed
    numbers = range(options.first, options.first + options.rigs)
    each = [seed] * options.rigs, [options.touches] * options.rigs
    start = multiprocessing.get_context("spawn")  # JAX's threads do not survive a fork
    with ProcessPoolExecutor(cores, start) as pool:
        rigs = list(pool.map(drawn, numbers, *each))
    with ProcessPoolExecutor(max(1, cores // 2), start) as pool:
        rows = [row for some in pool.map(judged, numbers, each[0], rigs) for row in some]
        # One rig of each model: how the others differ is seen above.
        off = pool.map(switched_off, numbers[:2], each[0][:2])
        errors = [row for some in off for row in some]
    from tomojax._environment import environment

    for row in rows:  # JSON has no infinity: most were miscounted
        row |= {
            k: None for k, a in row.items() if isinstance(a, float) and not np.isfinite(a)
        }
    report = {"environment": environment(), "rows": rows, "switched_off": errors}
    (options.out / "calibration.json").write_text(json.dumps(report, indent=1) + "\n")
    draw(rows, errors, options.out / "calibration.png")
    # Electrodes of the first are off as usual, of the third by 10 % of their diameter.
    some = dict(list(zip(numbers, rigs))[:3:2])
    draw_maps(some, seed, options.out / "calibration_maps.png")


if __name__ == "__main__":
    main()
