"""Studies numbers for `tomojax stability`: float32, solvers, gradients.

The sensor is small, so that thousands of points take minutes.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from tomojax.kernels.inverse import tikhonov
from tomojax.kernels.sheet import centroids, Resistances, slot_jacobian
from tomojax.sensor import resistances, Sensor, voltages

# λ/σ₁² of the solvers; routes of `tikhonov`.
RELATIVE = tuple(10.0 ** -np.arange(2, 13))
ROUTES = ("cholesky", "double")

_TOGETHER = 100  # points of a compiled call

# Of how many points derivatives are compared with differences; steps of those.
_COMPARED, _STEP = 50, 1e-4


def small(dtype: Any) -> Sensor:
    """Returns a sensor of 4 × 4 electrodes on 16 × 16 cells."""
    return Sensor.grid(4, 4, 0.02, 0.01, divisions=(16, 16), dtype=dtype)


def solver_rows(seed: int = 0) -> list[dict[str, Any]]:
    """Compares an image of eight grounds in float32 with float64, along λ.

    Needs float64 to be enabled: `jax.enable_x64`.
    """
    sensor = small(np.float64)
    table = resistances(sensor)
    grounds = jnp.arange(0, 16, 2)
    jac = _jacobian(sensor, table, grounds)
    rng = np.random.default_rng(seed)
    volts = jac @ np.maximum(rng.normal(size=jac.shape[1]), 0)
    volts = volts + 1e-3 * np.abs(volts).max() * rng.normal(size=len(volts))
    largest = np.linalg.norm(jac, 2) ** 2
    rows = []
    for relative in RELATIVE:
        lam = relative * largest
        exact = jac.T @ np.linalg.solve(jac @ jac.T + lam * np.eye(len(jac)), volts)
        for route in ROUTES:
            found = tikhonov(
                jnp.asarray(jac, jnp.float32),
                jnp.asarray(volts, jnp.float32),
                jnp.asarray(lam, jnp.float32),
                route=route,
            )
            error = np.linalg.norm(np.asarray(found, float) - exact) / np.linalg.norm(exact)
            told = {"solver": route, "relative_lam": float(relative)}
            flagged = not np.isfinite(error)
            rows.append(told | {"error": None if flagged else float(error)})
    return rows


def _jacobian(sensor: Sensor, table: Resistances, grounds: Array) -> np.ndarray:
    slots = sensor.slots(table.electrodes)
    jac = slot_jacobian(table, slots, grounds, jnp.zeros((), sensor.dtype))
    return np.asarray(jac).reshape(-1, jac.shape[-1])


# What a point of the gradients' study is made of, and the range of each.
RANGES = {
    "x": (0.01, 0.07),
    "y": (0.01, 0.07),
    "log_conductance": (np.log(1e-6), np.log(1e-2)),
    "log_lam": (np.log(1e-6), np.log(1e-1)),
    "log_sheet": (np.log(1e3), np.log(1e5)),
    "log_ground": (np.log(0.1), np.log(100.0)),
    "shift": (-1e-3, 1e-3),
    "weights": (0.0, 1.0),
}
_SLOTS = 4


def random_points(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Draws points anywhere in the ranges."""
    rng = np.random.default_rng(seed)
    return {
        name: rng.uniform(low, high, (count, _SLOTS) if name == "weights" else (count,))
        for name, (low, high) in RANGES.items()
    }


