"""Describes a few compact contacts as sources of current: parameters, slopes and drops.

In each slot the contacts' currents are the best fit (a small linear problem of its own:
variable projection). All slots of a frame share places and sizes.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels.contacts._field import among_at, Field, margin_of, Near
from tomojax.kernels.sheet import rectangle_green, rectangle_slope, Slots

# ln of the width of what is known of a contact's size beforehand.
SIZE_WIDTH = 0.5

# Parameters of a contact: place, size, how much longer it is than wide (see `LONG`), and ln
# of its conductance beside what its mean potential tells (of patches; 0 of discs).
DISC = 6

# What is known beforehand of (a² − b²)/8, half the difference of the second moments of an
# even ellipse: 1 σ, of the usual radius squared.
LONG = 0.08

# τ of `longness`, in σ.
NOT_ROUND = 3.0

# m of `longness`, in σ. Two contacts a pitch apart have as much as an ellipse of 2 : 1 a
# pitch and a half long: data hardly tell them apart, and m lies between what is usual of
# the one and of the other.
LONGEST = 5.0

# σ of ln g beyond which a conductance is hardly told: half as much again at nine in ten.
_VAGUE = 0.25

# A curve's points have this part of a usual radius, and so has half a ring's width.
NARROW = 0.5

# Of the drive voltage: a contact's own drop is not told more finely.
LEAST_DROP = 0.01


class Sheet(NamedTuple):
    """The sheet that the contacts touch, and the units of a fit."""

    field: Field
    thin: Float[Array, "nx ny M"]  # the same for a curve's points, see `thin_of`
    sheet_resistance: Float[Array, ""]
    slots: Slots
    drive_voltage: Float[Array, ""]
    unit: Float[Array, ""]  # of the fit's lengths, m
    size: Float[Array, ""]  # usual radius of a contact, m
    near: Near | None = None  # for patches


class Fitted(NamedTuple):
    """C contacts that fit a frame."""

    place: Float[Array, "C 2"]  # m
    extent: Float[Array, "C 2"]  # from the middle to the end of a bar, m; else 0
    ring: Float[Array, " C"]  # radius of a ring, m; else 0
    radius: Float[Array, " C"]  # of a disc; half the width of a bar or ring, m
    current: Float[Array, "S C"]  # A
    drop: Float[Array, "S C"]  # V0 − u at the contact, V
    voltages: Float[Array, "S M"]  # what they make, V


def unpack(sheet: Sheet, parameters: Float[Array, "C n"]) -> tuple[Array, Array]:
    """Returns places (C, 2) and radii (C,), m; mirrors a place beyond an edge back."""
    size = sheet.field.size
    place = parameters[:, :2] * sheet.unit
    place = size - jnp.abs(size - jnp.abs(place) % (2 * size))
    radius = sheet.size * jnp.exp(SIZE_WIDTH * parameters[:, 2])
    return place, jnp.minimum(radius, sheet.field.radii[-1])


def longness(long: Float[Array, "*C 2"]) -> Float[Array, "*C 2"]:
    """Weighs how long a contact is by the prior: round, or longer, but not a bar.

    The square of the result is q²/(1 + q²/τ²) + (q/m)⁴: q² near 0, then about τ², and a
    wall from m on.
    """
    square = (long**2).sum(-1, keepdims=True)
    wall = square / LONGEST**4
    return long * jnp.sqrt(1 / (1 + square / NOT_ROUND**2) + wall)


def green_of(sheet: Sheet, place: Float[Array, "C 2"], radius: Array):
    """Returns the function x ↦ ρ·G(x, place), V for each ampere that a disc feeds in."""
    # Evenly fed discs, whose own mean is that of a rim at a·e^(−1/4).
    rim, field = radius * float(np.exp(-0.25)), sheet.field
    rho, size, margin = sheet.sheet_resistance, field.size, margin_of(field)

    def green(x: Float[Array, "2"]) -> Float[Array, " C"]:
        even = rho * rectangle_green(x + margin, place + margin, rim, size + 2 * margin)
        if field.among is None:
            return even
        return even + jax.vmap(among_at, (None, 0, None))(field, place, x)

    return green


def slope_of(
    sheet: Sheet, place: Float[Array, "C 2"], radius: Float[Array, " C"]
) -> Float[Array, "C C 2"]:
    """Computes ∇ at each place of the potential of one ampere into each disc, Ω/m."""
    rim, margin = radius * float(np.exp(-0.25)), margin_of(sheet.field)
    size, at = sheet.field.size + 2 * margin, place + margin
    slope = sheet.sheet_resistance * rectangle_slope(at[:, None], at, rim, size)
    if sheet.field.among is None:
        return slope
    of_other = jax.vmap(jax.grad(among_at, 1), (None, None, 0))
    return slope + jax.vmap(of_other, (None, 0, None))(sheet.field, place, place)


def drops(
    sheet: Sheet,
    which: Int[Array, " S"],
    among: Float[Array, "C C"],
    level: Float[Array, "S C"],
    sunk: Float[Array, "S C"],
    current: Float[Array, "S C"],
) -> Float[Array, "S C"]:
    """Computes V0 − u at each contact, V.

    u = Σ_c I_c[G(x, x_c) − R_l(x_c)] − I·R_l(x) + I(R_ll + z), I the slot's total current;
    `among` is G, and `level` and `sunk` are R_l(x_c), as `Slots` have them.
    """
    total = current.sum(1, keepdims=True)
    mean = total[:, 0] * sheet.slots.path(which) - (current * level).sum(1)
    u = jnp.matmul(current, among.T, precision="highest") + mean[:, None]
    return sheet.drive_voltage - (u - total * sunk)


def hardly_told(
    sheet: Sheet, conductance: Float[Array, " C"], of_size: Float[Array, " C"]
) -> Bool[Array, " C"]:
    """Finds contacts that nearly impose their potential, so that g is hardly known.

    g = I/(V0 − u), and a contact's own part of u is Iρ/2π·ln(1/a). So σ of ln g is gρ/2π
    times σ of ln a. `of_size`: the variance of the size, in units of the prior's variance.
    """
    per_size = SIZE_WIDTH * sheet.sheet_resistance / (2 * np.pi)
    return jnp.abs(conductance) * per_size * jnp.sqrt(of_size) > _VAGUE


def not_beyond(
    shift: Float[Array, "*slots C 2"], radius: Float[Array, " C"]
) -> Float[Array, "*slots C 2"]:
    """Shortens what moves a current's middle, so that the middle stays in the contact.

    The dipole alone does not hold where another contact is near.
    """
    return shift * kept_within(shift, radius[:, None])


def kept_within(shift: Float[Array, "*n 2"], radius: Array) -> Float[Array, "*n 1"]:
    """Returns the part of a shift, 1 at most, that ends within 0.6 of the radius."""
    length = jnp.sqrt((shift**2).sum(-1, keepdims=True) + 1e-18)
    return jnp.minimum(1, 0.6 * radius / length)


def polarisability(sheet: Sheet, conductance: Array, radius: Array) -> Array:
    """Computes 2πa²κ/ρ: the dipole of a conducting disc in a field, A·m per V/m."""
    kappa = metallic(sheet, conductance)
    return 2 * np.pi * radius**2 * kappa / sheet.sheet_resistance


def metallic(sheet: Sheet, conductance: Array | float) -> Array:
    """Computes κ = I₂/I₀(√(gρ/π)), to 2 %: 0 for an evenly drawing contact, 1 for metal."""
    strength = conductance * sheet.sheet_resistance / np.pi  # gρ/π
    return strength / (strength + 8 + 0.8 * jnp.sqrt(strength + 1e-9))
