"""Describes a sheet that is no rectangle: the part of each element, and a place in space.

A sheet of any outline is cut out of its bounding box's mesh. P1 elements have one gradient
each, so that an element that the edge cuts carries its part of what a whole one does, and
the edge insulates by itself. A curved sheet has the same mesh in its chart, and its nodes
in space.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from tomojax.kernels.sheet._mesh import (
    element_area,
    namespace,
    node_areas,
    nodes,
    Shape,
    triangles,
    Values,
)

# What is outside conducts this part of the sheet: no node is loose.
OUTSIDE = 1e-6

# A chart's slopes are differences over this part of a cell.
_STEP = 1e-2


class Skin(NamedTuple):
    """What a sheet that is no flat rectangle has beside its box."""

    level: Float[Values, " nodes"]  # distance to the edge, m in the chart; negative inside
    surface: Callable | None = None  # chart (..., 2) ↦ space (..., 3), m; None: flat

    def points(self, chart: Float[Values, "*n 2"]) -> Float[Values, "*n d"]:
        """Returns places in space, m."""
        return chart if self.surface is None else self.surface(chart)


def covered(level: Float[Values, "K 3"]) -> Float[Values, " K"]:
    """Computes the part of each triangle where a level, linear in it, is negative.

    One vertex apart from the two others cuts off φ_a²/((φ_a − φ_b)(φ_a − φ_c)).
    """
    xp = namespace(level)
    inside = level < 0
    count = inside.sum(1)
    # The lone vertex: the one on the other side of both others.
    lone = xp.argmax(xp.where((count == 1)[:, None], inside, ~inside), 1)
    a, b, c = (
        xp.take_along_axis(level, (lone[:, None] + k) % 3, 1)[:, 0] for k in range(3)
    )
    below = (a - b) * (a - c)
    mixed = (count == 1) | (count == 2)
    corner = xp.where(mixed, a**2 / xp.where(mixed, below, 1), 0)
    return xp.where(count == 3, 1.0, xp.where(count == 2, 1 - corner, corner))


def coverage(skin: Skin, shape: Shape) -> Float[Values, " K"]:
    """Computes the part of each element that is on the sheet."""
    return covered(skin.level[triangles(shape)])


def stiffness_on(
    skin: Skin, shape: Shape, size: Float[Values, "2"]
) -> Float[Values, "K 3 3"]:
    """Computes each whole element's stiffness at 1 S per square: e_i·e_j/4A."""
    corners = skin.points(nodes(shape, size))[triangles(shape)]
    xp = namespace(corners)
    sides = xp.roll(corners, -1, 1) - xp.roll(corners, 1, 1)  # opposite each vertex
    products = (sides[:, :, None] * sides[:, None]).sum(-1)
    return products / (4 * _areas(corners))[:, None, None]


def element_areas(
    skin: Skin | None, shape: Shape, size: Float[Values, "2"]
) -> Float[Values, " K"]:
    """Computes the area of each element's part of the sheet, m²."""
    flat = element_area(shape, size)
    if skin is None:
        return namespace(flat).broadcast_to(flat, (2 * shape[0] * shape[1],))
    part = coverage(skin, shape)
    if skin.surface is None:
        return flat * part
    return part * _areas(skin.points(nodes(shape, size))[triangles(shape)])


def node_parts(
    skin: Skin, shape: Shape, size: Float[Values, "2"]
) -> Float[Values, " nodes"]:
    """Computes the area of the sheet that belongs to each node, m²."""
    part = element_areas(skin, shape, size) / element_area(shape, size)
    vertices = triangles(shape)
    count = np.bincount(vertices.ravel())
    each = part[:, None].repeat(3, 1)
    if namespace(part) is np:
        total = np.bincount(vertices.ravel(), each.ravel())
    else:
        total = namespace(part).zeros_like(skin.level).at[vertices].add(each)
    return total / count.astype(part.dtype) * node_areas(shape, size)


def distances(
    skin: Skin | None, places: Float[Values, "M 2"], others: Float[Values, "n 2"]
) -> Float[Values, "n M"]:
    """Computes squares of distances in space from places to others, m²."""
    if skin is not None:
        places, others = skin.points(places), skin.points(others)
    return sum((b[:, None] - a) ** 2 for a, b in zip(places.T, others.T))


def moves(
    skin: Skin | None, places: Float[Values, "M 2"], cell: Float[Values, "2"]
) -> Float[Values, "M 2 2"]:
    """Computes two steps in the chart that are unit steps in space, at right angles.

    With the chart's metric g the steps are the columns of g^(−1/2).
    """
    xp = namespace(places)
    unit = xp.broadcast_to(xp.eye(2, dtype=places.dtype), (len(places), 2, 2))
    if skin is None or skin.surface is None:
        return unit
    metric = _metric(skin, places, cell)
    # √g = (g + √det·I)/√(trace + 2√det), of two rows.
    root = xp.sqrt(xp.linalg.det(metric))
    whole = (metric + root[:, None, None] * unit) / xp.sqrt(
        xp.trace(metric, axis1=1, axis2=2) + 2 * root
    )[:, None, None]
    return xp.linalg.inv(whole)


def tangents(
    skin: Skin | None, places: Float[Values, "M 2"], cell: Float[Values, "2"]
) -> Float[Values, "M d 2"]:
    """Computes what a step in the chart's x, and in its y, is in space, at places."""
    xp = namespace(places)
    if skin is None or skin.surface is None:
        return xp.broadcast_to(xp.eye(2, dtype=places.dtype), (len(places), 2, 2))
    slopes = [
        (skin.points(places + by) - skin.points(places - by)) / (2 * by.sum())
        for by in xp.diag(_STEP * cell)
    ]
    return xp.stack(slopes, -1)


def _metric(
    skin: Skin, places: Float[Values, "M 2"], cell: Float[Values, "2"]
) -> Float[Values, "M 2 2"]:
    slope = tangents(skin, places, cell)
    return (slope[:, :, :, None] * slope[:, :, None]).sum(1)


def local_cells(
    skin: Skin | None, places: Float[Values, "M 2"], cell: Float[Values, "2"]
) -> Float[Values, "2 ..."]:
    """Computes the sides of the cells in space, at places, m."""
    if skin is None or skin.surface is None:
        return cell[:, None]
    metric = _metric(skin, places, cell)
    xp = namespace(metric)
    return xp.sqrt(xp.diagonal(metric, axis1=1, axis2=2)).T * cell[:, None]


def stretch(
    skin: Skin, places: Float[Values, "M 2"], cell: Float[Values, "2"]
) -> Float[Values, " M"]:
    """Tells by how much the chart stretches lengths at places: 0 where it keeps them."""
    return abs(moves(skin, places, cell) - np.eye(2, dtype=places.dtype)).max((1, 2))


def pinned_node(skin: Skin | None, shape: Shape) -> Int[Values, ""]:
    """Returns the node that is pinned to 0 V: the last, or the one furthest inside."""
    if skin is None:
        last = (shape[0] + 1) * (shape[1] + 1) - 1
        return np.asarray(last, np.int32)
    return skin.level.argmin().astype(np.int32)


def _areas(corners: Float[Values, "K 3 d"]) -> Float[Values, " K"]:
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    dot = (one * other).sum(-1)
    square = (one**2).sum(-1) * (other**2).sum(-1) - dot**2
    xp = namespace(square)
    return xp.sqrt(xp.maximum(square, xp.finfo(square.dtype).tiny)) / 2
