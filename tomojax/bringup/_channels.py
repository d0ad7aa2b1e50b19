"""Finds faults that levels of channels show before a fit: dead, stuck, noise, hum."""

import numpy as np
from jaxtyping import Bool, Float

from tomojax.bringup._fault import certainty, Fault
from tomojax.bringup.sheet._slots import Silence, Slots

# A channel that follows a touch by less than this part of what the others do is dead.
_FOLLOWS = 0.05

# A dead channel stays nearer to 0 than this, of the drive, or than so many times the noise.
_NEAR_ZERO = 0.01
_NOISES = 8.0

# A channel is noisy from so many times the others' noise on.
_LOUD = 3.0

# All channels are noisy from so many times a converter's noise on.
_ALL_LOUD = 5.0

# Hum is a fault from so many times a converter's noise on.
_HUM = 2.0

# Channels are alike that differ by less than so many times the noise, and by this part of
# their voltage, in slots that span so much of the drive.
_SAME = 6.0, 2e-3
_WIDE = 0.05

# Such slots that are needed, and electrodes that the contacts must be nearest to: a contact
# that holds still may lie as near to one electrode as to another.
_ALIKE_SLOTS, _ALIKE_PLACES = 16, 4

# Mains, Hz, and how near its frequency must be.
_MAINS = 50.0, 60.0
_NEAR = 0.02


