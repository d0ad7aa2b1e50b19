"""Measures changes of grounds and λ beside pyEIT and NumPy; many ground sets, rules for λ.

    python tests/benchmarks/reconstruction.py [--quick] [--out notebooks/results]

Writes reconstruction.json and reconstruction.png. Compile time apart.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import get_args

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

from benchmarks.physics import environment, quartiles, seconds  # noqa: E402

import tomojax as tx  # noqa: E402
from tomojax.kernels.inverse import (  # noqa: E402
    choose_lambda,
    lambda_grid,
    lambda_scores,
    LambdaRule,
    solve_reduced,
    Spectrum,
)
from tomojax.kernels.sheet import centroids  # noqa: E402

EIGHT = np.array([18, 19, 20, 26, 28, 34, 35, 36])


def relative(a, b) -> float | None:
    """None for NaN, which JSON does not have."""
    error = np.linalg.norm(np.asarray(a, float) - b) / np.linalg.norm(b)
    return float(error) if np.isfinite(error) else None


def change_beside_pyeit(jac: np.ndarray, quick: bool) -> dict:
    """New grounds (eight) and a new λ, then one frame; 3200 elements, 64 electrodes."""
    import references
    from pyeit.eit.jac import JAC
    from pyeit.eit.protocol import PyEITProtocol
    from pyeit.mesh import PyEITMesh

    from tomojax.kernels.sheet import nodes as mesh_nodes, triangles

    sensor = tx.Sensor.grid(divisions=(40, 40))
    nodes = np.asarray(mesh_nodes((40, 40), sensor.size), float)
    at = ((nodes[:, None] - np.asarray(sensor.electrode_xy)) ** 2).sum(-1).argmin(0)
    vertices = references.counterclockwise(nodes, triangles((40, 40)))
    mesh = PyEITMesh(node=nodes, element=vertices, perm=1e-4, el_pos=at)
    rng = np.random.default_rng(0)
    volts = jac[:, :, 1500]

    def protocol(grounds):
        pairs = np.array([[(g + 1) % 64, g] for g in grounds])
        reads = np.array([[[e, g] for e in range(64)] for g in grounds])
        return PyEITProtocol(pairs, reads, np.ones(64 * len(grounds), bool))

    solver = JAC(mesh, protocol(EIGHT))
    # Its Jacobian of all grounds, for changes that leave its FEM as it is.
    kept, _ = JAC(mesh, protocol(np.arange(64))).fwd.compute_jac()
    kept = kept.reshape(64, 64, -1)

    def pyeit_change() -> None:
        # pyEIT's setup takes its grounds from the constructor's protocol.
        solver.setup(p=0.5, lamb=float(rng.uniform(0.01, 0.1)), method="kotre")
        solver.solve(volts[EIGHT].ravel() + 1, volts[EIGHT].ravel(), normalize=False)

    def pyeit_h_only() -> None:
        grounds = rng.choice(64, 8, replace=False)
        rows, lam = kept[grounds].reshape(512, -1), float(rng.uniform(0.01, 0.1))
        solver.H = solver._compute_h(rows, 0.5, lam, "kotre")
        v = volts[grounds].ravel()
        solver.solve(v + 1, v, normalize=False)

    runs = {"pyEIT setup + solve": pyeit_change, "pyEIT, J kept, H + solve": pyeit_h_only}
    for dtype in (np.float64, np.float32):
        change = numpy_dual(jac.astype(dtype), volts.astype(dtype))

        def numpy_change(change=change) -> None:
            change(rng.choice(64, 8, replace=False), rng.uniform(5e3, 1e4))

        name = "NumPy, JJᵀ kept" + (", float32" if dtype == np.float32 else "")
        runs[name] = numpy_change
        exact = tx.reconstruct(jnp.asarray(jac), jnp.asarray(volts[EIGHT]), EIGHT, lam=7e3)
        error = relative(change(EIGHT, 7e3), np.asarray(exact.image))
        assert error is not None and error < (1e-2 if dtype == np.float32 else 1e-8), error
    compiled = jax.jit(lambda m, v, g, lam: tx.reconstruct(m, v[g], g, lam=lam).image)

    def eager(m, v, g, lam):
        return tx.reconstruct(m, v[jnp.asarray(g)], g, lam=lam).image

    whole, single = (jnp.asarray(jac, d) for d in (np.float64, np.float32))
    r192 = tx.paper.reduce_jacobian(whole, 192)
    for name, model, call in (
        ("compiled, r = 128", tx.paper.reduce_jacobian(whole, 128), compiled),
        ("compiled, r = 192", r192, compiled),
        ("compiled, r = 256", tx.paper.reduce_jacobian(whole), compiled),
        ("host checks too, r = 192", r192, eager),
        ("compiled, float32, r = 192", tx.paper.reduce_jacobian(single, 192), compiled),
        ("compiled, all columns", whole, compiled),
        ("compiled, float32, all columns", single, compiled),
    ):
        v = jnp.asarray(volts, np.float32 if "float32" in name else np.float64)

        def change(model=model, v=v, call=call) -> None:
            grounds = rng.choice(64, 8, replace=False)
            lam = v.dtype.type(rng.uniform(5e3, 1e4))
            jax.block_until_ready(call(model, v, grounds, lam))

        runs[f"tomojax, {name}"] = change
    # All but pyEIT: fifteen calls a turn. One would time the cache that others emptied.
    turns = 3 if quick else 7
    first = {name: seconds(run) for name, run in runs.items()}
    times: dict[str, list] = {name: [] for name in runs}
    for _ in range(turns):
        for name, run in runs.items():
            times[name] += [seconds(run) for _ in range(1 if "pyEIT" in name else 15)]
    result = {n: {"first_s": first[n], **quartiles(times[n])} for n in runs}
    return {"times": result, "ratios": ratios(result)}


def numpy_dual(jac: np.ndarray, volts: np.ndarray):
    """Eq. 3 of one frame by NumPy and SciPy, for any grounds and λ: Jᵀ(JJᵀ + λI)⁻¹V.

    JJᵀ of all grounds is there from before; a ground set is a submatrix of it.
    """
    channels = np.arange(64)
    rows = jac.reshape(-1, jac.shape[-1])
    gram = rows @ rows.T

    def change(grounds: np.ndarray, lam: float) -> np.ndarray:
        of_set = (64 * grounds[:, None] + channels).ravel()
        damped = gram[np.ix_(of_set, of_set)]
        damped.flat[:: len(damped) + 1] += lam
        factor = scipy.linalg.cho_factor(
            damped, lower=True, overwrite_a=True, check_finite=False
        )
        weights = scipy.linalg.cho_solve(factor, volts[grounds].ravel(), check_finite=False)
        # Slot by slot: J of the set is not copied.
        parts = zip(grounds, weights.reshape(-1, 64))
        return np.sum([w @ jac[ground] for ground, w in parts], axis=0)

    return change


def ratios(times: dict) -> dict:
    peers = {n: t["median_s"] for n, t in times.items() if not n.startswith("tomojax")}
    return {
        f"{peer} / {n}": s / t["median_s"]
        for peer, s in peers.items()
        for n, t in times.items()
        if n.startswith("tomojax")
    }


def many_sets(jac: np.ndarray, quick: bool) -> dict:
    """10 000 random sets of eight and 20 λ on one frame: one trace, one compiled call."""
    count, rank = 1000 if quick else 10_000, 128
    reduced = tx.paper.reduce_jacobian(jnp.asarray(jac), rank)
    rng = np.random.default_rng(0)
    sets = jnp.asarray(np.stack([rng.choice(64, 8, replace=False) for _ in range(count)]))
    lams = jnp.asarray(3.4e6 * np.logspace(-6, -1, 20))
    volts = jnp.asarray(jac[:, :, 1500])
    traces = 0

    @jax.jit
    def run(sets, lams, volts):
        nonlocal traces
        traces += 1

        def one(grounds):
            def at(lam):
                c = solve_reduced(reduced, grounds, volts[grounds], lam)
                return jnp.linalg.norm(c), jnp.isfinite(c).all()

            return jax.lax.map(at, lams)

        return jax.lax.map(one, sets)

    last = None

    def call() -> None:
        nonlocal last
        last = jax.block_until_ready(run(sets, lams, volts))

    first = seconds(call)
    times = [seconds(call) for _ in range(2)]
    each = count / float(np.median(times))
    return {
        "sets": count,
        "lams": 20,
        "rank": rank,
        "traces": traces,
        "first_s": first,
        "median_s": float(np.median(times)),
        "sets_per_s": each,
        "images_per_s": 20 * each,
        "all_finite": bool(last[1].all()),
    }


def rules(quick: bool) -> list[dict]:
    """Image error over the best λ's, for every rule, under three kinds of noise.

    Voltages from J on a finer mesh than the reconstruction's, one to three discs; five
    random ground sets; noise as a part of the largest voltage (of each, for gains).
    """
    coarse, fine = tx.Sensor.grid(divisions=(40, 40)), tx.Sensor.grid(divisions=(64, 64))
    places = [np.asarray(centroids(s.divisions, s.size)) for s in (coarse, fine)]
    rng = np.random.default_rng(0)
    names = get_args(LambdaRule)
    trials, per_set = (6, 3) if quick else (30, 6)
    errors: dict[tuple, dict[str, list]] = {}

    rule_of = jax.jit(
        lambda s, v, noise, name: choose_lambda(
            lambda_grid(s),
            lambda_scores(s, v, lambda_grid(s), name, noise),
        ),
        static_argnames="name",
    )
    for _ in range(trials // per_set):
        grounds = rng.choice(64, 8, replace=False)
        j, j_fine = (np.asarray(tx.jacobian(s, grounds)) for s in (coarse, fine))
        u, sigma, vt = np.linalg.svd(j.reshape(512, -1), full_matrices=False)
        spectrum = Spectrum(jnp.asarray(u.reshape(8, 64, -1)), jnp.asarray(sigma))
        lams = sigma[0] ** 2 * np.logspace(-11, 1, 97)
        for level in (1e-3, 5e-3, 2e-2):
            for kind in ("white", "gain", "common mode"):
                for _ in range(per_set):
                    truth, source = scene(rng, places)
                    exact = j_fine @ source * (40 / 64) ** 2
                    v = exact + level * NOISE[kind](rng, exact)
                    sd = jnp.asarray(np.sqrt(np.mean((v - exact) ** 2)))
                    beta = u.T @ v.ravel()

                    def error(lam, beta=beta, truth=truth, sigma=sigma, vt=vt):
                        image = (sigma / (sigma**2 + lam) * beta) @ vt
                        return np.linalg.norm(image - truth) / np.linalg.norm(truth)

                    best = min(error(lam) for lam in lams)
                    into = errors.setdefault((kind, level), {"best": []})
                    into["best"].append(best)
                    for name in names:
                        lam = float(rule_of(spectrum, jnp.asarray(v), sd, name))
                        into.setdefault(name, []).append(error(lam) / best)
    found = []
    for (kind, level), into in errors.items():
        for name in names:
            q = np.percentile(into[name], [25, 50, 75])
            found.append(
                {"noise": kind, "level": level, "rule": name, "trials": len(into[name])}
                | {"excess_q1": q[0], "excess_median": q[1], "excess_q3": q[2]}
                | {"best_error": float(np.median(into["best"]))}
            )
    for kind in NOISE:
        for name in names:
            pooled = np.concatenate([e[name] for (k, _), e in errors.items() if k == kind])
            found.append(
                {"noise": kind, "level": "all", "rule": name, "trials": len(pooled)}
                | {"excess_median": float(np.median(pooled))}
            )
            print(f"{kind:12s} {name:20s} {np.median(pooled):8.2f}")
    return found


NOISE = {
    "white": lambda rng, v: np.abs(v).max() * rng.standard_normal(v.shape),
    "gain": lambda rng, v: v * rng.standard_normal(64),
    "common mode": lambda rng, v: np.abs(v).max() * rng.standard_normal((8, 1)),
}


def scene(rng, places) -> list[np.ndarray]:
    discs = [
        (rng.uniform(0.02, 0.14, 2), rng.uniform(0.006, 0.015), rng.uniform(0.5, 1))
        for _ in range(rng.integers(1, 4))
    ]
    return [sum(a * (((p - c) ** 2).sum(1) < r * r) for c, r, a in discs) for p in places]


def draw(report: dict, path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import BLUE, GREY, plain, style

    figure = Figure(figsize=(16, 5.4), layout="constrained")
    low, last = figure.subplots(1, 2)
    times = report["change"]["times"]
    names = list(times)
    values = [1e3 * times[n]["median_s"] for n in names]
    colours = [BLUE if n.startswith("tomojax") else GREY for n in names]
    bars = low.barh(names, values, color=colours)
    low.bar_label(bars, [f"{value:.2g}" if value < 10 else f"{value:.0f}"
                         for value in values], padding=2, fontsize=9)  # fmt: skip
    low.set(xscale="log", xlabel="time, ms (median)")
    low.set_title("Eight new grounds, a new λ, one frame (peers grey)")
    low.invert_yaxis()
    low.margins(x=0.1)
    plain(low.xaxis)
    pooled = [r for r in report["rules"] if r["level"] == "all"]
    kinds = list(NOISE)
    rule_names = [r["rule"] for r in pooled if r["noise"] == kinds[0]]
    for i, kind in enumerate(kinds):
        y = np.arange(len(rule_names)) + 0.25 * (i - 1)
        values = [r["excess_median"] for r in pooled if r["noise"] == kind]
        look = {"color": style(i)["color"], "edgecolor": "w", "hatch": ("", "//", "..")[i]}
        last.barh(y, values, 0.25, label=f"{kind} noise", **look)
    last.set_yticks(np.arange(len(rule_names)), [n.replace("_", " ") for n in rule_names])
    last.axvline(1.5, color="k", lw=0.8, ls=":", label="1.5")
    last.set(xscale="log", xlabel="(image error)/(that of the best λ), median")
    last.set_title("Rules for λ: how near the best λ")
    last.invert_yaxis()
    last.legend(loc="upper right")
    plain(last.xaxis)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    parser.add_argument("--only", help="Run one part, and add it to the others' file.")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jac = np.asarray(tx.jacobian(tx.Sensor.grid(divisions=(40, 40))))
    path = arguments.out / "reconstruction.json"
    report = json.loads(path.read_text()) if arguments.only and path.is_file() else {}
    parts = {
        "change": lambda: change_beside_pyeit(jac, arguments.quick),
        "many_sets": lambda: many_sets(jac, arguments.quick),
        "rules": lambda: rules(arguments.quick),
    }
    for name in [arguments.only] if arguments.only else parts:
        report[name] = parts[name]()
    report["environment"] = environment()
    arguments.out.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(report, indent=1) + "\n")
    if set(parts) <= set(report):
        draw(report, arguments.out / "reconstruction.png")
    for name, row in report.get("change", {}).get("times", {}).items():
        print(f"{name:34s} {1e3 * row['median_s']:9.2f} ms  first {row['first_s']:.2f} s")
    print(report.get("change", {}).get("ratios"), report.get("many_sets"))


if __name__ == "__main__":
    main()
