"""Finds frames that contradict themselves or tell too little, before a method sees them."""

from typing import NamedTuple

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

# The part of the touched slots in which a ground that is none is no single bad reading.
_SLOTS = 0.25


class Looked(NamedTuple):
    """A first look at n frames: their levels, doubts and counts of readings."""

    data: Bool[np.ndarray, " n"]  # whether a voltage is good
    height: Float[np.ndarray, " n"]  # the highest |V|
    flags: Integer[np.ndarray, " n"]  # doubts of what has a contact
    most: Integer[np.ndarray, " n"]  # contacts that so many readings tell


def look_at(
    voltages: Float[np.ndarray, "n S M"],
    grounds: Integer[np.ndarray, "n S"],
    good: Bool[np.ndarray, "n S M"],
    drive_sign: float,
    noise: float,
    grounded: Bool[np.ndarray, "L M"],
) -> Looked:
    """Checks levels and counts readings; `noise` of a reading, V.

    `grounded` tells which electrodes each ground holds near 0 V.

    Bits: AGAINST_DRIVE and GROUND_NOT_LOWEST (see `level_bits`), and PLACE_UNCERTAIN where
    too few readings are there for errors to show.
    """
    whole = bool(good.all())
    high = (voltages if whole else np.where(good, voltages, -np.inf)).max(2)
    low = (voltages if whole else np.where(good, voltages, np.inf)).min(2)
    height = np.maximum(high, -low)
    if drive_sign < 0:
        low, high = -high, -low
    there, at = _at_ground(drive_sign * voltages, grounds, good, grounded)
    bits = level_bits(low, high, at, noise, np)
    least = np.maximum(_SLOTS * (height > TELLS * noise).sum(1), 1)
    flags = np.zeros(len(bits), np.uint32)
    for flag in (Flag.AGAINST_DRIVE, Flag.GROUND_NOT_LOWEST):
        often = ((bits & flag.value) > 0).sum(1) >= least
        flags[often] |= np.uint32(flag)
    each = good.sum(2)
    readings = each.sum(1)
    few = readings <= _FEW * good[0].size if len(good) else readings > 0
    each -= there
    beyond = np.maximum(each - 2, 0).sum(1) - _PLACE
    flags[(few | (beyond < _MORE)) & (readings > 0)] |= np.uint32(Flag.PLACE_UNCERTAIN)
    # c contacts: an offset, c currents, c places and shapes.
    most = (each.max(1, initial=0) - 1 - _MORE) // (1 + _CONTACT)
    return Looked(readings > 0, height.max(1, initial=-np.inf), flags, np.maximum(most, 1))


def _at_ground(
    voltages: Float[np.ndarray, "n S M"],
    grounds: Integer[np.ndarray, "n S"],
    good: Bool[np.ndarray, "n S M"],
    grounded: Bool[np.ndarray, "L M"],
) -> tuple[Integer[np.ndarray, "n S"], Float[np.ndarray, "n S"]]:
    """Counts good readings at grounds, and returns their lowest voltage; −inf for none."""
    if np.array_equal(grounded, np.eye(*grounded.shape)):
        there = np.take_along_axis(good, grounds[..., None], 2)[..., 0]
        at = np.take_along_axis(voltages, grounds[..., None], 2)[..., 0]
    else:
        held = grounded[grounds] & good
        there = held.sum(2)
        at = np.where(held, voltages, np.inf).min(2)
    return there.astype(int), np.where(there > 0, at, -np.inf)
