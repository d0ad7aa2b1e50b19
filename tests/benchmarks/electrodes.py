"""Compares electrodes where resolution is worst: designed places, and a uniform grid.

    python tests/benchmarks/electrodes.py [--out FOLDER] [--scenes 10]

16 and 64 electrodes lie on 160 mm × 160 mm. The first figure is `image_spread`, at places
and on cells that the design did not use. The second is half-value widths of images. A
resistor network (tests/rig.py) with that grid or those places makes the voltages. Its sheet
is even, as after a calibration, or varies by 2 %. For each, λ gives the least image error
of other scenes on other rigs. Writes electrodes.json and electrodes.png.
"""

import argparse
import itertools
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

jax.config.update("jax_enable_x64", True)

from rig import Rig, SIDE  # noqa: E402

import tomojax as tx  # noqa: E402
from tomojax.kernels.images import half_width, image_place  # noqa: E402

GRID, WIDTH, REGIONS = 32, 0.008, 5
CONTACTS = {"linear": (0.002, 1.0), "source": (0.006, 1e-4)}  # radius, m; S
LAMS = np.logspace(-7.5, -2, 23)  # λ/σ₁²


def uniform(n: int) -> tx.Sensor:
    x = (np.arange(n) + 0.5) / n * SIDE
    xy = np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2)
    return tx.Sensor([SIDE, SIDE], xy, divisions=(64, 64), dtype=np.float64)


def spreads(sensors: dict, count: int = 29, grid: int = 36) -> dict[str, np.ndarray]:
    """Maps of `image_spread` at other places, on other cells, λ the same for both."""
    x = np.linspace(0.0105, SIDE - 0.0105, count)
    places = jnp.asarray(np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2))
    first = next(iter(sensors.values()))
    lam = 1e-5 * float(tx.design.image_scale(first, grid=grid))
    found = jax.jit(
        lambda xy: tx.design.image_spread(first, places, xy, lam=lam, grid=grid)
    )
    return {
        name: np.asarray(found(sensor.electrode_xy)).reshape(count, count)
        for name, sensor in sensors.items()
    }


def scenes(
    sensor: tx.Sensor, kind: str, at: np.ndarray, variation: float, seed: int
) -> tx.design.SimulatedScenes:
    radius, conductance = CONTACTS[kind]
    nominal, volts = np.asarray(sensor.electrode_xy), []
    for k, place in enumerate(at):
        if k % (len(at) // 4) == 0:
            rng = np.random.default_rng(seed + k)
            rig = Rig(rng, variation=variation, nominal=nominal)
        volts.append(rig.measure(rig.scene((rig.disc(place, radius), conductance))[0]))
    return tx.design.SimulatedScenes(jnp.asarray(at), jnp.asarray(np.stack(volts)))


def widths(sensor: tx.Sensor, kind: str, variation: float, side: int) -> dict:
    """Half-value widths, mm, (side, side) over the sheet, and errors of place."""
    method = tx.method(sensor, kind, GRID)
    places = np.asarray(tx.design.design_places(sensor, [0.008, 0.008, 0.152, 0.152], 40))
    train = scenes(sensor, kind, places, variation, 100)
    rng = np.random.default_rng(11)
    x = np.linspace(0.01, SIDE - 0.01, side)
    at = np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2)
    at = at + rng.uniform(-0.002, 0.002, at.shape)
    tested = scenes(sensor, kind, at, variation, 500)
    ones, log_lams = jnp.ones(sensor.electrode_count), np.log(LAMS * method.scale())
    objective = tx.design.ImageError.of(method, train, WIDTH)
    tried = [replace(objective, log_lam=jnp.asarray(v)) for v in log_lams]
    errors = [float(one.value(ones)) for one in tried]
    best = int(np.argmin(errors))
    now = replace(
        tx.design.ImageError.of(method, tested, WIDTH), log_lam=jnp.asarray(log_lams[best])
    )
    images = now.images(ones).reshape(-1, GRID, GRID)
    width = jax.vmap(lambda i: half_width(i, method.cell))(images)
    found = jax.vmap(lambda i: image_place(i, method.cell))(images)
    off = np.linalg.norm(np.asarray(found) - at, axis=1)
    shaped = {"width": np.asarray(width), "place": off}
    return {
        "lam": float(LAMS[best]),
        **{name: 1e3 * values.reshape(side, side) for name, values in shaped.items()},
    }


