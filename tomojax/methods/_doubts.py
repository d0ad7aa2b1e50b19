"""Finds frames that contradict themselves or tell too little, before a method sees them."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer

from tomojax.kernels.flags import Flag
from tomojax.kernels.levels import level_bits, TELLS

# A frame with no more than this part of its voltages places a contact badly.
_FEW = 0.25

# The readings of a slot beside its ground's tell an offset and each contact's current; all
# slots share two numbers of a place, and a third of a shape.
_PLACE = 2
_CONTACT = 3

# With so many readings more, errors show; with fewer, whatever is read is a place. What is
# wrong with a channel is the same in all slots: further contacts would explain it, if one
# slot cannot tell them.
_MORE = 4

# One of so many touched slots: a ground that is none there is no single bad reading.
_EACH = 4


class Looked(NamedTuple):
    """A first look at n frames: their levels, doubts and counts of readings."""

    data: Bool[Any, " n"]  # whether a voltage is good
    height: Float[Any, " n"]  # the highest |V|
    flags: Integer[Any, " n"]  # doubts of what has a contact
    most: Integer[Any, " n"]  # contacts that so many readings tell


def look_at(
    voltages: Float[Any, "n S M"],
    grounds: Integer[Any, "n S"],
    good: Bool[Any, "n S M"],
    drive_sign: Any,
    noise: Any,
    highest: Any,
    grounded: Bool[Any, "L M"],
    xp: Any = np,
) -> Looked:
    """Checks levels and counts readings; `noise` of a reading, V; `xp`: NumPy or JAX's.

    `highest`: |V| that the drive cannot exceed. `grounded` tells which electrodes each
    ground holds near 0 V.

    Bits: SATURATED where a reading is beyond what the drive can make (or in millivolts),
    AGAINST_DRIVE and GROUND_NOT_LOWEST (see `level_bits`), and PLACE_UNCERTAIN where
    too few readings are there for errors to show.
    """
    towards = voltages * xp.asarray(drive_sign, voltages.dtype)
    whole = xp is np and bool(good.all())  # as most are
    high, low = (
        _folded(best, towards if whole else xp.where(good, towards, none), xp)
        for best, none in ((xp.maximum, -np.inf), (xp.minimum, np.inf))
    )
    height = xp.maximum(high, -low)
    there, at = _at_ground(towards, grounds, good, grounded, xp)
    bits = level_bits(low, high, at, noise, xp)
    heights = (height > TELLS * noise).sum(1)
    least = xp.maximum(-(-heights // _EACH), 1)  # rounded up
    top = height.max(1, initial=-np.inf)
    flags = xp.where(top > highest, np.uint32(Flag.SATURATED), np.uint32(0))
    for flag in (Flag.AGAINST_DRIVE, Flag.GROUND_NOT_LOWEST):
        often = ((bits & flag.value) > 0).sum(1) >= least
        flags |= xp.where(often, np.uint32(flag), np.uint32(0))
    each = np.full(good.shape[:2], good.shape[2]) if whole else good.sum(2)
    readings = each.sum(1)
    few = readings <= int(_FEW * np.prod(good.shape[1:]))
    each = each - there
    beyond = xp.maximum(each - 2, 0).sum(1) - _PLACE
    vague = (few | (beyond < _MORE)) & (readings > 0)
    flags |= xp.where(vague, np.uint32(Flag.PLACE_UNCERTAIN), np.uint32(0))
    # c contacts: an offset, c currents, c places and shapes.
    most = (each.max(1, initial=0) - 1 - _MORE) // (1 + _CONTACT)
    return Looked(readings > 0, top, flags, xp.maximum(most, 1))


def _folded(best: Any, values: Float[Any, "n S M"], xp: Any) -> Float[Any, "n S"]:
    """Takes the highest or the lowest of each slot.

    NumPy compares halves with each other: its `max` of short rows takes three times as
    long.
    """
    if xp is not np:
        return best.reduce(values, axis=2)
    while (wide := values.shape[2]) > 1:
        half = (wide + 1) // 2
        values = best(values[..., :half], values[..., wide - half :])
    return values[..., 0]


def _at_ground(
    voltages: Float[Any, "n S M"],
    grounds: Integer[Any, "n S"],
    good: Bool[Any, "n S M"],
    grounded: Bool[Any, "L M"],
    xp: Any,
) -> tuple[Integer[Any, "n S"], Float[Any, "n S"]]:
    """Counts good readings at grounds, and returns their lowest voltage; −inf for none."""
    if xp is np and np.array_equal(grounded, np.eye(*grounded.shape)):
        there = np.take_along_axis(good, grounds[..., None], 2)[..., 0]
        at = np.take_along_axis(voltages, grounds[..., None], 2)[..., 0]
    else:
        held = grounded[grounds] & good
        there = held.sum(2)
        at = xp.where(held, voltages, np.inf).min(2)
    return there.astype(int), xp.where(there > 0, at, -np.inf)
