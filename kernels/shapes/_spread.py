"""Computes how sure a fitted shape is, pixel by pixel: Laplace's approximation."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax.linalg import triangular_solve
from jaxtyping import Array, Float

from tomojax.kernels.algebra import matmul
from tomojax.kernels.shapes._field import touching, TwoLevels


class PixelSpread(NamedTuple):
    """The uncertainty of n pixels."""

    touch: Float[Array, " n"]  # the probability that a pixel touches
    deviation: Float[Array, " n"]  # of its conductance, of the level


def spread(
    field: TwoLevels, curvature: Float[Array, "K K"], w: Float[Array, " K"]
) -> PixelSpread:
    """Computes P(f > 0), and the deviation of the part of a pixel that touches.

    The mean of f over a pixel's points has the variance φᵀ(I + curvature)⁻¹φ.
    """
    unit = jnp.eye(len(w), dtype=w.dtype)
    chol = jnp.linalg.cholesky(curvature + unit, symmetrize_input=False)
    root = triangular_solve(chol, unit, left_side=True, lower=True)
    wave = field.waves.mean(1)
    deviation = jnp.sqrt((matmul(wave, root.T) ** 2).sum(1))
    probability = jax.scipy.stats.norm.cdf((field.mean + matmul(wave, w)) / deviation)
    _, steep = touching(field.waves, field.mean, w)
    return PixelSpread(probability, steep.sum(1) * deviation)
