"""Measures how much of an image is explained by the contacts that were read off it."""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from tomojax.kernels.algebra import matmul, where_needed
from tomojax.kernels.contacts import regular, solve_small
from tomojax.kernels.images._contacts import Contacts

# Pixels around a contact, in units of `reach`. (Four of them left twice as many lone
# contacts in doubt.)
_ABOUT = np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j])


# A row has nothing of its own of which less than this part is left, in squares: float32 has
# lost three digits of it then.
_NOTHING = 1e-6


def point_sources(
    basis: Float[Array, "r pixels"],
    contacts: Contacts,
    shape: tuple[int, int],
    cell: Float[Array, "2"],
) -> Float[Array, "C r"]:
    """Interpolates the columns of `basis` at contacts, between pixels linearly; 0: none."""
    return _interpolated(basis, contacts, shape, cell, 1)


def _interpolated(
    basis: Array, contacts: Contacts, shape: tuple[int, int], cell: Array, axis: int
) -> Float[Array, "C r"]:
    """Interpolates `basis`, whose pixels are along `axis`, at contacts; 0: none."""
    columns = jax.vmap(lambda xy: _at(basis, xy / cell - 0.5, shape, axis))(contacts.xy)
    return jnp.where(_there(contacts)[:, None], columns, 0)


def _there(contacts: Contacts) -> Bool[Array, " C"]:
    return jnp.arange(len(contacts.xy)) < contacts.count.astype(int)


def _around(
    columns: Float[Array, "pixels r"],
    contacts: Contacts,
    shape: tuple[int, int],
    cell: Float[Array, "2"],
    reach: tuple[int, int],
) -> Float[Array, "C 8 r"]:
    """Picks the rows of `columns` at pixels `reach` away from each contact; 0: none."""
    away = jnp.asarray(_ABOUT * reach)
    pixel = jnp.round(jnp.nan_to_num(contacts.xy / cell - 0.5)).astype(int)
    i, j = jnp.moveaxis(pixel[:, None] + away, -1, 0)
    i, j = jnp.clip(i, 0, shape[0] - 1), jnp.clip(j, 0, shape[1] - 1)
    rows = jnp.take(columns, i * shape[1] + j, 0, mode="clip")
    return jnp.where(_there(contacts)[:, None, None], rows, 0)


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


def _beside(rows: Float[Array, "n r"], seen: Float[Array, " r"]) -> Float[Array, " r"]:
    """Computes what no combination of `rows` explains of `seen`.

    Rows are taken off one after another (Gram and Schmidt): pixels about a contact have
    nearly the same, and float32 would lose what differs from products of theirs.
    """
    least = _NOTHING * (rows**2).sum() / len(rows)

    def take_off(k: Array, both: Array) -> Array:
        row = both[k]
        square = (row**2).sum()
        share = matmul(both, row) / jnp.where(square > least, square, jnp.inf)
        return both - share[:, None] * row

    both = jnp.concatenate([rows, seen[None]])
    return jax.lax.fori_loop(0, len(rows), take_off, both)[-1]


@cache
def explained_by(
    shape: tuple[int, int], reach: tuple[int, int]
) -> Callable[..., tuple[Array, Array, Array]]:
    """Makes a fit of contacts as point sources: currents, the part left, and the rest.

    The fit takes contacts, an image's coefficients, those of a source at each pixel, and
    the pixels' size. A source's are (pixels × r), and what they are less: None, or a
    product (pixels × q, q × r).
    The rest is what no currents at contacts and `reach` pixels around them explain: their
    size and shape, their place's error and nearby electrodes' errors are not in it.
    """

    def near_of(columns: Array, contacts: Contacts, cell: Array) -> Float[Array, "n _"]:
        points = _interpolated(columns, contacts, shape, cell, 0)
        around = _around(columns, contacts, shape, cell, reach)
        return jnp.concatenate([points, around.reshape(-1, columns.shape[1])])

    def whole(contacts: Contacts, seen: Array, columns: tuple, cell: Array) -> tuple:
        near = near_of(columns[0], contacts, cell)
        if columns[1] is not None:
            near -= matmul(near_of(columns[1][0], contacts, cell), columns[1][1])
        factors, left = explained(near[None, : len(contacts.xy)], seen[None])
        return factors[0], left, _beside(near, seen)

    def lone(contacts: Contacts, *others: Any) -> tuple[Array, Array, Array]:
        first = jax.tree.map(lambda a: a[:1] if a.ndim else a, contacts)
        carried, left, rest = whole(first, *others)
        return jnp.pad(carried, (0, len(contacts.radius) - 1)), left, rest

    return where_needed(whole, lone)
