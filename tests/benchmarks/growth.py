"""Measures how time grows with elements, electrodes, slots, contacts and frames.

    python tests/benchmarks/growth.py [--out notebooks/results]

Each curve is timed by itself on this machine, compile time apart. The exponent is fitted to
the upper half of the curve, where constant parts count little. Writes growth.json and
growth.png. Takes four minutes.
"""

import argparse
import json
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

from benchmarks.physics import environment  # noqa: E402

import tomojax as tx  # noqa: E402
from bench.frontier import repeated  # noqa: E402
from bench.network import Network  # noqa: E402
from tomojax.sensor import compiled_resistances  # noqa: E402

BATCH, FRAMES = 256, 32
# What theory has for large ones, and why.
WHY = {
    "table, elements": "a factor of n lines of n nodes: elements^2; small blocks are cheap",
    "images, pixels": "one product with a basis of 64 rows: 1",
    "table, electrodes": "as many right-hand sides: 1, beside the factor's own time",
    "images, electrodes": "voltages times basis: M·M + M·pixels a slot: 1 to 2",
    "images, slots": "voltages times operator: slots·M·M beside M·pixels, 1 in the end",
    "points, slots": "residuals of slots·M voltages: 1, beside what a frame costs at all",
    "points, contacts": "one, two, … contacts are fitted in turn: the sum of all steps",
    "images, frames": "one product: 1, once a call costs more than its dispatch",
}


# A curve's call, in a title.
WHAT = {"table": "Table of resistances", "images": "Images by source"}
WHAT |= {"points": "Contacts by points"}


def images_of(sensor, grounds, pixels=32, batch=BATCH):
    """A call that makes `source` images of so many frames."""
    model = tx.method(sensor, "source", pixels)
    good = np.ones((len(grounds), sensor.electrode_count), bool)
    prepared = model.prepare(np.asarray(grounds), good, model.choose_lambda([]))
    shape = batch, len(grounds), sensor.electrode_count
    volts = jnp.asarray(np.random.default_rng(0).normal(size=shape), jnp.float32)
    run = eqx.filter_jit(
        lambda m, p, v: jax.vmap(lambda frame: m.smooth_image(p, frame))(v)
    )
    return lambda: jax.block_until_ready(run(model, prepared, volts))


def grid(side: int) -> tx.Sensor:
    """side² electrodes on the paper's sheet."""
    pitch = 0.16 / side
    return tx.Sensor.grid(
        side, side, pitch, pitch / 2, divisions=(64, 64), dtype=np.float32
    )


def tables(sensor):
    return lambda: jax.block_until_ready(compiled_resistances(sensor, "fem"))


def points_of(slots: int, contacts: int):
    """A call that fits so many contacts to frames of so many slots."""
    sensor = tx.Sensor.grid(dtype=np.float32, divisions=(32, 32))
    rng = np.random.default_rng(contacts)
    rig = Network(sensor, rng)
    places = np.array([[0.04, 0.05], [0.12, 0.06], [0.07, 0.12]])[:contacts]
    found = [
        rig.measure(
            rig.scene(
                *((rig.disc(p + rng.uniform(-0.01, 0.01, 2), 0.006), 1e-4) for p in places)
            )[0]
        )
        for _ in range(4)
    ]
    grounds = np.linspace(0, 63, slots).round().astype(int)
    volts = np.resize(np.array(found)[:, grounds], (FRAMES, slots, 64)).astype(np.float32)
    batch = tx.Batch(tx.method(sensor, "points", 32), 1.0, contacts, images=False)
    under = np.tile(grounds, (FRAMES, 1))
    rows = batch(volts, under)
    assert (rows.contact_count == contacts).all()
    return lambda: batch(volts, under)


def curves():
    """Name, sizes, and the call of each size."""
    sensor = grid(8)
    sides = (16, 32, 64, 96, 128)
    yield (
        "table, elements",
        [2 * n * n for n in (32, 64, 96, 128, 160)],
        [
            tables(tx.Sensor.grid(divisions=(n, n), dtype=np.float32))
            for n in (32, 64, 96, 128, 160)
        ],
    )
    yield (
        "images, pixels",
        [n * n for n in sides],
        [images_of(sensor, [0], n) for n in sides],
    )
    sides = (4, 6, 8, 10, 12)
    yield "table, electrodes", [n * n for n in sides], [tables(grid(n)) for n in sides]
    yield (
        "images, electrodes",
        [n * n for n in sides],
        [images_of(grid(n), [0]) for n in sides],
    )
    slots = (1, 2, 4, 8, 16, 32, 64)
    yield "images, slots", slots, [images_of(sensor, range(n)) for n in slots]
    frames = tuple(4**k for k in range(8))
    yield "images, frames", frames, [images_of(sensor, [0], 32, n) for n in frames]
    slots = (2, 8, 32)
    yield "points, slots", slots, [points_of(n, 1) for n in slots]
    yield "points, contacts", (1, 2, 3), [points_of(2, n) for n in (1, 2, 3)]


def measured() -> list[dict]:
    found = []
    for name, sizes, calls in curves():
        times = [float(np.median(repeated(call)[1])) for call in calls]
        upper = slice(len(sizes) // 2 if len(sizes) > 3 else 0, None)
        slope = np.polyfit(np.log(sizes[upper]), np.log(times[upper]), 1)[0]
        row = {"curve": name, "sizes": list(sizes), "seconds": times}
        found.append(row | {"exponent": float(slope), "why": WHY[name]})
        print(f"{name:20s} ^{slope:5.2f}  {WHY[name]}", flush=True)
        jax.clear_caches()
    return found


def draw(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import plain, style

    figure = Figure(figsize=(15, 7.2), layout="constrained")
    figure.suptitle("How the time of a call grows, with the exponent of the upper half")
    for axes, row in zip(figure.subplots(2, 4).ravel(), rows):
        what, _, size = row["curve"].partition(", ")
        axes.loglog(row["sizes"], [1e3 * t for t in row["seconds"]], **style(0))
        axes.set_title(f"{WHAT[what]}: exponent {row['exponent']:.2f}", fontsize=11)
        axes.set(ylabel="time of a call, ms", xlabel=f"number of {size}")
        axes.margins(x=0.08, y=0.1)
        plain(axes.xaxis, axes.yaxis)
        axes.tick_params(axis="x", labelsize=9)
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    options = parser.parse_args()
    rows = measured()
    told = {"environment": environment(), "rows": rows}
    path = options.out / "growth.json"
    path.write_text(json.dumps(told, indent=1) + "\n")
    draw(rows, path.with_suffix(".png"))


if __name__ == "__main__":
    main()
