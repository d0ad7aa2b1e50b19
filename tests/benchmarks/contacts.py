"""Finds contacts from one to 64 slots: our models beside the paper's.

    python tests/benchmarks/contacts.py [--scenes 60] [--seed 3] [--out FOLDER]

A resistor network makes the voltages (tests/rig.py; a new sheet for every ten scenes), with
the converter's noise and zeros. Methods are told nominal values alone. Writes
contacts.json, contacts.png and separation.png; parts that --only leaves out stay in them.
Takes an hour, most of it to compile.
"""

import argparse
import json
import sys
import time
from itertools import permutations
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

from benchmarks.physics import environment  # noqa: E402
from rig import Rig  # noqa: E402

import tomojax as tx  # noqa: E402
from tomojax._pictures import name_points, plain, style  # noqa: E402

KINDS = {
    "one": "One contact",
    "two30": "Two contacts 30 mm apart",
    "two20": "Two contacts 20 mm apart",
    "two15": "Two contacts 15 mm apart",
    "bar": "A bar of 65 to 85 mm",
}
# Slots of `points`; and what the paper's method is given.
METHODS = {
    "points": ("corner", "corners", "ten", "all"),
    "shape": ("ten",),
    "source": ("corners", "ten", "all"),
    "linear": ("all", "around", "cop_line"),
}
# Of two contacts: how far apart, mm; slots; and the converter's noise, V.
APART, SLOTS, NOISES = (10, 12.5, 15, 20, 25, 30), ("corners", "ten", "all"), (3e-4, 3e-3)
NEAR = 3.0  # mm: found
# Whose rows are in the picture, and what is written beside them.
DRAWN = ("points", "shape", "source", "linear")
WORDS = {"corner": "1 corner", "corners": "2 corners", "ten": "10 slots", "all": "64 slots"}
WORDS |= {"around": "Around", "cop_line": "CoP line"}


def scene(kind: str, rig: Rig, rng: np.random.Generator):
    """Voltages of all grounds, truth (centre, S) of each contact, a bar's angle."""
    angle = rng.uniform(0, np.pi)
    along = np.array([np.cos(angle), np.sin(angle)])
    if kind == "one":
        radius = rng.uniform(0.003, 0.012)
        place = rng.uniform(radius + 1e-3, 0.159 - radius, 2)
        contacts = [(rig.disc(place, radius), 10 ** rng.uniform(-5.5, -2.5))]
    elif kind == "bar":
        sides = rng.uniform(0.065, 0.085), rng.uniform(0.008, 0.012)
        inside = rig.bar(rng.uniform(0.055, 0.105, 2), *sides, angle)
        contacts = [(inside, 10 ** rng.uniform(-2, 1))]
    else:
        apart, middle = float(kind[3:]) / 1000, rng.uniform(0.035, 0.125, 2)
        radii = rng.uniform(0.003, min(0.008, 0.42 * apart), 2)
        total, ratio = 10 ** rng.uniform(-5, -3.3), 10 ** rng.uniform(0, 1)
        contacts = [
            (rig.disc(middle + s * apart / 2 * along, r), total / f)
            for s, r, f in ((1, radii[0], 1), (-1, radii[1], ratio))
        ]
    exact, truth = rig.scene(*contacts)
    return rig.measure(exact), truth, angle


def grounds_of(sensor: tx.Sensor, name: str, volts: np.ndarray) -> np.ndarray:
    """Electrodes grounded; those around a contact follow two corner slots."""
    corners = np.asarray(tx.paper.exploration(sensor))
    if name == "all":
        return np.arange(len(volts))
    if name.startswith("corner"):
        return corners if name == "corners" else corners[:1]
    near = np.asarray(
        tx.pattern(sensor, "around" if name == "ten" else name, volts[corners])
    )
    return np.concatenate([corners, near]) if name == "ten" else near


def errors(rows: tx.methods.Rows, k: int, truth: list) -> tuple[bool, float]:
    """Whether the count is right, and the farthest contact from its truth, mm."""
    count, places = int(rows.contact_count[k]), np.array([p for p, _ in truth])
    if count != len(truth):
        return False, np.nan
    found = rows.contact_xy[k, :count]
    ways = (
        np.hypot(*(found[list(p)] - places).T).max() for p in permutations(range(count))
    )
    return True, 1e3 * min(ways)


