"""Describes a field of two levels: conductance where an object touches, none elsewhere.

    g(x) = level(x)·logistic(f(x)),  f = mean + Σ_m w_m·φ_m(x),  w normal, of variance 1

f is Gaussian beforehand, with Matérn's covariance of order 3/2, in the waves
cos(πix/a)·cos(πjy/b) of the sheet. The standard deviation of f is many times the width of
the logistic function's slope. So most of the sheet is at one of the two levels.

How sure a fitted shape is, pixel by pixel, is Laplace's approximation.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax.linalg import triangular_solve
from jaxtyping import Array, Float

from tomojax.kernels.algebra import gaussian, matmul
from tomojax.kernels.sheet import heights

# Points of a pixel along each side, over which its conductance is averaged: an outline
# crosses pixels.
_POINTS = 2

# f's standard deviation. On simulated letters, rings, hands and cables (making seeds)
# overlaps changed by 0.03 at most between 4 and 10, with lengths from 0.75 to 1.5 pitches.
_WIDTH = 10.0

# f's mean, in standard deviations.
_MEAN = -0.7

# f's length, of the electrodes' pitch.
_LENGTH = 1.5

# Matérn's order.
_ORDER = 1.5

# The shortest half period of a wave, of the pitch: no image showed more with shorter ones.
_SHORTEST = 0.5

# The part of a pixel that touches in a start: at least,
_LEAST = 1e-3
# and as far from 1.
_MOST = 0.05

# A start leaves out waves whose square is less than this part of the longest one's.
_SHORT = 1e-3

# The level is told from what is as near as this, of the pitch.
_NEAR = 1.0

# A level is at least this part of the whole image's: what is weaker may be no contact.
_FAINT = 0.1


class TwoLevels(NamedTuple):
    """The field's K waves at points of n pixels, the longest wave first."""

    waves: Float[Array, "n q K"]  # φ_m, times its standard deviation beforehand
    mean: Float[Array, ""]


def modes_of(
    shape: tuple[int, int], size: Float[np.ndarray, "2"], pitch: float, dtype
) -> TwoLevels:
    """Computes the waves on an image of `shape` pixels over a sheet of `size`, m."""
    most = np.floor(size / (_SHORTEST * pitch)).astype(int)
    orders = np.moveaxis(np.indices(tuple(most + 1)), 0, -1).reshape(-1, 2)
    wave = np.pi * orders / size
    square = (wave**2).sum(1)
    within = ((orders / np.maximum(most, 1)) ** 2).sum(1) <= 1
    power = (2 * _ORDER / (_LENGTH * pitch) ** 2 + square) ** -(_ORDER + 1)
    order = np.flatnonzero(within)
    order = order[np.argsort(square[order], kind="stable")]
    # Of a variance that all waves, the shorter ones too, would add up to.
    far = np.moveaxis(np.indices(tuple(8 * (most + 1))), 0, -1).reshape(-1, 2)
    rest = 2 * _ORDER / (_LENGTH * pitch) ** 2 + ((np.pi * far / size) ** 2).sum(1)
    deviation = _WIDTH * np.sqrt(power / (rest ** -(_ORDER + 1)).sum())[order]
    orders = orders[order]
    x, y = ((np.arange(n * _POINTS) + 0.5) / (n * _POINTS) for n in shape)
    along, across = (
        np.cos(np.pi * i[:, None] * v) for i, v in zip(orders.T, (x, y), strict=True)
    )
    tall = (heights(orders) * deviation)[:, None, None, None, None]
    along = along.reshape(len(orders), shape[0], 1, _POINTS, 1)
    across = across.reshape(len(orders), 1, shape[1], 1, _POINTS)
    waves = (tall * along * across).reshape(len(orders), -1, _POINTS**2)
    waves = np.ascontiguousarray(np.moveaxis(waves, 0, 2))
    return TwoLevels(jnp.asarray(waves, dtype), jnp.asarray(_MEAN * _WIDTH, dtype))


def touching(
    waves: Float[Array, "n q K"], mean: Float[Array, ""], w: Float[Array, " K"]
) -> tuple[Float[Array, " n"], Float[Array, "n q"]]:
    """Computes the part of each pixel that touches, and its ∂/∂f at the q points."""
    inside = jax.nn.sigmoid(mean + matmul(waves, w))
    return inside.mean(1), inside * (1 - inside) / waves.shape[1]


def levels(
    g: Float[Array, "nx ny"], cell: Float[Array, "2"], pitch: Float[Array, ""]
) -> Float[Array, "nx ny"]:
    """Estimates the conductance per area of what touches near each pixel: Σg²/Σg.

    A Gaussian weighs the sums by distance. Objects of unlike conductance have levels of
    their own.
    """
    along, across = (gaussian(n, _NEAR * pitch / c) for n, c in zip(g.shape, cell))
    blur = lambda a: matmul(matmul(along, a), across.T)  # noqa: E731
    tiny = jnp.finfo(g.dtype).tiny
    whole = (g**2).sum() / jnp.maximum(g.sum(), tiny)
    # What is far from all of it has no level of its own.
    least = _FAINT * whole
    own = (blur(g**2) + tiny) / jnp.maximum(blur(g), tiny)
    return jnp.maximum(own, jnp.maximum(least, tiny))


def near_touching(field: TwoLevels, touch: Float[Array, " n"]) -> Float[Array, " K"]:
    """Finds a w whose field touches about the part `touch` of each pixel.

    The waves are orthogonal at the points: each wave's weight is one product.
    """
    inside = jnp.clip(touch, _LEAST, 1 - _MOST)
    f = jnp.log(inside / (1 - inside)) - field.mean
    size = (field.waves**2).sum((0, 1))
    along = matmul(field.waves.sum(1).T, f)
    # Short waves are less than what noise would make of them.
    return along / (size + size.max() * _SHORT)


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
