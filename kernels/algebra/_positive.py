"""Least squares for an image of positive values: g = e^y, y smooth beforehand."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from tomojax.kernels.algebra._blocktri import matmul

# Steps of conjugate gradients within one of Gauss and Newton's, and how often a step that
# does not fit better is halved; the gain, as a part, at which it is enough.
_INNER, _HALVED, _ENOUGH = 30, 5, 3e-4

# The largest change of ln g in one step: beyond, the slopes say nothing.
_LONGEST = 2.0


class SmoothPrior(NamedTuple):
    """ln g = level + A·w·Bᵀ with w (nx, ny) normal beforehand, of variance 1."""

    along: Float[Array, "nx nx"]
    across: Float[Array, "ny ny"]
    level: Float[Array, ""]


class PositiveFit(NamedTuple):
    """Where it ended."""

    values: Float[Array, "nx ny"]
    cost: Float[Array, ""]  # of the data
    misfits: Float[Array, " S"]  # |r_s|²


def smooth_prior(
    shape: tuple[int, ...],
    length: Float[Array, "2"],
    width: float,
    level: Float[Array, ""],
) -> SmoothPrior:
    """A Gaussian of standard deviation `length` (in pixels) as the root of the covariance.

    `width`: the standard deviation of ln g; `level`: its mean.
    """
    along, across = (gaussian(n, s) for n, s in zip(shape, length))
    along, across = (
        side / jnp.sqrt((side**2).sum(1, keepdims=True)) for side in (along, across)
    )
    return SmoothPrior(width * along, across, level)


def gaussian(count: int, length: Float[Array, ""]) -> Float[Array, "n n"]:
    """exp(−(i − j)²/(2·length²))."""
    apart = jnp.asarray(np.arange(count)[:, None] - np.arange(count), length.dtype)
    return jnp.exp(-((apart / length) ** 2) / 2)


def positive_values(prior: SmoothPrior, w: Float[Array, "nx ny"]) -> Array:
    """g. Clipped where float32 ends: e^±60 of the level."""
    return jnp.exp(prior.level + jnp.clip(_smoothed(prior, w), -60, 60))


def _smoothed(prior: SmoothPrior, w: Array) -> Array:
    return matmul(matmul(prior.along, w), prior.across.T)


def near_positive(prior: SmoothPrior, values: Float[Array, "nx ny"]) -> Array:
    """A w whose image is about `values`; what is below the level is at it."""
    raised = jnp.log(jnp.maximum(values, jnp.exp(prior.level))) - prior.level

    # Damped, as the smoothing has no inverse in floating point.
    def inverse(side: Array) -> Array:
        unit = jnp.mean((side**2).sum(1)) * jnp.eye(len(side), dtype=side.dtype)
        return jnp.linalg.solve(matmul(side.T, side) + 0.1 * unit, side.T)

    return matmul(matmul(inverse(prior.along), raised), inverse(prior.across).T)


def positive_least_squares(
    model: Callable[[Array], tuple[Float[Array, "S W"], Callable[[], Array]]],
    prior: SmoothPrior,
    start: Float[Array, "nx ny"],
    tolerance: Array | float,
    most: int,
) -> PositiveFit:
    """min over w of Σ_s δ²·ln(1 + |r_s(g)|²/δ²) + |w|², by Gauss and Newton's steps.

    Each step's normal equations are solved by conjugate gradients, so that nothing is
    formed for the pixels but the slopes. Rows s that do not fit at all count little
    (Cauchy's loss). **Arguments:** `model`: from g to residuals and to what gives their
    slopes ∂r/∂g (S, W, nx·ny); `start` w; `tolerance` δ²; `most` steps.
    """

    def cost_of(rest: Array) -> Array:
        return tolerance * jnp.log1p((rest**2).sum(1) / tolerance).sum()

    def total(w: Array) -> Array:
        rest, _ = model(positive_values(prior, w))
        return cost_of(rest) + (w**2).sum()

    def step(carry: tuple) -> tuple:
        w, _, _, k = carry
        values = positive_values(prior, w)
        rest, slopes = model(values)
        cost = cost_of(rest) + (w**2).sum()
        weight = lax.rsqrt(1 + (rest**2).sum(1) / tolerance)[:, None]
        rows = (slopes() * weight[..., None]).reshape(-1, values.size)
        move = _gauss_newton(prior, rows, values, (rest * weight).ravel(), w)
        change = jnp.abs(_smoothed(prior, move)).max()
        move = move * jnp.minimum(1, _LONGEST / jnp.maximum(change, _LONGEST / 100))
        w, new = _shortened(total, w, move, cost)
        return w, new, cost - new, k + 1

    def going(carry: tuple) -> Array:
        _, cost, gain, k = carry
        return (k < most) & (gain > _ENOUGH * cost)

    infinite = jnp.asarray(jnp.inf, start.dtype)
    # The first gain counts whatever it is.
    first = step((start, infinite, infinite, jnp.zeros((), int)))
    w, *_ = lax.while_loop(going, step, (*first[:2], infinite, first[3]))
    values = positive_values(prior, w)
    rest, _ = model(values)
    return PositiveFit(values, cost_of(rest), (rest**2).sum(1))


def _gauss_newton(
    prior: SmoothPrior, rows: Array, values: Array, rest: Array, w: Array
) -> Array:
    """−(AᵀA + I)⁻¹(Aᵀr + w), A the slopes of r by w."""

    def along(v: Array) -> Array:
        return matmul(rows, (values * _smoothed(prior, v)).ravel())

    def back(r: Array) -> Array:
        at = values * matmul(r, rows).reshape(values.shape)
        return matmul(matmul(prior.along.T, at), prior.across)

    def inner(_: Array, state: tuple) -> tuple:
        move, left, direction, size = state
        ahead = back(along(direction)) + direction
        far = size / jnp.maximum(jnp.vdot(direction, ahead), jnp.finfo(size.dtype).tiny)
        left = left - far * ahead
        new = jnp.vdot(left, left)
        turned = left + new / jnp.maximum(size, jnp.finfo(size.dtype).tiny) * direction
        return move + far * direction, left, turned, new

    downhill = -(back(rest) + w)
    start = (jnp.zeros_like(w), downhill, downhill, jnp.vdot(downhill, downhill))
    return lax.fori_loop(0, _INNER, inner, start)[0]


def _shortened(
    total: Callable[[Array], Array], w: Array, move: Array, cost: Array
) -> tuple[Array, Array]:
    """The step, halved until it is one forward; none where it never is."""

    def halve(state: tuple) -> tuple:
        part, _, k = state
        part = part / 2
        return part, total(w + part * move), k + 1

    def going(state: tuple) -> Array:
        return ~(state[1] < cost) & (state[2] < _HALVED)

    one = jnp.ones((), w.dtype)
    first = one, total(w + move), jnp.zeros((), int)
    part, new, _ = lax.while_loop(going, halve, first)
    better = new < cost
    return jnp.where(better, w + part * move, w), jnp.where(better, new, cost)