def alike(
    volts: Float[np.ndarray, "n M"],
    good: Bool[np.ndarray, "n M"],
    drive: float,
    noise: float,
) -> list[tuple[int, int]]:
    """Finds pairs of channels that read the same in every slot with a contact."""
    high = np.where(good, volts, -np.inf).max(1)
    wide = high - np.where(good, volts, np.inf).min(1) > _WIDE * drive + 100 * noise
    v, there = volts[wide], good[wide] & (np.abs(volts[wide]) > 10 * noise)
    places = np.unique(np.where(good[wide], v, -np.inf).argmax(1))
    if len(v) < _ALIKE_SLOTS or len(places) < _ALIKE_PLACES:
        return []
    found = []
    for a in range(v.shape[1] - 1):
        both = there[:, a, None] & there[:, a + 1 :]
        near = np.abs(v[:, a, None] - v[:, a + 1 :])
        near = near < _SAME[0] * noise + _SAME[1] * np.abs(v[:, a, None])
        same = (near | ~both).all(0) & (both.sum(0) >= _ALIKE_SLOTS // 2)
        found += [(a, a + 1 + int(k)) for k in np.flatnonzero(same)]
    return found


def shorted(slots: Slots, volts: Float[np.ndarray, "n M"], silent: Silence) -> list[Fault]:
    """Finds channels that read the same in every touch; `volts` of touched slots."""
    noise = max(float(np.nan_to_num(np.median(silent.noise))), slots.nominal_noise)
    faults = []
    for a, b in alike(volts, np.isfinite(volts), slots.drive, noise):
        text = f"channels {a} and {b} read the same in every touch"
        mend = f"look for a short between the wires of channels {a} and {b}"
        faults.append(Fault("shorted", (a, b), 0.0, "V", 0.99, text, mend))
    return faults


def unresponsive(
    slots: Slots, volts: Float[np.ndarray, "n M"], silent: Silence
) -> list[Fault]:
    """Finds dead and stuck channels; `volts` of touched slots, with their zeros."""
    low, middle, high = np.quantile(volts, [0.1, 0.5, 0.9], axis=0)
    swing = np.quantile(np.abs(volts - silent.zero), 0.8, axis=0)
    usual = np.median(swing)
    moving = np.maximum(high - low, 0)
    still = moving < _FOLLOWS * max(float(np.median(moving)), 1e-12)
    noise = np.nan_to_num(silent.noise, nan=slots.nominal_noise)
    near = max(_NEAR_ZERO * slots.drive, _NOISES * float(np.median(noise)))
    # At the rail in a touch and elsewhere else: a level that does not follow is stuck.
    silent_too = swing < _FOLLOWS * usual
    dead = still & (np.abs(middle) < near) & (silent_too | (silent.slots == 0))
    faults = []
    for c in np.flatnonzero(dead).tolist():
        level, part = float(middle[c]), float(swing[c] / max(usual, 1e-12))
        sure, seen = certainty(0.2 / max(part, 1e-3)), f"{1e3 * level:+.1f} mV"
        text = (
            f"channel {c} stays at {seen} in every touch; the others rise by {usual:.2f} V"
        )
        mend = f"look for a broken wire between channel {c} and its electrode"
        faults.append(Fault("dead", (c,), level, "V", sure, text, mend))
    for c in np.flatnonzero(still & ~dead).tolist():
        level, sure = (
            float(middle[c]),
            certainty(0.2 * usual / max(moving[c], 1e-3 * usual)),
        )
        rail = min(abs(level - r) for r in slots.rig.rails) < 0.01 * slots.drive
        where = f"{level:+.3f} V" + (", the converter's rail" if rail else "")
        text = f"channel {c} stays at {where}, touched or not"
        mend = f"look for a short of channel {c} to a supply, or a dead input"
        faults.append(Fault("stuck", (c,), level, "V", sure, text, mend))
    return faults


def noise_faults(
    slots: Slots, silent: Silence, sane: Bool[np.ndarray, " M"]
) -> list[Fault]:
    """Finds channels that are noisier than the others, and noise of all channels."""
    if np.isnan(silent.noise).any():
        return []
    nominal = slots.nominal_noise
    usual = float(np.median(silent.noise[sane])) if sane.any() else nominal
    floor = max(usual, slots.rig.resolution / np.sqrt(12))
    faults = []
    if usual > _ALL_LOUD * nominal:
        sure, seen = certainty(usual / nominal - 2), f"{1e3 * usual:.2f} mV rms"
        most = f"{1e3 * nominal:.2f} mV are usual at this drive and resolution"
        text = f"all channels have {seen} of noise; {most}"
        mend = "shield the cables, join grounds at one point, average in the converter"
        faults.append(Fault("noise", (), usual, "V rms", sure, text, mend))
    for c in np.flatnonzero(sane & (silent.noise > _LOUD * floor)).tolist():
        rms, ratio = float(silent.noise[c]), float(silent.noise[c] / floor)
        seen = f"{1e3 * rms:.2f} mV rms of noise, {ratio:.0f} times the others'"
        text, sure = f"channel {c} has {seen}", certainty(ratio - 1)
        mend = f"look at the joint and the shield of channel {c}'s wire"
        faults.append(Fault("noise", (c,), rms, "V rms", sure, text, mend))
    return faults


def hum_faults(slots: Slots, silent: Silence, sane: Bool[np.ndarray, " M"]) -> list[Fault]:
    """Finds hum, its frequency and the channels that have hum."""
    if not silent.frequency:
        return []
    amplitude, frequency = np.where(sane, silent.hum, 0), silent.frequency
    enough = max(_HUM * slots.nominal_noise, 0.3 * float(np.quantile(amplitude, 0.95)))
    loud = np.flatnonzero(amplitude > enough).tolist()
    if not loud:
        return []
    value = float(np.median(amplitude[loud]))
    name = ""
    for mains in _MAINS:
        width = max(_NEAR * mains, 1 / max(silent.seconds, 1e-9))
        if abs(frequency - mains) < width:
            name = f", the mains' {mains:.0f} Hz"
    everywhere = len(loud) > 0.5 * sane.sum()
    who = "all channels have"
    if not everywhere:
        who = f"channels {', '.join(map(str, loud))} have"
    text = (
        f"{who} a hum of {1e3 * value:.2f} mV at {frequency:.1f} Hz{name} "
        f"(or a multiple of {slots.rig.f_switch:g} Hz from it)"
    )
    mend = (
        "join the object's drive, the converter and the sheet's ground at one point; "
        "keep mains leads away"
    )
    channels = () if everywhere else tuple(loud)
    seen = {"amplitude_V": value, "frequency_Hz": round(frequency, 2)}
    sure = certainty(np.sqrt(silent.prominence / 10))
    return [Fault("hum", channels, seen, "V, Hz", sure, text, mend)]
