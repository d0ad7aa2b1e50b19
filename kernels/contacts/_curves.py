"""Models one long contact as a curve of points: a bar, or the rim of a wide round object.

The current along the curve is that of an even contact of some conductance. Metal has one
potential: more current flows at the ends and, in each slot, towards the ground. A few modes
add uneven currents, different in each slot. The slopes leave out how the points' shares
change with place and shape; the modes make up for this.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from tomojax.kernels.algebra import Limits, solve_positive
from tomojax.kernels.contacts._equations import (
    best_currents,
    currents_of,
    Explained,
    made_by,
    whitened_rows,
    WhitenedFrame,
)
from tomojax.kernels.contacts._field import home_of, thin_rows_at
from tomojax.kernels.contacts._points import (
    drops,
    Fitted,
    green_of,
    NARROW,
    Sheet,
    SIZE_WIDTH,
    unpack,
)

# Points of a curve.
_POINTS = 18

# A bar's points are two rows of half as many along its axis, at this part of half its
# width: the current of metal flows at its rim.
_ROW = 0.58

# A mode's current is about this part of the mean's.
_UNEVEN = 0.3

# Conductance that is likely beforehand, beside a square of the sheet.
_STRENGTH = 30.0
# ln of how far from that it may be: from a current source to metal.
_STRENGTH_WIDTH = 1.5

# A bar's taper beforehand, ± as much: 0 is a rectangle, 1 an ellipse, whose conductance
# falls as √(1 − s²) towards its ends.
_TAPER = 0.5
# The largest taper: some conductance is left at each point.
_MOST_TAPER = 1.4

# Parameters of a curve: middle; from there to a bar's end, or a ring's radius and nothing;
# half a bar's width; strength; a bar's taper; and 0 of a bar, 1 of a ring, which stays.
CURVE = 8

# The longest step of each, as `discs` has them.
_LONGEST = 6.0, 6.0, 6.0, 6.0, 0.7, 1.0, 1.0, 0.0


class _Shape(NamedTuple):
    """The points of a bar or of a ring: their places, and the current at each point."""

    at: Float[Array, "N 2"]
    weights: Float[Array, " N"]
    tapered: Float[Array, " N"]  # how these change with the taper's parameter
    modes: Float[Array, "k N"]  # what each lets flow there, nothing in all


def curve(sheet: Sheet, frame: WhitenedFrame, parameters: Float[Array, "8"]) -> Explained:
    """Models a bar with Legendre's modes, or a rim with cos and sin of one and two angles.

    One model serves both shapes, because each model takes seconds to compile.
    """
    is_ring = parameters[-1] > 0.5
    moving = jax.jacfwd(lambda p: _shape_of(sheet, p, is_ring).at)(parameters)
    shape = _shape_of(sheet, parameters, is_ring)
    place, radius, reach = _stretch(sheet, parameters)
    fitted = (
        home_of(sheet.field, place)[None],
        jnp.where(is_ring, 0, reach)[None],
        jnp.where(is_ring, jnp.abs(reach[:1]), 0),
        jnp.where(is_ring, NARROW * sheet.size, radius)[None],
    )
    # A ring has no second length; its width and its taper move nothing.
    unused = jnp.where(is_ring, jnp.eye(CURVE, dtype=moving.dtype)[3], 0)
    known = jnp.concatenate([unused[None], jnp.eye(CURVE, dtype=moving.dtype)[4:]])
    prior = jnp.matmul(known, parameters.at[-1].set(0), precision="highest")
    return _curve(sheet, frame, shape, moving, fitted, prior, known, parameters)


def limits_of_curve(sheet: Sheet) -> Limits:
    """Returns limits: a bar's width ends at the table's largest disc. See `_LONGEST`."""
    largest = jnp.log(sheet.field.radii[-1] / sheet.size) / SIZE_WIDTH
    highest = jnp.where(jnp.arange(CURVE) == 4, largest, jnp.inf)
    highest = highest.at[6].set((_MOST_TAPER - _TAPER) / _TAPER)
    return Limits(highest, jnp.asarray(_LONGEST, highest.dtype))


def _shape_of(sheet: Sheet, p: Float[Array, "8"], is_ring: Bool[Array, ""]) -> _Shape:
    place, radius, reach = _stretch(sheet, p)
    nodes, weights = np.polynomial.legendre.leggauss(_POINTS // 2)
    nodes, weights = np.tile(nodes, 2), np.tile(weights, 2) / 4
    side = np.repeat([_ROW, -_ROW], _POINTS // 2)
    along = reach / jnp.sqrt((reach**2).sum() + 1e-12)
    across = jnp.stack([-along[1], along[0]]) * radius
    bar = jnp.asarray(nodes, p.dtype)[:, None] * reach
    bar = bar + jnp.asarray(side, p.dtype)[:, None] * across
    angle = 2 * np.pi * np.arange(_POINTS) / _POINTS
    waves = [f(k * angle) for k in (1, 2) for f in (np.cos, np.sin)]
    ring = jnp.abs(reach[0]) * jnp.asarray(np.stack(waves[:2], 1), p.dtype)
    even, none = np.full(_POINTS, 1 / _POINTS), np.zeros(_POINTS)
    legendre = weights * np.stack([nodes, 1.5 * nodes**2 - 0.5, none, none])
    # Of one length as Gauss's weights have it, so that the sum stays 1.
    ellipse = np.sqrt(1 - nodes**2)
    taper = weights * (ellipse / (weights * ellipse).sum() - 1)
    full, falling = (jnp.asarray(a, p.dtype) for a in (weights, _TAPER * taper))
    weights = full + (1 + p[6]) * falling
    both = (
        (bar, weights, falling, legendre),
        (ring, even, none, even * np.stack(waves)),
    )
    chosen = (
        jnp.where(is_ring, jnp.asarray(b, p.dtype), jnp.asarray(a, p.dtype))
        for a, b in zip(*both)
    )
    at, weights, tapered, modes = chosen
    return _Shape(place + at, weights, tapered, modes)


def _stretch(sheet: Sheet, p: Float[Array, "8"]) -> tuple[Array, Array, Array]:
    place, radius = unpack(sheet, jnp.concatenate([p[:2], p[4:5]])[None])
    return place[0], radius[0], p[2:4] * sheet.unit


def _curve(
    sheet: Sheet,
    frame: WhitenedFrame,
    shape: _Shape,
    moving: Float[Array, "N 2 P"],
    about: tuple[Array, Array, Array, Array],
    prior: Float[Array, " p"],
    known: Float[Array, "p P"],
    parameters: Float[Array, " P"],
) -> Explained:
    """Explains a frame by points that move by parameters; `about` begins a `Fitted`."""
    dtype, slots = parameters.dtype, len(frame.grounds)
    at, weights, tapered, modes = shape
    rows = jax.vmap(thin_rows_at, (None, None, 0))(sheet.thin, sheet.field.size, at)
    green = green_of(sheet, at, jnp.full(len(at), NARROW * sheet.size))
    among = jax.vmap(green)(at)
    strength = _STRENGTH * jnp.exp(_STRENGTH_WIDTH * parameters[5])
    own = sheet.sheet_resistance / (strength * weights)
    at_grounds = sheet.slots.level(rows[:, 0], frame.grounds)
    stronger = _STRENGTH_WIDTH * own, own * tapered / weights
    base, *by_own = (a.T for a in _even(among, own, at_grounds, stronger))  # (S, N)
    each = _made(base, rows[:, 0])[:, None]
    others = jnp.broadcast_to(_made(modes, rows[:, 0]), (slots, len(modes), rows.shape[-1]))
    unit = np.eye(len(modes) + 1)
    total = jnp.asarray(unit[0], dtype)
    columns = _in_slots(sheet, frame, jnp.concatenate([each, others], 1), total)
    column = whitened_rows(frame, columns)
    flowing = currents_of(column[:, :1], frame.whitened)
    # What is known of the modes: further values that are measured as 0.
    stiff = 1 / (_UNEVEN * jnp.abs(flowing) + 1e-15)
    more = stiff[..., None] * jnp.asarray(unit[:, 1:], dtype)
    column = jnp.concatenate([column, more], -1)
    measured = jnp.pad(frame.whitened, ((0, 0), (0, len(modes))))
    current, rest = best_currents(column, measured)
    fed = current[:, :1] * base + _made(current[:, 1:], modes)
    tangent = jnp.einsum("nkp,nkm->npm", moving, rows[:, 1:], precision="highest")
    tangent = _made(fed, tangent.reshape(len(at), -1)).reshape(slots, -1, rows.shape[-1])
    for k, by in zip((5, 6), by_own):
        tangent = tangent.at[:, k].add(current[:, :1] * _made(by, rows[:, 0]))
    tangent = whitened_rows(frame, _in_slots(sheet, frame, tangent, jnp.zeros((), dtype)))
    tangent = jnp.pad(tangent, ((0, 0), (0, 0), (0, len(modes))))
    volts = made_by(current, columns)
    sunk = sheet.slots.sunk(rows[:, 0], frame.grounds, volts)
    drop = drops(sheet, frame.grounds, among, at_grounds.T, sunk.T, fed)
    drop = jnp.matmul(drop, weights[:, None], precision="highest")
    fitted = Fitted(*about, current[:, :1], drop, volts)
    return Explained(rest, column, tangent, prior, known, fitted)


def _made(weights: Float[Array, "i N"], rows: Float[Array, "N j"]) -> Float[Array, "i j"]:
    return jnp.matmul(weights, rows, precision="highest")


def _in_slots(
    sheet: Sheet, frame: WhitenedFrame, potential: Float[Array, "S K M"], total: Array
) -> Float[Array, "S K M"]:
    """Computes volts in each slot; each slot has potentials of its own."""
    offset = sheet.slots.offset(frame.grounds)[:, None]
    share = total[..., None] if total.ndim else total
    return sheet.slots.apart(potential, frame.grounds) + share * offset


def _even(
    among: Float[Array, "N N"],
    own: Float[Array, " N"],
    at_ground: Float[Array, "N S"],
    less: Sequence[Float[Array, " N"]],
) -> list[Float[Array, "N S"]]:
    """Computes the shares of a slot's current that flow at each point of an even contact.

    (G + r)q = a + I·R_l(x) follows from V0 − u = r·q for any V0, with Σq = I. The function
    also returns how the shares change with r `less` by each of some amounts d: (G + r)⁻¹
    times d·q, with sum 0.
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
    return [shares, *(balanced(each[:, None] * shares, 0.0) for each in less)]
