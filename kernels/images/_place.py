"""The place of a contact in an image that measures how well a source there would fit."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.interpolate import CubicSpline

from tomojax.kernels.algebra import matmul

# A lone point source at the right place leaves this part of an image unexplained: the sheet
# and the contact differ from what the image is told.
_LEFT = 0.07

# Steps of the finer places, in each direction from a peak.
_STEPS = 8
_AT = np.arange(-_STEPS, _STEPS + 1) / _STEPS


def places_around(
    image: Float[Array, "nx ny"],
    i: Int[Array, " C"],
    j: Int[Array, " C"],
    cell: Float[Array, "2"],
    reach: tuple[int, int],
) -> Float[Array, "C 2"]:
    """Averages the places x_k around peaks (i, j), m: Σ w_k x_k / Σ w_k.

    A source at x_k explains the part (z_k/z_max)² of what the highest pixel does, if z is
    a statistic such as sLORETA's, so that w_k = exp(−(1 − (z_k/z_max)²)/2ε²). Beside an
    edge of the sheet z is flat over half a pitch: its highest place is as good as any.

    **Arguments:** `cell` (dx, dy), m; `reach`: pixels around a peak that are looked at.
    """
    nx, ny = image.shape
    rx, ry = reach
    along, across = (jnp.asarray(_finer(r), image.dtype) for r in reach)
    near_x, near_y = (jnp.arange(-r, r + 1, dtype=i.dtype) for r in (rx, ry))
    rows = jnp.clip(i[:, None] + near_x[None], 0, nx - 1)
    columns = jnp.clip(j[:, None] + near_y[None], 0, ny - 1)
    x = i[:, None].astype(image.dtype) + jnp.asarray(rx * _AT, image.dtype)[None]
    y = j[:, None].astype(image.dtype) + jnp.asarray(ry * _AT, image.dtype)[None]
    on_x, on_y = (x >= -0.5) & (x <= nx - 0.5), (y >= -0.5) & (y <= ny - 0.5)

    def one(
        rows: Array, columns: Array, on_x: Array, on_y: Array, x: Array, y: Array
    ) -> Array:
        patch = image[rows[:, None], columns]
        fine = matmul(matmul(along, patch), across.T)
        fine = jnp.where(on_x[:, None] & on_y, jnp.maximum(fine, 0), 0)
        top = fine.max()
        part = fine / jnp.where(top > 0, top, 1)
        weight = jnp.exp((part**2 - 1) / (2 * _LEFT**2))
        weight = jnp.where(part > 0, weight, 0)
        whole = jnp.where(top > 0, weight.sum(), 1)
        return jnp.stack([(weight.sum(1) * x).sum(), (weight.sum(0) * y).sum()]) / whole

    found = jax.vmap(one)(rows, columns, on_x, on_y, x, y)
    return (found + 0.5) * cell


@cache
def _finer(reach: int) -> Float[np.ndarray, "fine nodes"]:
    """From the pixels around a peak to places that are closer together: a cubic spline."""
    nodes = np.arange(-reach, reach + 1)
    return CubicSpline(nodes, np.eye(len(nodes)))(reach * _AT)
