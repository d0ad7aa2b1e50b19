"""Measures the channels' zeros and noise, in contact-free slots of a recording."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Integer

from tomojax.recordings import read_chunk, Recording
from tomojax.sensor import Calibration, nominal_noise

# Slots looked at for zeros, in so many stretches.
_SLOTS = 8192
_STRETCHES = 16

# Contact-free slots that there must be.
_LEAST = 16

# A contact-free slot does not exceed so many times the noise, or so many codes where these
# are coarse.
_QUIET = 11.0
_CODES = 3.0

# Means of a ground's slots differ from those of all by more σ²: something touches.
_SAME = 2.0

# The noise that is seen, times what is left of zeros.
_MORE = 1.1

# The noise is no less than this part of the nominal noise.
_NO_LESS = 0.02


def tare(recording: Recording, calibration: Calibration | None = None) -> Calibration:
    """Measures the channels' zeros and noise, in the recording's contact-free slots.

    These slots have all voltages within eleven times the noise, and the lowest means. Zeros
    do not depend on the ground: if these slots' means do, something touches. Fewer than 16
    slots, or a touch, leave the calibration (nominal by default) as it is.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> quiet = 0.002 + 1e-4 * np.random.default_rng(0).normal(size=(64, 2, 16))
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> recording = tx.recordings.ArrayRecording(rig, quiet, [0, 15])
    >>> print(f"{1e3 * np.mean(tx.calibration.tare(recording).offset):.1f} mV")
    2.0 mV
    """
    calibration = calibration or Calibration()
    calibration.check_count(recording.electrodes)
    v, grounds = quiet_slots(recording, calibration)
    if len(v) < _LEAST:
        return calibration
    # Of one slot and the next: what changes slowly does not count.
    noise = 1.4826 * np.median(np.abs(np.diff(v, axis=0))) / np.sqrt(2)
    means = v.mean(1)
    same = means <= np.quantile(means, 0.1) + 5 * noise / np.sqrt(v.shape[1])
    v, grounds = v[same], grounds[same]
    if len(v) < _LEAST:
        return calibration
    zero = v.mean(0)
    count = np.bincount(grounds)
    some = np.flatnonzero(count >= 2)
    apart = [count[g] * ((v[grounds == g].mean(0) - zero) ** 2).mean() for g in some]
    noise = float(v.std(0).mean())
    if len(some) > 1 and np.median(apart) > _SAME * noise**2:
        return calibration
    offset = zero * np.asarray(calibration.gain) + np.asarray(calibration.offset)
    least = _NO_LESS * nominal_noise(recording.rig.sensor())
    return replace(
        calibration,
        offset=tuple(float(z) for z in offset),
        noise=float(np.hypot(_MORE * noise, least)),
    )


def quiet_slots(
    recording: Recording, calibration: Calibration
) -> tuple[Float[np.ndarray, "n M"], Integer[np.ndarray, " n"]]:
    """Reads slots whose voltages are all within the noise, corrected, and their grounds."""
    each = max(1, _SLOTS // _STRETCHES // recording.slots)
    # No slot twice: grounds' means would seem to differ by more than noise lets them.
    count = min(_STRETCHES, max(1, recording.scans // each))
    starts = np.linspace(0, max(0, recording.scans - each), count).astype(int)
    rig = recording.rig
    least = max(_QUIET * nominal_noise(rig.sensor()), _CODES * rig.resolution)
    found, under = [], []
    for start in np.unique(starts).tolist():
        stop = min(start + each, recording.scans)
        chunk = read_chunk(recording, start, stop, "slot")
        v = calibration.voltages(chunk.voltages[:, 0].astype(float))
        quiet = chunk.good.all((1, 2)) & (np.abs(v).max(1) < least)
        found.append(v[quiet])
        under.append(chunk.grounds[quiet, 0])
    return np.concatenate(found), np.concatenate(under).astype(int)
