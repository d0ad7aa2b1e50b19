"""Places presses on skins that others measured, with and without known places.

    python tests/benchmarks/measured_skins.py FOLDER [--seeds 3]

FOLDER has skin_*.h5: recordings of kind conductivity with places. 600 presses drawn from
the first two thirds are learned from, and the last third is placed; each seed draws anew.
Two presses at once, presses twice as hard and none are made of the last third's frames. For
drift, 200 presses are learned from, and 200 are placed that come 1000 later or right after.
Beside stand pyEIT (`JAC` and `BP`, settings and reading of an image the best in hindsight)
and kernel ridge regression (settings by five folds). Writes measured_skins.json and .png to
notebooks/results.
"""

import argparse
import json
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE)]

RESULTS = HERE.parents[1] / "notebooks" / "results"
PRESSES = 600
KNOWN = (0, 5, 20, 50, 200, PRESSES)


def some(recording, rows):
    """The recording of some of its frames."""
    volts, t0 = recording.voltages[rows], recording.t0[rows]
    return replace(recording, voltages=volts, t0=t0, places=recording.places[rows])


def figures(xy, test, found=None) -> dict:
    """Median and 90 % of place errors, mm; the share within the stated deviation."""
    from tomojax import Flag

    away = np.linalg.norm(xy - test.places, axis=1)
    row = {
        "median_mm": 1e3 * float(np.median(away)),
        "p90_mm": 1e3 * float(np.quantile(away, 0.9)),
    }
    if found is not None:
        wide = np.sqrt(np.trace(found.covariance, axis1=1, axis2=2) / 2)
        row["within"] = float(np.mean(away < 1.515 * wide))
        for name in ("HIGH_RESIDUAL", "PLACE_UNCERTAIN"):
            row[name] = float(np.mean(found.flags & Flag[name].value > 0))
    return row


def odd(response, test) -> dict:
    """What becomes of two presses at once, of presses twice as hard, and of none.

    `two_flagged`: frames of the test's first half added to those of its second, places
    more than 30 mm apart. `none_flagged`: noise of a twentieth of the usual readings.
    """
    from tomojax import Flag

    def flagged(volts, name: str = "HIGH_RESIDUAL"):
        return response.locate(volts).flags & Flag[name].value > 0

    half = len(test.places) // 2
    one, other = some(test, slice(half)), some(test, slice(half, 2 * half))
    apart = np.linalg.norm(one.places - other.places, axis=1) > 0.03
    twice = response.locate(2 * test.voltages)
    away = np.linalg.norm(twice.xy - test.places, axis=1)
    quiet = np.random.default_rng(0).normal(size=test.voltages.shape) / 20
    usual = response.scale.reshape(test.voltages.shape[1:])
    return {
        "two_flagged": float(flagged(one.voltages + other.voltages)[apart].mean()),
        "twice_mm": 1e3 * float(np.median(away)),
        "twice_flagged": float(flagged(2 * test.voltages).mean()),
        "none_flagged": float(flagged(quiet * usual, "NO_CONTACT").mean()),
    }


def ridge(train, test) -> np.ndarray:
    """Places by kernel ridge regression of scaled readings; its settings by five folds."""
    flat = [one.voltages.reshape(len(one.voltages), -1) for one in (train, test)]
    middle = np.median(flat[0], 0)
    scale = np.median(np.abs(flat[0] - middle), 0)
    flat = [(one - middle) / scale for one in flat]

    def answer(x, y, at, width: float, damp: float) -> np.ndarray:
        def kernel(one):
            away = (one**2).sum(1)[:, None] - 2 * one @ x.T + (x**2).sum(1)
            return np.exp(-width * away)

        mean = y.mean(0)
        return mean + kernel(at) @ np.linalg.solve(
            kernel(x) + damp * np.eye(len(x)), y - mean
        )

    fold = np.arange(len(train.places)) % 5

    def error(width: float, damp: float) -> float:
        away = [
            answer(
                flat[0][fold != k], train.places[fold != k], flat[0][fold == k], width, damp
            )
            - train.places[fold == k]
            for k in range(5)
        ]
        return float(np.median(np.linalg.norm(np.concatenate(away), axis=1)))

    tried = [(w, d) for w in 10.0 ** np.arange(-5, -1.5, 0.5) for d in (1e-3, 1e-2, 0.1, 1)]
    return answer(flat[0], train.places, flat[1], *min(tried, key=lambda one: error(*one)))


