"""A few contacts followed from slot to slot: one linear least squares for each slot.

What is known of places and sizes is a mean and a covariance; a slot is taken with its
slopes at the mean, its currents are what fits best. A table of candidates is looked
through in each slot: a contact that appears or jumps is found in the slot that shows it.
Fixed sizes and few, small operations: each costs a microsecond or so, whatever its size.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels._blocktri import matmul
from tomojax.kernels._one_slot import (
    from_ground,
    in_slot,
    inverse_of,
    Noise,
    product,
    radius_of,
    regular,
    slot_weights,
    solve_small,
    tangents,
    weighed,
    Weights,
)
from tomojax.kernels._points import green_of, LEAST_DROP, polarisability, Sheet

# What is known of a place before (units of the fit, 1 mm for electrodes of 5 mm) and of
# a size: 1 σ. And by how much they move in a slot.
_FIRST, _DRIFT = (6.0, 6.0, 1.0), (0.05, 0.05, 0.02)

# χ² of a slot's own place beside what was known, of three values: beyond, it is news.
_NEWS = 40.0

# What a contact must explain: χ² at least, and this part of what the others leave; and a
# further one at least this part of the strongest's current, nearer than this to where it
# was seen before (units), in so many slots.
_SEEN, _SHARE, _WEAKEST, _NEAR, _OFTEN = 40.0, 0.5, 0.05, 12.0, 3

# One contact alone takes the others' place where it leaves less than this part of what
# they do, and explains this part at least; sizes are no further than this from usual.
_ELSEWHERE, _EXPLAINED, _LARGEST = 0.5, 0.1, 3.0


class Candidates(NamedTuple):
    """Usual contacts at K places: potentials of electrodes, squared, and tangents there."""

    place: Float[Array, "K 2"]  # m
    potential: Float[Array, "K M"]  # Ω
    square: Float[Array, "K M"]
    tangent: Float[Array, "K 4 M"]  # see `tangents`


class Followed(NamedTuple):
    """What is known of C contacts."""

    there: Bool[Array, " C"]
    place: Float[Array, "C 2"]  # m
    size: Float[Array, " C"]  # ln(radius/usual), in units of what is known beforehand
    covariance: Float[Array, "C 3 3"]  # of both, in units of the fit
    current: Float[Array, " C"]  # in the last slot, A
    conductance: Float[Array, " C"]  # S
    weak: Int[Array, " C"]  # slots in a row that hardly show it
    rival: Float[Array, "2"]  # where one more was seen last, m
    seen: Int[Array, ""]  # slots in a row that showed it there


def nothing_followed(size: Float[Array, "2"], count: int) -> Followed:
    """No contact yet of up to `count`, on a sheet of `size`."""
    dtype = size.dtype
    zero, whole = jnp.zeros(count, dtype), jnp.zeros(count, jnp.int32)
    return Followed(
        zero > 1,
        jnp.broadcast_to(size / 2, (count, 2)),
        zero,
        jnp.broadcast_to(_first(dtype), (count, 3, 3)),
        zero,
        zero,
        whole,
        jnp.zeros(2, dtype),
        jnp.zeros((), jnp.int32),
    )


def follow(
    sheet: Sheet,
    candidates: Candidates,
    known: Followed,
    voltages: Float[Array, " M"],
    used: Bool[Array, " M"],
    ground: Int[Array, ""],
    elapsed: Float[Array, ""],
    noise: Noise,
) -> tuple[Followed, Float[Array, " M"]]:
    """One slot later, and what the voltages are beside the contacts', V.

    **Arguments:** `voltages` 0 where not `used`; `elapsed` slots since the last one.
    """
    dtype = voltages.dtype
    weights = slot_weights(noise, voltages, used)
    # One by one, as in `product`.
    each = range(len(known.size))
    raw = jnp.stack([tangents(sheet, known.place[c], known.size[c]) for c in each])
    there = known.there[:, None, None]
    own = jnp.where(there, in_slot(sheet, raw, ground), 0)
    lean = _lean(sheet, known, raw, ground)
    own = own.at[:, 0].add((lean[..., None] * own[:, 1:3]).sum(1))
    search = _search(sheet, candidates, known, own[:, 0], weights, voltages, ground)
    new, there = search.new, search.there
    raw = jnp.where(new[:, None, None], candidates.tangent[search.chosen], raw)
    columns = jnp.where(new[:, None, None], in_slot(sheet, raw, ground), own)
    columns = jnp.where(there[:, None, None], columns, 0)
    place = jnp.where(new[:, None], candidates.place[search.chosen], known.place)
    size = jnp.where(new, 0, known.size)
    drift = elapsed * jnp.diag(jnp.asarray(_DRIFT, dtype) ** 2)
    wide = _first(dtype)
    covariance = jnp.where(new[:, None, None], wide, known.covariance + drift)
    moved, covariance, current = _update(columns, covariance, weights, voltages)
    place = place + moved[:, :2] * sheet.unit
    # Off the very edge, where a contact's own potential is infinite.
    edge = 0.1 * sheet.unit
    place = jnp.clip(place, edge, sheet.field.size - edge)
    # What the move makes of the fit, to first order.
    shift = (moved[..., None] * columns[:, 1:]).sum(1)
    rest = voltages - matmul(current, columns[:, 0] + shift)
    forward = current * jnp.sign(sheet.drive_voltage)
    strongest = jnp.where(there, forward, 0).max()
    hardly = (forward < _WEAKEST * strongest) | search.dark
    weak = jnp.where(there & hardly, known.weak + 1, 0)
    now = known._replace(
        there=there & (weak < _OFTEN),
        place=place,
        size=jnp.clip(size + moved[:, 2], -_LARGEST, _LARGEST),
        covariance=covariance,
        current=current,
        weak=weak,
        rival=search.rival,
        seen=search.seen,
    )
    at_ground = jax.lax.dynamic_index_in_dim(raw[:, 0], ground, 1, keepdims=False)
    conductance = _conductance(sheet, now, at_ground, ground)
    return now._replace(conductance=conductance), jnp.where(used, rest, 0)


class _Search(NamedTuple):
    """Contacts that appear."""

    new: Bool[Array, " C"]
    there: Bool[Array, " C"]
    chosen: Int[Array, ""]  # the candidate that a new one is at
    rival: Float[Array, "2"]
    seen: Int[Array, ""]
    dark: Bool[Array, ""]  # nothing stands out of the noise


def _search(
    sheet: Sheet,
    candidates: Candidates,
    known: Followed,
    columns: Float[Array, "C M"],
    weights: Weights,
    voltages: Float[Array, " M"],
    ground: Int[Array, ""],
) -> _Search:
    """Whether one contact alone explains the slot better, or one more is asked for."""
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
    nothing = _Search(~known.there & False, known.there, none, known.rival, none, none > 0)

    def look() -> _Search:
        offset = from_ground(sheet, ground)
        along = weighed_both, beside, normal
        gains = _gains(candidates, offset, ground, plain, scale, *along)
        return _chosen(sheet, candidates, known, *gains, left, alone)

    # What errors alone leave, χ² about the number of channels, has nothing to be found in.
    channels = (weights.each > 0).astype(left.dtype).sum()
    asked = (left > _SEEN + channels) | ~known.there.any()
    found = jax.lax.cond(asked, look, lambda: nothing)
    return found._replace(dark=alone < _SEEN)


def _chosen(
    sheet: Sheet,
    candidates: Candidates,
    known: Followed,
    gains: Float[Array, " K"],
    gains_alone: Float[Array, " K"],
    left: Float[Array, ""],
    alone: Float[Array, ""],
) -> _Search:
    k, k_alone = jnp.argmax(gains), jnp.argmax(gains_alone)
    # Everything is elsewhere.
    jumped = (left > _SEEN) & (alone - gains_alone[k_alone] < _ELSEWHERE * left)
    lone = gains_alone[k_alone] > _SEEN + _EXPLAINED * alone
    anew = (jumped | ~known.there.any()) & lone
    # One more, in several slots.
    more = (gains[k] > _SEEN) & (gains[k] > _SHARE * left) & ~anew & ~known.there.all()
    again = ((candidates.place[k] - known.rival) ** 2).sum() < (_NEAR * sheet.unit) ** 2
    seen = jnp.where(more, jnp.where(again, known.seen + 1, 1), 0)
    born = seen >= _OFTEN
    # In the first that is free.
    slot = jnp.arange(len(known.there)) == jnp.where(anew, 0, jnp.argmin(known.there))
    new = slot & (anew | born)
    return _Search(
        new,
        jnp.where(anew, slot, known.there | new),
        jnp.where(anew, k_alone, k).astype(jnp.int32),
        candidates.place[k],
        jnp.where(born | anew, 0, seen),
        anew & False,
    )


def _first(dtype) -> Float[Array, "3 3"]:
    return jnp.diag(jnp.asarray(_FIRST, dtype) ** 2)


def _gains(
    candidates: Candidates,
    offset: Float[Array, " M"],
    ground: Int[Array, ""],
    plain: Weights,
    scale: Float[Array, ""],
    weighed_both: Float[Array, "2 M"],
    beside: Float[Array, "C M"],
    normal: Float[Array, "C C"],
) -> tuple[Float[Array, " K"], Float[Array, " K"]]:
    """What each candidate explains of the rest beside the contacts, and of all alone.

    Its column is R_i − R_l + f_i, so that every product with it is one with R.
    """
    w = plain.each
    more = jnp.stack([w, w * offset])
    vectors = jnp.concatenate([weighed_both, beside, plain.common, more])
    products = product(candidates.potential, vectors.T)  # (K, C + 5)
    at_ground = jnp.take(candidates.potential, ground, 1)
    constant = matmul(vectors, offset)
    along = products - at_ground[:, None] * vectors.sum(1) + constant
    count = len(beside)
    by_rest, by_all = along[:, 0], along[:, 1]
    shares, common = along[:, 2 : 2 + count], along[:, 2 + count]
    # Σw(R + f − R_l)², less what the offset takes off.
    total, cross = products[:, -2], products[:, -1]
    own = matmul(candidates.square, w) + 2 * (cross - at_ground * total)
    own = own + constant[-1] - 2 * at_ground * constant[-2] + at_ground**2 * w.sum()
    own = own - scale * common**2
    own = jnp.maximum(own, 1e-6 * jnp.abs(own).max())
    inverse = solve_small(normal, jnp.eye(count, dtype=w.dtype))
    left = own - (product(shares, inverse) * shares).sum(1)
    near = left < 1e-3 * own
    gains = jnp.maximum(by_rest, 0) ** 2 / jnp.where(near, 1, left)
    return jnp.where(near, 0, gains), jnp.maximum(by_all, 0) ** 2 / own


def _update(
    columns: Float[Array, "C 4 M"],
    covariance: Float[Array, "C 3 3"],
    weights: Weights,
    voltages: Float[Array, " M"],
) -> tuple[Float[Array, "C 3"], Float[Array, "C 3 3"], Float[Array, " C"]]:
    """By how much each moves, what is known then, and currents."""
    count = len(columns)
    base = columns[:, 0]
    tangent = columns[:, 1:].reshape(3 * count, -1)
    all_columns = jnp.concatenate([base, tangent, voltages[None]])
    gram = product(all_columns, weighed(weights, all_columns).T)
    c, last = count, 4 * count
    inner = regular(gram[:c, :c])
    both = solve_small(inner, jnp.concatenate([gram[:c, c:last], gram[:c, last:]], 1))
    current = both[:, -1]
    share, own = both[:, :-1], jnp.repeat(current, 3)
    normal = gram[c:last, c:last] - product(gram[c:last, :c], share)
    normal = own[:, None] * normal * own
    right = own * (gram[c:last, last] - matmul(gram[c:last, :c], current))
    unit = jnp.eye(3, dtype=base.dtype)
    blocks = normal.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)]
    # News: what this slot says alone is not what was known. Then that counts little.
    wide = _first(base.dtype)
    innovation = (blocks[..., None] * covariance[:, None]).sum(2) + unit
    gain = right.reshape(count, 3)
    both = jnp.concatenate([innovation.transpose(0, 2, 1), covariance])
    inverses = solve_small(both, jnp.broadcast_to(unit, both.shape))
    tested = (inverses[:count] * gain[:, None]).sum(-1)
    unlikely = (tested * (covariance * gain[:, None]).sum(-1)).sum(-1)
    news = (unlikely > _NEWS)[:, None, None]
    wide = jnp.diag(1 / jnp.asarray(_FIRST, base.dtype) ** 2)
    inverse = jnp.where(news, wide, inverses[count:])
    same = np.eye(count, dtype=base.dtype)[:, None, :, None]
    weight = same * inverse[:, :, None]
    found = solve_small(
        normal + weight.reshape(3 * c, 3 * c),
        jnp.concatenate([right[:, None], jnp.eye(3 * c, dtype=base.dtype)], 1),
    )
    moved, spread = found[:, 0].reshape(count, 3), found[:, 1:]
    spread = spread.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)]
    longest = jnp.asarray([*_FIRST[:2], 1.0], base.dtype)
    return (
        jnp.clip(moved, -longest, longest),
        (spread + spread.transpose(0, 2, 1)) / 2,
        current - matmul(share, own * found[:, 0]),
    )


def _lean(sheet: Sheet, known: Followed, raw, ground) -> Float[Array, "C 2"]:
    """How far a contact's current is from its centre, in units: see `_points`."""
    radius = radius_of(sheet, known.size)
    moment = polarisability(sheet, jnp.maximum(known.conductance, 0), radius)
    total = known.current.sum()
    share = jnp.where(
        known.current != 0, total / jnp.where(known.current != 0, known.current, 1), 0
    )
    towards = jax.lax.dynamic_index_in_dim(raw[:, 1:3], ground, 2, keepdims=False)
    shift = moment[:, None] * share[:, None] * towards / sheet.unit**2
    longest = 0.6 * radius[:, None] / sheet.unit
    length = jnp.sqrt((shift**2).sum(-1, keepdims=True) + 1e-18)
    return shift * jnp.minimum(1, longest / length)


def _conductance(
    sheet: Sheet, now: Followed, at_ground: Float[Array, " C"], ground: Int[Array, ""]
) -> Float[Array, " C"]:
    """I/(V0 − u), S: see `_points.drops`."""
    radius = radius_of(sheet, now.size)
    own_ground = jnp.diagonal(sheet.field.electrodes) + sheet.ground_resistance
    among = jax.vmap(green_of(sheet, now.place, radius))(now.place)
    current = jnp.where(now.there, now.current, 0)
    total = current.sum()
    u = matmul(among, current) - (current * at_ground).sum()
    u = u + total * (own_ground[ground] - at_ground)
    drive = sheet.drive_voltage
    forward = jnp.sign(drive)
    drop = jnp.maximum(forward * (drive - u), LEAST_DROP * jnp.abs(drive))
    return forward * current / drop
