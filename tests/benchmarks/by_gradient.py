"""Sets λ and grounds found by gradient beside λ's rules, hand-made and exchanged sets.

    python tests/benchmarks/by_gradient.py [--rigs 10] [--each 20] [--seed N]

λ and sets are found on simulated rigs (`tx.design.simulate_scenes`): lone contacts of 2 to
6 mm, of 0.1, 1 and 10 times the conductance of a square. The gradient goes through Eq. 3
and the reading of its image to the place error itself: `tune` finds λ for each set, and
`descend_sets` finds eight grounds with their λ. "exchanged, error" is the best set that
exchanges find for that same error; "exchanged, information" is `tx.design.design`'s. Each
rule chooses λ for each frame; "hindsight" is the one λ for all that is best in the median
on the judging scenes. Those are lone contacts on resistor networks (`bench.rigs`), on a
seed that nothing was set on. Eq. 3 has J(0); a place is the centre of what exceeds half.
Writes by_gradient.json and by_gradient.png.
"""

import argparse
import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

jax.config.update("jax_enable_x64", True)

import tomojax as tx  # noqa: E402
from tomojax.kernels import inverse  # noqa: E402
from tomojax.kernels.images import image_place  # noqa: E402

RESULTS = HERE.parents[1] / "notebooks" / "results"
GRID, RANK, SLOTS, NEAR = 32, 96, 8, 1e-3  # m: nearer counts little more
STRONG, EACH, STEPS = (0.1, 1.0, 10.0), 48, 100  # of a square; scenes; of the descent
RULES = ("cautious", "discrepancy", "gcv", "l_curve", "marginal_likelihood")
PAPER, NOISE, AROUND = 1.8e-3, 3e-4, np.arange(-3, 3.1, 0.5)  # of σ₁²; V; decades
HAND = ("around", "cop_line", "v_line", "random_8")
FOUND = ("exchanged, information", "exchanged, error", "by gradient")


class PlaceError(tx.design.AbstractObjective):
    """√(d² + 1 mm²), d from the contact to where Eq. 3's image shows it, m.

    `own` has the slots of each scene for patterns that know the contact; the weights then
    do not count.
    """

    swaps = 24

    factors: jax.Array  # (L, M, r)
    grams: jax.Array  # (L, r, r)
    rights: jax.Array  # (P, L, r)
    basis: jax.Array  # (r, pixels)
    places: jax.Array  # (P, 2)
    cell: jax.Array
    log_lam: jax.Array
    own: jax.Array | None = None

    @classmethod
    def of(cls, method: Any, volts: jax.Array, places: jax.Array) -> "PlaceError":
        factors = jnp.asarray(method.all_factors()[..., :RANK], float)
        grams = jnp.einsum("lmr,lms->lrs", factors, factors)
        rights = jnp.einsum("lmr,plm->plr", factors, jnp.asarray(volts, float))
        basis, cell = (jnp.asarray(a, float) for a in (method.basis[:RANK], method.cell))
        lam = jnp.log(jnp.asarray(1e-3 * method.scale(), float))
        return cls(factors, grams, rights, basis, jnp.asarray(places, float), cell, lam)

    @property
    def slots(self) -> int:
        return len(self.grams)

    def alone(self, k: jax.Array) -> "PlaceError":
        k = jnp.atleast_1d(k)
        own = None if self.own is None else self.own[k]
        return replace(self, rights=self.rights[k], places=self.places[k], own=own)

    def found(self, weights: jax.Array) -> jax.Array:
        """The places that the images show, (P, 2) m; one set, or one for each scene."""
        lam = jnp.exp(self.log_lam)
        if weights.ndim == 1:
            right = jnp.einsum("l,plr->pr", weights, self.rights)
            phi = self._solved(jnp.einsum("l,lrs->rs", weights, self.grams), right.T, lam).T
        else:

            def one(each: tuple[jax.Array, jax.Array]) -> jax.Array:
                total = jnp.einsum("l,lrs->rs", each[0], self.grams)
                return self._solved(total, each[0] @ each[1], lam)

            phi = jax.lax.map(one, (weights, self.rights))
        images = (phi @ self.basis).reshape(-1, GRID, GRID)
        return jax.vmap(lambda image: image_place(image, self.cell))(images)

    def _solved(self, total: jax.Array, right: jax.Array, lam: jax.Array) -> jax.Array:
        damped = total + lam * jnp.eye(len(total))
        return jax.scipy.linalg.solve(damped, right, assume_a="pos")

    def __call__(self, weights: jax.Array) -> jax.Array:
        found = self.found(weights if self.own is None else self.own)
        return jnp.sqrt(((found - self.places) ** 2).sum(-1) + NEAR**2)


