"""Tells whether a recording still fits a calibration: zeros, and what contacts leave."""

from datetime import date
from typing import Any

import numpy as np

from tomojax.calibration._frames import points_of
from tomojax.calibration._recording import frame_length, quiet_slots, tare, touched
from tomojax.calibration.drift._adapter import lone_places, silence
from tomojax.calibration.drift._fitted import left_of
from tomojax.methods import Batch
from tomojax.recordings import Recording
from tomojax.sensor import Calibration, nominal_noise

# Frames that are looked at.
_FRAMES = 96

# Frames with a lone contact that tell enough; slots that do.
_ENOUGH = 8
_ENOUGH_SLOTS = 16

# χ² that a rig leaves of a contact where its errors are as stated: told errors are nearly
# the largest that are usual.
_USUAL = 0.4

# Several times as much fits no more, in zeros as in contacts.
_SEVERAL = 4.0

# Zeros of a nominal rig, 1 σ, and what a mean of many slots is no better than; of noise.
_NOMINAL = 1.1
_FLOOR = 0.1


def still_fits(
    recording: Recording, calibration: Calibration, today: date | None = None
) -> dict[str, Any]:
    """Tells how old a calibration is, and how a recording fits it; units in the keys.

    `zeros_chi2`: contact-free slots' means beside the calibration's zeros, over what is
    known of both; `contacts_chi2`: residuals of lone contacts, over their usual size;
    `gains_off_percent`: by how much gains seem to be off, rms, without the part that all
    share. None stands for unknown. `fits`: whether both χ² are below four.

    **Raises:** `ValueError` for a calibration of another number of electrodes.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> quiet = 0.02 + 3e-4 * np.random.default_rng(0).normal(size=(64, 2, 16))
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> recording = tx.recordings.ArrayRecording(rig, quiet, [0, 15])
    >>> for zero in (0.02, 0.022):  # V
    ...     known = tx.Calibration(offset=(zero,) * 16)
    ...     print(tx.calibration.still_fits(recording, known)["fits"])
    True
    False
    """
    sensor = recording.rig.sensor()
    calibration.sensor(sensor, sensor.divisions)  # raises for one of another rig
    found: dict[str, Any] = {"made": calibration.made, "age_days": None}
    if calibration.made:
        found["age_days"] = round(calibration.age_hours(today) / 24)
    found |= _zeros(recording, calibration) | _contacts(recording, calibration)
    told = [found[n] for n in ("zeros_chi2", "contacts_chi2") if found[n] is not None]
    return found | {"fits": max(told) < _SEVERAL if told else None}


def _zeros(recording: Recording, calibration: Calibration) -> dict[str, Any]:
    noise = calibration.noise or nominal_noise(recording.rig.sensor())
    slots, grounds = quiet_slots(recording, calibration)
    told = np.isfinite(slots).any(0)
    slots = slots[:, told]
    none = {"silent_slots": len(slots), "zeros_chi2": None, "zeros_off_mV": None}
    enough = len(slots) >= _ENOUGH_SLOTS
    if not enough or not silence(slots, grounds, noise, recording.rig.resolution):
        return none
    off = slots.mean(0)
    known = (calibration.deviation or {}).get("offset", _NOMINAL * noise)
    known = known[told] if np.ndim(known) else known
    variance = np.square(known) + noise**2 * (1 / len(slots) + _FLOOR**2)
    return none | {
        "zeros_chi2": float(np.mean(off**2 / variance)),
        "zeros_off_mV": 1e3 * float(np.sqrt(np.mean(off**2))),
    }


def _contacts(recording: Recording, calibration: Calibration) -> dict[str, Any]:
    sensor = recording.rig.sensor()
    tared = tare(recording, calibration)
    frames = touched(recording, tared, frame_length(recording), _FRAMES)
    none = {"lone_contacts": 0, "contacts_chi2": None, "gains_off_percent": None}
    if not len(frames.number):
        return none
    frames = frames.usable().spread(_FRAMES)
    points = points_of(sensor, calibration)
    volts, grounds = tared.voltages(frames.voltages.astype(np.float32)), frames.grounds
    rows = Batch(points, 1.0, contacts=2, images=False)(volts, grounds)
    places = lone_places(rows)
    alone = np.isfinite(places).all(1)
    if alone.sum() < _ENOUGH:
        return none | {"lone_contacts": int(alone.sum())}
    left = left_of(points, volts[alone], grounds[alone], places[alone])
    weight = 1 / left.variance
    total = weight.sum(0)
    told = total > 0
    mean = (weight * left.relative).sum(0)[told] / total[told]
    return {
        "lone_contacts": int(alone.sum()),
        "contacts_chi2": float(np.nanmedian(left.misfit)) / _USUAL,
        "gains_off_percent": 100 * float(np.std(mean)),
    }


def fit_text(found: dict[str, Any]) -> str:
    """Writes what `still_fits` found, in lines.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> quiet = 3e-4 * np.random.default_rng(0).normal(size=(64, 2, 16))
    >>> rig = tx.recordings.Rig.of(tx.Sensor.grid(4, 4, divisions=(16, 16)))
    >>> recording = tx.recordings.ArrayRecording(rig, quiet, [0, 15])
    >>> found = tx.calibration.still_fits(recording, tx.Calibration(made="2026-01-01"))
    >>> print(tx.calibration.fit_text(found).splitlines()[-1])
      the calibration still fits this recording
    """
    days, made = found["age_days"], found["made"]
    age = f"made on {made}, {days} days ago" if made else "nobody noted when it was made"
    lines = [f"calibration: {age}"]
    if found["zeros_chi2"] is None:
        lines.append("zeros: no contact-free slots that tell of them")
    else:
        lines.append("zeros: off by {zeros_off_mV:.2f} mV rms, χ² {zeros_chi2:.1f}")
    if found["contacts_chi2"] is None:
        lines.append("contacts: {lone_contacts} alone, too few to tell")
    else:
        lines.append(
            "contacts: {lone_contacts} alone, χ² {contacts_chi2:.1f}; "
            "gains off by {gains_off_percent:.2f} % rms"
        )
    contacts = found["contacts_chi2"] is None or found["contacts_chi2"] < _SEVERAL
    if found["fits"] is None:
        lines.append("nothing in this recording tells whether the calibration fits")
    elif found["fits"]:
        lines.append("the calibration still fits this recording")
    elif contacts:
        lines.append("zeros no longer fit: reconstruct takes them from contact-free slots")
    else:
        lines.append(
            "the calibration no longer fits this recording: calibrate again, or --adapt"
        )
    return "\n".join("  " + line.format(**found) for line in lines)
