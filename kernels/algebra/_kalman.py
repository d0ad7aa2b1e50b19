"""Filters a value that stands still or changes: Kalman's filter that restarts when it must.

The state does not move (or drifts, as a random walk): n measurements determine the state √n
times better than one. A test on the mean innovations over the last 1, 4, 16 and 64
measurements shows whether the state moved. If one mean cannot be noise, the state restarts
from that mean. So the filter follows a sudden step within one measurement, and a slow
change once the change shows.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from tomojax.kernels.algebra._blocktri import matmul, solve_positive
from tomojax.kernels.algebra._where_needed import tree_where

# Measurements over which innovations are averaged, and the χ² that none reaches by noise
# (of two values: once in 300 000).
HORIZONS = (1, 4, 16, 64)
_GATE = 25.0


class Level(NamedTuple):
    """The state that the filter knows of d values."""

    mean: Float[Array, " d"]
    covariance: Float[Array, "d d"]
    lags: Float[Array, "H d"]  # mean innovations over each horizon
    known: Float[Array, ""]  # measurements since it began


def no_level(size: int, dtype) -> Level:
    """Returns the state before any measurement of `size` values."""
    zero = jnp.zeros(size, dtype)
    lags = jnp.zeros((len(HORIZONS), size), dtype)
    return Level(zero, jnp.zeros((size, size), dtype), lags, jnp.zeros((), dtype))


def level_update(
    level: Level,
    measured: Float[Array, " d"],
    noise: Float[Array, "d d"],
    there: Bool[Array, ""],
    drift: Float[Array, "d d"],
) -> Level:
    """Updates the state by one measurement; where not `there`, only adds the drift.

    **Arguments:** `noise`: the measurement's covariance; `drift`: the growth of the state's
    covariance per measurement. The new covariance is Joseph's form, (I − K)P(I − K)ᵀ +
    KRKᵀ.
    """
    # What is not there must not spoil what is known: NaN times 0 is NaN.
    eye = jnp.eye(len(measured), dtype=measured.dtype)
    measured = jnp.where(there, measured, level.mean)
    noise = jnp.where(there, noise, eye)
    predicted = level.covariance + drift
    innovation = measured - level.mean
    count = level.known + 1
    # Running means until a horizon is full, then leaky ones of the same variance.
    rate = jnp.maximum(2 / (jnp.asarray(HORIZONS, eye.dtype) + 1), 1 / count)[:, None]
    lags = level.lags + rate * (innovation - level.lags)
    part = (rate / (2 - rate))[..., None]
    spread = part * noise
    tested = solve_positive(spread + predicted, lags[..., None])[..., 0]
    unlikely = (lags * tested).sum(-1)
    which = jnp.argmax(unlikely)
    first = level.known == 0
    anew = first | (unlikely[which] > _GATE)
    gain = solve_positive(predicted + noise, predicted).T
    left = eye - gain
    joseph = matmul(matmul(left, predicted), left.T) + matmul(matmul(gain, noise), gain.T)
    begun = jnp.where(first, measured, level.mean + lags[which])
    begun_spread = jnp.where(first, noise, spread[which])
    new = Level(
        jnp.where(anew, begun, level.mean + matmul(gain, innovation)),
        jnp.where(anew, begun_spread, (joseph + joseph.T) / 2),
        jnp.where(anew, 0, lags),
        jnp.where(anew, jnp.where(first, 1, 1 / part[which, 0, 0]), count),
    )
    still = level._replace(covariance=jnp.where(first, level.covariance, predicted))
    return tree_where(there, new, still)


def _likelihood(level: Level, measured: Array, noise: Array, drift: Array) -> Array:
    """Computes ln of a measurement's likelihood; changes and firsts count as the gate."""
    spread = level.covariance + drift + noise
    off = measured - level.mean
    unlikely = jnp.vdot(off, solve_positive(spread, off[:, None])[:, 0])
    # Of one or two values.
    area = spread[0, 0] if len(off) == 1 else jnp.linalg.det(spread)
    first = level.known == 0
    return -jnp.where(first, _GATE, jnp.minimum(unlikely, _GATE) + jnp.log(area)) / 2


class Measured(NamedTuple):
    """Measurements of d values, n in a row."""

    value: Float[Array, "n d"]
    noise: Float[Array, "n d d"]
    there: Bool[Array, " n"]
    begins: Bool[Array, " n"]  # whether all before is of something else


class Levels(NamedTuple):
    """The states after each of n measurements."""

    mean: Float[Array, "n d"]
    covariance: Float[Array, "n d d"]
    likelihood: Float[Array, " n"]  # ln, of each measurement by those before it


def filter_levels(measured: Measured, drift: Float[Array, "d d"]) -> Levels:
    """Runs `level_update` over all measurements; forgets all at each of `begins`."""
    nothing = no_level(measured.value.shape[1], measured.value.dtype)

    def step(level: Level, one: Measured) -> tuple[Level, Levels]:
        z, r, here, begin = one
        level = tree_where(begin, nothing, level)
        likely = jnp.where(here, _likelihood(level, z, r, drift), 0)
        level = level_update(level, z, r, here, drift)
        return level, Levels(level.mean, level.covariance, likely)

    return lax.scan(step, nothing, measured)[1]


def smooth_levels(measured: Measured, drift: Float[Array, "d d"]) -> Levels:
    """Estimates the state at each measurement from the measurements before and after.

    The function adds the filter's forward and backward runs as independent, and subtracts
    the measurement that both runs contain. Runs that disagree show a change of the state
    nearby. Then the run nearer to the measurement counts: the other run comes from beyond
    the change.
    """
    forward = filter_levels(measured, drift)
    # Backwards a stretch begins where the next one starts.
    ends = jnp.concatenate([measured.begins[1:], jnp.ones(1, bool)])
    turned = Measured(*(a[::-1] for a in measured._replace(begins=ends)))
    backward = Levels(*(a[::-1] for a in filter_levels(turned, drift)))

    def one(ahead_of: Levels, behind_it: Levels, now: Measured) -> Levels:
        (fm, fc, likely), (bm, bc, _), (z, r, here, _) = ahead_of, behind_it, now
        apart = fm - bm
        unlikely = jnp.vdot(apart, solve_positive(fc + bc, apart[:, None])[:, 0])
        unit = jnp.eye(len(z), dtype=z.dtype)
        r = jnp.where(here, r, unit)
        ahead, behind, own = (solve_positive(c, unit) for c in (fc, bc, r))
        # The measurement counts once, and no more than what it is a part of.
        shared = jnp.where(here, own, 0)
        weight = ahead + behind - shared
        total = matmul(ahead, fm) + matmul(behind, bm) - jnp.where(here, own @ z, 0)
        spread = solve_positive(weight, unit)
        both = matmul(spread, total)

        def far(mean: Array, covariance: Array) -> Array:
            off = jnp.where(here, z - mean, 0)
            return jnp.vdot(off, solve_positive(covariance + r, off[:, None])[:, 0])

        nearer = far(fm, fc) <= far(bm, bc)
        mean, covariance = jnp.where(nearer, fm, bm), jnp.where(nearer, fc, bc)
        sure = jnp.isfinite(both).all() & (jnp.diagonal(spread) > 0).all()
        agree = (unlikely < _GATE / 2) & sure
        mean = jnp.where(agree, both, mean)
        return Levels(mean, jnp.where(agree, spread, covariance), likely)

    return jax.vmap(one)(forward, backward, measured)