def simulated(sensor: Any) -> Any:
    """Places and voltages of the scenes that λ and sets are found on."""
    square = 1 / float(np.mean(np.asarray(sensor.sheet_resistance)))
    rng, region, made = np.random.default_rng(4), [0.01, 0.01, 0.15, 0.15], []
    for k, strong in enumerate(STRONG):
        at = np.asarray(tx.design.design_places(sensor, region, EACH))
        at = np.clip(at + rng.normal(0, 2e-3, at.shape), 0.008, 0.152)
        radii = rng.uniform(0.002, 0.006, EACH)
        more = {"conductance": strong * square, "rigs": 4, "seed": 20 + k}
        made.append(tx.design.simulate_scenes(sensor, at, radius=radii, **more))
    places = np.concatenate([np.asarray(m.places).reshape(-1, 2) for m in made])
    return places, np.concatenate([np.asarray(m.voltages) for m in made])


def grounds_of(sensor: Any, name: str, found: dict, volts: np.ndarray) -> np.ndarray:
    """The grounds of each scene, (n, S)."""
    if name in found:
        own = found[name]
    elif name in ("around", "cop_line"):
        scan = tx.paper.AdaptiveScan(sensor, name)
        explored = volts[:, np.asarray(tx.paper.exploration(sensor))]
        return np.asarray(jax.jit(jax.vmap(lambda v: scan(v)[0]))(explored))
    else:
        more = {"seed": 0} if name.startswith("random") else {}
        own = np.asarray(tx.pattern(sensor, name, **more))
    return np.tile(own, (len(volts), 1))


def weights_of(grounds: np.ndarray) -> jax.Array:
    weights = np.zeros((len(grounds), 64))
    np.put_along_axis(weights, grounds, 1, 1)
    return jnp.asarray(weights)


@eqx.filter_jit
def rules(factors: jax.Array, volts: jax.Array, grounds: jax.Array) -> jax.Array:
    """The λ that each rule chooses for each frame, (n, rules)."""

    def one(each: tuple[jax.Array, jax.Array]) -> jax.Array:
        v, ground = each
        spectrum = inverse.spectrum(factors[ground])
        grid = inverse.lambda_grid(spectrum)
        noise = jnp.asarray(NOISE)
        scores = [
            inverse.lambda_scores(spectrum, v, grid, rule, noise)  # pyright: ignore
            for rule in RULES
        ]
        return jnp.stack([inverse.choose_lambda(grid, score) for score in scores])

    return jax.lax.map(one, (volts, grounds))


@eqx.filter_jit
def _found(objective: PlaceError, weights: jax.Array, lams: jax.Array) -> jax.Array:
    """Places with a λ for each scene."""

    def one(each: tuple[jax.Array, ...]) -> jax.Array:
        k, w, lam = each
        return replace(objective.alone(k), log_lam=jnp.log(lam)).found(w)[0]

    return jax.lax.map(one, (jnp.arange(len(weights)), weights, lams))


def equation3(
    name: str, train: PlaceError, judge: PlaceError, volts: np.ndarray, sets: dict
) -> list[dict]:
    """Rows of Eq. 3 under one set: each rule's λ, the paper's, by gradient, hindsight."""
    weights = {k: weights_of(g) for k, g in sets.items()}
    own = replace(train, own=weights["train"])
    fixed = (sets["train"] == sets["train"][0]).all()
    tuned = tx.design.tune(train if fixed else own, weights["train"][0])
    lam = float(jnp.exp(tuned.objective.log_lam))
    total = jnp.einsum("l,lrs->rs", weights["judge"][0], judge.grams)
    strongest = float(jnp.linalg.eigvalsh(total)[-1])
    count = len(volts)
    used = np.take_along_axis(volts, sets["judge"][..., None], 1)
    lams = rules(judge.factors, jnp.asarray(used, float), jnp.asarray(sets["judge"]))
    chosen = dict(zip(RULES, np.asarray(lams).T))
    chosen["one for all, the paper's"] = np.full(count, PAPER * strongest)
    chosen["by gradient"] = np.full(count, lam)

    def off(lams: np.ndarray) -> np.ndarray:
        found = _found(judge, weights["judge"], jnp.asarray(lams))
        return 1e3 * np.hypot(*(np.asarray(found) - np.asarray(judge.places)).T)

    errors = {rule: off(lams) for rule, lams in chosen.items()}
    every = [off(np.full(count, lam * 10**d)) for d in AROUND]
    best = int(np.argmin([np.median(e) for e in every]))
    errors["hindsight"] = every[best]
    told = {"method": "Eq. 3", "set": name, "slots": sets["judge"].shape[1]}
    return [told | {"lam": rule} | figures(e) for rule, e in errors.items()]


