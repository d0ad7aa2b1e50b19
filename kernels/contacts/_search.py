"""Finds contacts that appear in one slot, in a table of candidates.

Sizes are fixed and operations are few: each costs about a microsecond, whatever its size.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels.algebra import matmul, tree_where
from tomojax.kernels.contacts._one_slot import (
    in_slot,
    inverse_of,
    product,
    regular,
    solve_small,
    weighed,
    Weights,
)
from tomojax.kernels.contacts._points import Sheet
from tomojax.kernels.sheet import Grounds, Slots

# What is known of a place before (units of the fit, 1 mm for electrodes of 5 mm) and of
# a size: 1 σ.
FIRST = (6.0, 6.0, 1.0)

# χ² that a contact must explain at least.
_SEEN = 40.0

# The part that one more contact must explain of what the others leave.
_SHARE = 0.5

# A further contact is new once it was seen no farther than this from place to place (units)
_NEAR = 12.0
# in so many slots.
OFTEN = 3

# Wrong contacts are dropped, and all are looked for again, in one slot of so many.
_DOUBTED = 4
# Each is looked for so many times beside the others.
_TURNS = 2
# One more contact must leave less than one part in so many of what the others leave.
_QUARTER = 4.0

# One contact alone takes the others' place where it leaves less than this part of what
# the others leave,
_ELSEWHERE = 0.5
# and explains this part at least of what there is. Contacts that leave it are wrong.
_EXPLAINED = 0.1


class Candidates(NamedTuple):
    """Usual contacts at K places: electrodes' potentials, with squares and tangents."""

    place: Float[Array, "K 2"]  # m
    potential: Float[Array, "M K"]  # Ω
    square: Float[Array, "M K"]
    tangent: Float[Array, "K 4 M"]  # see `tangents`


class Followed(NamedTuple):
    """The state of C contacts that are followed."""

    there: Bool[Array, " C"]
    place: Float[Array, "C 2"]  # m
    size: Float[Array, " C"]  # ln(radius/usual), in units of what is known beforehand
    covariance: Float[Array, "C 3 3"]  # of both, in units of the fit
    alone: Float[Array, "C 3 3"]  # the same, of what the last slot alone tells
    current: Float[Array, " C"]  # in the last slot, A
    conductance: Float[Array, " C"]  # S
    weak: Int[Array, " C"]  # slots in a row that hardly show it
    rival: Float[Array, "2"]  # where one more was seen last, m
    seen: Int[Array, ""]  # slots in a row that showed it there
    left: Float[Array, ""]  # χ² of each channel that contacts leave, of late
    doubted: Int[Array, ""]  # slots in a row that contacts are wrong in


def nothing_followed(size: Float[Array, "2"], count: int) -> Followed:
    """Returns the state without any contact of up to `count`, on a sheet of `size`."""
    dtype = size.dtype
    zero, whole = jnp.zeros(count, dtype), jnp.zeros(count, jnp.int32)
    first = jnp.broadcast_to(first_covariance(dtype), (count, 3, 3))
    return Followed(
        there=jnp.zeros(count, bool),
        place=jnp.broadcast_to(size / 2, (count, 2)),
        size=zero,
        covariance=first,
        alone=first,
        current=zero,
        conductance=zero,
        weak=whole,
        rival=jnp.zeros(2, dtype),
        seen=jnp.zeros((), jnp.int32),
        left=jnp.zeros((), dtype),
        doubted=jnp.zeros((), jnp.int32),
    )


def first_covariance(dtype) -> Float[Array, "3 3"]:
    return jnp.diag(jnp.asarray(FIRST, dtype) ** 2)


class Search(NamedTuple):
    """The result of a search for contacts that appear."""

    new: Bool[Array, " C"]
    there: Bool[Array, " C"]
    chosen: Int[Array, " C"]  # the candidates that new ones are at
    rival: Float[Array, "2"]
    seen: Int[Array, ""]
    dark: Bool[Array, ""]  # nothing stands out of the noise
    doubted: Int[Array, ""]


