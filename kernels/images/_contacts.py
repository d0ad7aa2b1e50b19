"""Reads contacts off an image: how many, where, how large, how much current.

Sizes are fixed and there is no gradient: an image is ranked and cut, not fitted. Most of
the time goes to passes over all pixels.
"""

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt

from tomojax._shown import tuple_shown
from tomojax.kernels.algebra import matmul, where_needed
from tomojax.kernels.images._peaks import find_peaks
from tomojax.kernels.images._place import place_around

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

    def __repr__(self) -> str:
        return tuple_shown(self, xy=("mm", 1e3), radius=("mm", 1e3))


def no_contacts(count: int, dtype) -> Contacts:
    """Returns no contact, with room for `count`."""
    nan = jnp.full(count, jnp.nan, dtype)
    xy, covariance = (jnp.full((count, n), jnp.nan, dtype) for n in (2, 3))
    return Contacts(jnp.zeros((), jnp.uint8), xy, nan, nan, nan, nan, covariance)


def largest_variance(covariance: Float[Array, "*contacts 3"]) -> Float[Array, "*contacts"]:
    """Computes a place's variance in its least known direction, m², from xx, yy, xy."""
    a, b, c = jnp.moveaxis(covariance, -1, 0)
    return (a + b) / 2 + jnp.sqrt(((a - b) / 2) ** 2 + c**2)


def read_contacts(
    image: Float[Array, "nx ny"],
    current: Float[Array, "nx ny"] | None,
    cell: Float[Array, "2"],
    count: int,
    level: float = 0.8,
    at_peak: bool = True,
    lowest: Float[Array, ""] | float = 0.0,
    reach: tuple[int, int] = (2, 2),
) -> Contacts:
    """Reads contacts off an image; `current` (A per pixel) is the current they carry.

    Each contact has a peak of `find_peaks`, or several; each pixel belongs to the nearest
    peak. A contact's current is the sum over its pixels. The part of the image above
    `level` of the highest pixel weighs place and moments. If `at_peak`, the image is a
    statistic, and `place_around` reads the place of a contact of one peak around that peak.
    Without `current`, contacts come highest first and carry NaN.

    **Arguments:** `cell` (dx, dy), m; `count` C; `lowest`: the level that a peak has to
    exceed, in the unit of the image (its noise); `reach`: pixels around a peak that its
    place is read from.
    """
    peaks = find_peaks(image, count, lowest)
    read = _reading(count, level, reach if at_peak else None, current is not None)
    needed = ((peaks.group > 0) & (peaks.group < count)).any()
    carried = image if current is None else current
    rows, pixels = read(needed, image, carried, *peaks)
    found = described(rows, image.shape, cell)  # pyright: ignore
    if at_peak:
        refined = (pixels + 0.5) * cell
        found = found._replace(xy=jnp.where(peaks.alone[:, None], refined, found.xy))
    found = strongest_first(found, peaks.first)
    if current is not None:
        return found
    return found._replace(current=jnp.full_like(found.current, jnp.nan))


@cache
def _reading(count: int, level: float, reach: tuple[int, int] | None, carries: bool):
    """Makes the function that sums over each contact, and places peaks, in pixels.

    The (C, 7) sums are weight times `powers`, and current (or else the height of the peak).
    One contact is the whole image. Each of several contacts costs passes over all pixels.
    """

    def place(image: Array, i: Array, j: Array) -> Float[Array, "2"]:
        if reach is None:
            return jnp.full(2, jnp.nan, image.dtype)
        return place_around(image, i, j, reach)

    def whole(
        image: Array, current: Array, i: Array, j: Array, height: Array, group: Array
    ) -> tuple[Array, Array]:
        flat, carried = image.ravel(), current.ravel()
        places = powers(image.shape, image.dtype)

        def contact(k: int) -> Float[Array, " 7"]:
            mine = _nearest(image.shape, places, i, j, group, k)
            weight = jnp.where(mine, jnp.maximum(flat - level * height[k], 0), 0)
            own = jnp.sum(jnp.where(mine, carried, 0)) if carries else height[k]
            return jnp.append(matmul(places, weight), own)

        at = jax.vmap(lambda i, j: place(image, i, j))(i, j)
        return jnp.stack([contact(k) for k in range(count)]), at

    def lone(
        image: Array, current: Array, i: Array, j: Array, height: Array, group: Array
    ) -> tuple[Array, Array]:
        weight = jnp.maximum(image.ravel() - level * height[0], 0)
        moments = matmul(powers(image.shape, image.dtype), weight)
        own = current.sum() if carries else height[0]
        row = jnp.append(moments, own)
        at = place(image, i[0], j[0])
        empty = jnp.zeros((count, 7), row.dtype), jnp.full((count, 2), jnp.nan, at.dtype)
        return empty[0].at[0].set(row), empty[1].at[0].set(at)

    return where_needed(whole, lone)


def powers(shape: tuple[int, ...], dtype) -> Float[Array, "6 pixels"]:
    """Returns 1, u, v, u², v², uv of each pixel, from the middle of the image."""
    nx, ny = shape
    u, v = np.indices((nx, ny)).reshape(2, -1) - np.array([[nx - 1], [ny - 1]]) / 2
    return jnp.asarray(np.stack([np.ones(nx * ny), u, v, u * u, v * v, u * v]), dtype)


def _nearest(
    shape, places: Float[Array, "6 pixels"], i, j, label, k
) -> Bool[Array, " pixels"]:
    """Finds the pixels nearest to a peak of label k; the lower label takes ties.

    Each pixel's result is arithmetic on that pixel alone, so that XLA fuses it into later
    steps.
    """
    nx, ny = shape
    own = below = above = jnp.full(places.shape[1], jnp.inf, places.dtype)
    for p in range(len(i)):
        u = i[p].astype(places.dtype) - (nx - 1) / 2
        v = j[p].astype(places.dtype) - (ny - 1) / 2
        # |x − p|² without the |x|² that all peaks share.
        distance = u**2 + v**2 - 2 * (u * places[1] + v * places[2])
        present = label[p] < len(i)
        own = jnp.where(label[p] == k, jnp.minimum(own, distance), own)
        below = jnp.where(label[p] < k, jnp.minimum(below, distance), below)
        higher = (label[p] > k) & present
        above = jnp.where(higher, jnp.minimum(above, distance), above)
    return (own < below) & (own <= above)


def described(
    rows: Float[Array, "C 7"], shape: tuple[int, int], cell: Float[Array, "2"]
) -> Contacts:
    """Turns sums of `powers` and of current into contacts."""
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
    """Sorts the contacts that are `first` by their current's size, and counts them."""
    # A few contacts: to count the stronger ones is quicker than to sort.
    key = jnp.where(first, jnp.abs(found.current), -jnp.inf)
    turn = jnp.arange(len(key))
    before = (key > key[:, None]) | ((key == key[:, None]) & (turn < turn[:, None]))
    order = jnp.argmax(before.sum(1) == turn[:, None], 1)
    keep = first[order]

    def sorted_(values: Array) -> Array:
        mask = keep.reshape(keep.shape + (1,) * (values.ndim - 1))
        return jnp.where(mask, values[order], jnp.nan)

    _, *values = found
    return Contacts(first.sum().astype(jnp.uint8), *map(sorted_, values))