def symmetric_points(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Draws points on the sheet's centre, its axes, diagonals and electrodes.

    Their weights are equal.
    """
    points = random_points(count, seed)
    middle, turn = 0.04, np.arange(count) % 5
    x, y = points["x"], points["y"]
    on = np.array([0.01, 0.03, 0.05, 0.07])[np.arange(count) % 4]
    points["x"] = np.select([turn == 0, turn == 1, turn == 4], [middle, middle, on], x)
    points["y"] = np.select([turn == 0, turn == 2, turn == 3, turn == 4],
                            [middle, middle, points["x"], on], y)  # fmt: skip
    points["shift"] = np.zeros(count)
    levels = np.array([0.0, 0.5, 1.0])[np.arange(count) % 3]
    points["weights"] = np.repeat(levels[:, None], _SLOTS, 1)
    return points


def pipeline(
    sensor: Sensor, centres: Float[Array, "K 2"], point: dict[str, Array]
) -> Float[Array, ""]:
    """Returns how wrong an image is, from sheet, electrodes, contact, weights and λ.

    The error adds two terms, in units of the sheet's side squared. One is the squared
    distance of the image's centre of gravity from the contact. The other is the image's
    second moment. The pipeline is sensor → resistances → voltages → J_s → Eq. 3.
    """
    side = sensor.size[0]
    xy = sensor.electrode_xy.at[5, 0].add(point["shift"])
    changed = replace(
        sensor,
        electrode_xy=xy,
        sheet_resistance=jnp.exp(point["log_sheet"]),
        ground_resistance=jnp.exp(point["log_ground"]),
    )
    table = resistances(changed)
    place = jnp.stack([point["x"], point["y"]])
    near = jnp.exp(-((centres - place) ** 2).sum(1) / (2 * (0.06 * side) ** 2))
    g = jnp.exp(point["log_conductance"]) * near / near.sum()
    grounds = jnp.array([0, 5, 10, 15])
    v = voltages(changed, g)[grounds]
    slots = changed.slots(table.electrodes)
    jac = slot_jacobian(table, slots, grounds, jnp.zeros((), sensor.dtype))
    rows = jac.reshape(-1, jac.shape[-1])
    weights = jnp.repeat(point["weights"], sensor.electrode_count)
    # Of the scale of J, whatever the weights.
    lam = jnp.exp(point["log_lam"]) * (rows**2).sum()
    phi = tikhonov(rows, v.ravel(), lam, weights)
    mass = phi**2 + 1e-30
    share = mass / mass.sum()
    middle = (share[:, None] * centres).sum(0)
    spread = (share * ((centres - middle) ** 2).sum(1)).sum()
    return (((middle - place) ** 2).sum() + spread) / side**2


def gradient_rows(
    count: int = 10_000, symmetric: int = 100, seed: int = 0
) -> list[dict[str, Any]]:
    """Compares the pipeline's gradient with differences, at random and symmetric points.

    Rows tell whether gradients are finite, and their largest difference. Needs float64 to
    be enabled.
    """
    sensor = small(np.float64)
    value = partial(pipeline, sensor, centroids(sensor.divisions, sensor.size))
    # One after another: `vmap` takes 1.5 times as long on the CPU, to compile too.
    both = jax.jit(partial(lax.map, jax.value_and_grad(value)))
    plain = jax.jit(partial(lax.map, value))
    rows = []
    for kind, points in (
        ("random", random_points(count, seed)),
        ("symmetric", symmetric_points(symmetric, seed)),
    ):
        n, finite, parts = len(points["x"]), 0, []
        for start in range(0, n, _TOGETHER):
            # The last call is filled up, so that one is compiled.
            at = np.arange(start, start + _TOGETHER) % n
            some = {k: jnp.asarray(v[at]) for k, v in points.items()}
            values, gradients = jax.tree.map(np.asarray, both(some))
            fine = np.isfinite(values)
            for g in gradients.values():
                fine &= np.isfinite(g).reshape(len(g), -1).all(1)
            finite += int(fine[: n - start].sum())
            parts.append(gradients)
        first = {k: v[:_COMPARED] for k, v in parts[0].items()}
        worst = _against_differences(plain, points, first)
        told = {"points": kind, "count": n, "finite": finite}
        rows.append(told | {"largest_difference": worst})
    return rows


def _against_differences(plain: Any, points: dict, gradients: dict) -> dict[str, float]:
    """Returns each argument's largest difference, over its largest derivative.

    Differences are central, of fourth order.
    """
    worst = {}
    some = {k: v[: len(gradients["x"])] for k, v in points.items()}
    n = len(some["x"])
    fill = np.resize(np.arange(n), _TOGETHER)
    for name, (low, high) in RANGES.items():
        step = _STEP * (high - low)

        def at(k: int, name=name, step=step) -> np.ndarray:
            moved = some[name] + k * step
            changed = {**some, name: moved}
            return np.asarray(plain({k: jnp.asarray(v[fill]) for k, v in changed.items()}))[
                :n
            ]

        numeric = (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * step)
        own = gradients[name]
        own = own.sum(-1) if own.ndim > 1 else own
        # Where a weight is 0 there is nothing below.
        inside = np.isfinite(numeric)
        scale = np.abs(own[inside]).max() + 1e-30
        worst[name] = float(np.abs(own - numeric)[inside].max() / scale)
    return worst
