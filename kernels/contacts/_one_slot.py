"""Computes the errors of one slot's voltages, and the voltages that a contact makes.

The functions serve code that takes one slot at a time: few, small operations.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels.algebra import matmul
from tomojax.kernels.contacts._field import (
    cubic,
    Field,
    home_of,
    lagrange,
    nearby_of,
    radii_about,
)
from tomojax.kernels.contacts._points import Sheet, SIZE_WIDTH

# 1 σ of a place and of a size before any slot. A place is in units of the fit, which follow
# from the electrodes: 1 mm for those of 5 mm.
FIRST = (6.0, 6.0, 1.0)

# χ² of a slot's own place beside what was known, of three values: beyond, it is news.
_NEWS = 40.0

# Sizes are no further than this from usual,
_LARGEST = 3.0
# and so much below the largest size of the table.
_BELOW = 1e-3


class Noise(NamedTuple):
    """The errors of a slot's voltages: as in `Errors`, with the longest waves alone."""

    converter: Float[Array, ""]  # V
    own: Float[Array, ""]  # a channel's, as a part of its voltage
    local: Float[Array, "M N"]  # voltages times it: of its voltage's bend and slopes
    smooth: Float[Array, "q M"]  # relative errors that channels have in common, 1 σ each
    offset: Float[Array, ""]  # of a slot, as a part of its mean voltage


class Weights(NamedTuple):
    """B of W' = BBᵀ, the inverse covariance of a slot's errors: see `whitened`."""

    each: Float[Array, " M"]  # 1/σ of a channel's own errors, 0 where it is not used
    common: Float[Array, "q M"]  # one after another, whitened by those before
    part: Float[Array, " q"]  # of each that is taken off


class Plain(NamedTuple):
    """W' = W − wwᵀ(1 − part)/Σw: the inverse covariance where an offset is in common."""

    each: Float[Array, " M"]  # w, the diagonal of W
    whole: Float[Array, ""]  # Σw
    part: Float[Array, ""]  # that counts of what all channels have in common


class OneSlot(NamedTuple):
    """One slot: its voltages, with the sheet, the ground and the errors' weights."""

    sheet: Sheet
    ground: Int[Array, ""]
    weights: Weights
    plain: Plain
    voltages: Float[Array, " M"]


def radius_of(sheet: Sheet, size: Array) -> Array:
    """Computes a contact's radius, m, from its size parameter."""
    return jnp.minimum(sheet.size * jnp.exp(SIZE_WIDTH * size), sheet.field.radii[-1])


@partial(jax.jit, inline=True)  # traced once for all contacts
def tangents(sheet: Sheet, place: Float[Array, "2"], size: Array) -> Float[Array, "4 M"]:
    """Computes R(x, a), Ω, and its derivatives by place (per unit) and size."""
    field: Field = sheet.field
    low, nodes = radii_about(field, radius_of(sheet, size))
    part, nearby = nearby_of(field.values, field.size, place, low, len(nodes))
    nearby = nearby.reshape(-1, nearby.shape[-1])
    cells = jnp.asarray(field.values.shape[:2], place.dtype) - 1

    def weights(moved: Float[Array, "3"]) -> Float[Array, " weights"]:
        along = cubic(part + moved[:2] * (sheet.unit / field.size * cells))
        radius = sheet.size * jnp.exp(SIZE_WIDTH * (size + moved[2]))
        by_size = lagrange(nodes, jnp.minimum(radius, field.radii[-1]) ** 2)
        flat = (along[0][:, None] * along[1]).ravel()
        return (flat[:, None] * by_size).ravel()

    none = jnp.zeros(3, place.dtype)
    all_weights = jnp.concatenate([weights(none)[None], jax.jacfwd(weights)(none).T])
    # XLA would else work each weight out again for each element of a product, forty
    # microseconds a contact.
    return product(jax.lax.optimization_barrier(all_weights), nearby)


