"""Builds the structured triangle mesh of a rectangle: numbering and geometry, no physics.

A rectangle has `shape = (nx, ny)` cells; each cell is cut into two right triangles. The
diagonals alternate like a checkerboard. So the mesh has every mirror symmetry of the
rectangle if `nx` and `ny` are even. Numbering is static (NumPy), places are not.
"""

from functools import lru_cache
from typing import Any, TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Shape = tuple[int, int]

# Arrays of JAX, or of NumPy where nothing is to be compiled. A result is of the arguments'
# kind, which a type checker cannot follow.
if TYPE_CHECKING:
    Values = Any
else:
    Values = Array | np.ndarray | np.generic


def namespace(values: Any) -> Any:
    """Returns NumPy for NumPy's values, else JAX's NumPy."""
    return np if isinstance(values, np.ndarray | np.generic) else jnp


def block_shape(shape: Shape) -> Shape:
    """Returns the number of blocks, and nodes per block: a block is a line of the mesh.

    Lines run across the longer side, and are as long as the shorter side. The cost of a
    factorisation grows with the cube of the block.
    """
    nx, ny = shape
    return max(nx, ny) + 1, min(nx, ny) + 1


def _node_number(shape: Shape, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    nx, ny = shape
    return i * (ny + 1) + j if nx >= ny else j * (nx + 1) + i


@lru_cache
def triangles(shape: Shape) -> np.ndarray:
    """Lists the vertices (K, 3) of the K = 2·nx·ny triangles, the right angle first.

    Element k = 2·(i·ny + j) + half is in cell (i, j): `reshape(nx, ny, 2)` is an image.
    """
    nx, ny = shape
    i, j = np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
    corner = {(a, b): _node_number(shape, i + a, j + b) for a in (0, 1) for b in (0, 1)}
    rising = (i + j) % 2 == 0  # the diagonal runs from (0, 0) to (1, 1)

    def half(up: tuple, down: tuple) -> np.ndarray:
        return np.stack(
            [np.where(rising, corner[u], corner[d]) for u, d in zip(up, down)], -1
        )

    lower = half(((1, 0), (0, 0), (1, 1)), ((0, 0), (1, 0), (0, 1)))
    upper = half(((0, 1), (1, 1), (0, 0)), ((1, 1), (0, 1), (1, 0)))
    # The same integers with and without `jax.enable_x64`: an array that is kept is a
    # constant that JAX may have converted already.
    return np.stack([lower, upper], 2).reshape(-1, 3).astype(np.int32)


@lru_cache
def _node_index(shape: Shape) -> np.ndarray:
    """Lists the grid index (i, j) of each node, (N, 2)."""
    nx, ny = shape
    i, j = np.meshgrid(np.arange(nx + 1), np.arange(ny + 1), indexing="ij")
    index = np.zeros(((nx + 1) * (ny + 1), 2), int)
    index[_node_number(shape, i, j).ravel()] = np.stack([i, j], -1).reshape(-1, 2)
    return index


def nodes(shape: Shape, size: Float[Values, "2"]) -> Float[Values, "nodes 2"]:
    """Computes places of the nodes, m."""
    return (_node_index(shape) / np.array(shape)).astype(size.dtype) * size


def node_image(values: np.ndarray, shape: Shape) -> np.ndarray:
    """Arranges nodes' values as an image (nx + 1, ny + 1)."""
    nx, ny = shape
    return values.reshape(nx + 1, ny + 1) if nx >= ny else values.reshape(ny + 1, nx + 1).T


@lru_cache
def cell_centres(shape: Shape) -> Float[np.ndarray, "cells 2"]:
    """Computes centres of a grid's cells on the unit square, with y counting fastest."""
    x, y = ((np.arange(n) + 0.5) / n for n in shape)
    return np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)


def cell_sides(shape: Shape, size: Float[Values, "2"]) -> Float[Values, "2"]:
    """Computes the sides of a cell, m."""
    return size / np.array(shape, size.dtype)


def node_areas(shape: Shape, size: Float[Values, "2"]) -> Float[Values, " nodes"]:
    """Computes the area that belongs to each node, m²: a cell inside, half at an edge."""
    index = _node_index(shape)
    inside = np.where((index == 0) | (index == np.array(shape)), 0.5, 1.0).prod(-1)
    return inside.astype(size.dtype) * cell_sides(shape, size).prod()


def centroids(shape: Shape, size: Float[Values, "2"]) -> Float[Values, "elements 2"]:
    """Computes centroids of the elements, m."""
    unit = (_node_index(shape) / np.array(shape))[triangles(shape)].mean(1)
    return unit.astype(size.dtype) * size


def element_area(shape: Shape, size: Float[Values, "2"]) -> Float[Values, ""]:
    """Computes the area of one element, m²: all are equal."""
    return cell_sides(shape, size).prod() / 2


def subpoints(
    shape: Shape, size: Float[Values, "2"], level: int = 2
) -> Float[Values, "elements points 2"]:
    """Computes the centroids of the 4^level equal triangles within each element, m."""
    weights = np.eye(3)[None]  # (triangles, corners, barycentric)
    for _ in range(level):
        mid = (weights + np.roll(weights, -1, 1)) / 2
        parts = [mid] + [
            np.stack([weights[:, c], mid[:, c], mid[:, c - 1]], 1) for c in range(3)
        ]
        weights = np.concatenate(parts)
    corners = (_node_index(shape) / np.array(shape))[triangles(shape)]
    unit = np.einsum("pb,kbd->kpd", weights.mean(1), corners)
    return unit.astype(size.dtype) * size
