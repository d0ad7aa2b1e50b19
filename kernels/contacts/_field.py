"""Potentials of electrodes anywhere on the sheet: a table, averaged over discs."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Field(NamedTuple):
    """R_e(x, a): the potential at electrode e per ampere fed into a disc of radius a at x.

    Which is also the mean over the disc of what a current fed into e makes. The table
    covers the sheet from edge to edge; `values` for the A `radii`.
    """

    values: Float[Array, "nx ny A M"]  # Ω
    radii: Float[Array, " A"]  # m
    electrodes: Float[Array, "M M"]  # R_ee', Ω
    size: Float[Array, "2"]  # of the sheet, m


def field_at(
    field: Field, place: Float[Array, "2"], radius: Float[Array, ""]
) -> Float[Array, " M"]:
    """R_e(x, a), Ω, of all electrodes; cubic in x, and in a² through the table's radii.

    Once differentiable. Radii beyond the table's are taken as its last; beyond the edges
    the sheet is mirrored.
    """
    part, nearby = _nearby(field, place)
    along = cubic(part)
    return _mixed(field, radius, along[0][:, None] * along[1], nearby)


def elongated_field_at(
    field: Field,
    place: Float[Array, "2"],
    radius: Float[Array, ""],
    moment: Float[Array, "2"],
) -> Float[Array, " M"]:
    """The same of a contact that is longer than wide: R + ½m₁(R_xx − R_yy) + m₂R_xy.

    `moment`: (xx − yy)/2 and xy of the current's second moments about its centre, m². Of
    their sum nothing is seen but beside electrodes: R is harmonic.
    """
    part, nearby = _nearby(field, place)
    cells = jnp.asarray(field.values.shape[:2], place.dtype) - 1
    per = (cells / field.size)[:, None]  # of cells, 1/m
    along, slope, bend = cubic(part), cubic_slope(part) * per, cubic_bend(part) * per**2
    both = bend[0][:, None] * along[1] - along[0][:, None] * bend[1]
    mixed = slope[0][:, None] * slope[1]
    weights = along[0][:, None] * along[1] + moment[0] / 2 * both + moment[1] * mixed
    return _mixed(field, radius, weights, nearby)


def _nearby(field: Field, place: Float[Array, "2"]) -> tuple[Array, Array]:
    """Finds the place within its cell (2,), and the table's sixteen points around it."""
    nx, ny = field.values.shape[:2]
    cells = jnp.array([nx - 1, ny - 1], place.dtype)
    at = place / field.size * cells
    low = jnp.clip(jnp.floor(at), 0, cells - 1)
    steps = jnp.arange(-1, 3)
    i = mirrored(low[0].astype(int) + steps, nx - 1)
    j = mirrored(low[1].astype(int) + steps, ny - 1)
    nearby = field.values[i[:, None], j[None]]
    return at - low, nearby.reshape(16, -1, field.values.shape[-1])


def _mixed(
    field: Field, radius: Array, weights: Float[Array, "4 4"], nearby: Array
) -> Float[Array, " M"]:
    by_size = lagrange(field.radii**2, jnp.minimum(radius, field.radii[-1]) ** 2)
    flat = weights.ravel()
    return jnp.einsum("n,a,nam->m", flat, by_size, nearby, precision="highest")


def mirrored(index: Array, last: int) -> Array:
    index = jnp.abs(index)
    return jnp.where(index > last, 2 * last - index, index)


def cubic(part: Float[Array, "2"]) -> Float[Array, "2 4"]:
    """Catmull and Rom's weights of four neighbours."""
    t = part[:, None]
    terms = [
        ((2 - t) * t - 1) * t,
        (3 * t - 5) * t**2 + 2,
        ((4 - 3 * t) * t + 1) * t,
        (t - 1) * t**2,
    ]
    return jnp.concatenate(terms, 1) / 2


def cubic_slope(part: Float[Array, "2"]) -> Float[Array, "2 4"]:
    """Their derivatives by `part`."""
    t = part[:, None]
    terms = [(4 - 3 * t) * t - 1, (9 * t - 10) * t, (8 - 9 * t) * t + 1, (3 * t - 2) * t]
    return jnp.concatenate(terms, 1) / 2


def cubic_bend(part: Float[Array, "2"]) -> Float[Array, "2 4"]:
    """Their second derivatives."""
    t = part[:, None]
    return jnp.concatenate([2 - 3 * t, 9 * t - 5, 4 - 9 * t, 3 * t - 1], 1)


def lagrange(nodes: Float[Array, " A"], at: Float[Array, ""]) -> Float[Array, " A"]:
    """Weights of the polynomial through values at `nodes`."""
    own = jnp.eye(len(nodes), dtype=bool)
    above = jnp.where(own, 1, at - nodes[None])
    below = jnp.where(own, 1, nodes[:, None] - nodes[None])
    return jnp.prod(above / below, axis=1)


def slot_columns(
    field: Field,
    potential: Float[Array, "*batch M"],
    grounds: Array,
    ground_resistance: Float[Array, "..."],
    total: Float[Array, "*#batch"] | float = 1.0,
) -> Float[Array, "*batch S M"]:
    """T^l = R_i − R_l + total·(R_ll + z − R_il): voltages per ampere, of each slot.

    `potential` is R(x, a), or a mix of several whose weights add up to `total`.
    """
    ee = field.electrodes
    z = jnp.broadcast_to(ground_resistance, ee.shape[:1])[grounds]
    offset = (ee[grounds, grounds] + z)[:, None] - ee[grounds]
    share = jnp.asarray(total, ee.dtype)[..., None, None]
    return potential[..., None, :] - potential[..., grounds][..., :, None] + share * offset


def field_and_slope(
    field: Field,
    place: Float[Array, "2"],
    radius: Float[Array, ""],
    moment: Float[Array, "2"] | None = None,
) -> tuple[Float[Array, " M"], Float[Array, "M 2"]]:
    """R(x, a) and its gradient along x; of a long contact with its `moment`."""
    if moment is None:
        return field_at(field, place, radius), jax.jacfwd(field_at, 1)(field, place, radius)
    long = elongated_field_at(field, place, radius, moment)
    return long, jax.jacfwd(field_at, 1)(field, place, radius)
