"""Measures how much of an image is explained by the contacts that were read off it."""

from collections.abc import Callable
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tomojax.kernels.algebra import matmul, solve_positive, where_needed
from tomojax.kernels.contacts import regular, solve_small
from tomojax.kernels.images._contacts import Contacts

# Of nine places, row by row.
_MIDDLE = 4


def point_sources(
    basis: Float[Array, "r pixels"],
    contacts: Contacts,
    shape: tuple[int, int],
    cell: Float[Array, "2"],
) -> Float[Array, "C r"]:
    """Interpolates the columns of `basis` at contacts, between pixels linearly; 0: none."""
    there = jnp.arange(len(contacts.xy)) < contacts.count.astype(int)
    columns = jax.vmap(lambda xy: _at(basis, xy / cell - 0.5, shape, 1))(contacts.xy)
    return jnp.where(there[:, None], columns, 0)


def _nearby(
    columns: Float[Array, "pixels r"],
    contacts: Contacts,
    shape: tuple[int, int],
    cell: Float[Array, "2"],
    about: Int[np.ndarray, "places 2"],
) -> Float[Array, "places C r"]:
    """Interpolates the rows of `columns` so many pixels from each contact; 0: none."""
    there = jnp.arange(len(contacts.xy)) < contacts.count.astype(int)
    pixels = contacts.xy / cell - 0.5 + jnp.asarray(about[:, None], cell.dtype)
    at = jax.vmap(jax.vmap(lambda pixel: _at(columns, pixel, shape, 0)))
    return jnp.where(there[:, None], at(pixels), 0)


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


def _at(basis: Array, pixel: Float[Array, "2"], shape: tuple[int, int], axis: int) -> Array:
    """Interpolates the column at a place in pixels; beyond the edge takes the nearest."""
    last = jnp.asarray(shape, pixel.dtype) - 1
    pixel = jnp.clip(jnp.nan_to_num(pixel), 0, last)
    low = jnp.minimum(jnp.floor(pixel), last - 1)
    (u, v), (i, j) = pixel - low, low.astype(int)
    corner = i * shape[1] + j
    steps = 0, 1, shape[1], shape[1] + 1
    a, b, c, d = (jnp.take(basis, corner + k, axis, mode="clip") for k in steps)
    return (1 - u) * ((1 - v) * a + v * b) + u * ((1 - v) * c + v * d)


@cache
def explained_by(
    shape: tuple[int, int], reach: tuple[int, int]
) -> Callable[..., tuple[Array, Array, Array]]:
    """Makes a fit of contacts as point sources: currents, the part left, and the rest.

    The fit takes contacts, an image's coefficients, those of a source at each pixel (pixels
    × r), and the pixels' size.
    The rest is what no currents within `reach` pixels of the contacts explain: their size
    and shape, their place's error and nearby electrodes' errors are not in it.
    """
    about = np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)]) * reach

    def whole(
        contacts: Contacts, seen: Array, columns: Array, cell: Array
    ) -> tuple[Array, Array, Array]:
        places = _nearby(columns, contacts, shape, cell, about)
        factors, left = explained(places[_MIDDLE][None], seen[None])
        near = places.reshape(-1, len(seen))
        gram, seen_by = matmul(near, near.T), matmul(near, seen)
        amount = solve_positive(regular(gram), seen_by[:, None])[:, 0]
        return factors[0], left, seen - matmul(amount, near)

    def lone(contacts: Contacts, *others: Array) -> tuple[Array, Array, Array]:
        first = jax.tree.map(lambda a: a[:1] if a.ndim else a, contacts)
        carried, left, rest = whole(first, *others)
        return jnp.pad(carried, (0, len(contacts.radius) - 1)), left, rest

    return where_needed(whole, lone)
