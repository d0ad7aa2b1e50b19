"""Follows a few contacts from slot to slot: one linear least squares for each slot.

A mean and a covariance hold the known places and sizes. Each slot is fitted with the slopes
at the mean and the best currents. `_search` finds contacts that appear or jump, in the slot
that shows them. Sizes are fixed and operations are few: each costs about a microsecond,
whatever its size.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels.algebra import matmul
from tomojax.kernels.contacts._anew import Candidates, WEAKEST
from tomojax.kernels.contacts._one_slot import (
    all_tangents,
    first_covariance,
    fitted,
    in_slot,
    Noise,
    OneSlot,
    plain_of,
    radius_of,
    slot_weights,
    update,
    Weights,
    whitened,
)
from tomojax.kernels.contacts._points import (
    green_of,
    LEAST_DROP,
    not_beyond,
    polarisability,
    Sheet,
)
from tomojax.kernels.contacts._search import Followed, OFTEN, search

# By how much a place (units of the fit, a twentieth of a pitch) and a size move: 1 σ, and
# as the root of the time. A finger that strokes.
_DRIFT = (0.05, 0.05, 0.02)
# The time in which they move so much, s.
_DRIFT_TIME = 1e-4

# Slots over which what is left is averaged.
_LATELY = 8


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
    slot = OneSlot(sheet, ground, weights, plain_of(weights), voltages)
    raw = all_tangents(sheet, known.place, known.size)
    there = known.there[:, None, None]
    own = jnp.where(there, in_slot(sheet, raw, ground), 0)
    lean = _lean(sheet, known, raw, ground, voltages)
    own = own.at[:, 0].add((lean[..., None] * own[:, 1:3]).sum(1))
    # The search looks for currents in the drive's direction.
    towards = slot._replace(voltages=jnp.sign(sheet.drive_voltage) * voltages)
    seen = search(towards, candidates, known, own[:, 0])
    new, there = seen.new, seen.there
    raw = jnp.where(new[:, None, None], seen.raw, raw)
    columns = jnp.where(new[:, None, None], in_slot(sheet, raw, ground), own)
    columns = jnp.where(there[:, None, None], columns, 0)
    place = jnp.where(new[:, None], seen.place, known.place)
    size = jnp.where(new, seen.size, known.size)
    drift = elapsed / _DRIFT_TIME * jnp.diag(jnp.asarray(_DRIFT, dtype) ** 2)
    unknown = first_covariance(dtype)
    covariance = jnp.where(new[:, None, None], unknown, known.covariance + drift)
    moved, covariance, alone, current = update(slot, columns, covariance)
    place, size = fitted(sheet, place, size, moved)
    # What the move makes of the fit, to first order.
    shift = (moved[..., None] * columns[:, 1:]).sum(1)
    rest = voltages - matmul(current, columns[:, 0] + shift)
    # What all channels are off is the ground's: no contact explains it, none is asked to.
    w = weights.each**2
    offset = matmul(w, rest) / jnp.maximum(w.sum(), 1e-30)
    rest = rest - offset
    forward = current * jnp.sign(sheet.drive_voltage)
    strongest = jnp.where(there, forward, 0).max()
    faint = forward < WEAKEST * strongest
    hardly = faint | seen.dark
    weak = jnp.where(there & hardly, known.weak + 1, 0)
    # One of several has to show itself in the next slot, too: a fault shows in one ground.
    weak = jnp.where(new & (there.sum() > 1), OFTEN - 1, weak)
    # Where all that was new has shown itself in the next slot, the doubt ends.
    fresh = known.there & (known.weak == OFTEN - 1)
    shown = fresh.any() & (~fresh | (there & (weak == 0))).all()
    now = known._replace(
        # What begins that faint is what errors make of the others.
        there=there & (weak < OFTEN) & ~(new & faint),
        place=place,
        size=size,
        covariance=covariance,
        alone=alone,
        current=current,
        weak=weak,
        rival=seen.rival,
        seen=seen.seen,
        left=_left(known, new, weights, rest),
        doubted=jnp.where(shown, 0, seen.doubted),
    )
    level = sheet.slots.level(raw[:, 0], ground)
    sunk = sheet.slots.sunk(raw[:, 0], ground, voltages)
    conductance = _conductance(sheet, now, level, sunk, ground, offset)
    return now._replace(conductance=conductance), jnp.where(used, rest, 0)


def _left(
    known: Followed,
    new: Bool[Array, " C"],
    weights: Weights,
    rest: Float[Array, " M"],
) -> Float[Array, ""]:
    """Averages χ² of each channel over some slots; starts anew with a new contact."""
    channels = jnp.maximum((weights.each > 0).sum(), 1).astype(rest.dtype)
    now = (whitened(weights, rest[None]) ** 2).sum() / channels
    share = jnp.where(new.any() | (known.left == 0), 1, 1 / _LATELY)
    return known.left + share * (now - known.left)


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
