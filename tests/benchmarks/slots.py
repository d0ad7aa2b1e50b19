"""Error against the number of slots: the paper's nine patterns and designed sets, by Eq. 3.

    python tests/benchmarks/slots.py [--scenes 40] [--out FOLDER]

Images of `linear` (J(0)) of contacts that hold the sheet at V0, the paper's own case.
Designs are made on nominal values; λ is chosen for each set by the least image error of
simulated scenes (rigs that vary); what is measured are voltages of a resistor network
(tests/rig.py), other sheets and places. Sets by place look up where `points` finds the
contacts in the two exploratory slots, which are not counted, as in the paper. Writes
slots.json and slots.png.
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
from tomojax import kernels  # noqa: E402

COUNTS = (1, 2, 4, 6, 8, 12, 16, 28)
APART = (0.015, 0.02, 0.025, 0.03, 0.04, 0.05, 0.06)  # m, of two contacts
GRID, WIDTH, RADIUS = 32, 0.008, 0.002
RAYLEIGH = 0.19
LAMS = np.logspace(-7.5, -2, 23)  # λ/σ₁²


def scenes(count: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Places (n, C, 2) and voltages (n, 64, 64) of single contacts, and of pairs."""
    found, rng = {}, np.random.default_rng(77)
    for name in ("one", *APART):
        places, volts = [], []
        for k in range(count):
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


class Sets:
    """The slots of each scene, (n, L) of 0 and 1, for each pattern and design."""

    def __init__(self, sensor: tx.Sensor):
        self.sensor = sensor
        self.points = tx.method(tx.Sensor.grid(divisions=(32, 32)), "points", GRID)
        self.corners = np.asarray(tx.exploration(sensor))
        places = tx.design_places(sensor, count=64)
        objective = tx.design_objective(sensor, places, "linear", grid=GRID)
        self.one_for_all, self.tables = {}, {}
        for n in COUNTS:
            self.one_for_all[n] = tx.design(objective, n).grounds
            policy = tx.design_policy(sensor, n, "linear", (12, 12), grid=GRID).policy
            self.tables[n] = np.asarray(policy.table)
            print(f"designed: {n} slots", flush=True)
            jax.clear_caches()

    def found(self, volts: np.ndarray) -> tx.Rows:
        batch = tx.Batch(self.points, 1.0, contacts=2, images=False)
        grounds = np.tile(self.corners, (len(volts), 1))
        return batch(volts[:, self.corners], grounds)

    def of(self, name: str, volts: np.ndarray, rows: tx.Rows) -> np.ndarray:
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
                # As a step takes them: in turn, and no ground twice.
                turn = [g for slot in zip(*each) for g in slot]
                w[list(dict.fromkeys(turn))[: int(n)]] = 1
        elif kind in ("around", "cop_line", "point"):
            for w, v in zip(weights, volts):
                w[np.asarray(tx.pattern(self.sensor, kind, v[self.corners]))] = 1
        elif kind.startswith("random"):
            for k, w in enumerate(weights):
                w[np.asarray(tx.pattern(self.sensor, kind, seed=k))] = 1
        else:
            weights[:, np.asarray(tx.pattern(self.sensor, kind))] = 1
        return weights


def images(objective: tx.ImageError, weights: np.ndarray, lam: float) -> jax.Array:
    now = replace(objective, log_lam=jnp.log(lam))
    return _images(now, jnp.asarray(weights))


@jax.jit
def _images(objective: tx.ImageError, weights: jax.Array) -> jax.Array:
    each = lambda x: objective.images_of(x[0], x[1][None])[0]  # noqa: E731
    return jax.lax.map(each, (weights, objective.rights))


