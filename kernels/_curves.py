"""One long contact as a curve of points: a bar, or the rim of something round and wide.

Its current along the curve is a sum of a few modes, other ones in each slot: near the
ground more flows.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax.kernels._field import field_at, slot_columns
from tomojax.kernels._points import drops, Fitted, green_of, in_volts, Sheet, unpack
from tomojax.kernels._whiten import currents, Frame, whitened_columns

# Points on the axis of a bar, and around a ring; a mode's current is this part of the
# mean's, about.
_ALONG, _AROUND, _UNEVEN = 9, 16, 0.6

# Half a ring's width, of a contact's usual radius.
_RIM = 0.5


def bar(
    sheet: Sheet, frame: Frame, parameters: Float[Array, "5"]
) -> tuple[Float[Array, "S W"], Float[Array, " priors"], Fitted]:
    """Middle, from there to its end, half its width; modes: Legendre's P₀, P₁, P₂."""
    shape = jnp.concatenate([parameters[:2], parameters[4:]])[None]
    place, radius = unpack(sheet, shape)
    extent = parameters[2:4] * sheet.unit
    nodes, weights = np.polynomial.legendre.leggauss(_ALONG)
    modes = np.stack([np.ones(_ALONG), nodes, 1.5 * nodes**2 - 0.5])
    at = place[0] + jnp.asarray(nodes, place.dtype)[:, None] * extent
    rest, penalty, current, drop, volts = _curve(
        sheet, frame, at, weights / 2, modes, radius[0]
    )
    priors = jnp.concatenate([penalty, parameters[4:]])
    ring = jnp.zeros_like(radius)
    return rest, priors, Fitted(place, extent[None], ring, radius, current, drop, volts)


def ring(
    sheet: Sheet, frame: Frame, parameters: Float[Array, "3"]
) -> tuple[Float[Array, "S W"], Float[Array, " priors"], Fitted]:
    """Middle and radius of a rim; modes: 1, cos, sin of the angle and of its double."""
    place, _ = unpack(sheet, parameters[None])
    wide = jnp.abs(parameters[2]) * sheet.unit
    angle = 2 * np.pi * np.arange(_AROUND) / _AROUND
    waves = [f(k * angle) for k in (1, 2) for f in (np.cos, np.sin)]
    modes = np.stack([np.ones(_AROUND), *waves])
    around = jnp.asarray(np.stack([modes[1], modes[2]], 1), place.dtype)
    radius = _RIM * sheet.size
    rest, penalty, current, drop, volts = _curve(
        sheet, frame, place[0] + wide * around, np.full(_AROUND, 1 / _AROUND), modes, radius
    )
    none = jnp.zeros_like(place)
    fitted = Fitted(place, none, wide[None], radius[None], current, drop, volts)
    return rest, penalty, fitted


def _curve(
    sheet: Sheet,
    frame: Frame,
    at: Float[Array, "N 2"],
    weights: np.ndarray,
    modes: np.ndarray,
    radius: Float[Array, ""],
) -> tuple[Array, Array, Array, Array, Array]:
    """What is left, priors, total current (S, 1), mean drop (S, 1) and voltages."""
    dtype = at.dtype
    shares = jnp.asarray(modes * weights, dtype)
    each = jax.vmap(field_at, (None, 0, None))(sheet.field, at, radius)
    potential = jnp.matmul(shares, each, precision="highest")
    # Modes beyond the first carry nothing in all.
    total = jnp.asarray(np.eye(len(modes))[0], dtype)
    z = sheet.ground_resistance
    columns = slot_columns(sheet.field, potential, frame.grounds, z, total)
    whitened = whitened_columns(frame, columns)
    even, _ = currents(frame, whitened[:1])
    uneven = 1 / (_UNEVEN * jnp.abs(even) + 1e-15) ** 2
    ridge = uneven * (1 - total)
    current, rest = currents(frame, whitened, ridge)
    penalty = (current * jnp.sqrt(uneven))[:, 1:].ravel()
    volts = in_volts(columns, current)
    among = jax.vmap(green_of(sheet, at, jnp.full(len(at), radius)))(at)
    fed = jnp.matmul(current, shares, precision="highest")
    drop = drops(sheet, frame, among, each, fed)
    drop = jnp.matmul(drop, jnp.asarray(weights, dtype)[:, None], precision="highest")
    return rest, penalty, current[:, :1], drop, volts
