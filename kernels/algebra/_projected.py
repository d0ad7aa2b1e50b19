"""Fits values that are nowhere negative by least squares, with projected gradients."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from tomojax.kernels.algebra._blocktri import matmul

# Steps of the projected gradient.
_PROJECTED = 100


def not_negative(
    w: Float[Array, " n"],
    coefficients: Float[Array, " r"],
    basis: Float[Array, "r n"],
    normal: Float[Array, "r r"],
    damping: Float[Array, ""],
) -> Float[Array, " n"]:
    """Finds the w ≥ 0 nearest to Tikhonov's, as the voltages and λ measure nearness.

    (Bw − c)ᵀN(Bw − c) + λ|w − BᵀBw|² is minimised by accelerated projected gradients
    (FISTA: Beck and Teboulle, SIAM J. Imaging Sci. 2, 183, 2009). A drive below 0 V turns
    the sign.
    """
    forward = jnp.where(w.sum() < 0, -1, 1).astype(w.dtype)
    c = forward * coefficients
    # N has λ in it, as off the rows' space; a trace bounds its largest eigenvalue.
    step = 1 / jnp.trace(normal)

    def gradient(w: Array) -> Array:
        seen = matmul(basis, w)
        return matmul(matmul(normal, seen - c) - damping * seen, basis) + damping * w

    def one(_: Array, state: tuple) -> tuple:
        w, ahead, t = state
        new = jnp.maximum(ahead - step * gradient(ahead), 0)
        later = (1 + jnp.sqrt(1 + 4 * t**2)) / 2
        return new, new + (t - 1) / later * (new - w), later

    start = jnp.maximum(forward * w, 0)
    first = start, start, jnp.ones((), w.dtype)
    return forward * lax.fori_loop(0, _PROJECTED, one, first)[0]
