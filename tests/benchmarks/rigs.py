"""Tries methods on rigs with more errors than they assume: places, counts, errors, flags.

    python tests/benchmarks/rigs.py [--rigs 12] [--each 10] [--seed N] [--model elements]

Every row of `bench.rigs.FAMILY` changes one property of the rig or the contact. A
method is told nominal values. Stated deviations of places are judged, too. The default
seeds are for judging: no threshold was set on them. `points`, `source` and `auto` have the
two corner slots, `follow` ten slots. `shape` has the two corners of a part of the
scenes. Writes notebooks/results/rigs.json and rigs.png.
"""

import argparse
import json
from pathlib import Path
from textwrap import wrap
from typing import Any

import matplotlib

matplotlib.use("Agg")

import jax  # noqa: E402
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

import tomojax as tx  # noqa: E402
from bench.frontier import DOUBT  # noqa: E402
from bench.rigs import (  # noqa: E402
    Elements,
    FAMILY,
    JUDGING,
    lone_contacts,
    LoneContacts,
)
from tomojax._pictures import plain, style  # noqa: E402

RESULTS = Path(__file__).parents[2] / "notebooks" / "results"
METHODS = ("points", "source", "auto", "follow", "shape")
VAGUE, FEW = tx.Flag.CONDUCTANCE_UNCERTAIN, 24


