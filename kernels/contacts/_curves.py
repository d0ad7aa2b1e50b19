"""One long contact as a curve of points: a bar, or the rim of something round and wide.

Its current along the curve is what an even contact of some conductance lets flow: metal
has one potential, so that more flows at ends and, in each slot, towards the ground. What
is uneven beside that is a sum of a few modes, other ones in each slot. Slopes leave out
how those shares change with place and shape: modes make up for it.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax.kernels.algebra import Limits, solve_positive
from tomojax.kernels.contacts._equations import currents_of, Explained, made_by
from tomojax.kernels.contacts._field import slot_columns, thin_rows_at
from tomojax.kernels.contacts._points import (
    drops,
    Fitted,
    green_of,
    NARROW,
    Sheet,
    SIZE_WIDTH,
    unpack,
)
from tomojax.kernels.contacts._whiten import whitened_rows, WhitenedFrame

# Points on the axis of a bar, and around a ring; a mode's current is this part of the
# mean's, about.
_ALONG, _AROUND, _UNEVEN = 9, 16, 0.3

# Two rows along a bar, of half its width.
_ROW = 0.58

# Conductance that is likely beforehand, beside a square of the sheet, and ln of how far
# from that it may be: from a current source to metal.
_STRENGTH, _STRENGTH_WIDTH = 30.0, 1.5

# The longest step of each parameter, as `discs` has them; a ring's radius as a place.
_LONGEST_BAR = 6.0, 6.0, 6.0, 6.0, 0.7, 1.0
_LONGEST_RING = 6.0, 6.0, 4.0, 1.0


def bar(sheet: Sheet, frame: WhitenedFrame, parameters: Float[Array, "6"]) -> Explained:
    """Middle, from there to its end, half its width, strength; modes: Legendre's."""
    nodes, weights = np.polynomial.legendre.leggauss(_ALONG)
    # Two rows: of metal, what flows is at its rim.
    nodes, weights = np.tile(nodes, 2), np.tile(weights, 2) / 4
    modes = np.stack([np.ones(2 * _ALONG), nodes, 1.5 * nodes**2 - 0.5])
    side = np.repeat([_ROW, -_ROW], _ALONG)

    def points(p: Float[Array, "6"]) -> Float[Array, "N 2"]:
        place, radius, extent = _stretch(sheet, p)
        along = extent / jnp.sqrt((extent**2).sum() + 1e-12)
        across = jnp.stack([-along[1], along[0]]) * radius
        at = place + jnp.asarray(nodes, p.dtype)[:, None] * extent
        return at + jnp.asarray(side, p.dtype)[:, None] * across

    place, radius, extent = _stretch(sheet, parameters)
    shape = place[None], extent[None], jnp.zeros_like(radius)[None], radius[None]
    known = np.eye(6)[4:]
    return _curve(sheet, frame, points, weights, modes, shape, known, parameters)


def ring(sheet: Sheet, frame: WhitenedFrame, parameters: Float[Array, "4"]) -> Explained:
    """Middle, radius and strength of a rim; modes: cos, sin of the angle and its double."""
    angle = 2 * np.pi * np.arange(_AROUND) / _AROUND
    waves = [f(k * angle) for k in (1, 2) for f in (np.cos, np.sin)]
    modes = np.stack([np.ones(_AROUND), *waves])
    around = np.stack([modes[1], modes[2]], 1)

    def points(p: Float[Array, "4"]) -> Float[Array, "N 2"]:
        place, _ = unpack(sheet, p[None, :3])
        return place[0] + jnp.abs(p[2]) * sheet.unit * jnp.asarray(around, p.dtype)

    place, _ = unpack(sheet, parameters[None, :3])
    wide = jnp.abs(parameters[2:3]) * sheet.unit
    shape = place, jnp.zeros_like(place), wide, NARROW * sheet.size[None]
    even, known = np.full(_AROUND, 1 / _AROUND), np.eye(4)[3:]
    return _curve(sheet, frame, points, even, modes, shape, known, parameters)


def limits_of_bar(sheet: Sheet) -> Limits:
    """A bar is at most as wide as the table's largest disc. See `_LONGEST_BAR`."""
    largest = jnp.log(sheet.field.radii[-1] / sheet.size) / SIZE_WIDTH
    highest = jnp.where(jnp.arange(6) == 4, largest, jnp.inf)
    return Limits(highest, jnp.asarray(_LONGEST_BAR, highest.dtype))


def limits_of_ring(sheet: Sheet) -> Limits:
    """A ring has no largest value. See `_LONGEST_RING`."""
    longest = jnp.asarray(_LONGEST_RING, sheet.size.dtype)
    return Limits(jnp.full_like(longest, jnp.inf), longest)


def _stretch(sheet: Sheet, p: Float[Array, "6"]) -> tuple[Array, Array, Array]:
    place, radius = unpack(sheet, jnp.concatenate([p[:2], p[4:5]])[None])
    return place[0], radius[0], p[2:4] * sheet.unit


