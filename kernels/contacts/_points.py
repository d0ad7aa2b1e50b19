"""A few compact contacts as sources of current: what they make, and how well it fits.

In each slot the contacts' currents are what fits best (a small linear problem of its own:
variable projection); places and sizes are shared by all slots of a frame.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from tomojax.kernels.contacts._field import Field, field_and_slope, slot_columns
from tomojax.kernels.contacts._whiten import currents, whitened_columns, WhitenedFrame
from tomojax.kernels.sheet import rectangle_green

# ln of the width of what is known of a contact's size beforehand.
SIZE_WIDTH = 0.5

# Parameters of a contact: place, size, and how much longer it is than wide (see `LONG`).
DISC = 5

# What is known beforehand of (a² − b²)/8, half the difference of the second moments of an
# even ellipse: 1 σ, of the usual radius squared. And τ and m of it, see `longness`. Two
# contacts a pitch apart have as much as an ellipse of 2 : 1 a pitch and a half long: data
# hardly tell them apart, and m lies between what is usual of the one and of the other.
LONG, NOT_ROUND, LONGEST = 0.08, 3.0, 5.0

# σ of ln g beyond which a conductance is hardly told: half as much again at nine in ten.
_VAGUE = 0.25

# Of the drive voltage: a contact's own drop is not told more finely.
LEAST_DROP = 0.01


class Sheet(NamedTuple):
    """What the contacts are on."""

    field: Field
    sheet_resistance: Float[Array, ""]
    ground_resistance: Float[Array, "..."]
    drive_voltage: Float[Array, ""]
    unit: Float[Array, ""]  # of the fit's lengths, m
    size: Float[Array, ""]  # usual radius of a contact, m


class Fitted(NamedTuple):
    """Contacts that fit, C of them."""

    place: Float[Array, "C 2"]  # m
    extent: Float[Array, "C 2"]  # from the middle to the end of a bar, m; else 0
    ring: Float[Array, " C"]  # radius of a ring, m; else 0
    radius: Float[Array, " C"]  # of a disc; half the width of a bar or ring, m
    current: Float[Array, "S C"]  # A
    drop: Float[Array, "S C"]  # V0 − u at the contact, V
    voltages: Float[Array, "S M"]  # what they make, V


def round_disc(place: Float[Array, "2"], size: Float[Array, ""]) -> Float[Array, "5"]:
    """Parameters of a contact that is as long as wide."""
    return jnp.concatenate([place, size[None], jnp.zeros(DISC - 3, place.dtype)])


def unpack(sheet: Sheet, parameters: Float[Array, "C n"]) -> tuple[Array, Array]:
    """Places (C, 2) and radii (C,), m; beyond an edge is mirrored to this side of it."""
    size = sheet.field.size
    place = parameters[:, :2] * sheet.unit
    place = size - jnp.abs(size - jnp.abs(place) % (2 * size))
    radius = sheet.size * jnp.exp(SIZE_WIDTH * parameters[:, 2])
    return place, jnp.minimum(radius, sheet.field.radii[-1])


def discs(
    sheet: Sheet, frame: WhitenedFrame, parameters: Float[Array, "C 5"]
) -> tuple[Float[Array, "S W"], Float[Array, " priors"], Fitted]:
    """Contacts about as long as wide; each leans to where its current flows, as metal.

    A disc of radius a whose contact is better than the sheet below it is polarised: its
    current's centre moves by 2πa²κ/ρ·E/I, κ = I₂/I₀(√(gρ/π)) from 0 to 1.
    """
    place, radius = unpack(sheet, parameters)
    moment = LONG * sheet.size**2 * parameters[:, 3:5]
    each = jax.vmap(field_and_slope, (None, 0, 0, 0))
    potential, slope = each(sheet.field, place, radius, moment)
    z = sheet.ground_resistance
    columns = slot_columns(sheet.field, potential, frame.grounds, z)
    whitened = whitened_columns(frame, columns)
    current, _ = currents(frame, whitened)
    drop, pull = _surroundings(sheet, frame, place, radius, potential, slope, current)
    shift = _lean(sheet, radius, current, drop, pull)
    tilt = slope[:, None] - slope[:, frame.grounds][:, :, None]  # (C, S, M, 2)
    moved = jnp.einsum("csmk,sck->csm", tilt, shift, precision="highest")
    whitened = whitened + whitened_columns(frame, moved)
    current, rest = currents(frame, whitened)
    volts = in_volts(columns + moved, current)
    none = jnp.zeros_like(place)
    return (
        rest,
        disc_priors(parameters),
        Fitted(place, none, none[:, 0], radius, current, drop, volts),
    )


def disc_priors(parameters: Float[Array, "C 5"]) -> Float[Array, " priors"]:
    """Lists the priors of sizes and of how long contacts are, in standard deviations."""
    return jnp.concatenate([parameters[:, 2], longness(parameters[:, 3:5]).ravel()])


def longness(long: Float[Array, "C 2"]) -> Float[Array, "C 2"]:
    """What is known beforehand of how long a contact is: round, or not, but not a bar.

    Its square is q²/(1 + q²/τ²) + (q/m)⁴: as q² near 0, about τ² then, a wall from m on.
    """
    square = (long**2).sum(-1, keepdims=True)
    wall = square / LONGEST**4
    return long * jnp.sqrt(1 / (1 + square / NOT_ROUND**2) + wall)


def in_volts(columns: Float[Array, "C S M"], current: Array) -> Array:
    """What currents (S, C) make, V."""
    return jnp.einsum("csm,sc->sm", columns, current, precision="highest")


def green_of(sheet: Sheet, place: Float[Array, "C 2"], radius: Array):
    # Evenly fed discs, whose own mean is that of a rim at a·e^(−1/4).
    rim = radius * float(np.exp(-0.25))
    rho, size = sheet.sheet_resistance, sheet.field.size
    return lambda x: rho * rectangle_green(x, place, rim, size)


def drops(
    sheet: Sheet,
    frame: WhitenedFrame,
    among: Float[Array, "C C"],
    potential: Float[Array, "C M"],
    current: Float[Array, "S C"],
) -> Float[Array, "S C"]:
    """V0 − u at each contact, V.

    u = Σ_c I_c[G(x, x_c) − R_l(x_c)] − I·R_l(x) + I(R_ll + z), I the slot's total; `among`
    G and `potential` R.
    """
    total = current.sum(1, keepdims=True)
    z = jnp.broadcast_to(sheet.ground_resistance, sheet.field.electrodes.shape[:1])
    own = (jnp.diagonal(sheet.field.electrodes) + z)[frame.grounds]
    at_ground = potential[:, frame.grounds].T  # (S, C)
    mean = total[:, 0] * own - (current * at_ground).sum(1)
    u = jnp.matmul(current, among.T, precision="highest") + mean[:, None]
    return sheet.drive_voltage - (u - total * at_ground)


def _surroundings(
    sheet, frame, place, radius, potential, slope, current
) -> tuple[Float[Array, "S C"], Float[Array, "S C 2"]]:
    """V0 − u at each contact, V, and −∇u of what is outside it, V/m."""
    green = green_of(sheet, place, radius)
    among, steep = jax.vmap(lambda x: (green(x), jax.jacfwd(green)(x)))(place)
    drop = drops(sheet, frame, among, potential, current)
    towards = current.sum(1)[:, None, None] * slope[:, frame.grounds].transpose(1, 0, 2)
    pull = towards - jnp.einsum("sd,cdk->sck", current, steep, precision="highest")
    return drop, pull


def hardly_told(
    sheet: Sheet, conductance: Float[Array, " C"], of_size: Float[Array, " C"]
) -> Bool[Array, " C"]:
    """Whether a contact so nearly imposes its potential that its conductance is not told.

    g = I/(V0 − u), and a contact's own part of u is Iρ/2π·ln(1/a): σ of ln g is gρ/2π times
    that of ln a. `of_size`: the variance of the size, of what is known beforehand.
    """
    per_size = SIZE_WIDTH * sheet.sheet_resistance / (2 * np.pi)
    return jnp.abs(conductance) * per_size * jnp.sqrt(of_size) > _VAGUE


def polarisability(sheet: Sheet, conductance: Array, radius: Array) -> Array:
    """2πa²κ/ρ: the dipole that a field makes of a disc of that conductance, A·m per V/m."""
    kappa = metallic(sheet, conductance)
    return 2 * np.pi * radius**2 * kappa / sheet.sheet_resistance


def metallic(sheet: Sheet, conductance: Array | float) -> Array:
    """κ = I₂/I₀(√(gρ/π)), to 2 %: 0 of a contact that draws evenly, 1 of metal."""
    strength = conductance * sheet.sheet_resistance / np.pi  # gρ/π
    return strength / (strength + 8 + 0.8 * jnp.sqrt(strength + 1e-9))


def _lean(
    sheet: Sheet,
    radius: Float[Array, " C"],
    current: Float[Array, "S C"],
    drop: Float[Array, "S C"],
    pull: Float[Array, "S C 2"],
) -> Float[Array, "S C 2"]:
    """How far the centre of a contact's current is from the contact's, m."""
    least = LEAST_DROP * jnp.abs(sheet.drive_voltage)
    forward = jnp.sign(sheet.drive_voltage)
    mean_drop = jnp.maximum((forward * drop).mean(0), least)
    flowing = jnp.maximum((forward * current).mean(0), 0)
    moment = polarisability(sheet, flowing / mean_drop, radius)
    enough = 1e-4 * jnp.abs(current).sum(1, keepdims=True) + 1e-15
    safe = jnp.where(jnp.abs(current) > enough, current, jnp.inf)
    shift = moment[:, None] * pull / safe[..., None]
    # Not out of the contact: where another is near, the dipole alone does not hold.
    longest = 0.6 * radius[:, None]
    length = jnp.sqrt((shift**2).sum(-1, keepdims=True) + 1e-18)
    return shift * jnp.minimum(1, longest / length)
