"""Waves over a rectangle, in which a sheet's variation is told."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

# Half periods along x and y that a sheet's variation is told in: at most so many together.
_WAVES = 4


def cosine_waves(
    places: Float[Array, "n 2"],
    size: Float[Array, "2"],
    orders: Int[np.ndarray, "q 2"],
) -> Float[Array, "q n"]:
    """cos(πix/a)·cos(πjy/b) at places, for `orders` (i, j) of half periods."""
    angles = jnp.asarray(np.pi * orders, places.dtype)[:, None] * (places / size)
    return jnp.prod(jnp.cos(angles), -1)


def smooth_modes(
    places: Float[Array, "n 2"], size: Float[Array, "2"]
) -> tuple[Float[Array, "q n"], Float[np.ndarray, " q"]]:
    """`cosine_waves` of mean square 1 for 1 ≤ i + j ≤ 4, and 1/(i² + j²)."""
    pairs = [(i, j) for i in range(_WAVES + 1) for j in range(_WAVES + 1 - i) if i + j]
    orders = np.array(pairs)
    height = np.sqrt(2.0 ** (orders > 0).sum(1))[:, None]
    modes = jnp.asarray(height, places.dtype) * cosine_waves(places, size, orders)
    return modes, 1 / (orders**2).sum(1)
