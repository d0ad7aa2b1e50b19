"""The demo's shapes: letters and a hand on a rig that no method is told of.

`python -m tomojax.cli._demo_shapes FILE` makes their voltages anew: a resistor network with
an uneven sheet, electrodes off their places, gains, zeros, noise (`tomojax.studies.rigs`).
"""

import sys
from pathlib import Path

import numpy as np

# Each shape: name, height and width of the strokes, m; turn, rad; S/m².
_SHAPES = (
    ("S", 0.11, 0.014, 0.2, 0.3),
    ("H", 0.1, 0.014, -0.3, 0.1),
    ("hand", 0.13, None, 0.3, 0.8),
    ("two", 0.12, None, 0.5, 0.2),
)
_TEN = (0, 7, 56, 63, 3, 24, 31, 60, 27, 36)
_TRUTH = 80  # pixels of a side


def make(path: Path) -> None:
    """Writes voltages (n, 64, 64), V, and what touched."""
    import tomojax as tx
    from tomojax.studies.rigs import draw_rig, draw_strokes, network_of

    rng = np.random.default_rng(3)
    rig = draw_rig(tx.Sensor.grid(), rng)
    exact, middle = network_of(rig), np.array([0.08, 0.08])
    part = (np.arange(_TRUTH) + 0.5) / _TRUTH * 0.16
    points = np.stack(np.meshgrid(part, part, indexing="ij"), -1).reshape(-1, 2)
    volts, truths = [], []
    for name, height, width, turn, per_area in _SHAPES:
        strokes = draw_strokes(name, middle, height, turn, per_area, width)
        read = rig.chain.read(exact.touched(strokes, np.arange(64)), rng)
        volts.append((read - rig.chain.zero).astype(np.float32))
        truths.append(strokes.inside(points).reshape(_TRUTH, _TRUTH))
    np.savez_compressed(path, volts=volts, touched=np.packbits(truths, axis=-1))


def draw(path: Path, out: Path) -> None:
    """Draws the truth, the paper's image of all grounds, and `shape`'s of ten."""
    from matplotlib.figure import Figure

    import tomojax as tx

    with np.load(path) as kept:
        volts = kept["volts"]
        truths = np.unpackbits(kept["touched"], axis=-1, count=_TRUTH)
    sensor = tx.Sensor.grid(dtype=np.float32)
    images = []
    for name, grounds in (("linear", np.arange(64)), ("shape", np.array(_TEN))):
        method = tx.method(sensor, name, 32)
        v = volts[:, grounds]
        frames = [tx.methods.Frame(one, grounds, np.isfinite(one)) for one in v]
        batch = tx.Batch(method, method.choose_lambda(frames))
        images.append(batch(v, np.tile(grounds, (len(v), 1))).image)
    titles = ("what touched", "the paper's Eq. 3, 64 slots", "shape, ten slots")
    from tomojax._pictures import gallery

    figure = Figure(figsize=(2 * len(volts) + 0.8, 7.0), layout="constrained")
    figure.suptitle("Shapes on the sheet, and their images")
    gallery(figure, dict(zip(titles, (truths, *images))), sensor.size)
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    make(Path(sys.argv[1]))
