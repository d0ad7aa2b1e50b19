"""Finds faults of measured scans: bits of `Flag` per slot, and the voltages to use.

Each rule has a few lines and is local in time. A slot's faults depend on nothing further
away than `HALO` slots or one scan. So chunks of a recording can be judged alone. The rules
need the noise of a real converter. A channel or a scan that repeats itself to the last bit
is not being read. A scene computed without noise would look stuck.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer, Shaped

from tomojax.kernels.flags import Flag

# A channel is dead or stuck when this many steps from slot to slot leave it unchanged, and
# in half of them most channels change. Noise of one code repeats by chance in 1 of 4 steps:
# once in 4e9.
HALO = 16

# Part of the channels that change by more than one code, where noise is of a code or more.
_BY_CODES = 0.25

# Codes coarser than this part of the drive stand still by themselves: of 128 readings of 8
# bits all repeat in 4 of 10 scans.
_COARSE = 1e-3

# A voltage below 0 or above the drive by this part of it is no potential of the sheet.
_BEYOND = 0.1


class Faults(NamedTuple):
    """Faults of n scans of S slots of M channels.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> volts = np.random.default_rng(0).uniform(0, 4, (1, 2, 16))
    >>> faults = tx.find_faults(volts, np.array([[0, 99]]), drive_voltage=4.5)
    >>> print(faults.good.all(2), [tx.Flag(int(f)).name for f in faults.flags[0] if f])
    [[ True False]] ['UNKNOWN_GROUND']
    """

    good: Bool[np.ndarray, "n S M"]  # voltages to use
    flags: Integer[np.ndarray, "n S"]  # bits of `Flag` per slot


def find_faults(
    voltages: Float[np.ndarray, "n S M"],
    grounds: Shaped[np.ndarray, "n S"],
    drive_voltage: float,
    rails: tuple[float, float] = (-np.inf, np.inf),
    repeats: bool = True,
    resolution: float = 0.0,
    conditions: int | None = None,
) -> Faults:
    """Finds bad channels, slots and scans of a stretch of a recording.

    **Arguments:** `voltages` V; `grounds` electrode numbers; `drive_voltage` V0;
    `rails` of the converter, V; `repeats` False does not look for stuck and dead channels
    and scans (voltages without noise); `resolution`: of one code, V, if known. A sound
    channel may repeat itself if noise moves the channel by less than a code, so coarse
    codes are not searched for repeats. A rail where the sheet's own potentials end, at 0 V
    or at the drive, is no saturation.
    `conditions`: how many there are, where grounds number a table of them.

    Bits: BAD_VOLTAGES, SATURATED, UNKNOWN_GROUND, DEAD_CHANNEL, STUCK_CHANNEL, ALL_ZERO,
    STUCK_SCAN.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> volts = np.random.default_rng(0).uniform(0, 4, (3, 2, 16))  # scans, slots, channels
    >>> volts[1, 0, 5] = np.nan
    >>> faults = tx.find_faults(volts, np.array([[0, 15]] * 3), drive_voltage=4.5)
    >>> int((~faults.good).sum()), tx.Flag(int(faults.flags[1, 0])).name
    (1, 'BAD_VOLTAGES')
    """
    scans, slots, channels = voltages.shape
    finite = np.isfinite(voltages)
    beyond = abs(_BEYOND * drive_voltage)
    ends = min(0.0, drive_voltage), max(0.0, drive_voltage)
    low, high = ends[0] - beyond, ends[1] + beyond
    if not low < rails[0] <= ends[0] + resolution:
        low = max(rails[0], low)
    if not ends[1] - resolution <= rails[1] < high:
        high = min(rails[1], high)
    saturated = finite & ((voltages <= low) | (voltages >= high))
    unknown = (grounds < 0) | (grounds >= (channels if conditions is None else conditions))
    zero = np.logical_not(voltages.any(-1))
    good = finite & ~saturated
    flags = (
        _bit(~finite.all(-1), Flag.BAD_VOLTAGES)
        | _bit(saturated.any(-1), Flag.SATURATED)
        | _bit(unknown, Flag.UNKNOWN_GROUND)
        | _bit(zero, Flag.ALL_ZERO)
    )
    if repeats and resolution <= _COARSE * abs(drive_voltage):
        frozen = (_repeated_scans(voltages) & ~zero.all(1))[:, None]
        still = _unchanging(voltages.reshape(-1, channels), resolution)
        still = still.reshape(voltages.shape)
        # One reason for each: at the rail and all at once are told already.
        still &= ~(saturated | zero[..., None] | frozen[..., None])
        dead = still & (voltages == 0)
        flags |= _bit(dead.any(-1), Flag.DEAD_CHANNEL)
        flags |= _bit((still & ~dead).any(-1), Flag.STUCK_CHANNEL)
        flags |= _bit(np.broadcast_to(frozen, flags.shape), Flag.STUCK_SCAN)
        good &= ~still & ~frozen[..., None]
    good &= ~(unknown | zero)[..., None]
    # A slot with less than half of its channels tells of those, not of the contact.
    enough = 2 * good.sum(-1) >= channels
    good &= enough[..., None]
    return Faults(good, flags)


def _bit(where: Any, flag: Flag) -> np.ndarray:
    return np.where(where, flag.value, 0).astype(np.uint32)


def _repeated_scans(voltages: np.ndarray) -> Bool[np.ndarray, " n"]:
    """Finds scans equal to a neighbour, unless nothing in the scans ever changes."""
    same = (voltages[1:] == voltages[:-1]).all((1, 2))
    found = np.zeros(len(voltages), bool)
    found[1:] |= same
    found[:-1] |= same
    if found.any() and voltages.shape[1] > 1:
        steps = voltages[found, 1:] != voltages[found, :-1]
        # Without noise and without contact every code is the same all the time.
        found[found] = (steps.mean(-1) > 0.5).mean(-1) >= 0.5
    return found


def _unchanging(
    slots: Float[np.ndarray, "slots M"], resolution: float
) -> Bool[np.ndarray, "slots M"]:
    """Finds values in `HALO` steps without change, while most channels change.

    Some channels must change by more than one code: otherwise only the codes stand still.
    """
    found = np.zeros(slots.shape, bool)
    if len(slots) <= HALO:
        return found
    step = slots[1:] - slots[:-1]
    same = step == 0
    far = np.abs(step) > 1.5 * resolution
    lively = (same.mean(1) < 0.5) & (far.mean(1) > _BY_CODES)
    # All of 16 steps, by doubling.
    whole = same
    for reach in (1, 2, 4, 8):
        whole = whole[:-reach] & whole[reach:]
    counts = np.concatenate([[0], np.cumsum(lively)])
    windows = (counts[HALO:] - counts[:-HALO]) >= HALO // 2
    whole = whole & windows[:, None]
    if not whole.any():
        return found
    for reach in range(HALO + 1):
        found[reach : reach + len(whole)] |= whole
    return found
