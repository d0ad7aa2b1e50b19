"""Computes the waves over a rectangle that describe a sheet's variation."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

# Half periods along x and y together of the waves that a sheet's errors are told in.
_LONGEST = 4


def cosine_waves(
    places: Float[Array, "n 2"],
    size: Float[Array, "2"],
    orders: Int[np.ndarray, "q 2"],
) -> Float[Array, "q n"]:
    """Computes cos(πix/a)·cos(πjy/b) at places, for `orders` (i, j) of half periods."""
    angles = jnp.asarray(np.pi * orders, places.dtype)[:, None] * (places / size)
    return jnp.prod(jnp.cos(angles), -1)


def smooth_orders(most: int = _LONGEST) -> Int[np.ndarray, "q 2"]:
    """Lists half periods (i, j) of waves, 1 ≤ i + j ≤ most, in the order of j within i."""
    pairs = [(i, j) for i in range(most + 1) for j in range(most + 1 - i) if i + j]
    return np.array(pairs)


def smooth_modes(
    places: Float[Array, "n 2"], size: Float[Array, "2"], most: int = _LONGEST
) -> tuple[Float[Array, "q n"], Float[np.ndarray, " q"]]:
    """Computes `cosine_waves` of mean square 1 for 1 ≤ i + j ≤ most, and 1/(i² + j²)."""
    orders = smooth_orders(most)
    modes = jnp.asarray(heights(orders)[:, None], places.dtype)
    return modes * cosine_waves(places, size, orders), 1 / (orders**2).sum(1)


def heights(orders: Int[np.ndarray, "q 2"]) -> Float[np.ndarray, " q"]:
    """Computes the factors that make the waves' mean squares 1."""
    return np.sqrt(2.0 ** (orders > 0).sum(1))
