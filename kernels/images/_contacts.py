"""Contacts read off an image: how many, where, how large, how much current.

Fixed sizes and no gradient: an image is ranked and cut, not fitted. What it costs are
passes over all pixels.
"""

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool, Float, Int, UInt

from tomojax.kernels.algebra import matmul
from tomojax.kernels.images._place import places_around

# A peak counts from this part of the highest: a third is noise and the blur's ripples.
_LOWEST_PEAK = 0.4

# Two peaks are one contact while the image between them stays above this part of the
# lower one: a bar over several electrodes has a peak near each.
_SADDLE = 0.8

# Moments of a contact whose relative difference is less have no direction.
_ROUND = 0.3


class Contacts(NamedTuple):
    """Up to C contacts, strongest first; NaN beyond `count`."""

    count: UInt[Array, ""]  # pyright: ignore (tuples have a method of that name)
    xy: Float[Array, "C 2"]  # m
    radius: Float[Array, " C"]  # of the disc with the same second moments, m
    angle: Float[Array, " C"]  # of the longest axis from x, rad in [0, π); NaN where round
    current: Float[Array, " C"]  # A
    conductance: Float[Array, " C"]  # S; NaN where the method does not tell it
    covariance: Float[Array, "C 3"]  # of the place, xx, yy, xy, m²; NaN as well


def no_contacts(count: int, dtype) -> Contacts:
    """None of `count`."""
    nan = jnp.full(count, jnp.nan, dtype)
    xy, covariance = (jnp.full((count, n), jnp.nan, dtype) for n in (2, 3))
    return Contacts(jnp.zeros((), jnp.uint8), xy, nan, nan, nan, nan, covariance)


def largest_variance(covariance: Float[Array, "*contacts 3"]) -> Float[Array, "*contacts"]:
    """Of a place, along the direction in which it is known least, m²; of xx, yy, xy."""
    a, b, c = jnp.moveaxis(covariance, -1, 0)
    return (a + b) / 2 + jnp.sqrt(((a - b) / 2) ** 2 + c**2)


def read_contacts(
    image: Float[Array, "nx ny"],
    current: Float[Array, "nx ny"],
    cell: Float[Array, "2"],
    count: int,
    level: float = 0.8,
    at_peak: bool = True,
    lowest: Float[Array, ""] | float = 0.0,
    reach: tuple[int, int] = (2, 2),
) -> Contacts:
    """The contacts of an image of which `current` (A per pixel) is what they carry.

    Peaks are the pixels above their 24 neighbours and above 0.4 of the highest; those
    with no saddle between them are one contact. Each pixel belongs to the nearest peak.
    A contact's current is the sum over its pixels; its place and moments are weighed by
    what exceeds `level` of its highest pixel. With `at_peak` the image is a statistic, and
    the place of a contact of one peak is read around that peak, see `places_around`.

    **Arguments:** `cell` (dx, dy), m; `count` C; `lowest`: what a peak has to exceed, in
    the unit of the image (its noise); `reach`: pixels around a peak that its place is read
    from.
    """
    nx, ny = image.shape
    peaks, there = _highest_peaks(image, count, lowest)
    i, j = peaks // ny, peaks % ny
    height = jnp.where(there, image[i, j], -jnp.inf)
    label = _joined(image, i, j, height, there)
    first = there & (label == jnp.arange(count))
    group = jnp.where(there, label, count)
    rows = _measure(count, level)(image, current, i, j, height, group)
    found = described(rows, (nx, ny), cell)
    if at_peak:
        alone = jnp.sum(label[:, None] == jnp.arange(count), 0, where=there[:, None]) == 1
        refined = places_around(image, i, j, cell, reach)
        found = found._replace(xy=jnp.where(alone[:, None], refined, found.xy))
    return strongest_first(found, first)


# Frames with several contacts that are measured at once, see `_measure`.
_TOGETHER = 128


