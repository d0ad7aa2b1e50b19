"""The README's picture: what touches, the paper's image, tomojax's; and the demo's.

    python tests/benchmarks/readme.py [--seed 1000500] [--out notebooks/results]

Six scenes on six rigs of a resistor network, whose errors no method is told. The paper's
Eq. 3 has all 64 grounds and Table I's λ, `shape` has ten grounds. The JSON has
the area that truth and image share, of the area that either has: an image of Eq. 3 at the
threshold that is best in hindsight, `shape` at its half level.
"""

import argparse
import json
import shutil
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import tomojax as tx
from bench.rigs import draw_rig, draw_strokes, network_of, Strokes
from tomojax.cli.demo import demo

SIDE, PIXELS = 0.16, 64
TEN = np.array([0, 7, 56, 63, 3, 24, 31, 60, 27, 36])


def scenes() -> dict[str, Strokes]:
    """Six things that touch, by the words under their column."""
    middle = np.array([0.08, 0.08])

    def fingers(*places: tuple[float, float]) -> Strokes:
        lines = tuple(np.array([place]) for place in places)
        return Strokes(lines, (0.013,) * len(lines), 0.4)

    return {
        "a finger": fingers((0.104, 0.063)),
        "three fingers": fingers((0.045, 0.06), (0.09, 0.112), (0.121, 0.058)),
        "the letter A": draw_strokes("A", middle, 0.115, 0.1, 0.3, 0.014),
        "a spanner": draw_strokes("spanner", middle, 0.135, 0.7, 2.0),
        "a cup's rim": draw_strokes("cup", middle, 0.1, 0.0, 0.5),
        "a hand": draw_strokes("hand", middle, 0.13, 0.2, 0.6),
    }


def overlap(truth: np.ndarray, image: np.ndarray) -> float:
    """The area in common, of the area of either."""
    return float((truth & image).sum() / (truth | image).sum())


def best_overlap(truth: np.ndarray, image: np.ndarray) -> float:
    """The largest overlap over thresholds."""
    levels = np.linspace(0.02, 0.98, 49) * image.max()
    return max(overlap(truth, image > level) for level in levels)


def images(name: str, grid: int, volts: np.ndarray, grounds: np.ndarray, sensor):
    """A method's rows of one frame."""
    method = tx.method(sensor, name, grid)
    frame = tx.methods.Frame(volts, grounds, np.isfinite(volts))
    batch = tx.Batch(method, method.choose_lambda([frame]))
    return batch(volts[None], grounds[None])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1_000_500)
    parser.add_argument("--out", type=Path, default=Path("notebooks/results"))
    given = parser.parse_args()
    rng, sensor = np.random.default_rng(given.seed), tx.Sensor.grid(dtype=np.float32)
    part = (np.arange(PIXELS) + 0.5) / PIXELS * SIDE
    points = np.stack(np.meshgrid(part, part, indexing="ij"), -1).reshape(-1, 2)
    figure = Figure(figsize=(11, 6), layout="constrained")
    grid = figure.subplots(3, 6)
    lines = (
        "what touches",
        "the paper's Eq. 3,\n64 slots: 6.4 ms",
        "tomojax,\nten slots: 1 ms",
    )
    rows = []
    electrodes = 1e3 * np.asarray(sensor.electrode_xy)
    for column, (words, strokes) in zip(grid.T, scenes().items()):
        rig = draw_rig(tx.Sensor.grid(), rng)
        exact = network_of(rig).touched(strokes, np.arange(64))
        read = rig.chain.read(exact, rng) - rig.chain.zero
        volts = read.astype(np.float32)
        truth = strokes.inside(points).reshape(PIXELS, PIXELS)
        paper = np.asarray(images("linear", PIXELS, volts, np.arange(64), sensor).image[0])
        ours = np.asarray(images("shape", PIXELS, volts[TEN], TEN, sensor).touch[0])
        shared = best_overlap(truth, paper), overlap(truth, ours > 0.5)
        rows.append(dict(zip(("scene", "overlap_eq3", "overlap_shape"), (words, *shared))))
        paper = np.clip(paper / np.nanmax(paper), 0, 1)
        for axes, image in zip(column, (truth, paper, ours)):
            extent = (0, 160, 0, 160)
            style = {"cmap": "cividis", "vmin": 0, "vmax": 1, "extent": extent}
            shown = axes.imshow(image.T, origin="lower", **style)
            axes.plot(*electrodes.T, ".", color="0.6", ms=1.5)
            axes.set(xticks=[], yticks=[])
        column[0].set_title(words)
    for axes, line in zip(grid[:, 0], lines):
        axes.set_ylabel(line, fontsize=11)
    bar = figure.colorbar(shown, ax=grid, shrink=0.6, ticks=[0, 1])
    bar.set_label("touched (Eq. 3: of its highest)")
    figure.savefig(given.out / "readme.png", dpi=100)
    told = {"rows": rows, "seed": given.seed}
    (given.out / "readme.json").write_text(json.dumps(told, indent=1) + "\n")
    print(json.dumps(told, indent=1))
    with tempfile.TemporaryDirectory() as folder:
        demo.main(["fingers", "--out", folder], standalone_mode=False)
        shutil.copy(f"{folder}/demo.png", given.out / "demo.png")


if __name__ == "__main__":
    main()
