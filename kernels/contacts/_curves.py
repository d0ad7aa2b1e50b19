"""One long contact as a curve of points: a bar, or the rim of something round and wide.

Its current along the curve is what an even contact of some conductance lets flow: metal
has one potential, so that more flows at ends and, in each slot, towards the ground. What
is uneven beside that is a sum of a few modes, other ones in each slot.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax.kernels.algebra import solve_positive
from tomojax.kernels.contacts._field import field_at, slot_columns
from tomojax.kernels.contacts._points import (
    drops,
    Fitted,
    green_of,
    in_volts,
    Sheet,
    unpack,
)
from tomojax.kernels.contacts._whiten import currents, whitened_columns, WhitenedFrame

# Points on the axis of a bar, and around a ring; a mode's current is this part of the
# mean's, about.
_ALONG, _AROUND, _UNEVEN = 9, 16, 0.3

# Two rows along a bar, and how wide each is, of half its width.
_ROW, _NARROW = 0.58, 0.5

# Half a ring's width, of a contact's usual radius.
_RIM = 0.5

# Conductance that is likely beforehand, beside a square of the sheet, and ln of how far
# from that it may be: from a current source to metal.
_STRENGTH, _STRENGTH_WIDTH = 30.0, 1.5


def bar(
    sheet: Sheet, frame: WhitenedFrame, parameters: Float[Array, "6"]
) -> tuple[Float[Array, "S W"], Float[Array, " priors"], Fitted]:
    """Middle, from there to its end, half its width, strength; modes: Legendre's."""
    shape = jnp.concatenate([parameters[:2], parameters[4:5]])[None]
    place, radius = unpack(sheet, shape)
    extent = parameters[2:4] * sheet.unit
    nodes, weights = np.polynomial.legendre.leggauss(_ALONG)
    # Two rows: of metal, what flows is at its rim.
    nodes, weights = np.tile(nodes, 2), np.tile(weights, 2) / 4
    modes = np.stack([np.ones(2 * _ALONG), nodes, 1.5 * nodes**2 - 0.5])
    along = extent / jnp.sqrt((extent**2).sum() + 1e-12)
    side = np.repeat([_ROW, -_ROW], _ALONG)
    across = jnp.stack([-along[1], along[0]]) * radius[0]
    at = place[0] + jnp.asarray(nodes, place.dtype)[:, None] * extent
    at = at + jnp.asarray(side, place.dtype)[:, None] * across
    rest, penalty, current, drop, volts = _curve(
        sheet, frame, at, weights, modes, _NARROW * radius[0], parameters[5]
    )
    priors = jnp.concatenate([penalty, parameters[4:]])
    ring = jnp.zeros_like(radius)
    return rest, priors, Fitted(place, extent[None], ring, radius, current, drop, volts)


def ring(
    sheet: Sheet, frame: WhitenedFrame, parameters: Float[Array, "4"]
) -> tuple[Float[Array, "S W"], Float[Array, " priors"], Fitted]:
    """Middle, radius and strength of a rim; modes: cos, sin of the angle and its double."""
    place, _ = unpack(sheet, parameters[None, :3])
    wide = jnp.abs(parameters[2]) * sheet.unit
    angle = 2 * np.pi * np.arange(_AROUND) / _AROUND
    waves = [f(k * angle) for k in (1, 2) for f in (np.cos, np.sin)]
    modes = np.stack([np.ones(_AROUND), *waves])
    around = jnp.asarray(np.stack([modes[1], modes[2]], 1), place.dtype)
    radius = _RIM * sheet.size
    even, at = np.full(_AROUND, 1 / _AROUND), place[0] + wide * around
    rest, penalty, current, drop, volts = _curve(
        sheet, frame, at, even, modes, radius, parameters[3]
    )
    none = jnp.zeros_like(place)
    fitted = Fitted(place, none, wide[None], radius[None], current, drop, volts)
    return rest, jnp.append(penalty, parameters[3]), fitted


def _curve(
    sheet: Sheet,
    frame: WhitenedFrame,
    at: Float[Array, "N 2"],
    weights: np.ndarray,
    modes: np.ndarray,
    radius: Float[Array, ""],
    strength: Float[Array, ""],
) -> tuple[Array, Array, Array, Array, Array]:
    """What is left, priors, total current (S, 1), mean drop (S, 1) and voltages."""
    dtype = at.dtype
    each = jax.vmap(field_at, (None, 0, None))(sheet.field, at, radius)
    among = jax.vmap(green_of(sheet, at, jnp.full(len(at), radius)))(at)
    conductance = _STRENGTH * jnp.exp(_STRENGTH_WIDTH * strength) / sheet.sheet_resistance
    own = 1 / (conductance * jnp.asarray(weights, dtype))
    base = _even(among, own, each[:, frame.grounds]).T  # (S, N)
    # Modes carry nothing in all.
    shares = jnp.asarray(modes[1:] * weights, dtype)
    total = jnp.asarray(np.eye(len(modes))[0], dtype)
    z = sheet.ground_resistance

    def in_slot(potential: Array, ground: Array, whole: float) -> Array:
        return slot_columns(sheet.field, potential, ground[None], z, whole)[..., 0, :]

    first = jnp.matmul(base, each, precision="highest")
    first = jax.vmap(in_slot, (0, 0, None))(first, frame.grounds, 1.0)
    potential = jnp.matmul(shares, each, precision="highest")
    zero = jnp.zeros(len(shares), dtype)
    others = slot_columns(sheet.field, potential, frame.grounds, z, zero)
    columns = jnp.concatenate([first[None], others])
    whitened = whitened_columns(frame, columns)
    even, _ = currents(frame, whitened[:1])
    uneven = 1 / (_UNEVEN * jnp.abs(even) + 1e-15) ** 2
    ridge = uneven * (1 - total)
    current, rest = currents(frame, whitened, ridge)
    penalty = (current * jnp.sqrt(uneven))[:, 1:].ravel()
    volts = in_volts(columns, current)
    fed = current[:, :1] * base + jnp.matmul(current[:, 1:], shares, precision="highest")
    drop = drops(sheet, frame.grounds, among, each[:, frame.grounds].T, fed)
    drop = jnp.matmul(drop, jnp.asarray(weights, dtype)[:, None], precision="highest")
    return rest, penalty, current[:, :1], drop, volts


def _even(
    among: Float[Array, "N N"], own: Float[Array, " N"], at_ground: Float[Array, "N S"]
) -> Float[Array, "N S"]:
    """Shares of a slot's current that flow at each point of an even contact.

    (G + r)q = a + I·R_l(x), from V0 − u = r·q, whatever V0 is; Σq = I.
    """
    mean = jnp.trace(among) / len(own)
    # Points nearer to each other than they are wide would make it singular.
    matrix = among + jnp.diag(own + 0.01 * mean)
    one = jnp.ones_like(own)[:, None]
    found = solve_positive(matrix, jnp.concatenate([one, at_ground], 1))
    alone, towards = found[:, :1], found[:, 1:]
    return towards + (1 - towards.sum(0)) / alone.sum() * alone