def search(
    sheet: Sheet,
    candidates: Candidates,
    known: Followed,
    columns: Float[Array, "C M"],
    weights: Weights,
    voltages: Float[Array, " M"],
    ground: Int[Array, ""],
) -> Search:
    """Tells whether one contact alone explains the slot better, or one more is needed."""
    # To look for contacts a common offset will do.
    scale = 1 / (1 + matmul(weights.common[0] ** 2, inverse_of(weights.each)))
    plain = Weights(weights.each, weights.common[:1], weights.common[:1] * scale)
    beside = weighed(plain, columns)
    normal = regular(product(columns, beside.T))
    fit = solve_small(normal, matmul(beside, voltages)[:, None])[:, 0]
    rest = voltages - matmul(fit, columns)
    weighed_both = weighed(plain, jnp.stack([rest, voltages]))
    left, alone = matmul(rest, weighed_both[0]), matmul(voltages, weighed_both[1])
    none = jnp.zeros_like(known.seen)
    nothing = Search(
        new=jnp.zeros_like(known.there),
        there=known.there,
        chosen=jnp.zeros_like(known.weak),
        rival=known.rival,
        seen=none,
        dark=jnp.zeros((), bool),
        doubted=none,
    )

    def gains(weighed_both: Array, beside: Array, normal: Array) -> tuple[Array, Array]:
        along = weighed_both, beside, normal
        return _gains(candidates, sheet.slots, ground, plain, scale, *along)

    def look() -> Search:
        both = gains(weighed_both, beside, normal)
        found = _chosen(sheet, candidates, known, *both, left, alone)
        # Contacts that came at once are not found one by one.
        wrong = known.there.any() & (left > _EXPLAINED * alone)
        doubted = jnp.where(wrong, known.doubted + 1, 0)
        return jax.lax.cond(
            doubted % _DOUBTED == 1,
            lambda: _all_anew(
                sheet, candidates, ground, plain, gains, voltages, left, found
            ),
            lambda: found,
        )._replace(doubted=doubted)

    # What errors alone leave, χ² about the number of channels, has nothing to be found in.
    channels = (weights.each > 0).astype(left.dtype).sum()
    asked = (left > _SEEN + channels) | ~known.there.any()
    found = jax.lax.cond(asked, look, lambda: nothing)
    # The contacts explain nothing of the voltages.
    return found._replace(dark=alone - left < _SEEN)


def _all_anew(
    sheet: Sheet,
    candidates: Candidates,
    ground: Int[Array, ""],
    plain: Weights,
    gains: Callable[[Array, Array, Array], tuple[Array, Array]],
    voltages: Float[Array, " M"],
    left: Float[Array, ""],
    found: Search,
) -> Search:
    """Looks for contacts from none on: one more, then each in turn beside the others.

    Each must quarter what the others leave.
    """
    count, offset = len(found.there), sheet.slots.offset(ground)
    slots, near_by = sheet.slots, (_NEAR * sheet.unit) ** 2
    each = jnp.arange(count, dtype=jnp.int32)

    def rest_of(columns: Array) -> tuple[Array, Array, Array]:
        beside = weighed(plain, columns)
        normal = regular(product(columns, beside.T))
        fit = solve_small(normal, matmul(beside, voltages)[:, None])[:, 0]
        return voltages - matmul(fit, columns), beside, normal

    # How many there are, and whose turn it is: the last one's, then each one's.
    turns = [(n, c) for n in range(count) for c in (n, *list(range(n + 1)) * _TURNS)]
    which, whose = jnp.asarray(turns, jnp.int32).T

    def turn(i: Array, state: tuple) -> tuple:
        columns, chosen, sets = state
        n, c = which[i], whose[i]
        others = jnp.where((each == c)[:, None], 0, columns)
        rest, beside, normal = rest_of(others)
        both = weighed(plain, jnp.stack([rest, voltages]))
        # Two candidates about one place would be one contact between them.
        away = candidates.place[:, None] - candidates.place[chosen]
        near = ((away**2).sum(-1) < near_by) & (others != 0).any(1)
        k = jnp.argmax(jnp.where(near.any(1), -1, gains(both, beside, normal)[0]))
        column = slots.relative(candidates.potential[:, k], ground) + offset
        columns, chosen = others.at[c].set(column), chosen.at[c].set(k.astype(jnp.int32))
        return columns, chosen, sets.at[n].set(chosen)

    def left_by(n: Array) -> Array:
        """Computes χ² that n + 1 leave once they have moved off the grid."""
        raw = in_slot(sheet, candidates.tangent[sets[n]], ground)[:, :3]
        raw = jnp.where((each <= n)[:, None, None], raw, 0)
        rest = rest_of(raw.reshape(3 * count, -1))[0]
        return matmul(rest, weighed(plain, rest[None])[0])

    columns = jnp.zeros((count, len(voltages)), voltages.dtype)
    chosen = jnp.zeros(count, jnp.int32)
    state = columns, chosen, jnp.zeros((count, count), jnp.int32)
    sets = jax.lax.fori_loop(0, len(turns), turn, state)[-1]
    # What errors alone leave is nothing that one more explains.
    least = (plain.each > 0).astype(left.dtype).sum()
    lefts = jnp.maximum(jax.lax.map(left_by, each), least)
    costs = lefts * _QUARTER ** (each + 1).astype(lefts.dtype)
    best = jnp.argmin(costs).astype(jnp.int32)
    better = costs[best] < left * _QUARTER ** found.there.sum().astype(left.dtype)
    there = each <= best
    changed = found._replace(
        new=there, there=there, chosen=sets[best], seen=jnp.zeros_like(found.seen)
    )
    return tree_where(better, changed, found)


