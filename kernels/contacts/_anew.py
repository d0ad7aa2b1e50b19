"""Looks for all the contacts of one slot from none on, when those that are followed fail.

Sets of contacts compete: fresh ones of each count, and the followed ones as they are, with
one more, and without the weakest. Each set moves to where its slot is explained best.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels.algebra import matmul
from tomojax.kernels.contacts._one_slot import (
    all_tangents,
    Beside,
    beside_columns,
    first_covariance,
    fitted,
    in_slot,
    OneSlot,
    update,
    whitened,
)

# A further contact is seen again no farther than this from place to place (units).
NEAR = 12.0

# A contact's current is at least this part of the strongest's.
WEAKEST = 0.05

# Each is looked for so many times beside the others.
_TURNS = 2
# One more contact must leave less than one part in so many of what the others leave.
_PART = 3.0
# χ² of a channel that errors alone leave, usually.
_USUAL = 0.4
# Below that, what a set leaves counts by this part.
_TIE = 0.05
# Costs that differ by less than this factor are alike, and the first of such sets is taken.
# Some sets end at the same places, and rounding alone would choose: float32 tells a cost to
# a thousandth. It is no figure of a sensor.
_ALIKE = 1.01
# A contact is split in two, so far from its place, units.
WAYS = ((8.0, 0.0), (0.0, 8.0), (6.0, 6.0), (6.0, -6.0))
# A place is vague that has more than this part of the variance before any slot.
_VAGUE = 0.3
# Steps by which a set moves to its best places.
_STEPS = 4


class Candidates(NamedTuple):
    """Usual contacts at K places: electrodes' potentials, with squares and tangents."""

    place: Float[Array, "K 2"]  # m
    potential: Float[Array, "M K"]  # Ω
    square: Float[Array, "M K"]
    tangent: Float[Array, "K 4 M"]  # see `tangents`

    def column(self, slot: OneSlot, k: Int[Array, ""]) -> Float[Array, " M"]:
        """Computes volts per ampere of one of the contacts."""
        slots, ground = slot.sheet.slots, slot.ground
        return slots.relative(self.potential[:, k], ground) + slots.offset(ground)


class Set(NamedTuple):
    """Contacts that explain a slot, of C at most."""

    there: Bool[Array, " C"]
    place: Float[Array, "C 2"]  # m
    size: Float[Array, " C"]
    left: Float[Array, ""]  # χ²


Gains = Callable[[Beside], tuple[Array, Array]]


def all_anew(
    slot: OneSlot,
    candidates: Candidates,
    gains: Gains,
    followed: Set,
    rival: Float[Array, "2"],
    way: Int[Array, ""],
) -> tuple[Bool[Array, ""], Set]:
    """Returns the best set, and whether it is another than `followed`.

    **Arguments:** `rival`, where one more was seen, m; `way`, of `WAYS`, contacts are
    split in two.
    """
    count, dtype = len(followed.there), slot.voltages.dtype
    chosen = _greedy(slot, candidates, gains, count)
    each, n = jnp.arange(count), followed.there.sum()
    free = (each == jnp.argmin(followed.there)) & ~followed.there

    def one_more(at: Array, whose: Array, to: Array) -> Set:
        return Set(
            followed.there | free,
            jnp.where(free[:, None], at, jnp.where(whose[:, None], to, followed.place)),
            jnp.where(free | whose, 0, followed.size),
            followed.left,
        )

    half = slot.sheet.unit * jnp.asarray(WAYS, dtype)[way]
    more = [one_more(rival, each < 0, rival)]
    for c in range(count):
        at = followed.place[c]
        more.append(one_more(at + half, each == c, at - half))
    places, none = candidates.place, jnp.zeros_like(followed.size)
    fresh = [Set(each <= k, places[chosen[k]], none, followed.left) for k in range(count)]
    sets = jax.tree.map(lambda *a: jnp.stack(a), followed, *more, *fresh)
    ended = jax.lax.map(lambda one: _settled(slot, one), sets)
    # What errors alone leave is nothing that one more explains.
    least = (slot.weights.each > 0).astype(dtype).sum() * _USUAL
    left = jnp.minimum(
        ended.left, jnp.where(jnp.arange(len(ended.left)) == 0, followed.left, jnp.inf)
    )
    costs = jnp.maximum(left, least) + _TIE * left
    costs = costs * _PART ** ended.there.sum(1).astype(left.dtype)
    best = jnp.argmax(costs <= _ALIKE * costs.min())
    return (best > 0) & (n > 0), jax.tree.map(lambda a: a[best], ended)


