"""Places presses on skins that others measured, from fewer of their injections.

    python tests/benchmarks/fewer_injections.py FOLDER [--seeds 3]

FOLDER has skin_*.h5: recordings of kind conductivity with places. A response is learned
with 600 presses drawn from the first two thirds, all at known places and by all injections;
each seed draws anew. The last third is placed by some of the injections, with a response
learned anew by these: by `design` ("chosen"), one after another by how far left-out
presses are placed ("presses"), by the relaxed problem's heaviest weights ("gradient"),
evenly spaced, and drawn ones (three sets a seed). Without learning anew, by the map of all
injections, stand the chosen ones ("restricted"), and two chosen ones with others chosen
for the place that these two found ("adaptive"). Writes fewer_injections.json and .png to
notebooks/results.
"""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from measured_skins import figures, PRESSES, RESULTS, some

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE)]

COUNTS = 1, 2, 4, 8
DRAWN = 3
CELL = 0.01  # m; places of one cell have the same injections


def adaptive(response, pairs, first, count, test) -> np.ndarray:
    """Places each frame by the first injections, and by others for where these found it."""
    from tomojax import ert

    found = ert.restrict(response, pairs, first).locate(test.voltages).xy
    cells, of = np.unique(np.round(found / CELL).astype(int), axis=0, return_inverse=True)
    for k, cell in enumerate(cells):
        near = CELL * cell.astype(float)
        more = ert.choose(response, pairs, count - len(first), after=first, near=near)
        mine, both = of.ravel() == k, [*first, *more]
        located = ert.restrict(response, pairs, both).locate(test.voltages[mine])
        found[mine] = located.xy
    return found


def of(recording, conditions):
    """The recording of some of its injections."""
    from tomojax import ert

    pairs = recording.pairs
    fewer = ert.Pairs(pairs.inject[conditions], pairs.read[conditions])
    return replace(recording, voltages=recording.voltages[:, conditions], pairs=fewer)


def measure(path: Path, seeds: int) -> list[dict]:
    """The table's rows of one skin."""
    from tomojax import design, ert

    whole = ert.load(path)
    n, pairs = len(whole.voltages), whole.pairs
    c = pairs.conditions
    test = some(whole, slice(2 * n // 3, n))
    rows = []

    def add(count: int, way: str, seed: int, xy, found=None) -> None:
        told = {"skin": path.stem, "injections": count, "way": way, "seed": seed}
        rows.append(told | figures(xy, test, found))
        print("  ".join(f"{k} {v}" for k, v in rows[-1].items()), flush=True)

    for seed in range(seeds):
        random = np.random.default_rng(seed)
        drawn = random.choice(2 * n // 3, PRESSES, replace=False)
        train = some(whole, drawn)
        response = ert.learn(train)
        found = response.locate(test.voltages)
        add(c, "all", seed, found.xy, found)
        told = ert.press_information(response, pairs)
        order = ert.choose(response, pairs, max(COUNTS), presses=train)
        for count in COUNTS:
            best = design.design(told, count)
            ways = {
                "chosen": [best.grounds],
                "presses": [order[:count]],
                "gradient": [np.argsort(-best.weights)[:count]],
                "even": [[k * c // count for k in range(count)]],
                "random": [random.choice(c, count, replace=False) for _ in range(DRAWN)],
            }
            for way, sets in ways.items():
                for one in sets:
                    mine = sorted(int(k) for k in one)
                    learned = ert.learn(of(train, mine))
                    found = learned.locate(of(test, mine).voltages)
                    add(count, way, seed, found.xy, found)
            mine = ert.restrict(response, pairs, best.grounds.tolist())
            found = mine.locate(test.voltages)
            add(count, "restricted", seed, found.xy, found)
            if count == 2:
                first = [int(k) for k in best.grounds]
            if count > 2:
                xy = adaptive(response, pairs, first, count, test)
                add(count, "adaptive", seed, xy)
    return rows


def draw(rows: list[dict], path: Path) -> None:
    """Draws the median place error by the number of injections."""
    from matplotlib.figure import Figure

    skins = sorted({row["skin"] for row in rows})
    figure = Figure((4.5 * len(skins), 4), layout="constrained")
    for axes, skin in zip(figure.subplots(1, len(skins), squeeze=False)[0], skins):
        mine = [r for r in rows if r["skin"] == skin]
        for way, mark in (
            ("random", "x:"),
            ("even", "s--"),
            ("gradient", "v-."),
            ("restricted", "+:"),
            ("adaptive", "^:"),
            ("chosen", "o-"),
            ("presses", "D-"),
        ):
            counts = sorted({r["injections"] for r in mine if r["way"] == way})
            each = [
                [r["median_mm"] for r in mine if (r["way"], r["injections"]) == (way, k)]
                for k in counts
            ]
            axes.plot(counts, [np.median(e) for e in each], mark, label=way)
            low, high = [min(e) for e in each], [max(e) for e in each]
            axes.fill_between(counts, low, high, alpha=0.15)
        whole = [r["median_mm"] for r in mine if r["way"] == "all"]
        axes.axhline(np.median(whole), ls=":", color="k", label="all 16")
        axes.set(xscale="log", yscale="log", title=skin, xlabel="injections of 16")
        axes.set_ylabel("place error, median, mm")
        axes.set_xticks(COUNTS, COUNTS, minor=False)
        axes.set_yticks([2, 3, 5, 10, 20], [2, 3, 5, 10, 20], minor=False)
        axes.minorticks_off()
        axes.legend(fontsize=8)
    figure.savefig(path, dpi=120)


def main() -> None:
    """Measures each skin of a folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--output", type=Path, default=RESULTS)
    told = parser.parse_args()
    from tomojax._environment import environment

    rows = []
    for path in sorted(told.folder.glob("skin_*.h5")):
        rows += measure(path, told.seeds)
    written = {"rows": rows, "summary": {}, "environment": environment()}
    out = told.output / "fewer_injections.json"
    out.write_text(json.dumps(written, indent=1) + "\n")
    draw(rows, told.output / "fewer_injections.png")


if __name__ == "__main__":
    main()
