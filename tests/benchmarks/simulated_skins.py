"""Places presses on simulated skins, one and two at once, and draws letters; pyEIT beside.

    python tests/benchmarks/simulated_skins.py [--quick] [--only SKIN ...] [--voltages FOLDER]

`bench.cem.Skin` makes the voltages: quadratic elements of scikit-fem, complete electrode
model. Skins: 16 electrodes on the rim of a disc of 100 mm; these and 8 inside; 8 × 8 in a
square of 160 mm. A press halves the conductance in a disc of 4 mm radius, more or less.
Noise is 0.1 % of the root mean square of all readings' changes, drawn anew by each seed.
Voltages take a quarter of an hour; `--voltages` keeps them. Writes simulated_skins.json and
.png to notebooks/results.
"""

import argparse
import json
import sys
import time
import warnings
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE)]

RESULTS = HERE.parents[1] / "notebooks" / "results"
SHEET = 1e-2  # S per square
RADIUS = 4e-3  # of a press, m
NOISE = 1e-3  # of the changes' root mean square
APART = (8, 12, 16, 20, 30, 40)  # mm, middle to middle: 8 touch
LONE, EACH = 60, 20  # frames of lone presses, and of pairs at each distance
LETTERS = "TLOH"


def ring(count: int, radius: float) -> np.ndarray:
    turn = 2 * np.pi * (np.arange(count) + 0.5) / count
    return radius * np.stack([np.cos(turn), np.sin(turn)], 1)


def square() -> np.ndarray:
    line = 0.01 + 0.02 * np.arange(8)
    return np.stack(np.meshgrid(line, line, indexing="ij"), -1).reshape(-1, 2)


# Electrodes on the rim and inside; sides of a skin, m; skipped electrodes.
SKINS = {
    "rim": {"across": 0.1, "rim": 16, "skipped": 7},
    "inside": {"across": 0.1, "rim": 16, "inner": ring(8, 0.025), "skipped": 11},
    "grid": {"across": 0.16, "inner": square(), "round": False, "skipped": 31},
}


def pairs_of(name: str):
    from tomojax import ert

    told = SKINS[name]
    count = told.get("rim", 0) + len(told.get("inner", ()))
    return ert.Pairs.skip(count, told["skipped"])


def drawn_places(name: str, rng) -> list[np.ndarray]:
    """Places of presses, m, of each frame: 15 mm off the edge and more."""
    across = SKINS[name]["across"]

    def frame(away: float) -> np.ndarray:
        while True:
            start, turn = across * rng.uniform(-0.5, 0.5, 2), rng.uniform(0, 2 * np.pi)
            both = start + away * np.array([[0, 0], [np.cos(turn), np.sin(turn)]])
            far = np.hypot(*both.T) if name != "grid" else abs(both).max(1)
            if (far < across / 2 - 0.015).all():
                return both[: 2 if away else 1]

    frames = [frame(0.0) for _ in range(LONE)]
    frames += [frame(1e-3 * away) for away in APART for _ in range(EACH)]
    middle = across / 2 if name == "grid" else 0.0
    return [frame + middle for frame in frames]


def letter(name: str, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Tells which places, of the letter's half height, are in its strokes."""
    wide = 0.28
    up, down = abs(y) < 1, abs(x) < 0.8
    left, right, top, bottom = x < -0.8 + wide, x > 0.8 - wide, y > 1 - wide, y < -1 + wide
    middle = abs(x) < wide / 2
    far = np.hypot(x, y)
    return {
        "T": up & down & (top | middle),
        "L": up & down & (left | bottom),
        "O": (far < 1) & (far > 1 - 1.2 * wide),
        "H": up & down & (left | right | (abs(y) < wide / 2)),
    }[name]


def made(name: str, folder: Path | None) -> dict:
    """Voltages of all scenes, V per A, and of none."""
    from bench.cem import disc, Skin

    path = folder and folder / f"{name}.npz"
    if path and path.is_file():
        return dict(np.load(path))
    told = {k: v for k, v in SKINS[name].items() if k != "skipped"}
    skin, pairs, rng = Skin(**told), pairs_of(name), np.random.default_rng(0)
    places = drawn_places(name, rng)
    depth = rng.uniform(0.3, 0.7, (len(places), 2))

    def volts(part) -> np.ndarray:
        return skin.voltages(pairs, lambda x: SHEET * part(x))

    def pressed(places, depth):
        return lambda x: np.prod(
            [1 - d * disc(x, p, RADIUS, skin.cell) for p, d in zip(places, depth)], 0
        )

    middle, high = (0.08, 0.045) if name == "grid" else (0.0, 0.03)
    empty = volts(lambda x: 1 + 0 * x[0])
    found = {
        "empty": empty,
        "places": np.stack([np.resize(p, (2, 2)) for p in places]),
        "count": np.array([len(p) for p in places]),
        "volts": np.stack([volts(pressed(*one)) for one in zip(places, depth)]) - empty,
        "letters": np.stack([
            volts(lambda x: 1 - 0.5 * letter(c, (x[0] - middle) / high, (x[1] - middle) / high))
            for c in LETTERS
        ]) - empty,
        "xy": skin.xy,
    }  # fmt: skip
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, **found)
    return found


if __name__ == "__main__":
    for n in sys.argv[1:]:
        t = time.time()
        made(n, Path("/tmp/sk/volts"))
        print(n, time.time() - t, flush=True)
