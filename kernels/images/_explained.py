"""Measures how much of an image is explained by the contacts that were read off it."""

from collections.abc import Callable
from functools import cache

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tomojax.kernels.algebra import matmul, where_needed
from tomojax.kernels.contacts import regular, solve_small
from tomojax.kernels.images._contacts import Contacts


def point_sources(
    basis: Float[Array, "r pixels"],
    contacts: Contacts,
    shape: tuple[int, int],
    cell: Float[Array, "2"],
) -> Float[Array, "C r"]:
    """Interpolates the columns of `basis` at contacts, between pixels linearly; 0: none."""
    columns = jax.vmap(lambda xy: _at(basis, xy / cell - 0.5, shape))(contacts.xy)
    there = jnp.arange(len(columns)) < contacts.count.astype(int)
    return jnp.where(there[:, None], columns, 0)


def explained(
    columns: Float[Array, "S C q"], seen: Float[Array, "S q"]
) -> tuple[Float[Array, "S C"], Float[Array, ""]]:
    """Fits a factor to each contact's column, slot by slot, and measures what is left.

    That is √(Σ_s min_a ‖d_s − aP_s‖² / Σ_s‖d_s‖²): 1 where all columns are 0.
    """

    def one(p: Float[Array, "C q"], d: Float[Array, " q"]) -> tuple[Array, Array]:
        a = solve_small(regular(matmul(p, p.T)), matmul(p, d)[:, None])[:, 0]
        return a, ((d - matmul(a, p)) ** 2).sum()

    factors, rest = jax.vmap(one)(columns, seen)
    whole = jnp.maximum((seen**2).sum(), jnp.finfo(seen.dtype).tiny)
    return factors, jnp.sqrt(rest.sum() / whole)


def _at(basis: Array, pixel: Float[Array, "2"], shape: tuple[int, int]) -> Array:
    """Interpolates the column at a place in pixels; beyond the edge takes the nearest."""
    last = jnp.asarray(shape, pixel.dtype) - 1
    pixel = jnp.clip(jnp.nan_to_num(pixel), 0, last)
    low = jnp.minimum(jnp.floor(pixel), last - 1)
    (u, v), (i, j) = pixel - low, low.astype(int)
    corner = i * shape[1] + j
    a, b = basis[:, corner], basis[:, corner + 1]
    c, d = basis[:, corner + shape[1]], basis[:, corner + shape[1] + 1]
    return (1 - u) * ((1 - v) * a + v * b) + u * ((1 - v) * c + v * d)


@cache
def explained_by(shape: tuple[int, int]) -> Callable[..., tuple[Array, Array]]:
    """Makes a fit of contacts as point sources: their currents, and what they leave."""

    def whole(
        contacts: Contacts, seen: Array, basis: Array, through: Array, cell: Array
    ) -> tuple[Array, Array]:
        points = matmul(point_sources(basis, contacts, shape, cell), through.T)
        factors, left = explained(points[None], seen[None])
        return factors[0], left

    def lone(contacts: Contacts, *others: Array) -> tuple[Array, Array]:
        first = jax.tree.map(lambda a: a[:1] if a.ndim else a, contacts)
        carried, left = whole(first, *others)
        return jnp.pad(carried, (0, len(contacts.radius) - 1)), left

    return where_needed(whole, lone)