def pyeit_best(test) -> np.ndarray:
    """The least median of pyEIT's methods, settings and readings of an image."""
    import pyeit.eit.bp as bp
    import pyeit.eit.jac as jac
    import pyeit.eit.protocol as protocol
    import pyeit.mesh as mesh

    pairs, m = test.pairs, len(test.electrode_xy)
    keep = np.ones(pairs.read.shape[:2], bool).ravel()
    told = protocol.PyEITProtocol(pairs.inject, pairs.read, keep)
    radius = np.linalg.norm(test.electrode_xy, axis=1).mean()
    body = mesh.create(m, h0=0.06, p_fix=test.electrode_xy / radius)
    middle = body.node[body.element].mean(1)[:, :2]
    zero = np.zeros(pairs.inject.shape[0] * pairs.readings)
    best = None
    for kind, grid in ((jac.JAC, (1e-4, 1e-3, 1e-2, 0.1, 1)), (bp.BP, (None,))):
        for damp in grid:
            eit = kind(body, told)
            if damp is None:
                eit.setup(weight="none")
            else:
                eit.setup(p=0.5, lamb=damp, method="kotre", perm=1, jac_normalized=False)
            forward = eit.fwd.solve_eit() if hasattr(eit.fwd, "solve_eit") else None
            sign = 1 if forward is None or not test.magnitude else np.sign(forward)
            volts = test.voltages.reshape(len(test.voltages), -1) * sign
            images = -np.stack([eit.solve(zero + one, zero) for one in volts])
            if images.shape[1] == len(body.node):
                images = images[:, body.element].mean(2)
            for turned in (images, -images):
                for share in (0.5, 0.7, 0.9):
                    weight = np.maximum(turned - share * turned.max(1, keepdims=True), 0)
                    xy = radius * weight @ middle / weight.sum(1, keepdims=True)
                    error = np.median(np.linalg.norm(xy - test.places, axis=1))
                    if best is None or error < best[0]:
                        best = (error, xy)
    return best[1]


def measure(path: Path, seeds: int) -> list[dict]:
    """The table's rows of one skin."""
    from tomojax import ert

    whole = ert.load(path)
    n = len(whole.voltages)
    test = some(whole, slice(2 * n // 3, n))
    rows = []

    def add(method: str, known: int | None, seed: int, **told) -> None:
        rows.append({"skin": path.stem, "method": method, "known": known} | told)
        rows[-1]["seed"] = seed
        print("  ".join(f"{k} {v}" for k, v in rows[-1].items()), flush=True)

    add("pyeit", None, 0, **figures(pyeit_best(test), test))
    later = some(whole, slice(1200, 1400))
    for first, method in ((0, "drift, 1000 later"), (1000, "drift, right after")):
        found = ert.learn(some(whole, slice(first, first + 200))).locate(later.voltages)
        add(method, 200, 0, **figures(found.xy, later, found))
    for seed in range(seeds):
        drawn = np.random.default_rng(seed).choice(2 * n // 3, PRESSES, replace=False)
        train = some(whole, drawn)
        middle = np.broadcast_to(train.places.mean(0), test.places.shape)
        add("centre", None, seed, **figures(middle, test))
        found = ert.nominal(train).locate(test.voltages)
        add("nominal", None, seed, **figures(found.xy, test, found))
        for known in KNOWN:
            begun = time.perf_counter()
            response = ert.learn(train.knowing(known))
            learned = time.perf_counter() - begun
            found = response.locate(test.voltages)
            told = figures(found.xy, test, found) | odd(response, test)
            told["learn_s"] = learned
            add("response", known, seed, **told)
            if known >= 20:
                xy = ridge(some(train, slice(known)), test)
                add("ridge", known, seed, **figures(xy, test))
    return rows


def draw(rows: list[dict], path: Path) -> None:
    """Draws the median place error by the number of known places."""
    from matplotlib.figure import Figure

    skins = sorted({row["skin"] for row in rows})
    figure = Figure((4.5 * len(skins), 4), layout="constrained")
    for axes, skin in zip(figure.subplots(1, len(skins), squeeze=False)[0], skins):
        for method, mark in (("response", "o-"), ("ridge", "s--")):
            of = [r for r in rows if r["skin"] == skin and r["method"] == method]
            known = sorted({r["known"] for r in of})
            each = [[r["median_mm"] for r in of if r["known"] == k] for k in known]
            places = np.maximum(known, 1)
            axes.plot(places, [np.median(e) for e in each], mark, label=method)
            axes.fill_between(
                places, [min(e) for e in each], [max(e) for e in each], alpha=0.2
            )
        for method, style in (("nominal", ":"), ("pyeit", "-.")):
            of = [
                r["median_mm"] for r in rows if (r["skin"], r["method"]) == (skin, method)
            ]
            label = "pyEIT, best in hindsight" if method == "pyeit" else method
            axes.axhline(np.median(of), ls=style, color="k", label=label)
        axes.set(xscale="log", yscale="log", title=skin, xlabel="known places (0 at 1)")
        axes.set_ylabel("place error, median, mm")
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

    warnings.simplefilter("ignore")
    rows = []
    for path in sorted(told.folder.glob("skin_*.h5")):
        rows += measure(path, told.seeds)
    written = {"rows": rows, "summary": {}, "environment": environment()}
    out = told.output / "measured_skins.json"
    out.write_text(json.dumps(written, indent=1) + "\n")
    draw(rows, told.output / "measured_skins.png")


if __name__ == "__main__":
    main()
