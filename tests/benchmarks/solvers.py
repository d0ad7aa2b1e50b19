"""Solves Eq. 3 by every route: how right in float32, and what value and gradient cost.

    python tests/benchmarks/solvers.py [--quick] [--out notebooks/results]

Writes solvers.json and solvers.png. Compile time apart.
"""

import argparse
import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

from benchmarks.physics import environment, quartiles, seconds  # noqa: E402

import tomojax as tx  # noqa: E402
from tomojax.kernels.inverse import solve_reduced, tikhonov  # noqa: E402
from tomojax.kernels.sheet import centroids  # noqa: E402

EIGHT = np.array([18, 19, 20, 26, 28, 34, 35, 36])
DECADES = (-2, -4, -6, -8, -10)
ROUTES = ("cholesky", "double")

# Frames, electrodes along a side.
SIZES = ((4, 8), (64, 8), (12, 6))


def errors(jac: np.ndarray, quick: bool) -> list[dict[str, Any]]:
    """Relative error of each float32 route against float64 on the same float32 numbers."""
    k = jac.shape[-1]
    place = np.asarray(centroids((40, 40), jnp.array([0.16, 0.16])))
    image = np.exp(-((place - [0.094, 0.067]) ** 2).sum(1) / (2 * 0.01**2))
    noise = np.random.default_rng(0)
    found = []
    run = jax.jit(tikhonov, static_argnames="route")
    for name, grounds in (("8", EIGHT), ("64", np.arange(64))):
        if quick and name == "64":
            continue
        rows = jac[grounds].reshape(-1, k).astype(np.float32)
        wide = rows.astype(np.float64)
        w, q = np.linalg.eigh(wide.T @ wide)
        reduced = tx.paper.reduce_jacobian(jnp.asarray(jac[grounds], np.float32), 256)
        for data in ("smooth", "random"):
            v = wide @ image if data == "smooth" else noise.standard_normal(len(rows))
            v = v.astype(np.float32)
            for decade in DECADES:
                lam = np.float32(w[-1] * 10.0**decade)
                exact = q @ ((q.T @ (wide.T @ v)) / (np.maximum(w, 0) + float(lam)))
                row = {"grounds": name, "data": data, "lam_rel": 10.0**decade}
                for route in ROUTES:
                    with jax.enable_x64(False):
                        row[route] = relative(run(rows, v, lam, route=route), exact)
                slots = jnp.arange(len(grounds))
                c = solve_reduced(reduced, slots, v.reshape(-1, 64), lam)
                row["blocks, r = 256"] = relative(c @ reduced.basis, exact)
                found.append(row)
                print(
                    {a: f"{b:.1e}" if isinstance(b, float) else b for a, b in row.items()}
                )
    return found


def relative(a, b) -> float | None:
    """None for NaN, which JSON does not have."""
    error = np.linalg.norm(np.asarray(a, float) - b) / np.linalg.norm(b)
    return float(error) if np.isfinite(error) else None


def gradients(quick: bool) -> list[dict[str, Any]]:
    """Value and gradient of a loss of the images, in the slots' weights and ln λ.

    Frames of all slots, one set of weights and one λ; J reduced to 256 rows, as many users
    have it, and whole for the smaller sensor. Errors are beside the same loss in float64 on
    the same numbers.
    """
    found = []
    for frames, side in SIZES[-1:] if quick else SIZES:
        sensor = tx.Sensor.grid(side, side, divisions=(4 * side,) * 2, dtype=np.float64)
        jac = tx.jacobian(sensor)
        # What a float32 caller has, in both dtypes.
        forms = {"r = 256": np.asarray(tx.paper.reduce_jacobian(jac, 256).factors)}
        if side == 6:
            forms["all columns"] = np.asarray(jac)
        for form, maps in forms.items():
            problem = Problem(maps.astype(np.float32), frames, side)
            for dtype in ("float32", "float64"):
                told = {"frames": frames, "slots": side**2, "J": form, "dtype": dtype}
                found += [told | row for row in problem.rows(dtype, 3 if quick else 9)]
    return found


