"""Finds what channels still show of the slot before, and takes off what all show."""

import numpy as np
from jaxtyping import Float

from tomojax.bringup._amounts import BEYOND, spread
from tomojax.bringup._fault import certainty, Fault
from tomojax.bringup._reading import Reading, Work
from tomojax.bringup._wiring import grounds_to_try
from tomojax.bringup.sheet._fit import sound
from tomojax.bringup.sheet._slots import Slots

# A sound rig may show so much of the slot before.
_OLD = 0.01

# A part that is so large is taken off before all else.
_TAKEN = 0.008
_HALF = 0.9

# A part is taken off if contacts fit so much better.
_BETTER = 0.97

# Parts that are tried, on so many slots.
_PARTS = 0.01, 0.03, 0.07, 0.15, 0.25, 0.35, 0.42, 0.6, 0.75, 0.9
_SOME = 60

# Beyond this part the order of channels is looked at again.
_MUCH = 0.1

# Residuals count up to this part of the voltages' span.
_MOST = 0.05


def common_part(work: Work) -> tuple[float, float]:
    """Computes the part of the slot before that all channels show, and 1 σ.

    A channel tells the part if its electrode was grounded in the slot before. No other
    reading shows the part as well: (V − P)/(V_before − P) with V_before near 0.
    """
    fits, row = work.fits, np.arange(len(work.volts))
    e = np.maximum(work.older, 0)
    told = (work.older >= 0) & (work.older != fits.ground) & work.usable[e]
    told &= (fits.far[row, e] > 0) & np.isfinite(work.before[row, e]) & sound(fits)
    drop = work.before[row, e] - fits.modelled[row, e]
    told &= -drop > 0.3 * fits.span
    if told.sum() < 10:
        return 0.0, np.inf
    electrode = e[told]
    part = (work.volts - fits.modelled)[row, e][told] / drop[told]
    each = [np.median(part[electrode == one]) for one in np.unique(electrode)]
    middle = np.array(each) if len(each) >= 5 else part
    error = max(spread(middle), 1e-3) / np.sqrt(len(middle))
    return float(np.median(middle)), error


def common_settling(common: float, error: float) -> list[Fault]:
    """Reports the part of the slot before that all channels show."""
    if not (common > _OLD and common > 5 * error):
        return []
    return [_lingers((), common, certainty(common / max(error, _OLD / 4)))]


def settling_faults(work: Work) -> list[Fault]:
    """Finds channels that show more of the slot before than all channels do.

    All slots together tell a gain, a place and an old slot apart.
    """
    value, error = work.values.value[:, 4], work.values.deviation[:, 4]
    some = np.flatnonzero(work.usable & (work.values.rows >= 10))
    usual = spread(value[some])
    faults = []
    for e in some:
        own = float(np.hypot(error[e], max(usual, 0.002)))
        if value[e] > max(2 * _OLD, BEYOND * own):
            part, c = float(value[e]), int(work.channel[e])
            faults.append(_lingers((c,), part, certainty(part / np.hypot(own, _OLD / 2))))
    return faults


def _lingers(channels: tuple[int, ...], part: float, sure: float) -> Fault:
    who = f"channel {channels[0]} shows" if channels else "all channels show"
    text = f"{who} {100 * part:.1f} % of the slot before"
    mend = "convert after the ground is switched, not before"
    if part < 0.9:
        waits = max(np.log(max(part, 1e-3) / 1e-3), 1) / np.log(1 / part) + 1
        mend = (
            "wait longer between switching the ground and converting: about "
            f"{waits:.1f} times as long; or make the sources' resistance less"
        )
    return Fault(
        "settling", channels, round(part, 4), "of the slot before", sure, text, mend
    )


def settle(reading: Reading) -> None:
    """Takes off what all channels show of the slot before.

    Channels show a part of the slot before, of its true voltages or of its readings. A part
    of true voltages is taken off slot after slot. The function takes whichever leaves less.
    """
    common, reading.lingers_error = common_part(reading.work())
    if not (np.isfinite(reading.lingers_error) and _TAKEN < common < _HALF):
        return
    kept = reading.volts, reading.order, reading.every
    every, count = reading.every, len(reading.number)
    some = np.sort(reading.rng.choice(count, min(count, _SOME), False))
    start = _misfit(reading, some, every)
    tried = []
    for recursive in (False, True):
        for part in (common, *_PARTS):
            settled = _unsettled(every, reading.slots, part, recursive)
            tried.append((_misfit(reading, some, settled), part, recursive))
    least, total, recursive = min(tried)
    if least > _BETTER * start:
        return
    for _ in range(3):
        reading.every = _unsettled(every, reading.slots, total, recursive)
        reading.volts = reading.every[reading.number].astype(float)
        reading.again()
        left = _misfit(reading, some, reading.every)
        if left > least * (1 + 1e-9):
            break
        kept, least = (reading.volts, reading.order, reading.every), left
        more, reading.lingers_error = common_part(reading.work())
        reading.lingers = total
        total = float(np.clip(total + (1 - total) * more, 0.0, _HALF))
        if abs(more) < 1e-3:
            break
    reading.volts, reading.order, reading.every = kept
    if reading.lingers > _MUCH:
        reading.fit()


def _misfit(reading: Reading, some: np.ndarray, every: Float[np.ndarray, "n M"]) -> float:
    """Averages the part of some slots that contacts leave, channel by channel."""
    order = reading.order.electrode
    volts, back = every[reading.number[some]].astype(float), np.argsort(order)
    told = grounds_to_try(reading.asked[some], order, reading.usable)
    fits = reading.fits_of(volts, told)
    left = np.abs(volts[:, back] - fits.modelled)
    part = left / np.maximum(fits.span, 1e-12)[:, None]
    return float(np.minimum(part, _MOST)[(fits.far > 0) & reading.usable[back]].mean())


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