def ten_grounds(sensor: tx.Sensor) -> np.ndarray:
    """The two corners, then eight electrodes spread over the sheet."""
    corners = np.asarray(tx.paper.exploration(sensor))
    m = sensor.electrode_count
    spread = np.setdiff1d(np.arange(m), corners)[:: max(1, (m - 2) // 8)][:8]
    return np.concatenate([corners, spread])


def followed(sensor: tx.Sensor, scenes: LoneContacts) -> dict[str, np.ndarray]:
    """Returns what a step says after ten slots, as fields of rows."""
    step = tx.make_step(sensor, "follow", contacts=3)
    last = []
    for v in scenes.volts:
        out = step.replay(step.state, v.astype(np.float32), scenes.grounds)[1]
        last.append(jax.tree.map(lambda a: np.asarray(a)[-1], out))
    fields = ("count", "xy", "covariance", "conductance")
    rows = {n: np.stack([getattr(o.contacts, n) for o in last]) for n in fields}
    return rows | {"flags": np.array([int(o.flags) for o in last])}


def in_batch(batch: tx.Batch, scenes: LoneContacts, most: int) -> dict[str, np.ndarray]:
    """Rows of the first `most` scenes from the two corners."""
    volts = scenes.volts[:most, :2].astype(np.float32)
    rows = batch(volts, np.tile(scenes.grounds[:2], (len(volts), 1)))
    fields = ("count", "xy", "covariance", "conductance")
    return {n: getattr(rows, f"contact_{n}") for n in fields} | {"flags": rows.flags}


def figures(rows: dict[str, np.ndarray], scenes: LoneContacts, pitch: float) -> dict:
    """Scores one method on one row; a place that is not found is infinitely far."""
    n = len(rows["flags"])
    count = rows["count"].astype(int)
    off = np.hypot(*np.moveaxis(rows["xy"] - scenes.xy[:n, None], -1, 0))
    there = np.arange(off.shape[1]) < count[:, None]
    error = np.where(count > 0, np.where(there, off, 0).max(1), np.inf)
    doubt = ((rows["flags"] & DOUBT) > 0) | (count == 0)
    far = error > pitch / 2
    z = (rows["xy"][:, 0] - scenes.xy[:n]) / np.sqrt(rows["covariance"][:, 0, :2])
    known = np.isfinite(z)
    g = np.abs(rows["conductance"][:, 0] / scenes.conductance[:n] - 1)
    told = (rows["flags"] & int(VAGUE)) == 0
    finite = np.isfinite(g)
    return {
        "scenes": n,
        "median_mm": 1e3 * float(np.median(error)),
        "p90_mm": 1e3 * float(np.sort(error)[int(np.ceil(0.9 * n)) - 1]),
        "largest_mm": 1e3 * float(error.max()),
        "count_right": float((count == 1).mean()),
        "flagged": float(doubt.mean()),
        "right_flagged": float((doubt & ~far).sum() / max(1, (~far).sum())),
        "far": int(far.sum()),
        "far_unflagged": int((far & ~doubt).sum()),
        "within_1_sigma": float((np.abs(z[known]) < 1).mean()) if known.any() else None,
        "conductance_median": float(np.median(g[finite])) if finite.any() else None,
        "conductance_p90": float(np.quantile(g[finite], 0.9)) if finite.any() else None,
        "conductance_told": float(told.mean()) if finite.any() else None,
        "conductance_p90_told": (
            float(np.quantile(g[finite & told], 0.9)) if (finite & told).any() else None
        ),
    }


def measured(options: argparse.Namespace) -> list[dict[str, Any]]:
    """A row for each method and row of the family; printed as they come."""
    sensor = tx.Sensor.grid(dtype=np.float32)
    pitch, grounds = sensor.mean_pitch, ten_grounds(sensor)
    batches = {}
    for name in METHODS:
        if name != "follow":
            method = tx.method(sensor, name)
            lam = method.choose_lambda([])
            batches[name] = tx.Batch(method, lam, contacts=3, images=False)
    model = Elements if options.model == "elements" else None
    rows = []
    for row in options.only or FAMILY:
        scenes = lone_contacts(
            sensor, row, options.seed, options.rigs, options.each, grounds, model
        )
        for name in METHODS:
            most = FEW if name == "shape" else len(scenes.xy)
            found = (
                followed(sensor, scenes)
                if name == "follow"
                else in_batch(batches[name], scenes, most)
            )
            rows.append({"row": row, "method": name, **figures(found, scenes, pitch)})
            print(line(rows[-1]), flush=True)
    return rows


def line(row: dict[str, Any]) -> str:
    sigma, told = row["within_1_sigma"], row["conductance_p90_told"]
    return (
        f"{row['row']:9s} {row['method']:11s} median {row['median_mm']:5.2f} mm, "
        f"90 % {row['p90_mm']:6.2f}, largest {row['largest_mm']:6.1f}, "
        f"count right {row['count_right']:4.0%}, flagged {row['flagged']:4.0%}, "
        f"far {row['far']} ({row['far_unflagged']} not flagged), "
        f"in 1 σ {'-' if sigma is None else format(sigma, '.0%')}, "
        f"conductance told 90 % {'-' if told is None else format(told, '.0%')}"
    )


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Median to 90 % of the places by row, and the part within the stated deviation."""
    names = list(dict.fromkeys(row["row"] for row in rows))
    figure, (places, sigmas) = plt.subplots(
        1, 2, figsize=(12, 0.5 * len(names) + 1.8), sharey=True, width_ratios=(2, 1),
        layout="constrained",
    )  # fmt: skip
    figure.suptitle("Lone contacts on rigs of other kinds; methods told nominal values")
    for k, method in enumerate(METHODS):
        look = style(method, linestyle="none")
        mine = [row for row in rows if row["method"] == method]
        at = [names.index(row["row"]) + 0.14 * (k - 2) for row in mine]
        low = np.array([row["median_mm"] for row in mine])
        high = np.minimum([row["p90_mm"] for row in mine], 100)
        places.hlines(at, low, high, colors=look["color"], lw=2)
        places.plot(low, at, **look, label=method)
        told = [(row["within_1_sigma"], y) for row, y in zip(mine, at)]
        told = np.array([t for t in told if t[0] is not None]).reshape(-1, 2)
        sigmas.plot(*told.T, **look)
    places.set(
        xscale="log",
        xlabel="place error, mm: median (mark), nine in ten (end of the line)",
        yticks=range(len(names)),
        yticklabels=["\n".join(wrap(FAMILY[name].title, 34)) for name in names],
        title="How near",
    )
    places.axvline(10, color="0.6", ls=":", lw=1, label="half a pitch")
    places.invert_yaxis()
    places.grid(axis="x", alpha=0.3)
    plain(places.xaxis)
    legend = places.get_legend_handles_labels()
    figure.legend(*legend, loc="outside lower center", ncols=7, frameon=False)
    sigmas.axvspan(0.60, 0.76, color="0.9", label="0.68 ± 0.08")
    sigmas.legend(loc="lower left", fontsize=8)
    sigmas.set(
        xlim=(0, 1), xlabel="part of places within 1 σ as stated", title="How sure it is"
    )
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=12)
    parser.add_argument("--each", type=int, default=10)
    parser.add_argument("--seed", type=int, default=JUDGING)
    parser.add_argument("--model", choices=("network", "elements"), default="network")
    parser.add_argument("--only", nargs="*", choices=list(FAMILY))
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    rows = measured(options)
    told = {k: v for k, v in vars(options).items() if k != "out"}
    name = "rigs" if options.model == "network" else "rigs_elements"
    text = json.dumps({"options": told, "rows": rows}, indent=1)
    (options.out / f"{name}.json").write_text(text + "\n")
    plot(rows, options.out / f"{name}.png")


if __name__ == "__main__":
    main()
