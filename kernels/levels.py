"""Checks a slot's wiring by its voltages, without any model of the contact.

A touching object feeds current into the sheet, and only the grounded electrode takes
current out. So every voltage has the direction of the drive, and the grounded electrode has
the lowest voltage (the maximum principle). The principle holds for any sheet, contacts and
ground path. The functions take arrays of NumPy and of JAX.
"""

from typing import Any

from tomojax.kernels.flags import Flag

# A grounded electrode above the lowest voltage by this part of the slot's span is none: the
# neighbours of a ground are higher by a fifth and more.
_ABOVE = 0.05

# An electrode with this part of the highest voltage is not grounded: its path would have
# more resistance than the sheet.
_PART = 0.5

# Voltages that are lower than so many times the noise tell nothing.
TELLS = 20.0

# The lowest of many channels is so many times the noise below what it would be without.
_LOWEST = 6.0


def level_bits(low: Any, high: Any, at_ground: Any, noise: Any, xp: Any) -> Any:
    """Flags each slot whose levels are impossible: AGAINST_DRIVE, GROUND_NOT_LOWEST.

    **Arguments:** `low`, `high`: the lowest and highest voltage of a slot's good channels,
    V in the direction of the drive. `at_ground`: the grounded electrode's voltage, V (−∞
    where that channel is not good). `noise` of a reading, V; `xp`: `numpy` or `jax.numpy`.
    """
    against = (-low > high) & (-low > TELLS * noise)
    span = high - low
    above = at_ground - low > _ABOVE * span + _LOWEST * noise
    above = above | (at_ground > _PART * high)
    lifted = ~against & above & (high > TELLS * noise)
    drive = xp.where(against, Flag.AGAINST_DRIVE.value, 0)
    return drive | xp.where(lifted, Flag.GROUND_NOT_LOWEST.value, 0)
