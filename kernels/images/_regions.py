"""Reads contacts as connected regions of an image that is dark between them."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from tomojax.kernels.images._contacts import (
    Contacts,
    described,
    powers,
    strongest_first,
)


def read_regions(
    image: Float[Array, "nx ny"],
    current: Float[Array, "nx ny"],
    cell: Float[Array, "2"],
    count: int,
    level: float,
) -> Contacts:
    """Reads up to `count` regions of pixels (8 neighbours) above `level` of the highest.

    The image weighs a region's place and moments. A region carries the sum of `current`
    over its pixels. The regions that carry most are kept.
    """
    inside = (image > level * image.max()) & (image > 0)
    label = _labels(inside).ravel()
    carried = jax.ops.segment_sum(current.ravel(), label, image.size + 1)[1:]
    most, which = lax.top_k(carried, count)
    mine = (label - 1 == which[:, None].astype(label.dtype)).astype(image.dtype)
    moments = (mine * image.ravel()) @ powers(image.shape, image.dtype).T
    rows = jnp.concatenate([moments, most[:, None]], 1)
    nx, ny = image.shape
    return strongest_first(described(rows, (nx, ny), cell), most > 0)


def _labels(inside: Array) -> Int[Array, "nx ny"]:
    """Numbers each connected region from 1; 0 is outside."""
    own = jnp.where(inside, 1 + jnp.arange(inside.size).reshape(inside.shape), 0)

    def spread(state: tuple[Array, Array]) -> tuple[Array, Array]:
        label, _ = state
        wide = jnp.pad(label, 1)
        nx, ny = label.shape
        near = [wide[i : i + nx, j : j + ny] for i in range(3) for j in range(3)]
        new = jnp.where(inside, jnp.stack(near).max(0), 0)
        return new, (new != label).any()

    return lax.while_loop(lambda s: s[1], spread, (own, jnp.asarray(True)))[0]
