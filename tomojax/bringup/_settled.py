"""Takes off what all channels still show of the slot before."""

import numpy as np

from tomojax.bringup._amounts import settling
from tomojax.bringup._reading import Reading
from tomojax.bringup._wiring import grounds_to_try
from tomojax.bringup.sheet._fit import fitted
from tomojax.bringup.sheet._slots import Slots

# A part that is so large is taken off before all else, if contacts fit so much better.
# Parts that are tried, on so many slots.
_TAKEN, _HALF, _BETTER = 0.008, 0.9, 0.97
_PARTS, _SOME = (0.01, 0.03, 0.07, 0.15, 0.25, 0.35, 0.42, 0.6, 0.75, 0.9), 60

# Beyond this part the order of channels is looked at again.
_MUCH = 0.1

# Residuals count up to this part of the voltages' span.
_MOST = 0.05


def settle(reading: Reading) -> None:
    """Takes off what all channels show of the slot before.

    Channels show a part of the slot before, of its true voltages or of its readings. A part
    of true voltages is taken off slot after slot. The function takes whichever leaves less.
    """
    common, error = settling(reading.work())
    reading.lingers_error = error
    if not (np.isfinite(error) and _TAKEN < common < _HALF):
        return
    plain = reading.volts, reading.order, reading.every
    some = np.sort(
        reading.rng.choice(len(reading.number), min(len(reading.number), _SOME), False)
    )
    start = _misfit(reading, some, plain[2])
    tried = []
    for recursive in (False, True):
        for part in (common, *_PARTS):
            every = _unsettled(plain[2], reading.slots, part, recursive)
            tried.append((_misfit(reading, some, every), part, recursive))
    least, total, recursive = min(tried)
    if least > _BETTER * start:
        return
    best = None
    for _ in range(3):
        reading.every = _unsettled(plain[2], reading.slots, total, recursive)
        reading.volts = reading.every[reading.number].astype(float)
        reading.again()
        left = _misfit(reading, some, reading.every)
        if left > least * (1 + 1e-9):
            break
        more, error = settling(reading.work())
        best, least = (reading.volts, reading.order, reading.every, total, error), left
        total = float(np.clip(total + (1 - total) * more, 0.0, _HALF))
        if abs(more) < 1e-3:
            break
    if best is None:
        reading.volts, reading.order, reading.every = plain
    else:
        reading.volts, reading.order, reading.every = best[:3]
        reading.lingers, reading.lingers_error = best[3:]
    if reading.lingers > _MUCH:
        reading.fit()


def _misfit(reading: Reading, some: np.ndarray, every: np.ndarray) -> float:
    """Averages the part of some slots that contacts leave, channel by channel."""
    back = np.argsort(reading.order.electrode)
    volts = every[reading.number[some]].astype(float)[:, back]
    weight = np.broadcast_to(reading.usable[back].astype(float), volts.shape)
    told = grounds_to_try(reading.asked[some], reading.order.electrode, reading.usable)
    always = (
        None if reading.always is None else int(reading.order.electrode[reading.always])
    )
    fits = fitted(reading.plane, volts, weight, told, always)
    part = np.abs(volts - fits.modelled) / np.maximum(fits.span, 1e-12)[:, None]
    return float(np.minimum(part, _MOST)[fits.far * weight > 0].mean())


def _unsettled(volts: np.ndarray, slots: Slots, part: float, recursive: bool) -> np.ndarray:
    """Takes a part of the slot before off each slot: of true voltages, or of readings."""
    before = np.concatenate([volts[:1], volts[:-1]])
    if not recursive:
        follows = slots.follows[:, None]
        return np.where(follows, (volts - part * before) / (1 - part), volts)
    if part < 0.5:
        from scipy.signal import lfilter

        found = np.empty_like(volts)
        for a, b in slots.runs(slots.follows | np.roll(slots.follows, -1)):
            start = volts[a : a + 1] * part / (1 - part)
            given = [1 / (1 - part)], [1, part / (1 - part)], volts[a:b]
            found[a:b] = lfilter(*given, axis=0, zi=-start)[0]
        alone = ~(slots.follows | np.roll(slots.follows, -1))
        found[alone] = volts[alone]
        return found.astype(volts.dtype)
    # Beyond a half that is not stable forwards: backwards it is.
    found = np.copy(volts)
    after = volts[-1]
    for s in range(len(volts) - 1, 0, -1):
        after = (volts[s] - (1 - part) * after) / part if slots.follows[s] else volts[s - 1]
        found[s - 1] = after
    return found
