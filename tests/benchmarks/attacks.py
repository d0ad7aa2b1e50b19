"""Counts ghosts on rigs with one fault: a short, a leak, a film, crosstalk, coarse codes.

    python tests/benchmarks/attacks.py [--seed N] [--rigs 6] [--each 12] [--method points]

Lone contacts are on rigs of resistor networks, from two corner slots and from ten. A far
place is half a pitch or further from the contact. Pairs of contacts on sound rigs, 30 mm
apart or further, show what the search for faults costs. No threshold was set on the default
seed. Writes attacks.json and attacks.png.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
RESULTS = HERE.parents[1] / "notebooks" / "results"

SLOTS = 2, 10


def grounds_of(sensor: Any, count: int) -> np.ndarray:
    """The two corners, and others spread over the sheet."""
    import tomojax as tx

    corners = np.asarray(tx.paper.exploration(sensor))
    rest = np.setdiff1d(np.arange(sensor.electrode_count), corners)
    return np.concatenate([corners, rest[:: max(1, len(rest) // (count - 1))]])[:count]


def counted(rows: Any, xy: np.ndarray, half: float) -> dict[str, Any]:
    """What rows of lone contacts tell: missed, far, doubted; places' errors, mm."""
    import tomojax as tx

    off = np.hypot(*np.moveaxis(rows.contact_xy - xy[:, None], -1, 0))
    there = np.arange(off.shape[1]) < rows.contact_count[:, None]
    told = rows.contact_count > 0
    far = told & (np.where(there, off, 0).max(1) > half)
    doubt = rows.flags & int(tx.methods.DOUBT) > 0
    fault = rows.flags & getattr(tx.Flag, "RIG_FAULT", 0) > 0
    first = np.where(told, off[:, 0], np.inf)
    return {
        "contacts": len(told),
        "missed_undoubted": int((~told & ~doubt).sum()),
        "missed": int((~told).sum()),
        "far": int(far.sum()),
        "far_undoubted": int((far & ~doubt).sum()),
        "right_doubted": int((told & ~far & doubt).sum()),
        "fault_told": int(fault.sum()),
        "place_median_mm": round(1e3 * float(np.median(first)), 3),
        "place_p90_mm": round(1e3 * float(np.quantile(first, 0.9)), 3),
    }


def measured(options: argparse.Namespace) -> dict[str, Any]:
    import faulty

    import tomojax as tx
    from bench import attacked

    sensor = faulty.grid(8, 8)
    model = tx.method(sensor, options.method)
    batch = tx.Batch(model, model.choose_lambda([]), 3, images=False)
    half = sensor.mean_pitch / 2
    lone = attacked.lone(sensor, options.seed, options.rigs, options.each)
    pairs = attacked.pairs(sensor, options.seed, options.rigs, options.each // 2, 0.03)
    xy, rows, two = np.array([s.xy[0] for s in lone]), [], []
    for slots in SLOTS:
        grounds = grounds_of(sensor, slots)

        def of(scenes: list, attack: Any, grounds=grounds) -> Any:
            seeds = [[options.seed, k] for k in range(len(scenes))]
            v = [
                attack(s, grounds, np.random.default_rng(seed))
                for s, seed in zip(scenes, seeds)
            ]
            volts = np.array(v, np.float32)
            return batch(volts, np.tile(grounds, (len(v), 1)))

        for name, attack in attacked.ATTACKS.items():
            found = counted(of(lone, attack), xy, half)
            rows.append({"attack": name, "slots": slots} | found)
            print(json.dumps(rows[-1]), flush=True)
        found = of(pairs, attacked.sound)
        fault = found.flags & getattr(tx.Flag, "RIG_FAULT", 0) > 0
        two.append(
            {
                "slots": slots,
                "pairs": len(pairs),
                "counted_right": int((found.contact_count == 2).sum()),
                "fault_told": int(fault.sum()),
            }
        )
        print(json.dumps(two[-1]), flush=True)
    return {"rows": rows, "pairs": two}


def plot(whole: dict[str, Any], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from tomojax._pictures import BLUE, ORANGE, VERMILION

    rows = whole["rows"]
    names = list(dict.fromkeys(row["attack"] for row in rows))
    figure, axes = plt.subplots(1, 2, figsize=(11, 5), sharey=True, layout="constrained")
    for one, slots in zip(axes, SLOTS):
        mine = [row for row in rows if row["slots"] == slots]
        part = [100 / row["contacts"] for row in mine]
        doubted = [
            p * (row["far"] - row["far_undoubted"] + row["missed"])
            for p, row in zip(part, mine)
        ]
        alone = [p * row["far_undoubted"] for p, row in zip(part, mine)]
        one.barh(names, doubted, color=ORANGE, label="far or missed, in doubt")
        one.barh(names, alone, left=doubted, color=VERMILION, label="far, undoubted")
        for k, row in enumerate(mine):
            text = f"{row['place_median_mm']:.2f} mm"
            one.text(99, k, text, ha="right", va="center", color=BLUE, fontsize=8)
        one.set(xlim=(0, 100), xlabel="part of the lone contacts, %")
        one.set_title(f"{slots} slots (blue: median error of the place)", fontsize=10)
    axes[0].invert_yaxis()
    axes[0].legend(loc="center right", fontsize=8)
    figure.suptitle("Rigs with one fault each, method points")
    figure.savefig(path, dpi=110)


def main() -> None:
    from bench.rigs import JUDGING

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=JUDGING + 510)
    parser.add_argument("--rigs", type=int, default=6)
    parser.add_argument("--each", type=int, default=12)
    parser.add_argument("--method", default="points")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    whole = measured(options)
    whole["options"] = {k: str(v) for k, v in vars(options).items() if k != "out"}
    (options.out / "attacks.json").write_text(json.dumps(whole, indent=1) + "\n")
    plot(whole, options.out / "attacks.png")


if __name__ == "__main__":
    main()
