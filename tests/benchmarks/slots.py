"""Measures error against slots: the paper's nine patterns and designed sets, by Eq. 3.

    python tests/benchmarks/slots.py [--scenes 160] [--out FOLDER]

Images of `linear` (J(0)) are of contacts that hold the sheet at V0, the paper's own case.
Designs are made on nominal values and simulated rigs. The measured voltages are those of a
resistor network (tests/rig.py), with other sheets and places. λ trades place for width.
Sets are therefore compared where they are equally wide. Each set has the λ at which its
images of simulated scenes are 10 mm wide (half-value width). The λ of least image error and
the whole curve are given, too.

Sets by place look up where `points` finds the contacts in the two exploratory slots. These
slots are not counted, as in the paper. Tables are `design_policy`'s before it makes
neighbours alike. "at most n" is the design of up to n slots whose simulated figures are
best. Writes slots.json and slots.png.
"""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

jax.config.update("jax_enable_x64", True)

from rig import Rig  # noqa: E402

import tomojax as tx  # noqa: E402
from tomojax.design import designs_by_place  # noqa: E402
from tomojax.kernels.images import half_width, image_place  # noqa: E402

COUNTS = (1, 2, 4, 6, 8, 12, 16, 28)
BY_PLACE, ONE_FOR_ALL, SHAPE = (1, 2, 4, 6, 8), (2, 4, 8, 16), (24, 24)
APART = (0.015, 0.02, 0.025, 0.03, 0.04, 0.05, 0.06)  # m, of two contacts
GRID, WIDTH, RADIUS = 32, 0.008, 0.002
ADAPTIVE = ("around", "cop_line", "point")
NAMES = {"around": "Around", "cop_line": "CoP line", "point": "Point"}
NAMES |= {"by_place 8": "designed by place, 8 slots"}
RAYLEIGH, WIDE = 0.19, 10.0  # mm
LAMS = np.logspace(-7.5, -3.5, 17)  # λ/σ₁²