class Problem:
    """Images of some frames should be like what they are of."""

    def __init__(self, maps: np.ndarray, frames: int, side: int) -> None:
        rng = np.random.default_rng(frames)
        self.maps = maps
        wide = maps.astype(float)
        flat = wide.reshape(-1, wide.shape[-1])
        self.largest = np.linalg.norm(flat, 2) ** 2
        self.targets = rng.normal(size=(frames, maps.shape[-1])).astype(np.float32)
        volts = np.einsum("lmk,fk->flm", wide, self.targets)
        noise = 1e-3 * np.abs(volts).max() * rng.normal(size=volts.shape)
        self.volts = (volts + noise).astype(np.float32)
        self.weights = rng.uniform(0.2, 1, side**2).astype(np.float32)

    def run(self, route: str, dtype: str) -> Callable[[int], Any]:
        """From λ's decade to the loss and its gradient, compiled once."""
        arrays = (self.maps, self.volts, self.targets, self.weights)
        maps, volts, targets, weights = (jnp.asarray(a, dtype) for a in arrays)
        rows = maps.reshape(-1, maps.shape[-1])

        @partial(jax.value_and_grad, argnums=(0, 1))
        def loss(weights, log_lam):
            w = jnp.repeat(weights, maps.shape[1])
            lam = jnp.exp(log_lam)
            solve = lambda v: tikhonov(rows, v.ravel(), lam, w, route)  # noqa: E731
            return jnp.mean((jax.vmap(solve)(volts) - targets) ** 2)

        compiled = jax.jit(loss)

        def at(decade: int):
            log_lam = jnp.asarray(np.log(self.largest * 10.0**decade), dtype)
            return jax.block_until_ready(compiled(weights, log_lam))

        return at

    def rows(self, dtype: str, turns: int) -> list[dict[str, Any]]:
        with jax.enable_x64(True):
            exact = self.run("cholesky", "float64")
            best = {decade: jax.device_get(exact(decade)) for decade in DECADES}
        made = []
        with jax.enable_x64(dtype == "float64"):
            runs = {route: self.run(route, dtype) for route in ROUTES}
            for route, run in runs.items():
                row = {"route": route, "first_s": seconds(partial(run, DECADES[0]))}
                for decade in DECADES:
                    value, (slope, by_lam) = jax.device_get(run(decade))
                    right, (right_slope, right_by_lam) = best[decade]
                    row[f"value {decade}"] = relative(value, right)
                    row[f"weights {decade}"] = relative(slope, right_slope)
                    row[f"lam {decade}"] = relative(by_lam, right_by_lam)
                made.append(row)
            times: dict[str, list[float]] = {route: [] for route in ROUTES}
            for _ in range(turns):
                for route, run in runs.items():
                    times[route].append(seconds(partial(run, DECADES[1])))
        for row in made:
            row |= quartiles(times[row["route"]])
            row["beside_cholesky"] = row["median_s"] / np.median(times["cholesky"])
            print({k: f"{v:.2g}" if isinstance(v, float) else v for k, v in row.items()})
        return made


def draw(report: dict[str, Any], path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import plain, style

    figure = Figure(figsize=(16, 10), layout="constrained")
    figure.suptitle("Eq. 3 by each route: how right in float32, and how fast")
    (left, right), (low, last) = figure.subplots(2, 2)
    routes = (*ROUTES, "blocks, r = 256")
    # Routes that are as right lie on each other: the first ones' lines are wide.
    looks = {
        route: {"color": style(k)["color"], "marker": style(k)["marker"],
                "markersize": 9 - 1.2 * k, "lw": 3 - 0.5 * k}
        for k, route in enumerate(routes)
    }  # fmt: skip
    for axes, grounds in ((left, "8"), (right, "64")):
        for route, look in looks.items():
            for data, line in (("smooth", "-"), ("random", "--")):
                mine = [
                    r
                    for r in report["errors"]
                    if (r["grounds"], r["data"]) == (grounds, data) and r[route] is not None
                ]
                x, y = [r["lam_rel"] for r in mine], [r[route] for r in mine]
                axes.loglog(x, y, ls=line, **look, label=f"{route}, {data}")
        axes.axhline(1e-4, color="k", lw=0.8, ls=":")
        axes.set(xlabel="λ/σ₁²", ylabel="relative error of an image", ylim=(1e-9, 1e3))
        axes.set_title(f"Image in float32, {grounds} grounds (no point: NaN)")
        axes.grid(alpha=0.3)
    left.legend(fontsize=8, ncols=2, title="route, voltages", loc="upper right")
    rows = report["gradients"]
    names = [f"{r['frames']} frames of {r['slots']}, {r['J']}, {r['dtype']}" for r in rows]
    kinds = list(dict.fromkeys(names))
    for i, route in enumerate(ROUTES):
        at = [kinds.index(n) + 0.2 * (i - 0.5) for n in names[i :: len(ROUTES)]]
        values = [1e3 * r["median_s"] for r in rows if r["route"] == route]
        look = {"color": looks[route]["color"], "edgecolor": "w", "label": route}
        low.barh(at, values, 0.2, hatch=("", "//")[i], **look)
    low.set_yticks(range(len(kinds)), kinds)
    low.set(xscale="log", xlabel="time of a call, ms (median)")
    low.set_title("Value and gradient in weights and λ")
    low.invert_yaxis()
    low.legend()
    plain(low.xaxis)
    for route in ROUTES:
        mine = [r for r in rows if r["route"] == route and r["dtype"] == "float32"][0]
        for what, line in (("value", "-"), ("weights", "--"), ("lam", ":")):
            points = [(10.0**d, mine[f"{what} {d}"]) for d in DECADES]
            points = [p for p in points if p[1] is not None]
            words = {"value": "value", "weights": "gradient, weights", "lam": "gradient, λ"}
            label = f"{route}, {words[what]}"
            x, y = [p[0] for p in points], [p[1] for p in points]
            last.loglog(x, y, ls=line, **looks[route], label=label)
    last.set(xlabel="λ/σ₁²", ylabel="relative error", ylim=(1e-9, 1e3))
    last.set_title(f"Value and gradients: {names[0]}")
    last.legend(fontsize=8, ncols=2, loc="upper right")
    last.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    parser.add_argument("--only", help="Run one part, and add it to the others' file.")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    path = arguments.out / "solvers.json"
    report = json.loads(path.read_text()) if arguments.only and path.is_file() else {}

    def of_errors() -> list[dict[str, Any]]:
        jac = np.asarray(tx.jacobian(tx.Sensor.grid(divisions=(40, 40))))
        return errors(jac, arguments.quick)

    parts = {"errors": of_errors, "gradients": lambda: gradients(arguments.quick)}
    for name in [arguments.only] if arguments.only else parts:
        report[name] = parts[name]()
    report["environment"] = environment()
    arguments.out.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(report, indent=1) + "\n")
    if set(parts) <= set(report):
        draw(report, arguments.out / "solvers.png")


if __name__ == "__main__":
    main()
