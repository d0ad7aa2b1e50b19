"""Fits a few parameters to many residuals: Levenberg and Marquardt's least squares.

Optimistix offers the same, but four times slower here and ten times longer to compile. Each
step of Optimistix is a QR of all residuals, and traces the model twice for values and
slopes.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

# Damping at first, and its change after a step that is taken or not.
_DAMPING, _LESS, _MORE = 1e-3, 1 / 8, 6.0

# The longest step of a parameter, in its unit; when to stop.
_LONGEST, _ENOUGH, _HOPELESS = 2.0, 1e-6, 1e5


def solve_positive(
    matrix: Float[Array, "*batch n n"], right: Float[Array, "*batch n k"]
) -> Float[Array, "*batch n k"]:
    """Solves A⁻¹B, A small, symmetric and positive: Gauss and Jordan's elimination.

    For small n this is faster than LAPACK, which is called once for each matrix of a batch.
    """

    def eliminate(k: Array, both: Array) -> Array:
        row = jax.lax.dynamic_index_in_dim(both, k, -2)
        pivot = jax.lax.dynamic_index_in_dim(row, k, -1)
        column = jax.lax.dynamic_index_in_dim(both, k, -1)
        row = row / pivot
        return jnp.where((jnp.arange(n) == k)[:, None], row, both - column * row)

    n = matrix.shape[-1]
    if n == 1:
        return right / matrix
    both = jnp.concatenate([matrix, right], -1)
    return jax.lax.fori_loop(0, n, eliminate, both)[..., n:]


class LeastSquares(NamedTuple):
    """The end of a fit: parameters, and the model's values and slopes there."""

    parameters: Float[Array, " P"]
    cost: Float[Array, ""]
    normal: Float[Array, "P P"]  # JᵀWJ
    rest: Float[Array, "S M"]
    priors: Float[Array, " priors"]
    slope: Float[Array, "P S M"]
    slope_priors: Float[Array, "P priors"]


class _Run(NamedTuple):
    """One start's descent so far."""

    at: LeastSquares
    gradient: Float[Array, " P"]
    damping: Float[Array, ""]
    steps: Int[Array, ""]
    gain: Float[Array, ""]  # of the last step, as a part of the cost


def least_squares(
    model: Callable[[Array], tuple[Float[Array, "S M"], Float[Array, " priors"], Any]],
    starts: Float[Array, "n P"],
    tolerance: Array | float,
    most: int,
    few: int = 0,
) -> LeastSquares:
    """Minimises Σ_s δ²·ln(1 + |r_s|²/δ²) + |priors|² over parameters of about unit size.

    Rows s of the residuals that do not fit at all count little (Cauchy's loss). So a slot
    whose ground lies under the contact does not spoil the other slots. `tolerance` is δ².
    Each of several starts has `few` steps, and the best start goes on for at most `most`.
    One loop runs all starts, because the loop's body takes seconds to compile.
    """
    n, count = starts.shape
    unit = jnp.eye(count, dtype=starts.dtype)
    one, none = jnp.ones((), starts.dtype), jnp.zeros((), int)

    def slopes(p: Array):
        linear = lambda t: jax.jvp(lambda p: model(p)[:2], (p,), (t,))  # noqa: E731
        return jax.vmap(linear, out_axes=(None, 0))(unit)

    sizes = jax.eval_shape(slopes, starts[0])
    (rest, priors), (along, along_priors) = jax.tree.map(
        lambda a: jnp.zeros(a.shape, a.dtype), sizes
    )

    def begun(at: LeastSquares, start: Array) -> _Run:
        at = at._replace(parameters=start, cost=one * jnp.inf, normal=unit)
        return _Run(at, jnp.zeros_like(start), one * _DAMPING, none, one)

    def step(run: _Run) -> _Run:
        at, damping = run.at, run.damping
        damped = at.normal + damping * jnp.diag(jnp.diagonal(at.normal))
        move = solve_positive(damped, run.gradient[:, None])[:, 0]
        trial = at.parameters - jnp.clip(move, -_LONGEST, _LONGEST)
        (rest, priors), (along, along_priors) = slopes(trial)
        misfit = (rest**2).sum(1) / tolerance
        weight = jax.lax.rsqrt(1 + misfit)[:, None]
        cost: Array = tolerance * jnp.log1p(misfit).sum() + (priors**2).sum()
        a = jnp.concatenate([(along * weight).reshape(count, -1), along_priors], 1)
        b = jnp.concatenate([(rest * weight).ravel(), priors])
        normal = jnp.matmul(a, a.T, precision="highest")
        gradient = jnp.matmul(a, b, precision="highest")
        new = LeastSquares(trial, cost, normal, rest, priors, along, along_priors)
        better = cost < at.cost
        # Not finite: the start, or a trial that failed.
        gain = jnp.where(jnp.isfinite(at.cost), (at.cost - cost) / at.cost, 1)
        gain = jnp.where(better, gain, jnp.where(damping > _HOPELESS, 0, 1))

        def pick(x: Any, y: Any) -> Any:
            return jax.tree.map(lambda x, y: jnp.where(better, x, y), x, y)

        damping = damping * pick(one * _LESS, one * _MORE)
        gradient = pick(gradient, run.gradient)
        return _Run(pick(new, at), gradient, damping, run.steps + 1, gain)

    def go(state: tuple[_Run, Array, Array, Array]) -> tuple[_Run, Array, Array, Array]:
        run, best, cost, number = state
        run = step(run)
        limit = jnp.where(number < n, few, most)
        ended = (run.steps >= limit) | (run.gain <= _ENOUGH)
        better = ended & (run.at.cost < cost)
        best = jnp.where(better, run.at.parameters, best)
        cost = jnp.where(better, run.at.cost, cost)
        number = jnp.where(ended, number + 1, number)
        start = jnp.where(number < n, starts[jnp.minimum(number, n - 1)], best)
        again = ended & (number <= n)
        new = begun(run.at, start)
        return (
            jax.tree.map(lambda a, b: jnp.where(again, a, b), new, run),
            best,
            cost,
            number,
        )

    nothing = LeastSquares(starts[0], one, unit, rest, priors, along, along_priors)
    # One start alone is the best.
    first = jnp.array(0 if n > 1 else n)
    start = begun(nothing, starts[0]), starts[0], one * jnp.inf, first
    return jax.lax.while_loop(lambda state: state[3] <= n, go, start)[0].at