def _chosen(
    sheet: Sheet,
    candidates: Candidates,
    known: Followed,
    gains: Float[Array, " K"],
    gains_alone: Float[Array, " K"],
    left: Float[Array, ""],
    alone: Float[Array, ""],
) -> Search:
    k, k_alone = jnp.argmax(gains), jnp.argmax(gains_alone)
    elsewhere = alone - gains_alone[k_alone]
    # One more, in several slots.
    more = (gains[k] > _SEEN) & (gains[k] > _SHARE * left) & ~known.there.all()
    more = more & known.there.any()
    # Everything is elsewhere, unless one more leaves clearly less.
    jumped = (left > _SEEN) & (elsewhere < _ELSEWHERE * left)
    jumped = jumped & ~(more & (left - gains[k] < _SHARE * elsewhere))
    lone = gains_alone[k_alone] > _SEEN + _EXPLAINED * alone
    anew = (jumped | ~known.there.any()) & lone
    more = more & ~anew
    again = ((candidates.place[k] - known.rival) ** 2).sum() < (_NEAR * sheet.unit) ** 2
    seen = jnp.where(more, jnp.where(again, known.seen + 1, 1), 0)
    born = seen >= OFTEN
    # In the first that is free.
    slot = jnp.arange(len(known.there)) == jnp.where(anew, 0, jnp.argmin(known.there))
    new = slot & (anew | born)
    return Search(
        new=new,
        there=jnp.where(anew, slot, known.there | new),
        chosen=jnp.broadcast_to(jnp.where(anew, k_alone, k), new.shape).astype(jnp.int32),
        rival=candidates.place[k],
        seen=jnp.where(born | anew, 0, seen),
        dark=jnp.zeros((), bool),
        doubted=jnp.zeros_like(known.doubted),
    )


def _gains(
    candidates: Candidates,
    slots: Slots,
    ground: Int[Array, ""],
    plain: Weights,
    scale: Float[Array, ""],
    weighed_both: Float[Array, "2 M"],
    beside: Float[Array, "C M"],
    normal: Float[Array, "C C"],
) -> tuple[Float[Array, " K"], Float[Array, " K"]]:
    """Computes how much each candidate explains: of what contacts leave, and of all.

    With one electrode grounded a candidate's column is R_i − R_l + f_i, so every product
    with the column is one with R.
    """
    w, offset = plain.each, slots.offset(ground)
    vectors = jnp.concatenate([weighed_both, beside, plain.common])
    if isinstance(slots, Grounds):
        vectors = jnp.concatenate([vectors, jnp.stack([w, w * offset])])
        products = product(vectors, candidates.potential)  # (C + 5, K)
        at_ground = jnp.take(candidates.potential, ground, 0)
        constant = matmul(vectors, offset)
        along = products - at_ground * vectors.sum(1)[:, None] + constant[:, None]
        # Σw(R + f − R_l)², less what the offset takes off.
        total, cross = products[-2], products[-1]
        own = matmul(w, candidates.square) + 2 * (cross - at_ground * total)
        own = own + constant[-1] - 2 * at_ground * constant[-2] + at_ground**2 * w.sum()
    else:
        columns = (slots.relative(candidates.potential.T, ground) + offset).T
        along, own = product(vectors, columns), matmul(w, columns**2)
    count = len(beside)
    by_rest, by_all = along[0], along[1]
    shares, common = along[2 : 2 + count], along[2 + count]
    own = own - scale * common**2
    own = jnp.maximum(own, 1e-6 * jnp.abs(own).max())
    inverse = solve_small(normal, jnp.eye(count, dtype=w.dtype))
    left = own - (product(inverse, shares) * shares).sum(0)
    near = left < 1e-3 * own
    gains = jnp.maximum(by_rest, 0) ** 2 / jnp.where(near, 1, left)
    return jnp.where(near, 0, gains), jnp.maximum(by_all, 0) ** 2 / own
