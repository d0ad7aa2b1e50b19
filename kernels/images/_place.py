"""Places a contact in an image that measures how well a source at each pixel would fit."""

from functools import cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tomojax.kernels.algebra import matmul
from tomojax.kernels.images._peaks import find_peaks

# A lone point source at the right place leaves this part of an image unexplained: the sheet
# and the contact differ from what the image is told.
_LEFT = 0.07

# Steps of the finer places, in each direction from a peak.
_STEPS = 8
_AT = np.arange(-_STEPS, _STEPS + 1) / _STEPS


def highest_place(
    image: Float[Array, "nx ny"], reach: tuple[int, int]
) -> Float[Array, "2"]:
    """Places the image's highest peak, in pixels: see `place_around`."""
    peak = find_peaks(image, 1)
    return place_around(image, peak.i[0], peak.j[0], reach)


def place_around(
    image: Float[Array, "nx ny"],
    i: Int[Array, ""],
    j: Int[Array, ""],
    reach: tuple[int, int],
) -> Float[Array, "2"]:
    """Averages the places x_k around a peak (i, j), in pixels: Σ w_k x_k / Σ w_k.

    Let z be a statistic such as sLORETA's. A source at x_k then explains (z_k/z_max)² of
    what the highest pixel explains, so w_k = exp(−(1 − (z_k/z_max)²)/2ε²). Beside an edge
    of the sheet z is flat over half a pitch: the highest place is as good as any.

    **Arguments:** `reach`: pixels around a peak that are looked at, along x and y.
    """
    shape = jnp.asarray(image.shape, i.dtype)
    finer, offsets = (jnp.asarray(a, image.dtype) for a in _finer(reach))
    near = jnp.asarray(_nodes(reach), i.dtype) + jnp.stack([i, j])
    near = jnp.clip(near, 0, shape - 1)
    fine = matmul(finer, image[near[:, 0], near[:, 1]])
    peak = jnp.stack([i, j]).astype(image.dtype)
    at = peak + offsets[:, :2]
    inside = ((at >= -0.5) & (at <= shape.astype(image.dtype) - 0.5)).all(1)
    fine = jnp.where(inside, jnp.maximum(fine, 0), 0)
    top = fine.max()
    part = fine / jnp.where(top > 0, top, 1)
    weight = jnp.where(part > 0, jnp.exp((part**2 - 1) / (2 * _LEFT**2)), 0)
    sums = matmul(weight, offsets)
    return peak + sums[:2] / jnp.where(top > 0, sums[2], 1)


def _nodes(reach: tuple[int, int]) -> np.ndarray:
    """Lists the pixels around a peak, relative to the peak."""
    sides = [np.arange(-r, r + 1) for r in reach]
    return np.stack(np.meshgrid(*sides, indexing="ij"), -1).reshape(-1, 2)


@cache
def _finer(
    reach: tuple[int, int],
) -> tuple[Float[np.ndarray, "fine nodes"], Float[np.ndarray, "fine 3"]]:
    """Returns cubic splines from pixels around a peak to finer places, and these places.

    The places are relative to the peak, in pixels, with a 1.
    """
    from scipy.interpolate import CubicSpline  # half a second, which most commands save

    sides = [CubicSpline(k, np.eye(len(k)))(r * _AT) for r in reach
             for k in [np.arange(-r, r + 1)]]  # fmt: skip
    x, y = np.meshgrid(*(r * _AT for r in reach), indexing="ij")
    return np.kron(*sides), np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