def scenes(count: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Places (n, C, 2) and voltages (n, 64, 64) of single contacts, and of pairs."""
    found, rng = {}, np.random.default_rng(77)
    for name in ("one", *APART):
        places, volts = [], []
        for k in range(count if name == "one" else count // 4):
            if k % 10 == 0:
                rig = Rig(np.random.default_rng(900 + k))
            middle = (
                rng.uniform(0.02, 0.14, 2) if name == "one" else rng.uniform(0.04, 0.12, 2)
            )
            at = middle[None]
            if name != "one":
                angle = rng.uniform(0, np.pi)
                along = np.array([np.cos(angle), np.sin(angle)])
                at = middle + np.array([[1], [-1]]) * name / 2 * along
            contacts = [(rig.disc(p, RADIUS), 1.0) for p in at]
            volts.append(rig.measure(rig.scene(*contacts)[0]))
            places.append(at)
        found[str(name)] = np.stack(places), np.stack(volts)
    return found


def two_point_dip(image, cell, one, other, samples: int = 65):
    """Measures the image's fall between two true places: 1 − valley / lower peak.

    The image is read along the line through both, a quarter of their distance beyond each.
    Each peak is the highest value in its half. 0 is one blob, 1 is full separation;
    Rayleigh's criterion is 0.19.
    """
    along = jnp.linspace(-0.25, 1.25, samples).astype(image.dtype)
    places = one + along[:, None] * (other - one)
    at = list((places / cell - 0.5).T)
    line = jax.scipy.ndimage.map_coordinates(image, at, order=1, mode="nearest")
    half = samples // 2
    peaks = jnp.argmax(line[: half + 1]), half + jnp.argmax(line[half:])
    index = jnp.arange(samples)
    between = (index >= peaks[0]) & (index <= peaks[1])
    valley = jnp.min(jnp.where(between, line, jnp.inf))
    return 1 - valley / jnp.minimum(line[peaks[0]], line[peaks[1]])


class Sets:
    """The slots of each scene, (n, L) of 0 and 1, for each pattern and design."""

    def __init__(self, sensor: tx.Sensor):
        self.sensor = sensor
        self.points = tx.method(tx.Sensor.grid(divisions=(32, 32)), "points", GRID)
        self.corners = np.asarray(tx.paper.exploration(sensor))
        information = tx.design.design_objective(
            sensor, tx.design.design_places(sensor, count=64), "linear", grid=GRID
        )
        self.one_for_all = {
            n: tx.design.design(information, n).grounds for n in ONE_FOR_ALL
        }
        jax.clear_caches()
        size = np.asarray(sensor.size)
        parts = [(np.arange(n) + 0.5) / n * s for n, s in zip(SHAPE, size)]
        places = np.stack(np.meshgrid(*parts, indexing="ij"), -1).reshape(-1, 2)
        objective = tx.design.design_objective(sensor, places, "linear", "rigs", grid=GRID)
        away = np.linalg.norm(np.asarray(sensor.electrode_xy) - places[:, None], axis=-1)
        self.tables = {}
        for n in BY_PLACE:
            sets = np.asarray(designs_by_place(objective, n)[0])
            order = np.argsort(np.where(sets > 0.5, away, np.inf), 1)[:, :n]
            self.tables[n] = order.reshape(*SHAPE, n)
            print(f"designed: {n} slots", flush=True)
            jax.clear_caches()

    def found(self, volts: np.ndarray) -> tx.methods.Rows:
        batch = tx.Batch(self.points, 1.0, contacts=2, images=False)
        grounds = np.tile(self.corners, (len(volts), 1))
        return batch(volts[:, self.corners], grounds)

    def of(self, name: str, volts: np.ndarray, rows: tx.methods.Rows) -> np.ndarray:
        kind, _, n = name.partition(" ")
        weights = np.zeros((len(volts), 64))
        if kind == "designed":
            weights[:, self.one_for_all[int(n)]] = 1
        elif kind == "by_place":
            table, size = self.tables[int(n)], np.asarray(self.sensor.size)
            for k, w in enumerate(weights):
                some = max(1, int(rows.contact_count[k]))
                at = np.nan_to_num(rows.contact_xy[k, :some], nan=0.08) / size
                cells = np.clip((at * table.shape[:2]).astype(int), 0, table.shape[0] - 1)
                each = [table[i, j] for i, j in cells]
                # In turn, and no ground twice.
                turn = [g for slot in zip(*each) for g in slot]
                w[list(dict.fromkeys(turn))[: int(n)]] = 1
        elif kind in ("around", "cop_line", "point"):
            scan = tx.paper.AdaptiveScan(self.sensor, kind)
            sets = jax.jit(jax.vmap(lambda v: scan(v)[0]))(volts[:, self.corners])
            np.put_along_axis(weights, np.asarray(sets), 1, 1)
        elif kind.startswith("random"):
            for k, w in enumerate(weights):
                w[np.asarray(tx.pattern(self.sensor, kind, seed=k))] = 1
        else:
            weights[:, np.asarray(tx.pattern(self.sensor, kind))] = 1
        return weights


def images(objective: tx.design.ImageError, weights: np.ndarray, lam: float) -> jax.Array:
    now = replace(objective, log_lam=jnp.log(lam))
    return _images(now, jnp.asarray(weights))


@jax.jit
def _images(objective: tx.design.ImageError, weights: jax.Array) -> jax.Array:
    each = lambda x: replace(objective, rights=x[1][None]).images(x[0])[0]  # noqa: E731
    return jax.lax.map(each, (weights, objective.rights))


def study(count: int) -> list[dict]:
    fine = tx.Sensor.grid(divisions=(64, 64))
    linear = tx.method(fine, "linear", GRID)
    rng = np.random.default_rng(4)
    radii = RADIUS * np.sqrt(2) ** rng.uniform(-1, 1, 192)
    region = [0.015, 0.015, 0.145, 0.145]
    single = tx.design.design_places(fine, region, 192)
    angle = rng.uniform(0, np.pi, 96)
    along = 0.015 * np.stack([np.cos(angle), np.sin(angle)], 1)
    middle = np.asarray(tx.design.design_places(fine, [0.04, 0.04, 0.12, 0.12], 96))
    pairs = np.stack([middle + along, middle - along], 1)
    train = {
        "train": tx.design.simulate_scenes(fine, single, radius=radii, rigs=8, seed=3),
        "pairs": tx.design.simulate_scenes(fine, pairs, rigs=8, seed=4),
    }
    sets, data = Sets(fine), scenes(count)
    data |= {k: (np.asarray(v.places), np.asarray(v.voltages)) for k, v in train.items()}
    places = {k: at.reshape(len(at), -1, 2) for k, (at, _) in data.items()}
    volts = {k: v for k, (_, v) in data.items()}
    objective = {
        k: tx.design.ImageError.of(
            linear, tx.design.SimulatedScenes(jnp.asarray(places[k]), jnp.asarray(v)), WIDTH
        )
        for k, v in volts.items()
    }
    rows_of = {k: sets.found(v) for k, v in volts.items()}
    names = [
        *tx.paper.PATTERNS,
        *(f"designed {n}" for n in ONE_FOR_ALL),
        *(f"by_place {n}" for n in BY_PLACE),
    ]
    table = []
    for name in names:
        weights = {k: sets.of(name, v, rows_of[k]) for k, v in volts.items()}
        table.append({"set": name} | figures(objective, weights, places, linear))
        print(json.dumps({k: v for k, v in table[-1].items() if k != "curve"}), flush=True)
        jax.clear_caches()
    return table + [at_most(table, n) for n in COUNTS]


def figures(objective, weights, places, linear) -> dict:
    """Of one set: where its simulated images are WIDE, where their error is least, and
    all along λ."""
    cell, scale = linear.cell, linear.scale()

    def square(k: str, lam: float) -> jax.Array:
        return images(objective[k], weights[k], lam * scale).reshape(-1, GRID, GRID)

    def singles(k: str, lam: float) -> dict:
        found = square(k, lam)
        place = jax.vmap(lambda i: image_place(i, cell))(found)
        off = 1e3 * np.linalg.norm(np.asarray(place) - places[k][:, 0], axis=1)
        width = 1e3 * np.asarray(jax.vmap(lambda i: half_width(i, cell))(found))
        flat, targets = found.reshape(len(found), -1), objective[k].targets
        alike = (flat * targets).sum(1) ** 2 / (flat**2).sum(1)
        return {
            "lam": lam,
            "place_median_mm": float(np.median(off)),
            "place_p90_mm": float(np.quantile(off, 0.9)),
            "place_mean_mm": float(off.mean()),
            "half_width_mm": float(width.mean()),
            "image_error": float(1 - alike.mean()),
        }

    def apart(k: str, lam: float) -> float:
        each = jax.vmap(lambda i, p: two_point_dip(i, cell, p[0], p[1]))
        dips = each(square(k, lam), jnp.asarray(places[k]))
        return float((np.asarray(dips) > RAYLEIGH).mean())

    def whole(lam: float) -> dict:
        separated = {f"{1e3 * d:g}": apart(str(d), lam) for d in APART}
        return singles("one", lam) | {"separated": separated}

    simulated = [singles("train", float(lam)) for lam in LAMS]
    widths = np.maximum.accumulate([s["half_width_mm"] for s in simulated])
    wide = float(np.exp(np.interp(WIDE, widths, np.log(LAMS))))
    least = float(LAMS[int(np.argmin([s["image_error"] for s in simulated]))])
    return {
        "slots": int(weights["one"].sum(1).mean().round()),
        "simulated": singles("train", wide) | {"pairs_30": apart("pairs", wide)},
        "equally_wide": whole(wide),
        "least_error": whole(least),
        "curve": [singles("one", float(lam)) for lam in LAMS],
    }


def at_most(table: list[dict], n: int) -> dict:
    """Of the designs by place of up to n slots, the best by their simulated figures: one
    for a single contact, one for two."""
    some = [r for r in table if r["set"] in [f"by_place {m}" for m in BY_PLACE if m <= n]]
    one = min(some, key=lambda r: r["simulated"]["place_mean_mm"])
    two = max(some, key=lambda r: r["simulated"]["pairs_30"])
    return {
        "set": f"at_most {n}",
        "slots": n,
        "slots_taken": [one["slots"], two["slots"]],
        "equally_wide": one["equally_wide"]
        | {"separated": two["equally_wide"]["separated"]},
        "curve": one["curve"],
    }


def draw(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import name_points, style

    figure = Figure(figsize=(16, 10.5), layout="constrained")
    figure.suptitle("Eq. 3 under the paper's patterns and under designed sets of grounds")
    *panels, last = figure.subplots(2, 2).ravel()
    keys = {
        "place_median_mm": ("place error, mm (median)", "Place of a contact"),
        "place_p90_mm": ("place error, mm (nine in ten)", "Place, nine in ten"),
        "pairs": ("part told apart, %", "Pairs 30 mm apart"),
    }
    kinds = {
        "at_most": (style(0), "designed by place, at most so many slots"),
        "by_place": (style(6, marker="none"), "designed by place, all of them"),
        "designed": (style(3, linestyle="--"), "designed, one set for all places"),
    }

    def figure_of(row: dict, key: str) -> float:
        wide = row["equally_wide"]
        return 100 * wide["separated"]["30"] if key == "pairs" else wide[key]

    for axes, (key, (label, title)) in zip(panels, keys.items()):
        for kind, (look, told) in kinds.items():
            some = [r for r in rows if r["set"].startswith(kind)]
            x = [0.1 * r["slots"] for r in some]
            axes.semilogx(x, [figure_of(r, key) for r in some], **look, label=told)
        named = []
        for r in (r for r in rows if r["set"] in tx.paper.PATTERNS):
            mark = "^" if r["set"] in ADAPTIVE else "o"
            at = 0.1 * r["slots"], figure_of(r, key)
            axes.semilogx(*at, mark, color="0.4", ms=5)
            named.append((NAMES.get(r["set"], r["set"].replace("_", " ")), *at))
        for mark, told in (("^", "pattern that knows the contact"), ("o", "pattern")):
            axes.semilogx([], [], mark, color="0.4", ms=5, label=told)
        axes.set(xlabel="time of a scan, ms (exploration not counted)", ylabel=label)
        axes.set_title(f"{title}; images {WIDE:g} mm wide")
        ticks = [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4]
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xticks([], minor=True)
        axes.set_xlim(0.08, 9)
        axes.grid(alpha=0.3)
        name_points(axes, named, size=8)
    told = panels[0].get_legend_handles_labels()
    figure.legend(*told, loc="outside lower center", ncols=5, frameon=False)
    for k, name in enumerate(("by_place 8", "around", "cop_line", "point")):
        curve = next(r["curve"] for r in rows if r["set"] == name)
        x = [c["half_width_mm"] for c in curve]
        for key, line in (("place_median_mm", "-"), ("place_p90_mm", ":")):
            label = NAMES[name] if line == "-" else None
            last.plot(x, [c[key] for c in curve], **style(k, linestyle=line, label=label))
    last.set(xlabel="half-value width, mm", ylabel="place error, mm")
    last.set(xlim=(7, 20), ylim=(0, 10))
    last.set_title("Place and width along λ: median, nine in ten (dotted)")
    last.grid(alpha=0.3)
    last.legend(fontsize=9, loc="lower right", ncols=2)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=160)
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    options = parser.parse_args()
    from benchmarks.physics import environment

    rows = study(options.scenes)
    content = {"environment": environment(), "rows": rows}
    (options.out / "slots.json").write_text(json.dumps(content, indent=1) + "\n")
    draw(rows, options.out / "slots.png")


if __name__ == "__main__":
    main()
