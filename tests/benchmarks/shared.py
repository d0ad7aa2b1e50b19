"""Compares several grounds at once with single ones: how near two contacts are told apart.

    python tests/benchmarks/shared.py [--pairs 40] [--out FOLDER]

Sets have 2 and 8 slots. The best single grounds are found for pairs 15 mm apart, anywhere.
From there, `design_shared` finds conductances to ground for the same pairs. Voltages are of
a resistor network (tests/rig.py) on other rigs and places. Two discs, with free currents in
each slot, are fitted to the voltages from 3 mm beside the truth. Writes shared.json and
shared.png.
"""

import argparse
import json
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

jax.config.update("jax_enable_x64", True)

from rig import Rig  # noqa: E402

import tomojax as tx  # noqa: E402
from tomojax import design as shared  # noqa: E402
from tomojax.kernels.algebra import matmul  # noqa: E402
from tomojax.kernels.contacts import slot_weights, solve_small, weighed  # noqa: E402

SLOTS, APART = (2, 8), (0.006, 0.008, 0.01, 0.0125, 0.015, 0.02, 0.025, 0.03)  # m
RADIUS, CONDUCTANCE, ROUNDS, BESIDE = 0.006, 1e-4, 25, 0.003


def pairs(rng: np.random.Generator, count: int, apart: float) -> np.ndarray:
    middle, angle = rng.uniform(0.03, 0.13, (count, 2)), rng.uniform(0, np.pi, count)
    along = np.stack([np.cos(angle), np.sin(angle)], 1)
    return middle[:, None] + np.array([1, -1])[:, None] * along[:, None] * apart / 2


def fit(made: shared.Pairs, start, volts, to_ground):
    """Places of two discs, sizes as usual, with the currents that fit in each slot."""
    m, unit = volts.shape[1], made.sheet.unit

    def slot(places, v, gamma):
        t, _ = shared.shared_map(made, places, gamma)
        weights = slot_weights(made.noise, v, jnp.ones(m, bool))
        free = t[:, 0]
        seen = weighed(weights, free)
        among = matmul(seen, free.T)
        current = solve_small(among, matmul(seen, v)[:, None])[:, 0]
        rest = v - matmul(current, free)
        moves = (current[:, None, None] * t[:, 1:3]).reshape(4, m)
        inner = weighed(weights, moves)
        across = matmul(inner, free.T)
        told = matmul(inner, moves.T) - matmul(across, solve_small(among, across.T))
        # What is left is not explained by the currents already.
        return told, matmul(inner, rest), matmul(weighed(weights, rest[None])[0], rest)

    def total(places):
        parts = jax.vmap(slot, (None, 0, 0))(places, volts, to_ground)
        return tuple(p.sum(0) for p in parts)

    def step(state, _):
        places, damping, parts = state
        told, right, cost = parts
        system = told + jnp.diag(damping * jnp.diagonal(told))
        move = solve_small(system, right[:, None])[:, 0].reshape(2, 2) * unit
        move = jnp.clip(move, -0.005, 0.005)
        tried = jnp.clip(places + move, 0.002, 0.158)
        new = total(tried)
        better = new[2] < cost
        kept = jax.tree.map(
            lambda a, b: jnp.where(better, a, b), (tried, *new), (places, *parts)
        )
        return (kept[0], jnp.where(better, damping / 5, damping * 5), kept[1:]), None

    first = start, jnp.asarray(1e-2), total(start)
    return jax.lax.scan(step, first, None, ROUNDS)[0][0]


def study(count: int) -> list[dict]:
    sensor = tx.Sensor.grid(divisions=(64, 64), dtype=np.float64)
    train = pairs(np.random.default_rng(1), 24, 0.015)
    most, sets, rows = float(shared.closed(sensor)), {}, []
    for slots in SLOTS:
        start = time.perf_counter()
        made = tx.design.design_shared(sensor, train, slots)
        single = np.zeros((slots, 64))
        single[np.arange(slots), made.grounds] = most
        sets[f"{slots} single"] = single
        sets[f"{slots} shared"] = made.to_ground
        rows.append(
            {
                "slots": slots,
                "design_s": round(time.perf_counter() - start, 1),
                "single_um": 1e6 * made.single,
                "shared_um": 1e6 * made.value,
                "relaxed_um": 1e6 * made.relaxed,
                "closed_switches": (made.to_ground > 0).sum(1).tolist(),
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    told = shared.pairs_of(sensor, train)
    fits = jax.jit(
        jax.vmap(lambda s, v, g: fit(told, s, v, g), (0, 0, None)), static_argnums=()
    )
    for apart in APART:
        rng = np.random.default_rng(7)
        at = pairs(rng, count, apart)
        start = at + BESIDE * rng.normal(size=at.shape) / np.sqrt(2)
        volts = {name: [] for name in sets}
        for k, two in enumerate(at):
            if k % 10 == 0:
                rig = Rig(np.random.default_rng(700 + k))
            both = [(rig.disc(p, RADIUS), CONDUCTANCE) for p in two]
            exact = rig.shared(np.concatenate(list(sets.values())), *both)
            read = np.split(
                rig.measure(exact), np.cumsum([len(s) for s in sets.values()])[:-1]
            )
            for name, v in zip(sets, read):
                volts[name].append(v)
        for name, g in sets.items():
            found = np.asarray(
                fits(jnp.asarray(start), jnp.asarray(np.stack(volts[name])), jnp.asarray(g))
            )
            off = np.linalg.norm(found - at, axis=-1).max(1)
            rows.append(
                {
                    "set": name,
                    "apart_mm": 1e3 * apart,
                    "told_apart": float((off < apart / 3).mean()),
                    "place_median_mm": 1e3 * float(np.median(off)),
                    "place_p90_mm": 1e3 * float(np.quantile(off, 0.9)),
                }
            )
            print(json.dumps(rows[-1]), flush=True)
    return rows


def draw(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import BLUE, ORANGE

    figure = Figure(figsize=(11, 4.8), layout="constrained")
    figure.suptitle("Two contacts: one ground in each slot, or several at once")
    left, right = figure.subplots(1, 2)
    for slots, color in zip(SLOTS, (BLUE, ORANGE)):
        for kind, style in (("single", "--o"), ("shared", "-s")):
            some = [r for r in rows if r.get("set") == f"{slots} {kind}"]
            apart = [r["apart_mm"] for r in some]
            label = f"{slots} slots, " + (
                "one ground each" if kind == "single" else "several at once"
            )
            left.plot(
                apart,
                [100 * r["told_apart"] for r in some],
                style,
                color=color,
                label=label,
            )
            right.plot(apart, [r["place_median_mm"] for r in some], style, color=color)
    left.axhline(80, color="0.8", zorder=0)
    left.set(
        xlabel="distance of the contacts, mm",
        ylabel="pairs with both within a third of it, %",
        title="Pairs told apart",
        ylim=(0, 103),
    )
    right.set(
        xlabel="distance of the contacts, mm",
        ylabel="error of the worse place, mm (median)",
        title="Place",
        ylim=(0, None),
    )
    left.legend()
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    options = parser.parse_args()
    from benchmarks.physics import environment

    rows = study(options.pairs)
    content = {"environment": environment(), "rows": rows}
    (options.out / "shared.json").write_text(json.dumps(content, indent=1) + "\n")
    draw(rows, options.out / "shared.png")


if __name__ == "__main__":
    main()