def _settled(slot: OneSlot, start: Set) -> Set:
    """Moves contacts to where they explain the slot best; none may be faint or vague."""
    sheet, voltages = slot.sheet, slot.voltages
    unknown = first_covariance(voltages.dtype)
    covariance = jnp.broadcast_to(unknown, (len(start.there), 3, 3))

    def step(_: Array, state: tuple) -> tuple:
        place, size, *_ = state
        own = in_slot(sheet, all_tangents(sheet, place, size), slot.ground)
        columns = jnp.where(start.there[:, None, None], own, 0)
        moved, spread, _, current = update(slot, columns, covariance)
        shift = (moved[..., None] * columns[:, 1:]).sum(1)
        rest = voltages - matmul(current, columns[:, 0] + shift)
        left = (whitened(slot.weights, rest[None]) ** 2).sum()
        return *fitted(sheet, place, size, moved), left, current, spread

    zero = jnp.zeros_like(start.size)
    state = start.place, start.size, jnp.zeros_like(start.left), zero, covariance
    ended = jax.lax.fori_loop(0, _STEPS, step, state)
    place, size, left, current, spread = ended
    # The slot tells hardly more of such a place than was known: as good as one too many.
    vague = (spread[:, 0, 0] + spread[:, 1, 1]) > _VAGUE * jnp.trace(unknown[:2, :2])
    faint = start.there & (current < WEAKEST * current.max())
    left = jnp.where((start.there & vague).any(), _PART, 1) * left
    return Set(start.there, place, size, jnp.where(faint.any(), jnp.inf, left))


def _greedy(
    slot: OneSlot, candidates: Candidates, gains: Gains, count: int
) -> Int[Array, "C C"]:
    """Looks for one contact, two, …: one more, then each in turn beside the others."""
    voltages, places = slot.voltages, candidates.place
    near_by = (NEAR * slot.sheet.unit) ** 2
    each = jnp.arange(count, dtype=jnp.int32)
    # How many there are, and whose turn it is: the last one's, then each one's.
    more = [(n, c) for n in range(1, count) for c in (n, *list(range(n + 1)) * _TURNS)]
    turns = [(0, 0), *more]
    which, whose = jnp.asarray(turns, jnp.int32).T

    def turn(i: Array, state: tuple) -> tuple:
        columns, chosen, sets = state
        n, c = which[i], whose[i]
        others = jnp.where((each == c)[:, None], 0, columns)
        beside = beside_columns(slot.plain, others, voltages)
        # Two candidates about one place would be one contact between them.
        away = places[:, None] - places[chosen]
        near = ((away**2).sum(-1) < near_by) & (others != 0).any(1)
        k = jnp.argmax(jnp.where(near.any(1), -1, gains(beside)[0]))
        columns = others.at[c].set(candidates.column(slot, k))
        chosen = chosen.at[c].set(k.astype(jnp.int32))
        return columns, chosen, sets.at[n].set(chosen)

    columns = jnp.zeros((count, len(voltages)), voltages.dtype)
    chosen = jnp.zeros(count, jnp.int32)
    state = columns, chosen, jnp.zeros((count, count), jnp.int32)
    return jax.lax.fori_loop(0, len(turns), turn, state)[-1]
