"""Finds contacts that appear in one slot, in a table of candidates.

Sizes are fixed and operations are few: each costs about a microsecond, whatever its size.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels.algebra import matmul, tree_where
from tomojax.kernels.contacts._anew import all_anew, Candidates, NEAR, Set, WAYS
from tomojax.kernels.contacts._one_slot import (
    all_tangents,
    Beside,
    beside_columns,
    first_covariance,
    OneSlot,
    Plain,
    product,
    solve_small,
    weighed,
)
from tomojax.kernels.sheet import Grounds

# χ² that a contact must explain at least.
_SEEN = 40.0

# The part that one more contact must explain of what the others leave.
_SHARE = 0.5

# A contact is gone that so many slots in a row hardly show.
OFTEN = 3

# Contacts are in doubt while they leave so much χ² of a channel, of late.
_UNUSUAL = 0.8
# After 1, 2, 4, 8, … doubted slots all are looked for again, then in one of so many.
_DOUBTED = 64
# So many slots without a doubt make up for one with.
_DECAY = 16

# One contact alone takes the others' place where it leaves less than this part of what
# the others leave,
_ELSEWHERE = 0.5
# and explains this part at least of what there is. Contacts that leave it are wrong.
_EXPLAINED = 0.1


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
    doubted: Int[Array, ""]  # slots that contacts are wrong in, see `_DECAY`


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


class Search(NamedTuple):
    """The result of a search for contacts that appear."""

    new: Bool[Array, " C"]
    there: Bool[Array, " C"]
    place: Float[Array, "C 2"]  # of new ones, m
    size: Float[Array, " C"]
    raw: Float[Array, "C 4 M"]  # and their tangents
    rival: Float[Array, "2"]
    seen: Int[Array, ""]
    dark: Bool[Array, ""]  # nothing stands out of the noise
    doubted: Int[Array, ""]


def search(
    slot: OneSlot, candidates: Candidates, known: Followed, columns: Float[Array, "C M"]
) -> Search:
    """Tells whether one contact alone explains the slot better, or one more is needed."""
    plain, voltages = slot.plain, slot.voltages  # a common offset will do to look
    beside = beside_columns(plain, columns, voltages)
    left, alone = _square(plain, beside.rest), _square(plain, voltages)
    channels = (slot.weights.each > 0).astype(left.dtype).sum()
    none = jnp.zeros_like(known.seen)
    calm = jnp.where(known.there.any(), jnp.maximum(known.doubted - 1, 0), 0)
    nothing = Search(
        new=jnp.zeros_like(known.there),
        there=known.there,
        place=known.place,
        size=known.size,
        raw=jnp.zeros((len(known.size), *candidates.tangent.shape[1:]), voltages.dtype),
        rival=known.rival,
        seen=none,
        dark=jnp.zeros((), bool),
        doubted=calm,
    )

    gains = partial(_gains, slot, candidates)

    def look() -> Search:
        found = _chosen(slot, candidates, known, beside, gains(beside), (left, alone))
        # Contacts that came at once are not found one by one.
        wrong = (left > _EXPLAINED * alone) | (known.left > _UNUSUAL) | (found.seen > 0)
        doubted = jnp.where(wrong & known.there.any(), known.doubted + _DECAY, calm)
        times = doubted // _DECAY
        due = ((times & (times - 1)) == 0) | (times % _DOUBTED == 0)
        again = wrong & (times > known.doubted // _DECAY) & due
        return jax.lax.cond(again, lambda: look_again(found), lambda: found)._replace(
            doubted=doubted
        )

    def look_again(found: Search) -> Search:
        """Looks for all contacts again; the new are where they explain the slot best."""
        followed = Set(known.there, known.place, known.size, known.left * channels)
        way = known.doubted // _DECAY % len(WAYS)  # each time another
        better, best = all_anew(slot, candidates, gains, followed, found.rival, way)
        none = jnp.zeros_like(found.seen)
        placed = found._replace(
            new=best.there,
            there=best.there,
            place=best.place,
            size=best.size,
            raw=all_tangents(slot.sheet, best.place, best.size),
            seen=none,
            doubted=none,
        )
        return tree_where(better, placed, found._replace(seen=none))

    # What errors alone leave, χ² about the number of channels, has nothing to be found in.
    asked = (left > _SEEN + channels) | ~known.there.any()
    found = jax.lax.cond(asked, look, lambda: nothing)
    # The contacts explain nothing of the voltages.
    return found._replace(dark=alone - left < _SEEN)


def _square(plain: Plain, x: Float[Array, " M"]) -> Float[Array, ""]:
    """Computes χ² of a slot by the plain errors."""
    return matmul(x, weighed(plain, x[None])[0])


def _left(
    plain: Plain, rest: Float[Array, " M"], column: Float[Array, " M"]
) -> Float[Array, ""]:
    """Computes χ² that one more column leaves of `rest`.

    By what is left of voltages: float32 has lost it from what the column explains.
    """
    beside = weighed(plain, column[None])[0]
    amount = matmul(rest, beside) / jnp.maximum(matmul(column, beside), 1e-30)
    return _square(plain, rest - amount * column)


def _chosen(
    slot: OneSlot,
    candidates: Candidates,
    known: Followed,
    beside: Beside,
    both_gains: tuple[Float[Array, " K"], Float[Array, " K"]],
    both_left: tuple[Float[Array, ""], Float[Array, ""]],
) -> Search:
    """Chooses from what each candidate explains: of what contacts leave, and of all."""
    (gains, gains_alone), (left, alone) = both_gains, both_left
    k, k_alone = jnp.argmax(gains), jnp.argmax(gains_alone)
    elsewhere = _left(slot.plain, slot.voltages, candidates.column(slot, k_alone))
    column = candidates.column(slot, k)
    share = solve_small(beside.normal, matmul(beside.weighed, column)[:, None])[:, 0]
    one_more = _left(slot.plain, beside.rest, column - matmul(share, beside.columns))
    # One more: then all are looked for again.
    more = (gains[k] > _SEEN) & (gains[k] > _SHARE * left) & ~known.there.all()
    more = more & known.there.any()
    # Everything is elsewhere, unless one more leaves clearly less.
    jumped = (left > _SEEN) & (elsewhere < _ELSEWHERE * left)
    jumped = jumped & ~(more & (one_more < _SHARE * elsewhere))
    lone = gains_alone[k_alone] > _SEEN + _EXPLAINED * alone
    anew = (jumped | ~known.there.any()) & lone
    more = more & ~anew
    again = ((candidates.place[k] - known.rival) ** 2).sum() < (NEAR * slot.sheet.unit) ** 2
    seen = jnp.where(more, jnp.where(again, known.seen + 1, 1), 0)
    first = jnp.arange(len(known.there)) == 0
    new = first & anew
    raw = jnp.broadcast_to(
        candidates.tangent[k_alone], (len(new), *candidates.tangent.shape[1:])
    )
    return Search(
        new=new,
        there=jnp.where(anew, first, known.there),
        place=jnp.broadcast_to(candidates.place[k_alone], known.place.shape),
        size=jnp.zeros_like(known.size),
        raw=raw,
        rival=candidates.place[k],
        seen=jnp.where(anew, 0, seen),
        dark=jnp.zeros((), bool),
        doubted=jnp.zeros_like(known.doubted),
    )


def _gains(
    slot: OneSlot, candidates: Candidates, beside: Beside
) -> tuple[Float[Array, " K"], Float[Array, " K"]]:
    """Computes how much each candidate explains: of what contacts leave, and of all.

    A candidate's column is m + x, x without a weighed mean: float32 would lose the little
    that x is beside m. The column is R − UR_E + f, with R − R_l where one electrode is
    grounded, so every product with x is one with R and with the few rows of R_E.
    """
    slots, ground, plain = slot.sheet.slots, slot.ground, slot.plain
    table = candidates.potential
    w, whole, offset = plain.each, plain.whole, slots.offset(ground)
    both = weighed(plain, jnp.stack([beside.rest, slot.voltages]))
    vectors = jnp.concatenate([both, beside.weighed])
    sums = vectors.sum(1)
    middle = matmul(w, offset) / whole
    offset = offset - middle
    centred = vectors - (sums / whole)[:, None] * w
    rows = jnp.concatenate([centred, jnp.stack([w / whole, w * offset])])
    products = product(rows, table)  # (C + 4, K)
    level, cross = products[-2], products[-1]
    along = products[:-2] + matmul(vectors, offset)[:, None]
    own = matmul(w, candidates.square) - whole * level**2
    own = own + 2 * cross + matmul(w, offset**2)
    if isinstance(slots, Grounds):
        mean = level - jnp.take(table, ground, 0) + middle
    else:
        entered, taken = jnp.take(table, slots.at[ground], 0), slots.taken[ground]
        part = matmul(w, taken) / whole
        mean = level - matmul(part, entered) + middle
        taken = taken - part
        heavy = w[:, None] * taken  # (M, g)
        along = along - product(matmul(vectors, taken), entered)
        squares = product(matmul(taken.T, heavy), entered)
        twice = product(heavy.T, table) + matmul(offset, heavy)[:, None]
        own = own + (entered * (squares - 2 * twice)).sum(0)
    along = along + sums[:, None] * mean
    own = own + plain.part * whole * mean**2
    own = jnp.maximum(own, 1e-6 * jnp.abs(own).max())
    by_rest, by_all, shares = along[0], along[1], along[2:]
    inverse = solve_small(beside.normal, jnp.eye(len(beside.normal), dtype=w.dtype))
    left = own - (product(inverse, shares) * shares).sum(0)
    near = left < 1e-3 * own
    gains = jnp.maximum(by_rest, 0) ** 2 / jnp.where(near, 1, left)
    return jnp.where(near, 0, gains), jnp.maximum(by_all, 0) ** 2 / own
