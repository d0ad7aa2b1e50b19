"""A value that stands still or changes: Kalman's filter that begins anew when it must.

The state is one that does not move (or drifts, as a random walk): of n measurements it
knows √n times more than of one. Whether it did move is asked of the mean innovations over
the last 1, 4, 16 and 64 measurements: where one of them cannot be noise, the state begins
anew from what these say. So a step is followed within the measurement that shows it, and
what is slow is followed as soon as it shows.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from tomojax.kernels.algebra._blocktri import matmul
from tomojax.kernels.algebra._least_squares import solve_positive

# Measurements over which innovations are averaged, and the χ² that none reaches by noise
# (of two values: once in 300 000).
HORIZONS = (1, 4, 16, 64)
_GATE = 25.0


class Level(NamedTuple):
    """What is known of d values."""

    mean: Float[Array, " d"]
    covariance: Float[Array, "d d"]
    lags: Float[Array, "H d"]  # mean innovations over each horizon
    known: Float[Array, ""]  # measurements since it began


def no_level(size: int, dtype) -> Level:
    """Nothing known of `size` values."""
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
    """One measurement later; without one (`there` False) only the drift is added.

    **Arguments:** `noise` the measurement's covariance; `drift` what the state's own
    grows by. The covariance is Joseph's form, (I − K)P(I − K)ᵀ + KRKᵀ.
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
    return jax.tree.map(lambda a, b: jnp.where(there, a, b), new, still)


def _likelihood(level: Level, measured: Array, noise: Array, drift: Array) -> Array:
    """ln of a measurement's; what is a change, or the first, is as unlikely as the gate."""
    spread = level.covariance + drift + noise
    off = measured - level.mean
    unlikely = jnp.vdot(off, solve_positive(spread, off[:, None])[:, 0])
    # Of one or two values.
    area = spread[0, 0] if len(off) == 1 else jnp.linalg.det(spread)
    first = level.known == 0
    return -jnp.where(first, _GATE, jnp.minimum(unlikely, _GATE) + jnp.log(area)) / 2


class Levels(NamedTuple):
    """After each of n measurements."""

    mean: Float[Array, "n d"]
    covariance: Float[Array, "n d d"]
    likelihood: Float[Array, " n"]  # ln, of each measurement by those before it


def filter_levels(
    measured: Float[Array, "n d"],
    noise: Float[Array, "n d d"],
    there: Bool[Array, " n"],
    begins: Bool[Array, " n"],
    drift: Float[Array, "d d"],
) -> Levels:
    """`level_update` from the first to the last; anew, with nothing known, at `begins`."""
    nothing = no_level(measured.shape[1], measured.dtype)

    def step(level: Level, one: tuple) -> tuple[Level, Levels]:
        z, r, here, begin = one
        level = jax.tree.map(lambda a, b: jnp.where(begin, a, b), nothing, level)
        likely = jnp.where(here, _likelihood(level, z, r, drift), 0)
        level = level_update(level, z, r, here, drift)
        return level, Levels(level.mean, level.covariance, likely)

    return lax.scan(step, nothing, (measured, noise, there, begins))[1]


def smooth_levels(
    measured: Float[Array, "n d"],
    noise: Float[Array, "n d d"],
    there: Bool[Array, " n"],
    begins: Bool[Array, " n"],
    drift: Float[Array, "d d"],
) -> Levels:
    """Of each measurement what those before and after it say.

    The filter forwards and backwards, added as independent but for the measurement
    itself, which both have. Where they disagree the state has changed nearby, and the one
    holds that is nearer to the measurement: the other comes from beyond the change.
    """
    forward = filter_levels(measured, noise, there, begins, drift)
    z, r, here = measured[::-1], noise[::-1], there[::-1]
    # Backwards a stretch begins where the next one starts.
    ends = jnp.concatenate([begins[1:], jnp.ones(1, bool)])[::-1]
    backward = Levels(*(a[::-1] for a in filter_levels(z, r, here, ends, drift)))

    def one(ahead_of: Levels, behind_it: Levels, z: Array, r: Array, here: Array) -> Levels:
        (fm, fc, likely), (bm, bc, _) = ahead_of, behind_it
        apart = fm - bm
        unlikely = jnp.vdot(apart, solve_positive(fc + bc, apart[:, None])[:, 0])
        unit = jnp.eye(len(z), dtype=z.dtype)
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

    safe = jnp.where(
        there[:, None, None], noise, jnp.eye(measured.shape[1], dtype=noise.dtype)
    )
    return jax.vmap(one)(forward, backward, measured, safe, there)
