"""Describes a sheet that is no rectangle: the part of each element, and a place in space.

A sheet of any outline is cut out of its bounding box's mesh. P1 elements have one gradient
each, so that an element that the edge cuts carries its part of what a whole one does, and
the edge insulates by itself. A curved sheet has the same mesh in its chart, and its nodes
in space.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax.kernels.sheet._mesh import element_area, node_areas, nodes, Shape, triangles

# What is outside conducts this part of the sheet: no node is loose.
OUTSIDE = 1e-6

# A chart's slopes are differences over this part of a cell.
_STEP = 1e-2


class Skin(NamedTuple):
    """What a sheet that is no flat rectangle has beside its box."""

    level: Float[Array, " nodes"]  # distance to the edge, m in the chart; negative inside
    surface: Callable | None = None  # chart (..., 2) ↦ space (..., 3), m; None: flat

    def points(self, chart: Float[Array, "*n 2"]) -> Float[Array, "*n d"]:
        """Returns places in space, m."""
        return chart if self.surface is None else self.surface(chart)


@jax.jit
def covered(level: Float[Array, "K 3"]) -> Float[Array, " K"]:
    """Computes the part of each triangle where a level, linear in it, is negative.

    One vertex apart from the two others cuts off φ_a²/((φ_a − φ_b)(φ_a − φ_c)).
    """
    inside = level < 0
    count = inside.sum(1)
    # The lone vertex: the one on the other side of both others.
    lone = jnp.argmax(jnp.where((count == 1)[:, None], inside, ~inside), 1)
    a, b, c = (
        jnp.take_along_axis(level, (lone[:, None] + k) % 3, 1)[:, 0] for k in range(3)
    )
    below = (a - b) * (a - c)
    mixed = (count == 1) | (count == 2)
    corner = jnp.where(mixed, a**2 / jnp.where(mixed, below, 1), 0)
    return jnp.where(count == 3, 1.0, jnp.where(count == 2, 1 - corner, corner))


def coverage(skin: Skin, shape: Shape) -> Float[Array, " K"]:
    """Computes the part of each element that is on the sheet."""
    return covered(skin.level[triangles(shape)])


def stiffness_on(
    skin: Skin, shape: Shape, size: Float[Array, "2"]
) -> Float[Array, "K 3 3"]:
    """Computes each whole element's stiffness at 1 S per square: e_i·e_j/4A."""
    corners = skin.points(nodes(shape, size))[triangles(shape)]
    sides = jnp.roll(corners, -1, 1) - jnp.roll(corners, 1, 1)  # opposite each vertex
    products = jnp.einsum("kid,kjd->kij", sides, sides, precision="highest")
    return products / (4 * _areas(corners))[:, None, None]


def element_areas(
    skin: Skin | None, shape: Shape, size: Float[Array, "2"]
) -> Float[Array, " K"]:
    """Computes the area of each element's part of the sheet, m²."""
    flat = element_area(shape, size)
    if skin is None:
        return jnp.broadcast_to(flat, (2 * shape[0] * shape[1],))
    part = coverage(skin, shape)
    if skin.surface is None:
        return flat * part
    return part * _areas(skin.points(nodes(shape, size))[triangles(shape)])


def node_parts(skin: Skin, shape: Shape, size: Float[Array, "2"]) -> Float[Array, " nodes"]:
    """Computes the area of the sheet that belongs to each node, m²."""
    part = element_areas(skin, shape, size) / element_area(shape, size)
    vertices = triangles(shape)
    zero = jnp.zeros_like(skin.level)
    each = jnp.broadcast_to(part[:, None], vertices.shape)
    mean = zero.at[vertices].add(each) / jnp.asarray(
        np.bincount(vertices.ravel()), part.dtype
    )
    return mean * node_areas(shape, size)


def distances(
    skin: Skin | None, places: Float[Array, "M 2"], others: Float[Array, "n 2"]
) -> Float[Array, "n M"]:
    """Computes squares of distances in space from places to others, m²."""
    if skin is not None:
        places, others = skin.points(places), skin.points(others)
    return ((others[:, None] - places[None]) ** 2).sum(-1)


def moves(
    skin: Skin | None, places: Float[Array, "M 2"], cell: Float[Array, "2"]
) -> Float[Array, "M 2 2"]:
    """Computes two steps in the chart that are unit steps in space, at right angles.

    With the chart's metric g the steps are the columns of g^(−1/2).
    """
    unit = jnp.broadcast_to(jnp.eye(2, dtype=places.dtype), (len(places), 2, 2))
    if skin is None or skin.surface is None:
        return unit
    metric = _metric(skin, places, cell)
    # √g = (g + √det·I)/√(trace + 2√det), of two rows.
    root = jnp.sqrt(jnp.linalg.det(metric))
    whole = (metric + root[:, None, None] * unit) / jnp.sqrt(
        jnp.trace(metric, axis1=1, axis2=2) + 2 * root
    )[:, None, None]
    return jnp.linalg.inv(whole)


def _metric(
    skin: Skin, places: Float[Array, "M 2"], cell: Float[Array, "2"]
) -> Float[Array, "M 2 2"]:
    slopes = [
        (skin.points(places + by) - skin.points(places - by)) / (2 * by.sum())
        for by in jnp.diag(_STEP * cell)
    ]
    slope = jnp.stack(slopes, -1)  # (M, 3, 2)
    return jnp.einsum("mdi,mdj->mij", slope, slope, precision="highest")


def local_cells(
    skin: Skin | None, places: Float[Array, "M 2"], cell: Float[Array, "2"]
) -> Float[Array, "2 ..."]:
    """Computes the sides of the cells in space, at places, m."""
    if skin is None or skin.surface is None:
        return cell[:, None]
    metric = _metric(skin, places, cell)
    return jnp.sqrt(jnp.diagonal(metric, axis1=1, axis2=2)).T * cell[:, None]


def stretch(
    skin: Skin, places: Float[Array, "M 2"], cell: Float[Array, "2"]
) -> Float[Array, " M"]:
    """Tells by how much the chart stretches lengths at places: 0 where it keeps them."""
    unit = jnp.eye(2, dtype=places.dtype)
    return jnp.abs(moves(skin, places, cell) - unit).max((1, 2))


def pinned_node(skin: Skin | None, shape: Shape) -> Array:
    """Returns the node that is pinned to 0 V: the last, or the one furthest inside."""
    last = (shape[0] + 1) * (shape[1] + 1) - 1
    if skin is None:
        return jnp.asarray(last, jnp.int32)
    return jnp.argmin(jax.lax.stop_gradient(skin.level)).astype(jnp.int32)


def _areas(corners: Float[Array, "K 3 d"]) -> Float[Array, " K"]:
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    dot = (one * other).sum(-1)
    square = (one**2).sum(-1) * (other**2).sum(-1) - dot**2
    return jnp.sqrt(jnp.maximum(square, jnp.finfo(square.dtype).tiny)) / 2