def measured(
    kind: str, name: str, rows: tx.methods.Rows, scenes: list, slots: int, s: float
) -> dict:
    """A row of the table."""
    right, error = np.array([errors(rows, k, t) for k, (_, t, _) in enumerate(scenes)]).T
    row = {
        "scene": kind,
        "method": name,
        "slots": slots,
        "scenes": len(scenes),
        "count_right": right.mean(),
        "found_3mm": float(np.mean(error < NEAR)),
        "place_median_mm": float(np.nanmedian(error)) if right.any() else None,
        "place_p90_mm": float(np.nanquantile(error, 0.9)) if right.any() else None,
        "place_max_mm": float(np.nanmax(error)) if right.any() else None,
        "ms_per_frame": 1e3 * s / len(scenes),
    }
    if kind == "bar":
        true = np.array([angle for _, _, angle in scenes])
        off = (rows.contact_angle[:, 0] - true + np.pi / 2) % np.pi - np.pi / 2
        off = np.degrees(np.abs(np.nan_to_num(off, nan=np.pi / 2)))
        row |= {"angle_median_deg": np.median(off), "angle_p90_deg": np.quantile(off, 0.9)}
    if rows.image is not None:
        cell = np.float32([0.005, 0.005])
        radii = [
            tx.kernels.images.half_area_radius(jnp.asarray(i), cell) for i in rows.image
        ]
        row["image_width_median_mm"] = 2e3 * float(np.median(radii))
    if kind == "one":
        true = np.array([t[0][1] for _, t, _ in scenes])
        off = np.abs(rows.contact_conductance[:, 0] / true - 1)
        row["conductance_median"] = (
            float(np.median(off)) if np.isfinite(off).all() else None
        )
    return row


def run(sensor: tx.Sensor, models: dict, kind: str, count: int, seed: int) -> list[dict]:
    table = []
    rng, scenes = np.random.default_rng(seed), []
    for k in range(count):
        rig = Rig(rng) if k % 10 == 0 else rig  # noqa: F821
        scenes.append(scene(kind, rig, rng))
    for method, names in METHODS.items():
        for name in names:
            grounds = np.array([grounds_of(sensor, name, v) for v, _, _ in scenes])
            volts = np.stack([v[g] for (v, _, _), g in zip(scenes, grounds)])
            # Of the paper's method λ is one for all patterns.
            frames = [tx.methods.Frame(v, g, v > -9) for v, g in zip(volts[:8], grounds)]
            lam = models[method].choose_lambda(frames)
            batch = tx.Batch(models[method], lam, images=kind == "one")
            batch(volts, grounds)  # compiles, also what few frames ask for
            start = time.perf_counter()
            rows = batch(volts, grounds)
            spent = time.perf_counter() - start
            label = f"{method}, {name}"
            row = measured(kind, label, rows, scenes, grounds.shape[1], spent)
            print(json.dumps(row), flush=True)
            table.append(row)
    return table


def separations(
    sensor: tx.Sensor, points: tx.methods.AbstractMethod, count: int, seed: int
) -> list[dict]:
    """Which part of pairs is told as two, both within 3 mm."""
    batch = tx.Batch(points, 1.0, images=False)
    table = []
    for noise in NOISES:
        for apart in APART:
            rng = np.random.default_rng(seed)
            rig = Rig(rng, noise=noise)
            scenes = [scene(f"two{apart}", rig, rng) for _ in range(count)]
            for name in SLOTS:
                grounds = np.array([grounds_of(sensor, name, v) for v, _, _ in scenes])
                volts = np.stack([v[g] for (v, _, _), g in zip(scenes, grounds)])
                rows = batch(volts, grounds)
                found = [errors(rows, k, t)[1] < NEAR for k, (_, t, _) in enumerate(scenes)]
                row = {
                    "scene": "separation",
                    "apart_mm": apart,
                    "slots": grounds.shape[1],
                    "noise_mV": 1e3 * noise,
                    "found_3mm": float(np.mean(found)),
                }
                print(json.dumps(row), flush=True)
                table.append(row)
    return table


