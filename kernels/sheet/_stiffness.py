"""Builds the stiffness of a sheet in contact, P1 elements, as a matrix and as an operator.

A = Σ_k σ_k·∫∇φ∇φᵀ + diag(g). The sheet's conductance is σ (S per square), and a contact's
conductance to an object at 0 V is g (S per node). Contacts sit on nodes, not the elements'
means. So the matrix of a flat sheet has no positive entry off its diagonal, which keeps
every potential between the object's and ground. One node is pinned to 0 V: the last, a
corner of the sheet, or one inside an outline. The choice of the pinned potential drops out
of what is measured.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tomojax.kernels.algebra import BlockTri
from tomojax.kernels.sheet._mesh import (
    block_shape,
    cell_sides,
    namespace,
    Shape,
    triangles,
    Values,
)


def reference_stiffness(
    shape: Shape, size: Float[Values, "2"]
) -> Float[Values, "elements 3 3"]:
    """Computes the stiffness of each element of a flat sheet at 1 S per square.

    A right triangle has legs p (to vertex 1) and q (to vertex 2). The hypotenuse carries
    nothing and the legs are conductances q/2p and p/2q. The first vertex is the right angle
    and the first leg lies along x, see `triangles`.
    """
    dx, dy = cell_sides(shape, size)
    along_x, along_y = dy / (2 * dx), dx / (2 * dy)
    edge_x = np.array([[1, -1, 0], [-1, 1, 0], [0, 0, 0]])
    edge_y = np.array([[1, 0, -1], [0, 0, 0], [-1, 0, 1]])
    one = along_x * edge_x.astype(size.dtype) + along_y * edge_y.astype(size.dtype)
    return namespace(one).broadcast_to(one, (2 * shape[0] * shape[1], 3, 3))


def assemble(
    local: Float[Array, "elements 3 3"],
    contact: Float[Array, " nodes"],
    shape: Shape,
    pinned: Int[Array, ""],
) -> BlockTri:
    """Builds A as a block-tridiagonal matrix, the pinned node's row and column cleared.

    **Arguments:** `local` stiffness of each element, S; `contact` g, S per node; `shape`
    cells of the mesh; `pinned` node.
    **Returns:** blocks (n, b, b) and (n − 1, b, b). The pinned node keeps a diagonal entry
    alone, of the size of the others, so that the scale of the matrix stays even.
    """
    n, b = block_shape(shape)
    vertices = triangles(shape)
    row, column = (
        np.broadcast_to(v, (len(vertices), 3, 3)).ravel()
        for v in (vertices[:, :, None], vertices[:, None, :])
    )
    entries = jnp.where((row != pinned) & (column != pinned), local.ravel(), 0)

    def blocks(keep: np.ndarray, count: int) -> Array:
        at = np.flatnonzero(keep)
        zero = jnp.zeros((count, b, b), local.dtype)
        return zero.at[column[at] // b, row[at] % b, column[at] % b].add(entries[at])

    lower = blocks(row // b == column // b + 1, n - 1)
    diagonal = blocks(row // b == column // b, n)
    diagonal = diagonal + contact.reshape(n, b)[:, :, None] * jnp.eye(b, dtype=local.dtype)
    at = pinned // b, pinned % b, pinned % b
    return BlockTri(diagonal.at[at].set(mean_conductance(local)), lower)


def mean_conductance(local: Float[Array, "elements 3 3"]) -> Float[Array, ""]:
    """Computes a conductance of the size of the elements' own, S."""
    return jnp.trace(local, axis1=1, axis2=2).mean() / 2


def apply(
    local: Float[Array, "elements 3 3"],
    contact: Float[Array, " nodes"],
    shape: Shape,
    potential: Float[Array, "nodes m"],
) -> Float[Array, "nodes m"]:
    """Computes A·u element by element, nothing pinned: the currents (A) that u asks for."""
    vertices = triangles(shape)
    currents = jnp.einsum("kij,kjm->kim", local, potential[vertices], precision="highest")
    return (contact[:, None] * potential).at[vertices].add(currents)


def spread(values: Float[Array, " elements"], shape: Shape) -> Float[Array, " nodes"]:
    """Turns currents per element into currents per node: Σ_k values_k b_k."""
    n, b = block_shape(shape)
    vertices = triangles(shape)
    shares = jnp.broadcast_to(values[:, None] / 3, vertices.shape)
    return jnp.zeros(n * b, values.dtype).at[vertices].add(shares)