def slot_weights(
    noise: Noise, voltages: Float[Array, " M"], used: Bool[Array, " M"]
) -> Weights:
    """Factors the inverse covariance of a slot's errors, one common error after another."""
    near = matmul(voltages, noise.local).reshape(-1, len(voltages))
    own = (noise.own * voltages) ** 2 + (near**2).sum(0)
    variance = noise.converter**2 + own
    each = jnp.where(used, jax.lax.rsqrt(variance), 0)
    size = jnp.abs(voltages)
    flat = jnp.broadcast_to(noise.offset * size.mean(), (1, len(size)))
    common = jnp.concatenate([flat, noise.smooth * size]) * each
    done, parts = [], []
    while len(common):
        # (I + uuᵀ)^-½ = I − uuᵀ·part
        length = jnp.sqrt(1 + (common[0] ** 2).sum())
        parts.append(1 / (length + length**2))
        done.append(common[0])
        common = _without(common[1:], done[-1], parts[-1])
    return Weights(each, jnp.stack(done), jnp.stack(parts))


def whitened(weights: Weights, x: Float[Array, "n M"]) -> Float[Array, "n M"]:
    """Multiplies rows by B, so that a slot's errors have the covariance I.

    Products of such rows are x·W'·yᵀ. W' itself would lose float32's digits: what channels
    have in common is far larger than their own errors.
    """
    x = x * weights.each
    for u, part in zip(weights.common, weights.part):
        x = _without(x, u, part)
    return x


def _without(x: Float[Array, "n M"], u: Float[Array, " M"], part: Array) -> Array:
    return x - (part * matmul(x, u))[:, None] * u


def plain_of(weights: Weights) -> Plain:
    w, u = weights.each**2, weights.common[0]
    return Plain(w, jnp.maximum(w.sum(), 1e-30), 1 / (1 + matmul(u, u)))


def weighed(plain: Plain, x: Float[Array, "n M"]) -> Float[Array, "n M"]:
    """Multiplies rows by the plain inverse covariance of a slot's errors."""
    mean = matmul(x, plain.each) / plain.whole
    return (x - (1 - plain.part) * mean[:, None]) * plain.each


class Beside(NamedTuple):
    """Contacts' columns, and what they leave of a slot's voltages."""

    columns: Float[Array, "C M"]  # V/A
    rest: Float[Array, " M"]  # V
    weighed: Float[Array, "C M"]
    normal: Float[Array, "C C"]  # columns along weighed ones


def beside_columns(
    plain: Plain, columns: Float[Array, "C M"], voltages: Float[Array, " M"]
) -> Beside:
    """Fits columns to voltages by the plain errors."""
    beside = weighed(plain, columns)
    normal = regular(product(columns, beside.T))
    fit = solve_small(normal, matmul(beside, voltages)[:, None])[:, 0]
    return Beside(columns, voltages - matmul(fit, columns), beside, normal)


def all_tangents(
    sheet: Sheet, place: Float[Array, "C 2"], size: Float[Array, " C"]
) -> Float[Array, "C 4 M"]:
    """Computes `tangents` of each contact, one by one as in `product`."""
    return jnp.stack([tangents(sheet, place[c], size[c]) for c in range(len(size))])


def in_slot(
    sheet: Sheet, raw: Float[Array, "C 4 M"], ground: Int[Array, ""]
) -> Float[Array, "C 4 M"]:
    """Computes volts per ampere under one ground, and how a move changes the volts."""
    relative = sheet.slots.relative(raw, ground)
    return relative.at[:, 0].add(sheet.slots.offset(ground))


def first_covariance(dtype) -> Float[Array, "3 3"]:
    return jnp.diag(jnp.asarray(FIRST, dtype) ** 2)