@cache
def _measure(count: int, level: float):
    """(C, 7) sums of each contact: weight times `powers`, and current.

    One contact is the whole image. With several, each costs passes over all pixels, and
    under `vmap` every frame would pay for the most that any frame of the batch has: the
    rule for batches takes all frames for one contact, then those that have more again.
    """

    def one(
        image: Array, current: Array, i: Array, j: Array, height: Array, group: Array
    ) -> Float[Array, "C 7"]:
        flat, carried = image.ravel(), current.ravel()
        places = powers(image.shape, image.dtype)

        def contact(k: int) -> Float[Array, " 7"]:
            mine = _nearest(image.shape, places, i, j, group, k)
            weight = jnp.where(mine, jnp.maximum(flat - level * height[k], 0), 0)
            own = jnp.sum(jnp.where(mine, carried, 0))
            return jnp.append(matmul(weight, places), own)

        return jnp.stack([contact(k) for k in range(count)])

    def lone(image, current, height) -> Float[Array, "C 7"]:
        weight = jnp.maximum(image.ravel() - level * height[0], 0)
        moments = matmul(weight, powers(image.shape, image.dtype))
        row = jnp.append(moments, current.sum())
        return jnp.zeros((count, 7), row.dtype).at[0].set(row)

    measure = custom_vmap(one)

    @measure.def_vmap
    def _(size, batched, *values):
        values = [
            v if b else jnp.broadcast_to(v, (size, *jnp.shape(v)))
            for v, b in zip(values, batched)
        ]
        image, current, _, _, height, group = values
        several = ((group > 0) & (group < count)).any(1)
        together = min(_TOGETHER, size)
        # Those with several contacts first.
        order = jnp.argsort(~several, stable=True)
        order = jnp.concatenate([order, jnp.broadcast_to(order[-1:], (together,))])

        def again(state: tuple[Array, Array]) -> tuple[Array, Array]:
            done, rows = state
            these = lax.dynamic_slice_in_dim(order, done, together)
            found = jax.vmap(one)(*(v[these] for v in values))
            return done + together, rows.at[these].set(found)

        rows = jax.vmap(lone)(image, current, height)
        left = several.sum()
        start = jnp.zeros_like(left), rows
        rows = lax.while_loop(lambda state: state[0] < left, again, start)[1]
        return rows, True

    return measure


def powers(shape: tuple[int, ...], dtype) -> Float[Array, "pixels 6"]:
    """1, u, v, u², v², uv of each pixel, from the middle of the image."""
    nx, ny = shape
    u, v = np.indices((nx, ny)).reshape(2, -1) - np.array([[nx - 1], [ny - 1]]) / 2
    return jnp.asarray(np.stack([np.ones(nx * ny), u, v, u * u, v * v, u * v], 1), dtype)


def _highest_peaks(
    image: Float[Array, "nx ny"], count: int, lowest: Float[Array, ""] | float
) -> tuple[Int[Array, " C"], Bool[Array, " C"]]:
    """Flat places of up to `count` local maxima, the highest first, and which there are."""
    nx, ny = image.shape
    size = nx * ny
    around = _running_max(_running_max(image, 0), 1)
    top = image.max()
    high = (image > _LOWEST_PEAK * top) & (image > lowest) & (top > 0)
    is_peak = (image >= around) & high
    # Value and place in one integer, so that one pass finds both: positive floats are
    # ordered as their bits are, and the last bits of the value do not rank peaks.
    bits = lax.bitcast_convert_type((image / top).astype(jnp.float32), jnp.int32)
    place_bits = (size - 1).bit_length()
    place = jnp.arange(size, dtype=jnp.int32).reshape(nx, ny)
    packed = jnp.where(is_peak, (bits >> place_bits << place_bits) | place, -1)
    # Made once: fused into each pass below it would be made again in each.
    packed: Array = lax.optimization_barrier(packed)
    found = []
    below = jnp.array(jnp.iinfo(jnp.int32).max, jnp.int32)
    for _ in range(count):
        below = jnp.where(packed < below, packed, -1).max()
        found.append(below)
    best = jnp.stack(found)
    there = best >= 0
    return jnp.where(there, best & ((1 << place_bits) - 1), 0), there


