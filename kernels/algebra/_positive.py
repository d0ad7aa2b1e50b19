"""Fits an image of positive values by least squares: g = e^y, y smooth beforehand."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels.algebra._blocktri import matmul

# Steps of conjugate gradients for each of Gauss and Newton's, always as many: where they
# end by how little is left, images stay spread out and twice as many steps are needed.
_INNER = 12

# Of Gauss and Newton's steps within one evaluation of the model: at most, and the gain, as
# a part of the cost, at which they are enough; and the latter of evaluations.
_WITHIN, _ENOUGH_WITHIN, _ENOUGH = 8, 5e-3, 1e-3

# The shortest part of a step that is tried. The largest change of ln g in one step: beyond,
# the slopes say nothing.
_SHORTEST, _LONGEST = 1 / 32, 2.0


class SmoothPrior(NamedTuple):
    """The prior ln g = level + A·w·Bᵀ, with w (nx, ny) normal, of variance 1."""

    along: Float[Array, "nx nx"]
    across: Float[Array, "ny ny"]
    level: Float[Array, ""]


class PositiveFit(NamedTuple):
    """The end of a fit."""

    values: Float[Array, "nx ny"]
    cost: Float[Array, ""]  # of the data
    misfits: Float[Array, " S"]  # |r_s|²
    state: Any  # the model's there


class Run(NamedTuple):
    """The best w so far, and the step that is tried next."""

    w: Float[Array, "nx ny"]
    move: Float[Array, "nx ny"]
    part: Float[Array, ""]  # of the move
    cost: Float[Array, ""]  # with the prior's
    state: Any  # what was evaluated there
    steps: Int[Array, ""]
    ended: Bool[Array, ""]


def smooth_prior(
    shape: tuple[int, ...],
    length: Float[Array, "2"],
    width: float,
    level: Float[Array, ""],
) -> SmoothPrior:
    """Builds the covariance's root from a Gaussian of standard deviation `length`, pixels.

    `width`: the standard deviation of ln g; `level`: the mean of ln g.
    """
    along, across = (gaussian(n, s) for n, s in zip(shape, length))
    along, across = (
        side / jnp.sqrt((side**2).sum(1, keepdims=True)) for side in (along, across)
    )
    return SmoothPrior(width * along, across, level)


def gaussian(count: int, length: Float[Array, ""]) -> Float[Array, "n n"]:
    """Returns exp(−(i − j)²/(2·length²))."""
    apart = jnp.asarray(np.arange(count)[:, None] - np.arange(count), length.dtype)
    return jnp.exp(-((apart / length) ** 2) / 2)


def positive_values(prior: SmoothPrior, w: Float[Array, "nx ny"]) -> Array:
    """Returns g, clipped where float32 ends: e^±60 of the level."""
    return jnp.exp(prior.level + jnp.clip(_smoothed(prior, w), -60, 60))


def _smoothed(prior: SmoothPrior, w: Array) -> Array:
    return matmul(matmul(prior.along, w), prior.across.T)


def _unsmoothed(prior: SmoothPrior, y: Array) -> Array:
    """Applies the transpose of `_smoothed`."""
    return matmul(matmul(prior.along.T, y), prior.across)


def near_positive(prior: SmoothPrior, values: Float[Array, "nx ny"]) -> Array:
    """Finds a w whose image is about `values`; values below the level count as level."""
    raised = jnp.log(jnp.maximum(values, jnp.exp(prior.level))) - prior.level

    # Damped, as the smoothing has no inverse in floating point.
    def inverse(side: Array) -> Array:
        unit = jnp.mean((side**2).sum(1)) * jnp.eye(len(side), dtype=side.dtype)
        return jnp.linalg.solve(matmul(side.T, side) + 0.1 * unit, side.T)

    return matmul(matmul(inverse(prior.along), raised), inverse(prior.across).T)


def positive_least_squares(
    model: Callable[[Array], tuple[Float[Array, "S W"], Any]],
    slopes: Callable[[Any], Callable[[Array], Float[Array, "S W"]]],
    own: Float[Array, "nx ny"],
    prior: SmoothPrior,
    start: Float[Array, "nx ny"],
    tolerance: Array | float,
    most: int,
) -> PositiveFit:
    """Minimises Σ_s δ²·ln(1 + |r_s(g)|²/δ²) + |w|² over w, by Gauss and Newton's steps.

    Rows s that do not fit at all count little (Cauchy's loss). Between evaluations of the
    model at g₀, residuals count as linear in (g − g₀)(1 + g₀R)/(1 + gR): the effect of one
    value saturates by 1/R. Such a step costs products with the slopes alone, and gains most
    of what evaluations of the model would.
    **Arguments:** `model`: from g to residuals and to a state; `slopes`: from that state to
    the linear map from changes of g to changes of the residuals; `own` R; `start` w;
    `tolerance` δ²; `most` evaluations of the model.
    """

    def cost_of(rest: Array, w: Array) -> Array:
        return tolerance * jnp.log1p((rest**2).sum(1) / tolerance).sum() + (w**2).sum()

    def evaluated(w: Array) -> tuple[Array, tuple[Array, Any]]:
        rest, state = model(positive_values(prior, w))
        return cost_of(rest, w), (rest, state)

    def move_from(w: Array, at: tuple[Array, Any]) -> Array:
        rest, state = at
        before, linear = positive_values(prior, w), slopes(state)

        def nearly(w: Array) -> tuple[Array, Array]:
            g = positive_values(prior, w)
            change = (g - before) * (1 + before * own) / (1 + g * own)
            left = rest + linear(change)
            return cost_of(left, w), left

        transposed = jax.linear_transpose(linear, before)
        back = lambda r: transposed(r)[0]  # noqa: E731

        def newton(w: Array, left: Array) -> Array:
            g = positive_values(prior, w)
            steep = g * ((1 + before * own) / (1 + g * own)) ** 2
            weight = 1 / (1 + (left**2).sum(1) / tolerance)[:, None]

            def normal(v: Array) -> Array:
                changed = weight * linear(steep * _smoothed(prior, v))
                return v + _unsmoothed(prior, steep * back(changed))

            uphill = w + _unsmoothed(prior, steep * back(weight * left))
            move = _conjugate(normal, -uphill)
            change = jnp.abs(_smoothed(prior, move)).max()
            return move * jnp.minimum(1, _LONGEST / jnp.maximum(change, _LONGEST / 100))

        return descended(nearly, newton, w, _WITHIN, _ENOUGH_WITHIN).w - w

    run = descended(evaluated, move_from, start, most, _ENOUGH)
    (rest, state), values = run.state, positive_values(prior, run.w)
    cost = run.cost - (run.w**2).sum()
    return PositiveFit(values, cost, (rest**2).sum(1), state)


def descended(
    evaluated: Callable[[Array], tuple[Array, Any]],
    move_from: Callable[[Array, Any], Array],
    start: Array,
    most: int,
    enough: float,
) -> Run:
    """Moves while each move lowers the cost by more than a part; halves a failed move.

    **Arguments:** `evaluated`: cost and state at w; `move_from`: the move from w and state;
    `most` evaluations; `enough`: the gain, as a part of the cost, that ends the descent.
    """

    def step(run: Run) -> Run:
        w = run.w + run.part * run.move
        cost, state = evaluated(w)
        steps = run.steps + 1

        def onward() -> Run:
            ended = run.cost - cost <= enough * cost
            # What would not be tried is not worked out.
            still = ~ended & (steps < most)
            move = lax.cond(still, move_from, lambda w, _: w, w, state)
            return Run(w, move, one, cost, state, steps, ended)

        def shorter() -> Run:
            short = run.part <= _SHORTEST
            return run._replace(part=run.part / 2, steps=steps, ended=short)

        return lax.cond(cost < run.cost, onward, shorter)

    def going(run: Run) -> Array:
        return ~run.ended & (run.steps < most)

    one = jnp.ones((), start.dtype)
    cost, state = jax.eval_shape(evaluated, start)
    nothing = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), state)
    highest = jnp.asarray(jnp.inf, cost.dtype)
    zero, ended = jnp.zeros((), int), jnp.zeros((), bool)
    first = Run(start, jnp.zeros_like(start), one, highest, nothing, zero, ended)
    return lax.while_loop(going, step, first)


def _conjugate(
    normal: Callable[[Array], Array], downhill: Float[Array, "nx ny"]
) -> Float[Array, "nx ny"]:
    """Solves normal(x) = downhill approximately, by conjugate gradients."""
    tiny = jnp.finfo(downhill.dtype).tiny

    def inner(_: Array, state: tuple) -> tuple:
        move, left, direction, size = state
        ahead = normal(direction)
        far = size / jnp.maximum(jnp.vdot(direction, ahead), tiny)
        left = left - far * ahead
        new = jnp.vdot(left, left)
        turned = left + new / jnp.maximum(size, tiny) * direction
        return move + far * direction, left, turned, new

    start = jnp.zeros_like(downhill), downhill, downhill, jnp.vdot(downhill, downhill)
    return lax.fori_loop(0, _INNER, inner, start)[0]
