"""Measures designs of grounds: the gap to the best possible, speed, a robot's gain.

    python tests/benchmarks/design.py [--only gap|places|lambda|loop] [--out FOLDER]

The part gap takes every objective (eight of 64 slots), with greedy and exchange beside. The
part places makes a table for 1024 places, with compiling. The part lambda sets λ by
gradient against a grid. The part loop closes the loop on rigs of another model
(tests/rig.py). There, a table by place stands against *Around*, in place error and in time.
Writes design.json and design.png.
"""

import argparse
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

import tomojax as tx  # noqa: E402

KINDS = [(m, c) for m in ("points", "linear", "source") for c in ("place", "d", "worst")]
POLICIES = ("around", "cop_line", "around_contacts", "designed")
RIGS, LENGTH, HOLD = tuple(range(81, 93)), 48, 16


def gap(sensor) -> list[dict]:
    places, rows = tx.design.design_places(sensor, count=64), []
    for method, criterion in KINDS:
        objective = tx.design.design_objective(sensor, places, method, criterion)
        begin = time.perf_counter()
        found = tx.design.design(objective, 8)
        rows.append(
            {
                "kind": "gap",
                "method": method,
                "criterion": criterion,
                "value": found.value,
                "unit": found.unit,
                "gap": found.value / found.bound - 1,
                "gap_rounded": found.rounded / found.bound - 1,
                "gap_greedy": found.greedy / found.bound - 1,
                "seconds_with_compiling": time.perf_counter() - begin,
                "grounds": found.grounds.tolist(),
            }
        )
        print(json.dumps(rows[-1]), flush=True)
        jax.clear_caches()
    return rows


