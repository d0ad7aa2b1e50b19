"""Places unlabelled presses, and learns from them where readings come from.

The sheet's physics places each press roughly. A smooth map from places to readings is then
fitted to half of the presses and places the other half, in rounds, while the map's length
shrinks: long at first, so that a map only follows what all presses agree on. Presses whose
place is known stay where they are.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float, Integer

from tomojax._programs import kept
from tomojax.kernels.inverse import (
    place_scores,
    shrunk_covariance,
    smooth_map,
    SmoothMap,
)

# Errors of readings are the map's too, and are alike in frames that lie side by side; their
# covariance comes from few frames. Log-probabilities therefore count for a part.
_TRUST = 0.2

_ROUNDS = 32
_LONGEST, _SHORTEST = 3.0, 0.2  # of a map's length, in widths of the sheet
_PHYSICS_ROUNDS = 8


class Posterior(NamedTuple):
    """Places by the candidates' probabilities."""

    xy: Float[Array, "n 2"]
    covariance: Float[Array, "n 2 2"]
    chi2: Float[Array, " n"]  # of a reading, at the likeliest candidate
    best: Integer[Array, " n"]  # that candidate's number

    @property
    def deviation(self) -> Float[np.ndarray, " n"]:
        """Returns the deviation along one axis, m."""
        return np.sqrt(np.trace(self.covariance, axis1=1, axis2=2) / 2)


class Learned(NamedTuple):
    """A map at the candidates, and what readings scatter about it."""

    map: SmoothMap
    whitener: Float[Array, "K K"]


@jax.jit  # as one program to compile
def whitener_of(covariance: Float[Array, "K K"]) -> Float[Array, "K K"]:
    """Returns W with WᵀW = Σ⁻¹."""
    low = jnp.linalg.cholesky(covariance)
    return solve_triangular(low, jnp.eye(len(low), dtype=low.dtype), lower=True)


@kept
def learned(
    places: Float[Array, "N 2"],
    readings: Float[Array, "N K"],
    deviation: Float[Array, " N"],
    at: Float[Array, "G 2"],
    length: Float[Array, ""],
) -> Learned:
    """Fits maps, and the covariance of what they leave."""
    found = smooth_map(places, readings, deviation, at, length)
    return Learned(found, whitener_of(shrunk_covariance(found.left)))


@kept
def place(
    readings: Float[Array, "n K"],
    mapped: Float[Array, "G K"],
    spread: Float[Array, " G"],
    whitener: Float[Array, "K K"],
    at: Float[Array, "G 2"],
) -> Posterior:
    """Places frames by a map."""
    scores, chi2 = place_scores(readings, mapped, spread, whitener)
    return posterior(scores, chi2 / readings.shape[1], at)


@kept
def learned_moves(
    readings: Float[Array, "M K"], away: Float[Array, "M 2"], reach: Float[Array, ""]
) -> SmoothMap:
    """Fits a smooth map from readings to how far places were found from the true ones."""
    certain = jnp.zeros(len(readings), readings.dtype)
    return smooth_map(readings, away, certain, readings[:1], reach)


def posterior(
    scores: Float[Array, "n G"], chi2: Float[Array, "n G"], at: Float[Array, "G 2"]
) -> Posterior:
    """Returns places by log-probabilities, which count for a part."""
    scores = _TRUST * (scores - scores.max(1, keepdims=True))
    weights = jnp.exp(scores) / jnp.exp(scores).sum(1, keepdims=True)
    xy = weights @ at
    away = at - xy[:, None]
    covariance = jnp.einsum("ng,ngi,ngj->nij", weights, away, away)
    best = jnp.argmax(scores, 1)
    least = jnp.take_along_axis(chi2, best[:, None], 1)[:, 0]
    return Posterior(xy, covariance, least, best)


@kept
def place_by_physics(
    readings: Float[Array, "n K"], columns: Float[Array, "G K"], at: Float[Array, "G 2"]
) -> tuple[Posterior, Float[Array, "K K"]]:
    """Places frames by one local change of any strength above 0; learns errors on the way.

    Frames count alike, by their shapes: weak presses tell of errors as strong ones do.
    """
    unit = readings / jnp.linalg.norm(readings, axis=1, keepdims=True)
    whitener = jnp.eye(unit.shape[1], dtype=unit.dtype)
    found = by_columns(unit, columns, whitener, at)[0]
    for _ in range(_PHYSICS_ROUNDS):
        found, strength = by_columns(unit, columns, whitener, at)
        whitener = whitener_of(shrunk_covariance(unit - strength * columns[found.best]))
    return found, whitener


@kept
def by_columns(
    unit: Float[Array, "n K"],
    columns: Float[Array, "G K"],
    whitener: Float[Array, "K K"],
    at: Float[Array, "G 2"],
) -> tuple[Posterior, Float[Array, "n 1"]]:
    white, maps = unit @ whitener.T, columns @ whitener.T
    size = jnp.sum(maps**2, 1)
    strength = jnp.maximum(white @ maps.T, 0) / size
    gain = strength**2 * size
    left = jnp.sum(white**2, 1)[:, None] - gain
    found = posterior(gain / 2, left / unit.shape[1], at)
    return found, jnp.take_along_axis(strength, found.best[:, None], 1)


def learn_places(
    readings: Float[np.ndarray, "N K"],
    places: Float[np.ndarray, "N 2"],
    deviation: Float[np.ndarray, " N"],
    at: Float[np.ndarray, "G 2"],
    width: float,
    progress: Callable[[str], None] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Moves places whose deviation is above 0 to where maps of other frames put them.

    Returns places, and deviations along an axis.
    """
    random = np.random.default_rng(0)
    free, fixed = np.flatnonzero(deviation > 0), np.flatnonzero(deviation == 0)
    places, deviation = np.array(places), np.array(deviation)
    if len(free) < 2:
        return places, deviation
    lengths = width * np.geomspace(_LONGEST, _SHORTEST, _ROUNDS).astype(readings.dtype)
    for step, length in enumerate(lengths):
        if progress is not None:
            progress(f"round {step + 1} of {_ROUNDS}")
        moved, wide = np.array(places), np.array(deviation)
        one, other = np.array_split(random.permutation(free), 2)
        for half, rest in ((one, other), (other, one)):
            of = np.concatenate([fixed, rest])
            by = learned(places[of], readings[of], deviation[of], at, length)
            found = place(readings[half], by.map.readings, by.map.spread, by.whitener, at)
            moved[half], wide[half] = found.xy, found.deviation
        places, deviation = moved, wide
    return places, deviation