def _running_max(image: Array, axis: int) -> Array:
    """The highest of each pixel and its two neighbours on either side."""
    pads = [(2, 2) if a == axis else (0, 0) for a in range(2)]
    wide = jnp.pad(image, pads, constant_values=-jnp.inf)
    n = image.shape[axis]
    shifted = [lax.slice_in_dim(wide, k, k + n, axis=axis) for k in range(5)]
    pairs = jnp.maximum(shifted[0], shifted[1]), jnp.maximum(shifted[3], shifted[4])
    return jnp.maximum(jnp.maximum(*pairs), shifted[2])


def _joined(image, i, j, height, there) -> Int[Array, " C"]:
    """For each peak the first that it is one contact with."""
    count = len(i)
    link = [[a == b for b in range(count)] for a in range(count)]
    linked = jnp.array(link)
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


def _nearest(
    shape, places: Float[Array, "pixels 6"], i, j, label, k
) -> Bool[Array, " pixels"]:
    """The pixels nearest to a peak of label k; to the lower label where equally near.

    All of it is arithmetic on each pixel alone, to be fused into what uses it.
    """
    nx, ny = shape
    own = below = above = jnp.full(len(places), jnp.inf, places.dtype)
    for p in range(len(i)):
        u = i[p].astype(places.dtype) - (nx - 1) / 2
        v = j[p].astype(places.dtype) - (ny - 1) / 2
        # |x − p|² without the |x|² that all peaks share.
        distance = u**2 + v**2 - 2 * (u * places[:, 1] + v * places[:, 2])
        present = label[p] < len(i)
        own = jnp.where(label[p] == k, jnp.minimum(own, distance), own)
        below = jnp.where(label[p] < k, jnp.minimum(below, distance), below)
        higher = (label[p] > k) & present
        above = jnp.where(higher, jnp.minimum(above, distance), above)
    return (own < below) & (own <= above)


def described(
    rows: Float[Array, "C 7"], shape: tuple[int, int], cell: Float[Array, "2"]
) -> Contacts:
    """From sums of `powers` and of current to contacts."""
    weight, u, v, uu, vv, uv, current = rows.T
    weight = jnp.where(weight > 0, weight, jnp.nan)
    u, v = u / weight, v / weight
    # A pixel's own variance is 1/12: no contact is smaller than the pixel that shows it.
    a = (jnp.maximum(uu / weight - u**2, 0) + 1 / 12) * cell[0] ** 2
    b = (jnp.maximum(vv / weight - v**2, 0) + 1 / 12) * cell[1] ** 2
    c = (uv / weight - u * v) * cell[0] * cell[1]
    apart = jnp.sqrt((a - b) ** 2 + 4 * c**2)
    angle = jnp.where(apart > _ROUND * (a + b), jnp.arctan2(2 * c, a - b) / 2, jnp.nan)
    at = jnp.stack([u, v], 1) + jnp.array(shape, rows.dtype) / 2
    return Contacts(
        jnp.zeros((), jnp.uint8),
        at * cell,
        jnp.sqrt(2 * (a + b)),
        jnp.where(angle < 0, angle + jnp.pi, angle),
        current,
        jnp.full_like(current, jnp.nan),
        jnp.full((len(current), 3), jnp.nan, current.dtype),
    )


def strongest_first(found: Contacts, first: Bool[Array, " C"]) -> Contacts:
    """Those that are `first`, by their current, and how many."""
    # A few contacts: to count the stronger ones is quicker than to sort.
    key = jnp.where(first, found.current, -jnp.inf)
    turn = jnp.arange(len(key))
    before = (key > key[:, None]) | ((key == key[:, None]) & (turn < turn[:, None]))
    order = jnp.argmax(before.sum(1) == turn[:, None], 1)
    keep = first[order]

    def sorted_(values: Array) -> Array:
        mask = keep.reshape(keep.shape + (1,) * (values.ndim - 1))
        return jnp.where(mask, values[order], jnp.nan)

    _, *values = found
    return Contacts(first.sum().astype(jnp.uint8), *map(sorted_, values))