def _curve(
    sheet: Sheet,
    frame: WhitenedFrame,
    points: Callable[[Array], Float[Array, "N 2"]],
    weights: np.ndarray,
    modes: np.ndarray,
    shape: tuple[Array, Array, Array, Array],
    known: np.ndarray,
    parameters: Float[Array, " P"],
) -> Explained:
    """A curve whose last parameter is its strength; `known` are those with a prior."""
    dtype, slots = parameters.dtype, len(frame.grounds)
    at = points(parameters)
    rows = jax.vmap(thin_rows_at, (None, None, 0))(sheet.thin, sheet.field.size, at)
    green = green_of(sheet, at, jnp.full(len(at), NARROW * sheet.size))
    among = jax.vmap(green)(at)
    strength = _STRENGTH * jnp.exp(_STRENGTH_WIDTH * parameters[-1])
    own = sheet.sheet_resistance / (strength * jnp.asarray(weights, dtype))
    at_grounds = rows[:, 0, frame.grounds]
    base, by_strength = (a.T for a in _even(among, own, at_grounds))  # (S, N)
    # Modes carry nothing in all.
    shares = jnp.asarray(modes[1:] * weights, dtype)
    each = _made(base, rows[:, 0])[:, None]
    others = jnp.broadcast_to(
        _made(shares, rows[:, 0]), (slots, len(shares), rows.shape[-1])
    )
    total = jnp.asarray(np.eye(len(modes))[0], dtype)
    columns = _in_slots(sheet, frame, jnp.concatenate([each, others], 1), total)
    column = whitened_rows(frame, columns)
    flowing = currents_of(column[:, :1], frame.whitened)
    # What is known of the modes: further values that are measured as 0.
    stiff = 1 / (_UNEVEN * jnp.abs(flowing) + 1e-15)
    more = stiff[..., None] * jnp.eye(len(modes), dtype=dtype)[:, 1:]
    column = jnp.concatenate([column, more], -1)
    measured = jnp.pad(frame.whitened, ((0, 0), (0, len(shares))))
    current = currents_of(column, measured)
    current = current + currents_of(column, measured - made_by(current, column))
    rest = measured - made_by(current, column)
    fed = current[:, :1] * base + _made(current[:, 1:], shares)
    moving = jax.jacfwd(points)(parameters)  # (N, 2, P)
    tangent = jnp.einsum("nkp,nkm->npm", moving, rows[:, 1:], precision="highest")
    tangent = _made(fed, tangent.reshape(len(at), -1)).reshape(slots, -1, rows.shape[-1])
    stronger = current[:, :1] * _made(by_strength, rows[:, 0])
    tangent = tangent.at[:, -1].add(stronger)
    tangent = whitened_rows(frame, _in_slots(sheet, frame, tangent, jnp.zeros((), dtype)))
    tangent = jnp.pad(tangent, ((0, 0), (0, 0), (0, len(shares))))
    drop = drops(sheet, frame.grounds, among, at_grounds.T, fed)
    drop = jnp.matmul(drop, jnp.asarray(weights, dtype)[:, None], precision="highest")
    fitted = Fitted(*shape, current[:, :1], drop, made_by(current, columns))
    slope = jnp.asarray(known, dtype)
    prior = jnp.matmul(slope, parameters, precision="highest")
    return Explained(rest, column, tangent, prior, slope, fitted)


def _made(weights: Float[Array, "i N"], rows: Float[Array, "N j"]) -> Float[Array, "i j"]:
    return jnp.matmul(weights, rows, precision="highest")


def _in_slots(
    sheet: Sheet, frame: WhitenedFrame, potential: Float[Array, "S K M"], total: Array
) -> Float[Array, "S K M"]:
    """Volts in each slot, of which each has potentials of its own."""

    def one(potential: Array, ground: Array) -> Float[Array, "K M"]:
        z = sheet.ground_resistance
        return slot_columns(sheet.field, potential, ground[None], z, total)[:, 0]

    return jax.vmap(one)(potential, frame.grounds)


def _even(
    among: Float[Array, "N N"], own: Float[Array, " N"], at_ground: Float[Array, "N S"]
) -> tuple[Float[Array, "N S"], Float[Array, "N S"]]:
    """Shares of a slot's current that flow at each point of an even contact.

    (G + r)q = a + I·R_l(x), from V0 − u = r·q, whatever V0 is; Σq = I. And how they change
    with `_STRENGTH_WIDTH`·ln of r less: G's inverse times r·q, Σ = 0.
    """
    mean = jnp.trace(among) / len(own)
    # Points nearer to each other than they are wide would make it singular.
    matrix = among + jnp.diag(own + 0.01 * mean)
    unit = jnp.eye(len(own), dtype=own.dtype)
    inverse = solve_positive(matrix, unit)
    alone = inverse.sum(1, keepdims=True)

    def balanced(right: Array, total: float) -> Array:
        found = _made(inverse, right)
        return found + (total - found.sum(0)) / alone.sum() * alone

    shares = balanced(at_ground, 1.0)
    return shares, balanced(_STRENGTH_WIDTH * own[:, None] * shares, 0.0)
