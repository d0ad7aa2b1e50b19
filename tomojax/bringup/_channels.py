"""Finds faults that levels of channels show before a fit: dead, stuck, noise, hum."""

import numpy as np
from jaxtyping import Bool, Float

from tomojax.bringup._fault import certainty, Fault
from tomojax.bringup.sheet._silence import Silence
from tomojax.bringup.sheet._slots import Slots

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

# Mains, Hz, and how near its frequency must be.
_MAINS = 50.0, 60.0
_NEAR = 0.02


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
    for c in np.flatnonzero(dead):
        part = float(swing[c] / max(usual, 1e-12))
        faults.append(
            Fault(
                "dead",
                (int(c),),
                float(middle[c]),
                "V",
                certainty(0.2 / max(part, 1e-3)),
                f"channel {c} stays at {1e3 * middle[c]:+.1f} mV in every touch; "
                f"the others rise by {usual:.2f} V",
                f"look for a broken wire between channel {c} and its electrode",
            )
        )
    for c in np.flatnonzero(still & ~dead):
        rail = min(abs(middle[c] - r) for r in slots.rig.rails) < 0.01 * slots.drive
        where = f"{middle[c]:+.3f} V" + (", the converter's rail" if rail else "")
        faults.append(
            Fault(
                "stuck",
                (int(c),),
                float(middle[c]),
                "V",
                certainty(0.2 * usual / max(moving[c], 1e-3 * usual)),
                f"channel {c} stays at {where}, touched or not",
                f"look for a short of channel {c} to a supply, or a dead input",
            )
        )
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
        faults.append(
            Fault(
                "noise",
                (),
                usual,
                "V rms",
                certainty(usual / nominal - 2),
                f"all channels have {1e3 * usual:.2f} mV rms of noise; "
                f"{1e3 * nominal:.2f} mV are usual at this drive and resolution",
                "shield the cables, join grounds at one point, average in the converter",
            )
        )
    for c in np.flatnonzero(sane & (silent.noise > _LOUD * floor)):
        ratio = float(silent.noise[c] / floor)
        faults.append(
            Fault(
                "noise",
                (int(c),),
                float(silent.noise[c]),
                "V rms",
                certainty(ratio - 1),
                f"channel {c} has {1e3 * silent.noise[c]:.2f} mV rms of noise, {ratio:.0f} "
                "times the others'",
                f"look at the joint and the shield of channel {c}'s wire",
            )
        )
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
    some = f"channels {', '.join(map(str, loud))} have"
    fault = Fault(
        "hum",
        () if everywhere else tuple(loud),
        {"amplitude_V": value, "frequency_Hz": round(frequency, 2)},
        "V, Hz",
        certainty(np.sqrt(silent.prominence / 10)),
        f"{'all channels have' if everywhere else some} a hum of {1e3 * value:.2f} mV at "
        f"{frequency:.1f} Hz{name} (or a multiple of {slots.rig.f_switch:g} Hz from it)",
        "join the object's drive, the converter and the sheet's ground at one point; "
        "keep mains leads away",
    )
    return [fault]