def places(sensor) -> list[dict]:
    from tomojax.design import designs_by_place

    parts = (np.arange(32) + 0.5) / 32 * 0.16
    grid = np.stack(np.meshgrid(parts, parts, indexing="ij"), -1).reshape(-1, 2)
    rows = []
    for method in ("points", "linear"):
        criterion = "place" if method == "points" else "a"
        objective = tx.design.design_objective(sensor, grid, method, criterion)
        begin = time.perf_counter()
        sets, bound = jax.block_until_ready(designs_by_place(objective, 8))
        spent = time.perf_counter() - begin
        values = jax.jit(
            lambda o, w: jax.lax.map(
                lambda x: o.alone(x[0]).value(x[1]), (jnp.arange(1024), w)
            )
        )(objective, sets)
        off = np.asarray(values / bound) - 1
        rows.append(
            {
                "kind": "places",
                "method": method,
                "places": 1024,
                "seconds_with_compiling": spent,
                "gap_median": float(np.median(off)),
                "gap_max": float(off.max()),
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    return rows


def lambdas(sensor) -> list[dict]:
    fine = replace(sensor, divisions=(64, 64))
    scenes = tx.design.simulate_scenes(fine, tx.design.design_places(fine, count=48))
    linear, rows = tx.method(fine, "linear", 32), []
    grounds = np.array([11, 13, 20, 27, 33, 36, 44, 52])
    w = jnp.zeros(64).at[grounds].set(1)
    for smooth in (False, True):
        objective = tx.design.ImageError.of(linear, scenes, 0.008, smooth=smooth)
        found = tx.design.tune(objective, w)
        lams = objective.log_lam + np.log(10) * jnp.linspace(-3, 4, 29)
        lengths = jnp.log(jnp.linspace(0.3, 4, 12)) if smooth else jnp.zeros(1)

        def at(length, lam, objective=objective, smooth=smooth):
            now = replace(objective, log_lam=lam)
            return (replace(now, log_length=length) if smooth else now).value(w)

        over = jax.vmap(jax.vmap(at, (None, 0)), (0, None))
        grid = jax.jit(over)(lengths, lams)
        rows.append(
            {
                "kind": "lambda",
                "with_length": smooth,
                "error": float(found.value),
                "solves": found.solves,
                "grid_error": float(grid.min()),
                "grid_solves": int(grid.size),
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    return rows


def loop(sensor) -> list[dict]:
    from rig import Rig

    table = tx.design.design_policy(sensor, 8).policy
    single = tx.Sensor.grid(dtype=np.float32, divisions=(32, 32))
    size = jnp.asarray(single.size)
    own = {"designed": tx.step.Lookup(table.table, table.idle, size)}
    step = tx.make_step(single, "follow", POLICIES, tables=own, contacts=1)
    errors = {name: [] for name in POLICIES}
    spent = {name: [] for name in POLICIES}
    t = np.linspace(0, 2 * np.pi, LENGTH)
    for seed in RIGS:
        rng = np.random.default_rng(seed)
        rig = Rig(rng)
        phase, far = rng.uniform(0, 2 * np.pi, 2), rng.uniform(0.035, 0.062, 2)
        eight = np.stack(
            [far[0] * np.sin(t + phase[0]), far[1] * np.sin(2 * t + phase[1])], 1
        )
        path = 0.08 + eight
        # A contact is cells of 0.8 mm: it is where their middle is.
        made = [rig.scene((rig.disc(p, 0.006), 1e-4)) for p in path]
        volts = np.stack([m[0] for m in made])
        path = np.stack([m[1][0][0] for m in made])
        for name in POLICIES:
            rig.rng = np.random.default_rng(1)
            state, ground = step.switch(step.state, name), 0
            for k in np.repeat(np.arange(LENGTH), HOLD):
                v = rig.measure(volts[k, ground]).astype(np.float32)
                begin = time.perf_counter_ns()
                state, out = step(state, v, ground)
                ground = int(out.ground)
                spent[name].append(time.perf_counter_ns() - begin)
                errors[name].append(np.hypot(*(np.asarray(out.contacts.xy[0]) - path[k])))
    rows, each = [], {}
    for name in POLICIES:
        off = 1e3 * np.array(errors[name]).reshape(len(RIGS), LENGTH, HOLD)[:, 1:]
        each[name] = np.median(off, (1, 2))
        apart = each[name] - each["around"]  # on the same rigs
        rows.append(
            {
                "kind": "loop",
                "policy": name,
                "place_median_mm": float(np.median(off)),
                "place_p90_mm": float(np.quantile(off, 0.9)),
                "place_mean_mm": float(off.mean()),
                "less_than_around_mm": float(-apart.mean()),
                "less_than_around_se_mm": float(apart.std(ddof=1) / len(RIGS) ** 0.5),
                "each_rig_median_mm": each[name].tolist(),
                "slot_p50_us": float(np.median(spent[name])) / 1e3,
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    return rows


def draw(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import BLUE, GREEN, ORANGE, plain

    figure = Figure(figsize=(13, 5), layout="constrained")
    left, right = figure.subplots(1, 2)
    gaps = [row for row in rows if row["kind"] == "gap"]
    at = np.arange(len(gaps))
    labels = {
        "gap_rounded": ("rounded", ORANGE, "//"),
        "gap_greedy": ("greedy", GREEN, ".."),
        "gap": ("exchanged, the answer", BLUE, ""),
    }
    for k, (name, (label, colour, hatch)) in enumerate(labels.items()):
        values = [100 * max(row[name], 1e-4) for row in gaps]
        look = {"color": colour, "hatch": hatch, "edgecolor": "w", "label": label}
        left.bar(at + 0.27 * (k - 1), values, 0.27, **look)
    left.set(yscale="log", xlabel="method and criterion")
    plain(left.yaxis)
    left.axhline(5, color="0.4", lw=1, ls="--", label="5 %")
    names = [f"{row['method']}\n{row['criterion']}" for row in gaps]
    left.set_xticks(at, names, fontsize=9)
    left.set(ylabel="above the relaxation's bound, %")
    left.set_title("Sets of eight grounds of 64: how far from the best possible")
    left.legend()
    loops = [row for row in rows if row["kind"] == "loop"]
    at = np.arange(len(loops))
    looks = {
        "place_median_mm": (BLUE, "", "median"),
        "place_p90_mm": (ORANGE, "//", "90 %"),
    }
    for k, (name, (colour, hatch, label)) in enumerate(looks.items()):
        look = {"color": colour, "hatch": hatch, "edgecolor": "w", "label": label}
        bars = right.bar(at + 0.35 * (k - 0.5), [r[name] for r in loops], 0.35, **look)
        right.bar_label(bars, fmt="%.2f", fontsize=9)
    right.set_xticks(
        at, [row["policy"].replace("_", " ").replace("cop", "CoP") for row in loops]
    )
    right.set(ylabel="place error, mm", xlabel="policy")
    right.set_title("Closed loop on rigs that are not ours")
    right.set_ylim(0, 1.2 * max(row["place_p90_mm"] for row in loops))
    right.legend(ncols=2)
    figure.savefig(path, dpi=110)


PARTS = {"gap": gap, "places": places, "lambda": lambdas, "loop": loop}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    parser.add_argument("--only", choices=tuple(PARTS))
    options = parser.parse_args()
    from benchmarks.physics import environment

    path = options.out / "design.json"
    wanted = [options.only] if options.only else list(PARTS)
    rows = json.loads(path.read_text())["rows"] if options.only and path.exists() else []
    rows = [row for row in rows if row["kind"] not in wanted]
    sensor = tx.Sensor.grid(divisions=(32, 32), dtype=np.float64)
    for name in wanted:
        rows += PARTS[name](sensor)
    path.write_text(
        json.dumps({"environment": environment(), "rows": rows}, indent=1) + "\n"
    )
    if {"gap", "loop"} <= {row["kind"] for row in rows}:
        draw(rows, path.with_suffix(".png"))


if __name__ == "__main__":
    main()