def update(
    slot: OneSlot, columns: Float[Array, "C 4 M"], covariance: Float[Array, "C 3 3"]
) -> tuple[Array, Float[Array, "C 3 3"], Float[Array, "C 3 3"], Float[Array, " C"]]:
    """Returns moves (C, 3), the covariance then and by this slot alone, and currents."""
    c = len(columns)
    others = jnp.concatenate([columns[:, 1:].reshape(3 * c, -1), slot.voltages[None]])
    rows = whitened(slot.weights, jnp.concatenate([columns[:, 0], others]))
    base, others = rows[:c], rows[c:]
    # What no current explains is taken of rows, not of their products: float32 again.
    fit = solve_small(regular(product(base, base.T)), product(base, others.T))
    rest = others - product(fit.T, base)
    gram = product(rest, rest.T)
    share, current = fit[:, :-1], fit[:, -1]
    own = jnp.repeat(current, 3)
    normal = own[:, None] * gram[:-1, :-1] * own
    right = own * gram[:-1, -1]
    unit = jnp.eye(3, dtype=base.dtype)
    blocks = normal.reshape(c, 3, c, 3)[np.arange(c), :, np.arange(c)]
    # News: what this slot says alone is not what was known. Then only what was known before
    # any slot counts.
    before = jnp.diag(1 / jnp.asarray(FIRST, base.dtype) ** 2)
    innovation = (blocks[..., None] * covariance[:, None]).sum(2) + unit
    gain = right.reshape(c, 3)
    matrices = [innovation.transpose(0, 2, 1), covariance, blocks + before]
    all_three = jnp.concatenate(matrices)
    inverses = solve_small(all_three, jnp.broadcast_to(unit, all_three.shape))
    of_innovation, of_covariance, alone = jnp.split(inverses, 3)
    tested = (of_innovation * gain[:, None]).sum(-1)
    unlikely = (tested * (covariance * gain[:, None]).sum(-1)).sum(-1)
    news = (unlikely > _NEWS)[:, None, None]
    inverse = jnp.where(news, before, of_covariance)
    same = np.eye(c, dtype=base.dtype)[:, None, :, None]
    weight = same * inverse[:, :, None]
    found = solve_small(
        normal + weight.reshape(3 * c, 3 * c),
        jnp.concatenate([right[:, None], jnp.eye(3 * c, dtype=base.dtype)], 1),
    )
    moved, spread = found[:, 0].reshape(c, 3), found[:, 1:]
    spread = spread.reshape(c, 3, c, 3)[np.arange(c), :, np.arange(c)]
    longest = jnp.asarray([*FIRST[:2], 1.0], base.dtype)
    return (
        jnp.clip(moved, -longest, longest),
        (spread + spread.transpose(0, 2, 1)) / 2,
        alone,
        current - matmul(share, own * found[:, 0]),
    )


def fitted(
    sheet: Sheet,
    place: Float[Array, "C 2"],
    size: Float[Array, " C"],
    moved: Float[Array, "C 3"],
) -> tuple[Float[Array, "C 2"], Float[Array, " C"]]:
    """Returns places and sizes after a move, on the sheet and in the table."""
    # Off the very edge, where a contact's own potential is infinite.
    edge = 0.1 * sheet.unit
    place = place + moved[:, :2] * sheet.unit
    place = jnp.clip(place, edge, sheet.field.size - edge)
    place = jax.vmap(home_of, (None, 0))(sheet.field, place)
    return place, jnp.clip(size + moved[:, 2], -_LARGEST, _largest(sheet))


def _largest(sheet: Sheet) -> Float[Array, ""]:
    """The largest size: below the largest disc of the table, where slopes by size end.

    At or beyond that a contact that grew in wrong slots would never shrink again.
    """
    table = jnp.log(sheet.field.radii[-1] / sheet.size) / SIZE_WIDTH
    return jnp.minimum(_LARGEST, table - _BELOW)


def product(a: Float[Array, "n k"], b: Float[Array, "k m"]) -> Float[Array, "n m"]:
    """Multiplies a·b, a column or a row at a time.

    For a whole product XLA calls a library. XLA fuses columns or rows with the operations
    around them into one function, where the caller lets it (see `Step`).
    """
    if b.shape[1] <= a.shape[0]:
        return jnp.stack([matmul(a, b[:, j]) for j in range(b.shape[1])], 1)
    return jnp.stack([matmul(a[i], b) for i in range(a.shape[0])])


def regular(normal: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Adds to the diagonal, so that the matrix is not singular."""
    eps = 16 * jnp.finfo(normal.dtype).eps
    diagonal = jnp.diagonal(normal)
    more = eps * diagonal.sum() + jnp.where(diagonal > 0, 0, 1)
    return normal + jnp.diag(more)


def solve_small(
    matrix: Float[Array, "*batch n n"], right: Float[Array, "*batch n k"]
) -> Float[Array, "*batch n k"]:
    """Solves A⁻¹B of a few unknowns, unrolled: a loop's turn costs more than the work."""
    n = matrix.shape[-1]
    both = jnp.concatenate([matrix, right], -1)
    for k in range(n):
        row = both[..., k : k + 1, :] / both[..., k : k + 1, k : k + 1]
        both = jnp.where(
            (np.arange(n) == k)[:, None], row, both - both[..., k : k + 1] * row
        )
    return both[..., n:]
