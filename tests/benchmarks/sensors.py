"""Tries methods on other sensors: electrodes, sizes, discs, sheets, drives, bits.

    python tests/benchmarks/sensors.py [--rigs 6] [--each 6] [--pairs 40] [--seed N]

Sensors differ from the default in one property or in all. Lone contacts are drawn by the
defaults of `bench.rigs`; pairs have centres one pitch apart. A method is told
nominal values and has the two corner slots, `follow` ten slots. Errors are in pitches. The
default seeds are for judging. Writes notebooks/results/sensors.json and sensors.png; parts
that --only leaves out stay in them.
"""

import argparse
import itertools
import json
from pathlib import Path
from textwrap import wrap
from typing import Any, NamedTuple

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from rigs import figures, followed, in_batch, RESULTS, ten_grounds  # noqa: E402

import tomojax as tx  # noqa: E402
from bench.frontier import DOUBT  # noqa: E402
from bench.rigs import (  # noqa: E402
    FAMILY,
    JUDGING,
    lone_contacts,
    make_rig,
    network_of,
    Touch,
)
from tomojax._pictures import plain, style  # noqa: E402


class Kind(NamedTuple):
    """A sensor of another kind, and the row of the family that its rigs are of."""

    electrodes: int = 8  # along each side
    side: float = 0.16  # m
    disc: float = 0.25  # its diameter, of the pitch
    square: float = 20e3  # Ω/sq
    drive: float = 4.5  # V
    row: str = "usual"

    def sensor(self) -> tx.Sensor:
        n, pitch = self.electrodes, self.side / self.electrodes
        # No coarser than half a disc, as the default's.
        bits = FAMILY[self.row].rig.get("bits", 16)
        cells = max(int(np.ceil(2 * n / self.disc / 2)), 2 * n, 16)
        return tx.Sensor.grid(
            n,
            n,
            pitch=pitch,
            margin=pitch / 2,
            electrode_diameter=self.disc * pitch,
            sheet_resistance=self.square,
            drive_voltage=self.drive,
            divisions=(cells, cells),
            dtype=np.float32,
            resolution=2 * self.drive / 0.9 / 2**bits,  # told, as a file tells it
        )


KINDS = {
    "default": Kind(),
    "2 × 2": Kind(electrodes=2),
    "3 × 3": Kind(electrodes=3),
    "4 × 4": Kind(electrodes=4),
    "6 × 6": Kind(electrodes=6),
    "16 × 16": Kind(electrodes=16),
    "20 mm": Kind(side=0.02),
    "500 mm": Kind(side=0.5),
    "discs of 0.1 pitch": Kind(disc=0.1),
    "discs of 0.5 pitch": Kind(disc=0.5),
    "1 kΩ/sq": Kind(square=1e3),
    "100 kΩ/sq": Kind(square=100e3),
    "0.5 V": Kind(drive=0.5),
    "12 V": Kind(drive=12.0),
    "10 bits": Kind(row="bits_10"),
    "18 bits": Kind(row="bits_18"),
    "4 × 4, 20 mm, 0.5, 1 kΩ/sq, 0.5 V": Kind(4, 0.02, 0.5, 1e3, 0.5),
    "16 × 16, 500 mm, 0.5, 100 kΩ/sq, 12 V": Kind(16, 0.5, 0.5, 1e5, 12.0),
}
METHODS = ("points", "source", "auto", "follow")


def pairs(sensor: tx.Sensor, row: str, seed: int, count: int, apart: float) -> tuple:
    """Voltages of pairs of discs (n, 2, M), the grounds, and their places (n, 2, 2), m.

    Radii 0.15 to 0.4 pitches; 0.1 to 5 times the conductance of a square, less by up to
    ten times for each.
    """
    rng = np.random.default_rng([seed, 77, *row.encode()])
    pitch, size = sensor.mean_pitch, np.asarray(sensor.size, float)
    corners = np.asarray(tx.paper.exploration(sensor))
    square = float(np.mean(np.asarray(sensor.sheet_resistance)))
    volts, places, rig, exact = [], [], None, None
    for k in range(count):
        if k % 10 == 0:
            rig = make_rig(sensor, row, rng)
            exact = network_of(rig)
        turn = rng.uniform(0, np.pi)
        half = apart * pitch / 2 * np.array([np.cos(turn), np.sin(turn)])
        edge = np.minimum(1.25 * pitch, 0.4 * size)
        middle = rng.uniform(edge, size - edge)
        radii = rng.uniform(0.15, min(0.4, 0.42 * apart), 2) * pitch
        whole = 2 * 10 ** rng.uniform(-1, 0.7) / square
        parts = whole * 10 ** -rng.uniform(0, 1, 2)
        two = [
            Touch(middle + s * half, (r, r), 0.0, g)
            for s, r, g in zip((1, -1), radii, parts)
        ]
        weights = [(exact.weights(t), t.conductance) for t in two]
        v = exact.network.under(corners, *weights)
        volts.append(rig.chain.read(v, rng))
        places.append([t.xy for t in two])
    return np.array(volts), corners, np.array(places)


