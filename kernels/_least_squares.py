"""Levenberg and Marquardt's least squares for a few parameters and many residuals.

Optimistix has this too: four times slower here and ten times longer to compile, since
its step is a QR of all residuals, and values and slopes are two traces of the model.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# Damping at first, and its change after a step that is taken or not.
_DAMPING, _LESS, _MORE = 1e-3, 1 / 8, 6.0

# The longest step of a parameter, in its unit; when to stop.
_LONGEST, _ENOUGH, _HOPELESS = 2.0, 1e-5, 1e5


def solve_positive(
    matrix: Float[Array, "*batch n n"], right: Float[Array, "*batch n k"]
) -> Float[Array, "*batch n k"]:
    """A⁻¹B of a few unknowns, A symmetric and positive: Gauss and Jordan's elimination.

    Without LAPACK, whose batches share out to XLA's few CPU threads and wait for them:
    two such calls at once stop for ever on two cores. It is faster for small n, too.
    """

    def eliminate(k: Array, both: Array) -> Array:
        row = jax.lax.dynamic_index_in_dim(both, k, -2)
        pivot = jax.lax.dynamic_index_in_dim(row, k, -1)
        column = jax.lax.dynamic_index_in_dim(both, k, -1)
        row = row / pivot
        return jnp.where((jnp.arange(n) == k)[:, None], row, both - column * row)

    n = matrix.shape[-1]
    both = jnp.concatenate([matrix, right], -1)
    return jax.lax.fori_loop(0, n, eliminate, both)[..., n:]


class LeastSquares(NamedTuple):
    """Where it ended."""

    parameters: Float[Array, " P"]
    cost: Float[Array, ""]
    normal: Float[Array, "P P"]  # JᵀWJ


def least_squares(
    model: Callable[[Array], tuple[Float[Array, "S M"], Float[Array, " priors"], Any]],
    start: Float[Array, " P"],
    tolerance: float,
    most: int,
) -> LeastSquares:
    """min Σ_s δ²·ln(1 + |r_s|²/δ²) + |priors|² over parameters of about unit size.

    Rows s of the residuals that do not fit at all count little (Cauchy's loss): a slot
    whose ground lies under the contact does not spoil the others. `tolerance` δ².
    """
    count = len(start)
    unit = jnp.eye(count, dtype=start.dtype)

    def slopes(p: Array):
        linear = lambda t: jax.jvp(lambda p: model(p)[:2], (p,), (t,))  # noqa: E731
        return jax.vmap(linear, out_axes=(None, 0))(unit)

    def step(carry):
        p, cost, normal, gradient, damping, k, _ = carry
        damped = normal + damping * jnp.diag(jnp.diagonal(normal))
        move = solve_positive(damped, gradient[:, None])[:, 0]
        trial = p - jnp.clip(move, -_LONGEST, _LONGEST)
        (rest, priors), (along, along_priors) = slopes(trial)
        misfit = (rest**2).sum(1) / tolerance
        weight = jax.lax.rsqrt(1 + misfit)[:, None]
        new = tolerance * jnp.log1p(misfit).sum() + (priors**2).sum()
        better = new < cost
        a = jnp.concatenate([(along * weight).reshape(count, -1), along_priors], 1)
        b = jnp.concatenate([(rest * weight).ravel(), priors])
        # Not finite: the start, or a trial that failed.
        gain = jnp.where(jnp.isfinite(cost), (cost - new) / cost, 1)
        gain = jnp.where(better, gain, jnp.where(damping > _HOPELESS, 0, 1))

        def pick(x: Array, y: Array) -> Array:
            return jnp.where(better, x, y)

        return (
            pick(trial, p),
            pick(new, cost),
            pick(jnp.matmul(a, a.T, precision="highest"), normal),
            pick(jnp.matmul(a, b, precision="highest"), gradient),
            damping * pick(jnp.asarray(_LESS, p.dtype), jnp.asarray(_MORE, p.dtype)),
            k + 1,
            gain,
        )

    one = jnp.ones((), start.dtype)
    first = (
        start,
        one * jnp.inf,
        unit,
        jnp.zeros_like(start),
        one * _DAMPING,
        jnp.zeros((), int),
        one,
    )
    going = lambda c: (c[5] < most) & (c[6] > _ENOUGH)  # noqa: E731
    p, cost, normal, *_ = jax.lax.while_loop(going, step, first)
    return LeastSquares(p, cost, normal)
