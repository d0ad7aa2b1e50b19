"""Finds objects in a water tank with 32 electrodes on its rim, from measured voltages.

    python tests/benchmarks/tank.py FOLDER [--truth FOLDER] [--left-out N] [--cases 1 2 ...]

FOLDER has ref.mat and data1.mat, data2.mat, … of the Kuopio Tomography Challenge 2023. The
truth is true1.mat, … or 1_true.mat, …, there or in the folder of `--truth`; cases without
truth are found all the same. `--left-out` leaves out all that the first N electrodes inject
or read: the challenge's level L leaves out the first 2(L − 1). Scores are the challenge's.
Writes tank.json and tank.png to the folder of `--output`; notebooks/results by default.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE)]

RESULTS = HERE.parents[1] / "notebooks" / "results"

# The tank's radius, m. Electrodes cover half of the rim; the first is at the top, the next
# ones are anticlockwise.
RADIUS = 0.115
SPACING = 0.005  # of the mesh, m
PIXELS = 256


def similarity(truth: np.ndarray, found: np.ndarray) -> float:
    """The challenge's SSIM of two masks: a Gaussian of 80 pixels, cut at 160."""
    apart = np.subtract.outer(np.arange(PIXELS), np.arange(PIXELS))
    window = np.where(abs(apart) <= 160, np.exp(-0.5 * (apart / 80) ** 2), 0)
    window /= window.sum(1, keepdims=True)

    def mean(image: np.ndarray) -> np.ndarray:
        return window @ image @ window.T

    one, two = mean(truth), mean(found)
    spread = mean(truth**2) - one**2 + mean(found**2) - two**2
    joint = mean(truth * found) - one * two
    alike = (2 * one * two + 1e-4) * (2 * joint + 9e-4)
    return float((alike / ((one**2 + two**2 + 1e-4) * (spread + 9e-4))).mean())


def score(truth: np.ndarray, found: np.ndarray) -> float:
    """The mean similarity of both kinds of objects."""
    return float(
        np.mean([similarity(1.0 * (truth == k), 1.0 * (found == k)) for k in (1, 2)])
    )


def classes(model, found) -> np.ndarray:
    """0, 1 and 2 at the challenge's pixels: rows from the top, columns from the left."""
    x = RADIUS * ((np.arange(PIXELS) + 0.5) * 2 / PIXELS - 1)
    less, more = (np.nan_to_num(model.image(p, x, x)) for p in (found.less, found.more))
    kind = np.where(np.maximum(less, more) > 0.5, np.where(less > more, 1, 2), 0)
    return kind.T[::-1]


def truth_of(folder: Path, number: str) -> np.ndarray | None:
    """The segmentation of a case, where there is one."""
    from scipy.io import loadmat

    for name in (f"true{number}.mat", f"{number}_true.mat"):
        if (folder / name).is_file():
            return loadmat(folder / name)["truth"].astype(int)
    return None


def draw(found: dict, truths: dict, scores: dict, path: Path) -> None:
    """Draws each case's answer, and the truth above."""
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure

    figure = Figure((2.4 * len(found), 5), layout="constrained")
    axes = figure.subplots(2, len(found), squeeze=False)
    kinds = ListedColormap(["white", "tab:orange", "tab:blue"])
    for above, below, (number, image) in zip(*axes, found.items()):
        truth = truths[number]
        for place, shown in ((above, truth), (below, image)):
            place.set(xticks=(), yticks=(), aspect="equal")
            if shown is not None:
                place.imshow(shown, cmap=kinds, vmin=0, vmax=2)
        above.set_title(f"case {number}: objects", fontsize=9)
        mark = "" if truth is None else f", score {scores[number]:.2f}"
        below.set_title(f"found{mark}", fontsize=9)
    figure.supxlabel("orange: conducts less than water; blue: more", fontsize=9)
    figure.savefig(path, dpi=120)


def main() -> None:
    """Finds the objects of each case and scores them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--left-out", type=int, default=0)
    parser.add_argument("--cases", nargs="*")
    parser.add_argument("--output", type=Path, default=RESULTS)
    told = parser.parse_args()
    from scipy.io import loadmat

    from tomojax._environment import environment
    from tomojax.ert import disc_model, Levels

    begun = time.perf_counter()
    before = loadmat(told.folder / "ref.mat")
    inject, read = before["Injref"].T.astype(float), before["Mpat"].T.astype(float)
    model = disc_model(RADIUS, inject.shape[1], SPACING, first=np.pi / 2)
    out = np.arange(inject.shape[1]) < told.left_out
    gone = (inject[:, out] != 0).any(1)[:, None] | (read[:, out] != 0).any(1)

    def volts(values: np.ndarray) -> np.ndarray:
        return np.where(gone, np.nan, values.reshape(gone.shape))

    levels = Levels(model, inject, read, volts(before["Uelref"]))
    prepared = time.perf_counter() - begun
    every = sorted(p.stem.removeprefix("data") for p in told.folder.glob("data*.mat"))
    found, truths, scores, rows = {}, {}, {}, []
    for number in told.cases or every:
        begun = time.perf_counter()
        result = levels(volts(loadmat(told.folder / f"data{number}.mat")["Uel"]))
        found[number] = classes(model, result)
        truths[number] = truth = truth_of(told.truth or told.folder, number)
        scores[number] = None if truth is None else score(truth, found[number])
        rows.append({
            "case": number,
            "score": scores[number],
            "rest": result.rest,
            "misfit": result.misfit,
            "seconds": time.perf_counter() - begun,
        })  # fmt: skip
        print("  ".join(f"{k} {v}" for k, v in rows[-1].items()), flush=True)
    known = [s for s in scores.values() if s is not None]
    summary = {"score": sum(known), "of": len(known), "left_out": told.left_out}
    summary |= {"conductance_S": levels.rest_conductance, "prepare_s": prepared}
    print(f"score {sum(known):.3f} of {len(known)}")
    written = {"rows": rows, "summary": summary, "environment": environment()}
    (told.output / "tank.json").write_text(json.dumps(written, indent=1) + "\n")
    draw(found, truths, scores, told.output / "tank.png")


if __name__ == "__main__":
    main()