def told_apart(batch: tx.Batch, scenes: tuple, apart: float, pitch: float) -> dict:
    """Pairs of which two were found, both nearer than a third of their distance."""
    volts, grounds, places = scenes
    rows = batch(volts.astype(np.float32), np.tile(grounds, (len(volts), 1)))
    doubt = (rows.flags & DOUBT) > 0
    right, error = [], []
    for k, truth in enumerate(places):
        xy = rows.contact_xy[k, :2]
        each = [
            np.hypot(*(xy[list(order)] - truth).T).max()
            for order in itertools.permutations(range(2))
        ]
        right.append(rows.contact_count[k] == 2 and min(each) < apart * pitch / 3)
        error.append(min(each) / pitch)
    right = np.array(right)
    return {
        "pairs": len(right),
        "told_apart": float(right.mean()),
        "median_pitch": float(np.median(np.array(error)[right])) if right.any() else None,
        "right_flagged": float((doubt & right).sum() / max(1, right.sum())),
        "wrong_unflagged": int((~right & ~doubt).sum()),
    }


def measured(options: argparse.Namespace) -> list[dict[str, Any]]:
    """A row for each sensor and method; printed as they come."""
    rows = []
    for name in options.only or KINDS:
        kind = KINDS[name]
        sensor = kind.sensor()
        pitch, grounds = sensor.mean_pitch, ten_grounds(sensor)
        scenes = lone_contacts(
            sensor, kind.row, options.seed, options.rigs, options.each, grounds
        )
        two = pairs(sensor, kind.row, options.seed, options.pairs, 1.0)
        for method in options.methods:
            row = {"sensor": name, "method": method}
            if method == "follow":
                row |= figures(followed(sensor, scenes), scenes, pitch)
            else:
                made = tx.method(sensor, method)
                batch = tx.Batch(made, made.choose_lambda([]), contacts=3, images=False)
                row |= figures(in_batch(batch, scenes, len(scenes.xy)), scenes, pitch)
                row |= told_apart(batch, two, 1.0, pitch)
            # In pitches: figures of `rigs` are in mm.
            for each in ("median", "p90", "largest"):
                row[f"{each}_pitch"] = row.pop(f"{each}_mm") / 1e3 / pitch
            rows.append(row)
            print(line(row), flush=True)
    return rows


def line(row: dict[str, Any]) -> str:
    sigma, pair = row["within_1_sigma"], row.get("told_apart")
    return (
        f"{row['sensor']:20s} {row['method']:8s} median {row['median_pitch']:.4f} "
        f"90 % {row['p90_pitch']:.4f} pitches, count right {row['count_right']:4.0%}, "
        f"flagged {row['flagged']:4.0%}, far {row['far']} ({row['far_unflagged']} not "
        f"flagged), in 1 σ {'-' if sigma is None else format(sigma, '.0%')}, "
        f"pairs {'-' if pair is None else format(pair, '.0%')} "
        f"({row.get('wrong_unflagged', '-')} wrong and not flagged)"
    )


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Median to 90 % of the places, and pairs told apart, by sensor."""
    names = list(dict.fromkeys(row["sensor"] for row in rows))
    figure, (places, apart) = plt.subplots(
        1, 2, figsize=(12, 0.45 * len(names) + 1.8), sharey=True, width_ratios=(2, 1),
        layout="constrained",
    )  # fmt: skip
    figure.suptitle("Sensors of other kinds; methods told nominal values")
    for k, method in enumerate(METHODS):
        look = style(method, linestyle="none")
        mine = [row for row in rows if row["method"] == method]
        if not mine:
            continue
        at = np.array([names.index(row["sensor"]) + 0.15 * (k - 1.5) for row in mine])
        low = np.array([row["median_pitch"] for row in mine])
        high = np.array([row["p90_pitch"] for row in mine])
        # What finds nothing is at the right edge.
        low, high = (np.minimum(v, 5) for v in (low, high))
        places.hlines(at, low, high, colors=look["color"], lw=2)
        places.plot(low, at, **look, label=method)
        two = [(row["told_apart"], y) for row, y in zip(mine, at) if "told_apart" in row]
        if two:
            apart.plot(*np.array(two).T, **look, clip_on=False)
    words = [name.replace(", 0.5, ", ", discs of 0.5 pitch, ") for name in names]
    places.set(
        xscale="log",
        xlabel="place error, pitches: median (mark), nine in ten (line); 5: lost",
        yticks=range(len(names)),
        yticklabels=["\n".join(wrap(name, 26)) for name in words],
        title="Lone contacts",
    )
    places.axvline(0.5, color="0.6", ls=":", lw=1, label="half a pitch")
    places.invert_yaxis()
    places.grid(axis="x", alpha=0.3)
    plain(places.xaxis)
    legend = places.get_legend_handles_labels()
    figure.legend(*legend, loc="outside lower center", ncols=6, frameon=False)
    apart.axvline(0.8, color="0.6", ls=":", lw=1)
    apart.set(xlim=(0, 1), xlabel="part told apart (dotted: 0.8)")
    apart.set_title("Pairs one pitch apart")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=6)
    parser.add_argument("--each", type=int, default=6)
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--seed", type=int, default=JUDGING)
    parser.add_argument("--methods", nargs="*", choices=METHODS, default=list(METHODS))
    parser.add_argument("--only", nargs="*", choices=list(KINDS))
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    rows = measured(options)
    path = options.out / "sensors.json"
    told = {name: getattr(options, name) for name in ("rigs", "each", "pairs", "seed")}
    kept = json.loads(path.read_text()) if path.exists() else {}
    if kept.get("options") == told:
        new = {row["sensor"] for row in rows}
        rows += [row for row in kept["rows"] if row["sensor"] not in new]
        rows.sort(key=lambda row: list(KINDS).index(row["sensor"]))
    text = json.dumps({"options": told, "rows": rows}, indent=1, ensure_ascii=False)
    path.write_text(text + "\n")
    plot(rows, options.out / "sensors.png")


if __name__ == "__main__":
    main()
