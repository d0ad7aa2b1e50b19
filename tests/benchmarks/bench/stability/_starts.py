"""Studies assumptions and starts for `tomojax stability`: ρ of J(ρ), and optimisers' λ.

The sensor is small, and a resistor network makes the voltages.
"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from bench.network import Network
from bench.stability._numbers import small
from tomojax.design import descend_sets, design_places, ImageError, simulate_scenes, tune
from tomojax.kernels.sheet import centroids
from tomojax.methods import Linear
from tomojax.paper import reconstruct
from tomojax.sensor import jacobian

# ρ that J(ρ) is told, in sheet resistances; the contacts' own is about one.
RESISTANCES = (0.0, 1e-3, 1e-2, 0.1, 1.0, 10.0, 1e2, 1e4, 1e8, float("inf"))

# λ that an optimiser starts from, of the largest singular value squared.
STARTS = tuple(10.0**k for k in (-14, -11, -8, -5, -2, 1, 4, 7))

_CONTACTS, _RADIUS, _CONDUCTANCE, _LAM = 12, 0.004, 1e-4, 1e-3
_SLOTS = 3


def resistance_rows(dtype: Any = np.float32, seed: int = 0) -> list[dict[str, Any]]:
    """Returns how far off Eq. 3 with J(ρ) finds contacts, for every ρ it may be told."""
    sensor, rng = small(dtype), np.random.default_rng(seed)
    rig = Network(sensor, rng)
    places = rng.uniform(0.02, 0.06, (_CONTACTS, 2))
    made = [rig.scene((rig.disc(p, _RADIUS), _CONDUCTANCE)) for p in places]
    volts = rig.measure(np.array([v for v, _ in made])).astype(dtype)
    truth = np.array([centres[0][0] for _, centres in made])
    rows = []
    for relative in RESISTANCES:
        rho = relative * float(sensor.sheet_resistance)
        shown = relative if np.isfinite(relative) else None
        told = {"dtype": np.dtype(dtype).name, "resistance": shown, "raised": None}
        try:
            jac = np.asarray(jacobian(sensor, None, rho))
            largest = np.linalg.norm(jac.reshape(-1, jac.shape[-1]).astype(float), 2) ** 2
            found = reconstruct(jac, volts, lam=float(_LAM * largest))
        except ValueError as error:
            rows.append(told | {"raised": str(error), "place_median_mm": None, "silent": 0})
            continue
        away = _away(
            np.asarray(found.image, float),
            np.asarray(centroids(sensor.divisions, sensor.size)),
            truth,
        )
        silent = ~np.isfinite(away) & (np.asarray(found.flags) == 0)
        median = 1e3 * float(np.median(away)) if np.isfinite(away).all() else None
        rows.append(told | {"place_median_mm": median, "silent": int(silent.sum())})
    return rows


def _away(images: np.ndarray, centres: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Returns how far the middle above half an image's highest is from the truth, m."""
    part = np.maximum(images - 0.5 * images.max(1, keepdims=True), 0)
    middle = (part @ centres) / part.sum(1, keepdims=True)
    return np.hypot(*(middle - truth).T)


def start_rows(starts: tuple[float, ...] = STARTS, seed: int = 0) -> list[dict[str, Any]]:
    """Returns where optimisers end in float32 from each starting λ, beside the best end.

    `tune` finds λ of every slot, `descend_sets` three slots and λ.
    """
    sensor = small(np.float32)
    method = Linear.of(sensor, (16, 16))
    scenes = simulate_scenes(sensor, design_places(sensor, count=16), seed=seed)
    objective = ImageError.of(method, scenes, _RADIUS)
    every = jnp.ones(objective.slots, objective.dtype)
    found: dict[str, list[float]] = {"tune": [], "descend_sets": []}
    for start in starts:
        log_lam = jnp.log(jnp.asarray(start * method.scale(), objective.dtype))
        begun = replace(objective, log_lam=log_lam)
        found["tune"].append(float(tune(begun, every).value))
        drawn = descend_sets(begun, _SLOTS)
        found["descend_sets"].append(float(drawn.objective.value(drawn.weights)))
    return [
        {
            "optimiser": name,
            "start": start,
            "excess": value / float(np.nanmin(values)) - 1 if np.isfinite(value) else None,
        }
        for name, values in found.items()
        for start, value in zip(starts, values)
    ]