def figures(errors: np.ndarray) -> dict[str, Any]:
    """Median with its 95 % by bootstrap, and 90 % of the place errors, mm."""
    errors = np.nan_to_num(errors, nan=160.0)  # nothing found: a side off
    rng = np.random.default_rng(0)
    some = np.median(rng.choice(errors, (1000, len(errors))), 1)
    return {
        "median_mm": float(np.median(errors)),
        "median_between_mm": np.quantile(some, [0.025, 0.975]).tolist(),
        "quartiles_mm": np.quantile(errors, [0.25, 0.75]).tolist(),
        "p90_mm": float(np.quantile(errors, 0.9)),
        "each_mm": np.round(errors, 3).tolist(),
    }


def searched(sensor: Any, train: PlaceError) -> dict[str, np.ndarray]:
    """Eight grounds by exchange and by gradient."""
    coarse = tx.Sensor.grid(divisions=(32, 32))
    places = tx.design.design_places(coarse, count=64)
    information = tx.design.design_objective(coarse, places, "linear", grid=GRID)
    found = {"exchanged, information": tx.design.design(information, SLOTS).grounds}
    drawn = tx.design.descend_sets(train, SLOTS, steps=STEPS, draws=2)
    found["by gradient"] = np.flatnonzero(np.asarray(drawn.weights) > 0.5)
    start = jnp.zeros(64).at[found["exchanged, information"]].set(1)
    tuned = tx.design.tune(train, start).objective
    better = jax.jit(lambda w: tx.design.exchange(tuned.value, w, SLOTS, tuned.swaps))
    found["exchanged, error"] = np.flatnonzero(np.asarray(better(start)) > 0.5)
    return {name: found[name] for name in FOUND}


def study(options: argparse.Namespace) -> dict[str, Any]:
    from bench.rigs import lone_contacts

    sensor = tx.Sensor.grid(divisions=(64, 64))
    linear = tx.method(sensor, "linear", GRID)
    told = {"rigs": options.rigs, "each": options.each, "grounds": np.arange(64)}
    lone = lone_contacts(tx.Sensor.grid(), "usual", options.seed, **told)
    data = {"train": simulated(sensor), "judge": (lone.xy, lone.volts)}
    train, judge = (PlaceError.of(linear, volts, at) for at, volts in data.values())
    found, rows = searched(sensor, train), []
    sets = {
        name: {k: grounds_of(sensor, name, found, v) for k, (_, v) in data.items()}
        for name in (*FOUND, *HAND)
    }
    for name, own in sets.items():
        rows += equation3(name, train, judge, data["judge"][1], own)
        print_rows(rows[-len(RULES) - 3 :])
    return {"grounds": {k: v.tolist() for k, v in found.items()}, "rows": rows}


def print_rows(rows: list[dict]) -> None:
    for r in rows:
        print(
            f"{r['method']:7} {r['set']:24} {r['slots']:2} λ {r['lam']:26} "
            f"median {r['median_mm']:6.2f} ({r['median_between_mm'][0]:.2f} to "
            f"{r['median_between_mm'][1]:.2f}), 90 % {r['p90_mm']:6.2f} mm",
            flush=True,
        )


def draw(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import BLUE, GREEN, ORANGE, plain

    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    names = list(dict.fromkeys(r["set"] for r in rows if r["method"] == "Eq. 3"))
    looks = {
        "by gradient": (BLUE, "D", "λ by gradient, with quartiles"),
        "one for all, the paper's": (ORANGE, "s", "one λ of σ₁² for all"),
        "hindsight": ("0.4", "|", "λ in hindsight"),
    }
    for r in (r for r in rows if r["method"] == "Eq. 3"):
        y, look = -names.index(r["set"]), looks.get(r["lam"], (GREEN, ".", "each rule's λ"))
        if r["lam"] == "by gradient":
            axes.plot(r["quartiles_mm"], [y, y], color=BLUE, lw=1)
        label = look[2] if r["set"] == names[0] and r["lam"] != "gcv" else None
        shown = label if r["lam"] in looks or r["lam"] == RULES[0] else None
        axes.plot(r["median_mm"], y, look[1], color=look[0], ms=9, label=shown)
    axes.set_yticks([-k for k in range(len(names))], [n.replace("_", " ") for n in names])
    axes.set(xscale="log", xlabel="place error, mm (median)", title="Eq. 3, J(0)")
    plain(axes.xaxis)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=10)
    parser.add_argument("--each", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1_000_161)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    from tomojax._environment import environment

    made = {name: getattr(options, name) for name in ("rigs", "each", "seed")}
    report = {"environment": environment(), "options": made, **study(options)}
    (options.out / "by_gradient.json").write_text(json.dumps(report, indent=1) + "\n")
    draw(report["rows"], options.out / "by_gradient.png")


if __name__ == "__main__":
    main()
