"""Tries methods with several and partial grounds a slot, beside one grounded electrode.

    python tests/benchmarks/conditions.py [--each 30] [--rigs 6] [--seed N]

Voltages come of a resistor network with errors (`bench.network`) that no method is told.
Each scene is read from ten slots: one electrode grounded; a pair, through 4 Ω each; an
electrode through 4 Ω with another through 1 kΩ; four neighbours. Places are judged in
pitches, bars by the overlap where touch is likelier than not. The default seed is for
judging. Writes conditions.json and conditions.png.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from skins import answers, judged

import tomojax as tx
from bench.network import Network
from bench.skins import pixels

RESULTS = Path(__file__).parents[2] / "notebooks" / "results"
METHODS = ("points", "source", "auto", "follow", "shape")
KINDS = ("one", "two", "bar")


def tables(sensor: tx.Sensor) -> dict[str, np.ndarray]:
    """Ten conditions of each kind, S to ground."""
    xy, m = np.asarray(sensor.electrode_xy, float), sensor.electrode_count
    apart = np.hypot(*(xy[:, None] - xy).transpose(2, 0, 1))
    firsts = np.array([0, 7, 56, 63, 3, 24, 31, 60, 27, 36])
    found = {name: np.zeros((10, m)) for name in ("one", "pair", "partial", "four")}
    for k, first in enumerate(firsts):
        near, far = np.argsort(apart[first])[:4], int(apart[first].argmax())
        for name in found:
            found[name][k, first] = 1 / 4
        found["pair"][k, far] = 1 / 4
        found["partial"][k, far] = 1e-3
        found["four"][k, near] = 1 / 4
    return found


def draw(rig: Network, kind: str, rng: np.random.Generator) -> tuple:
    """Contacts of a scene, their places, and the bar's mask."""
    size = rig.cells.max(0) + rig.cells.min(0)
    if kind == "bar":
        at, turn = rng.uniform(0.3, 0.7, 2) * size, rng.uniform(0, np.pi)
        inside = rig.bar(at, 0.05, 0.014, turn)
        return [(inside, 10 ** rng.uniform(-4.5, -3.5))], np.full((3, 2), np.nan), inside
    while True:
        places = rng.uniform(0.08, 0.92, (KINDS.index(kind) + 1, 2)) * size
        if len(places) == 1 or np.hypot(*(places[0] - places[1])) > 0.03:
            break
    discs = [rig.disc(at, rng.uniform(4e-3, 8e-3)) for at in places]
    told = np.full((3, 2), np.nan)
    told[: len(places)] = [rig.cells[inside].mean(0) for inside in discs]
    touches = [(inside, 10 ** rng.uniform(-5.3, -4)) for inside in discs]
    return touches, told, np.zeros(len(rig.cells), bool)


def scenes_of(sensor: tx.Sensor, options: argparse.Namespace) -> dict[str, dict]:
    """The same scenes read under each kind of conditions."""
    kinds, rng = np.repeat(KINDS, options.each), np.random.default_rng(options.seed)
    rigs = [Network(sensor, rng) for _ in range(options.rigs)]
    at, shape = pixels(np.asarray(sensor.size, float))
    cell = (at / np.asarray(sensor.size, float) * rigs[0].shape).astype(int)
    found = {name: [] for name in tables(sensor)}
    places, masks = [], []
    for k, kind in enumerate(kinds):
        rig = rigs[k % len(rigs)]
        touches, told, inside = draw(rig, kind, rng)
        places.append(told)
        masks.append(inside.reshape(rig.shape)[tuple(cell.T)].reshape(shape))
        for name, table in tables(sensor).items():
            found[name].append(rig.measure(rig.shared(table, *touches)))
    told = {"kinds": kinds, "places": np.stack(places), "masks": np.stack(masks)}
    told["pitch"] = sensor.mean_pitch
    return {name: told | {"volts": np.float32(volts)} for name, volts in found.items()}


def plot(rows: list[dict], path: Path) -> None:
    """Medians of places, or overlaps, by kind of conditions."""
    from matplotlib.figure import Figure

    from tomojax._pictures import plain, style

    names = list(dict.fromkeys(row["conditions"] for row in rows))
    figure = Figure(figsize=(10, 4), layout="constrained")
    figure.suptitle("Ten slots with one ground, or several")
    places, bars = figure.subplots(1, 2)
    for k, method in enumerate(METHODS):
        look = style(method, linestyle="none")
        for kind, axes, field in (("one", places, "median"), ("bar", bars, "overlap")):
            mine = [r for r in rows if (r["method"], r["scene"]) == (method, kind)]
            at = [names.index(r["conditions"]) + 0.12 * (k - 2) for r in mine]
            if mine:
                axes.plot(at, [r[field] for r in mine], **look, label=method)
    places.set(yscale="log", ylabel="lone contact off, pitches: median")
    plain(places.yaxis)
    bars.set(ylim=(0, 1), ylabel="bar's overlap, median")
    for axes in (places, bars):
        axes.set_xticks(range(len(names)), names)
        axes.legend(fontsize=8)
        axes.grid(axis="y", alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=30)
    parser.add_argument("--rigs", type=int, default=6)
    parser.add_argument("--seed", type=int, default=1000500)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    sensor, rows = tx.Sensor.grid(dtype=np.float32), []
    scenes, told = scenes_of(sensor, options), tables(sensor)
    for method in METHODS:
        kinds = KINDS[2:] if method == "shape" else KINDS[:2]
        for name, found in scenes.items():
            some = np.isin(found["kinds"], kinds)
            part = {k: a if np.ndim(a) == 0 else a[some] for k, a in found.items()}
            which = replace(sensor, conditions=told[name])
            said = answers(which, method, part["volts"], np.arange(10))
            for kind in kinds:
                row = {"conditions": name, "method": method, "scene": kind}
                rows.append(row | judged(said, part, kind))
                print(json.dumps(rows[-1]), flush=True)
    asked = {k: v for k, v in vars(options).items() if k != "out"}
    text = json.dumps({"options": asked, "rows": rows}, indent=1)
    (options.out / "conditions.json").write_text(text + "\n")
    plot(rows, options.out / "conditions.png")


if __name__ == "__main__":
    main()
