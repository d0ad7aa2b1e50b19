"""Finds the peaks of an image, and groups the peaks of one contact."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

# A peak counts from this part of the highest: a third is noise and the blur's ripples.
_LOWEST_PEAK = 0.4

# Two peaks are one contact while the image between them stays above this part of the
# lower one: a bar over several electrodes has a peak near each.
_SADDLE = 0.8


class Peaks(NamedTuple):
    """Up to C peaks, the highest first."""

    i: Int[Array, " C"]  # pixels
    j: Int[Array, " C"]
    height: Float[Array, " C"]  # −∞ where there is none
    group: Int[Array, " C"]  # the first that it is one contact with; C where there is none

    @property
    def first(self) -> Bool[Array, " C"]:
        """Tells whether each peak is the first of its contact."""
        return self.group == jnp.arange(len(self.group))

    @property
    def alone(self) -> Bool[Array, " C"]:
        """Tells whether each peak is the only one of its contact."""
        return self.first & (self.sizes == 1)

    @property
    def sizes(self) -> Int[Array, " C"]:
        """Counts the peaks of each contact."""
        return (self.group[:, None] == jnp.arange(len(self.group))).sum(0)


def find_peaks(
    image: Float[Array, "nx ny"], count: int, lowest: Float[Array, ""] | float = 0.0
) -> Peaks:
    """Finds up to `count` peaks, each the highest of 3 × 3 squares of 2 × 2 pixels.

    Peaks exceed `lowest` and 0.4 of the highest. Peaks with no saddle between them are one
    contact.
    """
    squares = _squares(image)
    wide, size = squares.shape[1], squares.size
    top = _once(squares.max())
    high = (squares > _LOWEST_PEAK * top) & (squares > lowest) & (top > 0)
    # Value and place in one number, so that one pass finds both: positive floats are
    # ordered as their bits are, and the last bits of the value do not rank peaks.
    part = (squares * (1 / top)).astype(jnp.float32)
    bits = lax.bitcast_convert_type(part, jnp.int32)
    last = (1 << (size - 1).bit_length()) - 1
    place = jnp.arange(size, dtype=jnp.int32).reshape(squares.shape)
    packed = lax.bitcast_convert_type((bits & ~last) | place, jnp.float32)
    packed = _once(jnp.where(high, packed, -1))
    if count > 1:  # the highest is one in any case
        packed = _once(jnp.where(packed >= _around(packed), packed, -1))
    found, below = [], jnp.asarray(jnp.inf, jnp.float32)
    for _ in range(count):
        below = jnp.where(packed < below, packed, -1).max()
        found.append(below)
    best = jnp.stack(found)
    there = best > 0
    place = jnp.where(there, lax.bitcast_convert_type(best, jnp.int32) & last, 0)
    i, j, height = _highest_of(image, 2 * (place // wide), 2 * (place % wide))
    height = jnp.where(there, height, -jnp.inf)
    group = jnp.where(there, _joined(image, i, j, height, there), count)
    return Peaks(i, j, height, group)


def _once(values: Array) -> Array:
    """Stops XLA from computing values again in each pass that uses them."""
    return lax.optimization_barrier(values)  # pyright: ignore


def _squares(image: Float[Array, "nx ny"]) -> Array:
    """Takes the highest of each 2 × 2 pixels."""
    odd = [(0, n % 2) for n in image.shape]
    if any(more for _, more in odd):
        image = jnp.pad(image, odd, constant_values=-jnp.inf)
    nx, ny = image.shape
    rows = image.reshape(nx // 2, 2, ny)
    rows = jnp.maximum(rows[:, 0], rows[:, 1])
    return _once(jnp.maximum(rows[:, ::2], rows[:, 1::2]))


def _around(values: Array) -> Array:
    """Takes the highest of each value and its eight neighbours."""
    wide = jnp.pad(values, 1, constant_values=-1)
    rows = _once(jnp.maximum(jnp.maximum(wide[:-2], wide[2:]), wide[1:-1]))
    return jnp.maximum(jnp.maximum(rows[:, :-2], rows[:, 2:]), rows[:, 1:-1])


def _highest_of(image: Array, i: Array, j: Array) -> tuple[Array, Array, Array]:
    """Finds the highest of four pixels from (i, j) on, inside the image."""
    nx, ny = image.shape
    rows = jnp.minimum(i[:, None] + jnp.array([0, 0, 1, 1], i.dtype), nx - 1)
    columns = jnp.minimum(j[:, None] + jnp.array([0, 1, 0, 1], j.dtype), ny - 1)
    values = image[rows, columns]
    which = jnp.argmax(values, 1)[:, None]
    of_each = (jnp.take_along_axis(a, which, 1)[:, 0] for a in (rows, columns, values))
    i, j, height = of_each
    return i, j, height


def _joined(image, i, j, height, there) -> Int[Array, " C"]:
    """Finds for each peak the first peak of the same contact."""
    count = len(i)
    linked = jnp.eye(count, dtype=bool)
    for a in range(count):
        for b in range(a):
            # A quarter, half and three quarters of the way.
            low = jnp.array(jnp.inf, image.dtype)
            for part in (1, 2, 3):
                s = (i[a] * part + i[b] * (4 - part) + 2) // 4
                t = (j[a] * part + j[b] * (4 - part) + 2) // 4
                low = jnp.minimum(low, image[s, t])
            one = (low > _SADDLE * height[a]) & there[a] & there[b]  # a is the lower
            linked = linked.at[a, b].set(one).at[b, a].set(one)
    label = jnp.arange(count)
    for _ in range(count - 1):
        label = jnp.min(jnp.where(linked, label[None], count), axis=1)
    return label