def draw_separations(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots()
    for k, slots in enumerate(sorted({r["slots"] for r in rows})):
        for noise, line in zip(NOISES, ("-", "--")):
            some = [r for r in rows if r["slots"] == slots and r["noise_mV"] == 1e3 * noise]
            x, y = [r["apart_mm"] for r in some], [100 * r["found_3mm"] for r in some]
            label = f"{slots} slots, noise {1e3 * noise:g} mV"
            axes.plot(x, y, **style(k, linestyle=line, label=label))
    axes.axvline(20, color="0.7", lw=1)
    axes.annotate(" the electrodes' pitch", (20, 3), color="0.4")
    axes.set(xlabel="between two contacts, mm", ylabel="% found, both within 3 mm")
    axes.set(ylim=(0, 103), title="Two contacts, currents up to 1 : 10 (points)")
    axes.legend()
    figure.savefig(path, dpi=110)


def draw(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 8), layout="constrained")
    figure.suptitle("Contacts that each model finds, by the time of a scan")
    axes = figure.subplots(2, 3).ravel()
    for axis, kind in zip(axes, KINDS):
        value = "angle_median_deg" if kind == "bar" else "place_median_mm"
        named = []
        for r in rows:
            method, _, pattern = r["method"].partition(", ")
            if r["scene"] != kind or method not in DRAWN or r[value] is None:
                continue
            full = r["found_3mm"] if kind.startswith("two") else r["count_right"]
            at = r["slots"] / 10, r[value]
            axis.plot(*at, **style(method, linestyle="none", markersize=3 + 8 * full))
            share = "" if full == 1 else f", {100 * full:.0f} %"
            named.append((WORDS.get(pattern, pattern) + share, *at))
        error = "error of the angle, °" if kind == "bar" else "place error, mm"
        share = "found within 3 mm" if kind.startswith("two") else "counted right"
        axis.set(xscale="log", yscale="log", xlim=(0.07, 20))
        axis.set(xlabel="time of a scan, ms", ylabel=f"{error} (median)")
        axis.set_title(f"{KINDS[kind]}; %, size: {share}", fontsize=11)
        axis.margins(y=0.12)
        axis.grid(alpha=0.3)
        plain(axis.xaxis, axis.yaxis)
        name_points(axis, named, size=8, aside=9)
    for method in DRAWN:
        paper = " (the paper's Eq. 3)" if method == "linear" else ""
        look = style(method, linestyle="none", markersize=9)
        axes[-1].plot([], [], **look, label=method + paper)
    for full in (1, 0.5, 0):
        look = {"color": "0.6", "markersize": 3 + 8 * full}
        axes[-1].plot([], [], "o", **look, label=f"{100 * full:.0f} % of the scenes")
    axes[-1].legend(loc="center", frameon=False, fontsize=11)
    axes[-1].set_axis_off()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--seed", type=int, default=3)
    kinds = (*KINDS, "separation")
    parser.add_argument("--only", nargs="*", choices=kinds, default=kinds)
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    options = parser.parse_args()
    sensor = tx.Sensor.grid(dtype=np.float32, divisions=(32, 32))
    models = {name: tx.method(sensor, name, 32) for name in METHODS}
    path = options.out / "contacts.json"
    for kind in options.only:
        if kind == "separation":
            new = separations(sensor, models["points"], options.scenes, options.seed)
        else:
            new = run(sensor, models, kind, options.scenes, options.seed)
        before = json.loads(path.read_text())["rows"] if path.exists() else []
        rows = [row for row in before if row["scene"] != kind] + new
        content = {"environment": environment(), "seed": options.seed, "rows": rows}
        path.write_text(json.dumps(content, indent=1) + "\n")
        draw([r for r in rows if r["scene"] != "separation"], path.with_suffix(".png"))
        pairs = [r for r in rows if r["scene"] == "separation"]
        draw_separations(pairs, options.out / "separation.png")
        # A process may not map as much compiled code as all kinds have.
        jax.clear_caches()


if __name__ == "__main__":
    main()