def regions(values: np.ndarray) -> float:
    """The worst of the means over 5 × 5 regions."""
    return float(
        max(
            part.mean()
            for rows in np.array_split(values, REGIONS)
            for part in np.array_split(rows, REGIONS, 1)
        )
    )


def study(side: int) -> tuple[list[dict], dict]:
    rows, maps = [], {}
    for n in (4, 8):
        start = time.perf_counter()
        grid = uniform(n)
        made = tx.design.design_electrodes(grid)
        seconds = time.perf_counter() - start
        sensors = {
            "uniform": grid,
            "designed": replace(grid, electrode_xy=jnp.asarray(made.electrode_xy)),
        }
        spread = spreads(sensors)
        maps[n * n] = made.electrode_xy, spread
        row = {
            "electrodes": n * n,
            "design_s": round(seconds, 1),
            "spread_worst_mm": {
                k: round(1e3 * float(v.max()), 2) for k, v in spread.items()
            },
            "spread_mean_mm": {
                k: round(1e3 * float(v.mean()), 2) for k, v in spread.items()
            },
            "ratio_worst": float(spread["designed"].max() / spread["uniform"].max()),
            "electrode_xy_mm": np.round(1e3 * made.electrode_xy, 2).tolist(),
        }
        jax.clear_caches()
        for kind, variation in itertools.product(CONTACTS if side else (), (0.0, 0.02)):
            each = {name: widths(s, kind, variation, side) for name, s in sensors.items()}
            jax.clear_caches()
            told = {"lam": {name: e["lam"] for name, e in each.items()}}
            for what in ("width", "place"):
                worst = {name: regions(e[what]) for name, e in each.items()}
                told |= {
                    f"{what}_mean_mm": {k: float(e[what].mean()) for k, e in each.items()},
                    f"{what}_worst_region_mm": worst,
                    f"{what}_ratio": worst["designed"] / worst["uniform"],
                }
            row[f"{kind}, sheet within {100 * variation:g} %"] = told
        print(json.dumps({k: v for k, v in row.items() if "xy" not in k}), flush=True)
        rows.append(row)
    return rows, maps


def maps_of(rows: list[dict]) -> dict:
    """The places and the spreads of designs that are kept, for `draw`."""
    maps = {}
    for row in rows:
        grid = uniform(int(row["electrodes"] ** 0.5))
        xy = np.array(row["electrode_xy_mm"]) / 1e3
        designed = replace(grid, electrode_xy=jnp.asarray(xy))
        maps[row["electrodes"]] = xy, spreads({"uniform": grid, "designed": designed})
    return maps


def draw(rows: list[dict], maps: dict, path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import VALUE

    figure = Figure(figsize=(11.5, 9.6), layout="constrained")
    figure.suptitle("Where electrodes lie, and how widely the image of a contact spreads")
    side = 1e3 * SIDE
    for line, (row, (count, (xy, spread))) in zip(
        figure.subplots(2, 2), zip(rows, maps.items())
    ):
        top = 1e3 * max(v.max() for v in spread.values())
        low = 1e3 * min(v.min() for v in spread.values())
        shown = None
        for axes, (name, values) in zip(line, spread.items()):
            shown = axes.imshow(
                1e3 * values.T,
                origin="lower",
                vmin=low,
                vmax=top,
                extent=(10.5, side - 10.5, 10.5, side - 10.5),
                cmap=VALUE,
            )
            at = (
                np.asarray(uniform(int(count**0.5)).electrode_xy)
                if name == "uniform"
                else xy
            )
            axes.plot(*(1e3 * at.T), "o", color="w", mec="k", ms=5)
            axes.set(
                title=f"{count} electrodes, {name}:\nworst {1e3 * values.max():.1f} mm",
                aspect="equal",
                xlim=(0, side),
                ylim=(0, side),
                xlabel="x, mm",
                ylabel="y, mm",
            )
        figure.colorbar(shown, ax=line, label="spread of a contact's image, mm")
        line[1].set_title(f"{line[1].get_title()} ({row['ratio_worst']:.2f} of the grid's)")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--scenes",
        type=int,
        default=10,
        help="Scenes along a side; 0 measures the spread alone.",
    )
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    options = parser.parse_args()
    from benchmarks.physics import environment

    rows, maps = study(options.scenes)
    content = {"environment": environment(), "rows": rows}
    (options.out / "electrodes.json").write_text(json.dumps(content, indent=1) + "\n")
    draw(rows, maps, options.out / "electrodes.png")


if __name__ == "__main__":
    main()