def study(count: int) -> list[dict]:
    fine = tx.Sensor.grid(divisions=(64, 64))
    linear = tx.method(fine, "linear", GRID)
    cell, scale = linear.cell, linear.scale()
    train = tx.simulate_scenes(fine, tx.design_places(fine, count=48), rigs=8, seed=3)
    sets, data = Sets(fine), scenes(count)
    objective = {"train": tx.ImageError.of(linear, train, WIDTH)}
    places = {"train": np.asarray(train.places)[:, None]}
    volts = {"train": np.asarray(train.voltages)}
    for name, (at, v) in data.items():
        scene = tx.Scenes(jnp.asarray(at[:, 0]), jnp.asarray(v))
        objective[name] = tx.ImageError.of(linear, scene, WIDTH)
        places[name], volts[name] = at, v
    rows_of = {name: sets.found(v) for name, v in volts.items()}
    names = [
        *tx.PATTERNS,
        *(f"designed {n}" for n in COUNTS),
        *(f"by_place {n}" for n in COUNTS),
    ]
    table = []
    for name in names:
        table.append(row(name, sets, objective, places, volts, rows_of, cell, scale))
        print(json.dumps(table[-1]), flush=True)
        jax.clear_caches()
    return table


def row(name, sets, objective, places, volts, rows_of, cell, scale) -> dict:
    weights = {k: sets.of(name, v, rows_of[k]) for k, v in volts.items()}
    targets = objective["train"].targets
    errors = []
    for lam in LAMS * scale:
        found = images(objective["train"], weights["train"], lam)
        alike = (found * targets).sum(1) ** 2 / (found**2).sum(1)
        errors.append(float(1 - alike.mean()))
    lam = float(LAMS[int(np.argmin(errors))])
    square = lambda k: images(objective[k], weights[k], lam * scale).reshape(-1, GRID, GRID)  # noqa: E731
    one = square("one")
    place = jax.vmap(lambda i: kernels.image_place(i, cell))(one)
    off = 1e3 * np.linalg.norm(np.asarray(place) - places["one"][:, 0], axis=1)
    width = 1e3 * np.asarray(jax.vmap(lambda i: kernels.half_width(i, cell))(one))
    dips = {}
    for d in APART:
        pair = jnp.asarray(places[str(d)])
        each = jax.vmap(lambda i, p: kernels.two_point_dip(i, cell, p[0], p[1]))
        dips[f"{1e3 * d:g}"] = float(
            (np.asarray(each(square(str(d)), pair)) > RAYLEIGH).mean()
        )
    far = [float(mm) for mm, part in dips.items() if part >= 0.8]
    return {
        "set": name,
        "slots": int(weights["one"].sum(1).mean().round()),
        "lam_rule": "least image error of simulated scenes",
        "lam": lam,
        "train_error": float(min(errors)),
        "place_median_mm": float(np.median(off)),
        "place_p90_mm": float(np.quantile(off, 0.9)),
        "half_width_mm": float(width.mean()),
        "separated": dips,
        "separation_mm": min(far) if far else None,
    }


def draw(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(17, 4.6), layout="constrained")
    rows = [r | {"pairs": 100 * r["separated"]["30"]} for r in rows]
    keys = {
        "place_median_mm": "place error, median, mm",
        "place_p90_mm": "place error, 90 %, mm",
        "half_width_mm": "half-value width, mm",
        "pairs": "of pairs 30 mm apart told apart, %",
    }
    for axes, (key, told) in zip(figure.subplots(1, 4), keys.items()):
        for kind, style in (("designed", "C3-o"), ("by_place", "C0-^")):
            some = [r for r in rows if r["set"].startswith(kind)]
            label = "designed, one for all" if kind == "designed" else "designed, by place"
            axes.semilogx(
                [0.1 * r["slots"] for r in some], [r[key] for r in some], style, label=label
            )
        for r in rows:
            if r["set"] in tx.PATTERNS:
                mark = "^" if r["set"] in ("around", "cop_line", "point") else "o"
                axes.semilogx(0.1 * r["slots"], r[key], mark, color="0.4")
                axes.annotate(r["set"], (0.1 * r["slots"], r[key]), size=7)
        axes.set(xlabel="Δt, ms (exploration not counted)", ylabel=told)
        axes.set_xticks(
            [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4],
            labels="0.1 0.2 0.4 0.8 1.6 3.2 6.4".split(),
        )
        axes.set_xticks([], minor=True)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    options = parser.parse_args()
    from benchmarks.physics import environment

    rows = study(options.scenes)
    content = {"environment": environment(), "rows": rows}
    (options.out / "slots.json").write_text(json.dumps(content, indent=1) + "\n")
    draw(rows, options.out / "slots.png")


if __name__ == "__main__":
    main()
