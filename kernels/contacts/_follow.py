"""Follows a few contacts from slot to slot: one linear least squares for each slot.

A mean and a covariance hold the known places and sizes. Each slot is fitted with the slopes
at the mean and the best currents. `_search` finds contacts that appear or jump, in the slot
that shows them. Sizes are fixed and operations are few: each costs about a microsecond,
whatever its size.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels.algebra import matmul
from tomojax.kernels.contacts._field import home_of
from tomojax.kernels.contacts._one_slot import (
    in_slot,
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
from tomojax.kernels.contacts._points import (
    green_of,
    LEAST_DROP,
    not_beyond,
    polarisability,
    Sheet,
    SIZE_WIDTH,
)
from tomojax.kernels.contacts._search import (
    Candidates,
    FIRST,
    first_covariance,
    Followed,
    OFTEN,
    search,
)

# By how much a place (units of the fit, a twentieth of a pitch) and a size move: 1 σ, and
# as the root of the time. A finger that strokes.
_DRIFT = (0.05, 0.05, 0.02)
# The time in which they move so much, s.
_DRIFT_TIME = 1e-4

# χ² of a slot's own place beside what was known, of three values: beyond, it is news.
_NEWS = 40.0

# Slots over which what is left is averaged.
_LATELY = 8

# A contact's current is at least this part of the strongest's.
_WEAKEST = 0.05

# Sizes are no further than this from usual,
_LARGEST = 3.0
# and so much below the largest size of the table.
_BELOW = 1e-3


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
    """Returns the contacts one slot later, and the voltages beside the contacts' own, V.

    **Arguments:** `voltages` 0 where not `used`; `elapsed` since the last slot, s.
    """
    dtype = voltages.dtype
    # The grounded electrode's own voltage is that of its path, which is hardly known.
    used = used & ~sheet.slots.grounded(ground)
    weights = slot_weights(noise, voltages, used)
    # One by one, as in `product`.
    each = range(len(known.size))
    raw = jnp.stack([tangents(sheet, known.place[c], known.size[c]) for c in each])
    there = known.there[:, None, None]
    own = jnp.where(there, in_slot(sheet, raw, ground), 0)
    lean = _lean(sheet, known, raw, ground, voltages)
    own = own.at[:, 0].add((lean[..., None] * own[:, 1:3]).sum(1))
    # The search looks for currents in the drive's direction.
    towards = jnp.sign(sheet.drive_voltage) * voltages
    seen = search(sheet, candidates, known, own[:, 0], weights, towards, ground)
    new, there = seen.new, seen.there
    raw = jnp.where(new[:, None, None], candidates.tangent[seen.chosen], raw)
    columns = jnp.where(new[:, None, None], in_slot(sheet, raw, ground), own)
    columns = jnp.where(there[:, None, None], columns, 0)
    place = jnp.where(new[:, None], candidates.place[seen.chosen], known.place)
    size = jnp.where(new, 0, known.size)
    drift = elapsed / _DRIFT_TIME * jnp.diag(jnp.asarray(_DRIFT, dtype) ** 2)
    unknown = first_covariance(dtype)
    covariance = jnp.where(new[:, None, None], unknown, known.covariance + drift)
    moved, covariance, alone, current = _update(columns, covariance, weights, voltages)
    place = place + moved[:, :2] * sheet.unit
    # Off the very edge, where a contact's own potential is infinite.
    edge = 0.1 * sheet.unit
    place = jnp.clip(place, edge, sheet.field.size - edge)
    place = jax.vmap(home_of, (None, 0))(sheet.field, place)
    # What the move makes of the fit, to first order.
    shift = (moved[..., None] * columns[:, 1:]).sum(1)
    rest = voltages - matmul(current, columns[:, 0] + shift)
    # What all channels are off is the ground's: no contact explains it, none is asked to.
    offset = matmul(weights.each, rest) / jnp.maximum(weights.each.sum(), 1e-30)
    rest = rest - offset
    forward = current * jnp.sign(sheet.drive_voltage)
    strongest = jnp.where(there, forward, 0).max()
    faint = forward < _WEAKEST * strongest
    hardly = faint | seen.dark
    weak = jnp.where(there & hardly, known.weak + 1, 0)
    now = known._replace(
        # What begins that faint is what errors make of the others.
        there=there & (weak < OFTEN) & ~(new & faint),
        place=place,
        size=jnp.clip(size + moved[:, 2], -_LARGEST, _largest(sheet)),
        covariance=covariance,
        alone=alone,
        current=current,
        weak=weak,
        rival=seen.rival,
        seen=seen.seen,
        left=_left(known, new, weights, rest),
        doubted=seen.doubted,
    )
    level = sheet.slots.level(raw[:, 0], ground)
    sunk = sheet.slots.sunk(raw[:, 0], ground, voltages)
    conductance = _conductance(sheet, now, level, sunk, ground, offset)
    return now._replace(conductance=conductance), jnp.where(used, rest, 0)


def _largest(sheet: Sheet) -> Float[Array, ""]:
    """The largest size: below the largest disc of the table, where slopes by size end.

    At or beyond that a contact that grew in wrong slots would never shrink again.
    """
    table = jnp.log(sheet.field.radii[-1] / sheet.size) / SIZE_WIDTH
    return jnp.minimum(_LARGEST, table - _BELOW)


def _left(
    known: Followed,
    new: Bool[Array, " C"],
    weights: Weights,
    rest: Float[Array, " M"],
) -> Float[Array, ""]:
    """Averages χ² of each channel over some slots; starts anew with a new contact."""
    channels = jnp.maximum((weights.each > 0).sum(), 1).astype(rest.dtype)
    now = matmul(rest, weighed(weights, rest[None])[0]) / channels
    share = jnp.where(new.any() | (known.left == 0), 1, 1 / _LATELY)
    return known.left + share * (now - known.left)


def _update(
    columns: Float[Array, "C 4 M"],
    covariance: Float[Array, "C 3 3"],
    weights: Weights,
    voltages: Float[Array, " M"],
) -> tuple[Array, Float[Array, "C 3 3"], Float[Array, "C 3 3"], Float[Array, " C"]]:
    """Returns moves (C, 3), the covariance then and by this slot alone, and currents."""
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
    # News: what this slot says alone is not what was known. Then only what was known before
    # any slot counts.
    before = jnp.diag(1 / jnp.asarray(FIRST, base.dtype) ** 2)
    innovation = (blocks[..., None] * covariance[:, None]).sum(2) + unit
    gain = right.reshape(count, 3)
    matrices = [innovation.transpose(0, 2, 1), covariance, blocks + before]
    all_three = jnp.concatenate(matrices)
    inverses = solve_small(all_three, jnp.broadcast_to(unit, all_three.shape))
    of_innovation, of_covariance, alone = jnp.split(inverses, 3)
    tested = (of_innovation * gain[:, None]).sum(-1)
    unlikely = (tested * (covariance * gain[:, None]).sum(-1)).sum(-1)
    news = (unlikely > _NEWS)[:, None, None]
    inverse = jnp.where(news, before, of_covariance)
    same = np.eye(count, dtype=base.dtype)[:, None, :, None]
    weight = same * inverse[:, :, None]
    found = solve_small(
        normal + weight.reshape(3 * c, 3 * c),
        jnp.concatenate([right[:, None], jnp.eye(3 * c, dtype=base.dtype)], 1),
    )
    moved, spread = found[:, 0].reshape(count, 3), found[:, 1:]
    spread = spread.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)]
    longest = jnp.asarray([*FIRST[:2], 1.0], base.dtype)
    return (
        jnp.clip(moved, -longest, longest),
        (spread + spread.transpose(0, 2, 1)) / 2,
        alone,
        current - matmul(share, own * found[:, 0]),
    )


def _lean(sheet: Sheet, known: Followed, raw, ground, volts) -> Float[Array, "C 2"]:
    """Computes how far a contact's current is from its centre, in units: see `_points`."""
    radius = radius_of(sheet, known.size)
    moment = polarisability(sheet, jnp.maximum(known.conductance, 0), radius)
    total = known.current.sum()
    flowing = known.current != 0
    share = jnp.where(flowing, total / jnp.where(flowing, known.current, 1), 0)
    towards = sheet.slots.sunk(raw[:, 1:3], ground, volts)
    shift = moment[:, None] * share[:, None] * towards / sheet.unit**2
    return not_beyond(shift, radius / sheet.unit)


def _conductance(
    sheet: Sheet,
    now: Followed,
    level: Float[Array, " C"],
    sunk: Float[Array, " C"],
    ground: Int[Array, ""],
    offset: Float[Array, ""],
) -> Float[Array, " C"]:
    """Computes I/(V0 − u), S: see `_points.drops`; the ground lifts all by `offset`, V."""
    radius = radius_of(sheet, now.size)
    path = sheet.slots.path(ground)
    among = jax.vmap(green_of(sheet, now.place, radius))(now.place)
    current = jnp.where(now.there, now.current, 0)
    total = current.sum()
    u = matmul(among, current) - (current * level).sum()
    u = u + total * (path - sunk) + offset
    drive = sheet.drive_voltage
    forward = jnp.sign(drive)
    drop = jnp.maximum(forward * (drive - u), LEAST_DROP * jnp.abs(drive))
    return forward * current / drop
