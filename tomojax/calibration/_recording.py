"""A rig's calibration from its recordings: contact-free slots, contacts at known places."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tomojax._require import require
from tomojax.calibration._calibrate import calibrate
from tomojax.recordings import read_chunk, Recording
from tomojax.sensor import Calibration, nominal_noise

# Slots looked at for zeros, in how many stretches; the least there must be; what none of
# them exceeds, in the noise (and codes, where these are coarse). Means of a ground's slots
# beside those of all, in σ²: more is a contact.
_SLOTS, _STRETCHES, _LEAST, _QUIET, _CODES, _SAME = 8192, 16, 16, 11.0, 3.0, 2.0

# Slots that a calibration is made of: more tell little that is new.
# What a contact exceeds to be of use, in the noise, and the fewest such slots.
_MOST, _TOUCHED, _FEWEST = 2048, 110.0, 64

# The noise that is seen, times what is left of zeros; and of the nominal one at least.
_MORE, _NO_LESS = 1.1, 0.02


def tare(recording: Recording, calibration: Calibration | None = None) -> Calibration:
    """Zeros of the channels and their noise, from the recording's contact-free slots.

    Those with all voltages within eleven times the noise and a mean that is the lowest.
    Zeros do not depend on the ground: where these slots' means do, something touches. With
    fewer than 16 slots, or with a touch, the calibration (nominal by default) as it is.

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
    v, grounds = _quiet_slots(recording, calibration)
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


def _quiet_slots(
    recording: Recording, calibration: Calibration
) -> tuple[Float[np.ndarray, "n M"], np.ndarray]:
    each = max(1, _SLOTS // _STRETCHES // recording.slots)
    starts = np.linspace(0, max(0, recording.scans - each), _STRETCHES).astype(int)
    rig = recording.rig
    least = max(_QUIET * nominal_noise(rig.sensor()), _CODES * rig.resolution)
    found, under = [], []
    for start in np.unique(starts).tolist():
        stop = min(start + each, recording.scans)
        _, v, grounds, good, _ = read_chunk(recording, start, stop, "slot")
        v = calibration.voltages(v[:, 0].astype(float))
        quiet = good.all((1, 2)) & (np.abs(v).max(1) < least)
        found.append(v[quiet])
        under.append(grounds[quiet, 0])
    return np.concatenate(found), np.concatenate(under).astype(int)


def calibrate_recording(
    recording: Recording, places: Float[np.ndarray, "n 2"], most: int = _MOST
) -> Calibration:
    """`calibrate` on a recording of one contact, at `places` (m) in each slot or scan.

    Zeros are taken from contact-free slots first, where there are. Slots with faults,
    without a contact or without a place (NaN) are left out; of the others up to `most`,
    spread evenly.

    **Raises:** `ValueError` for places that are neither one per slot nor one per scan, or
    with fewer than 64 slots left.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(2, 2, divisions=(8, 8), dtype=np.float32)
    >>> places = np.random.default_rng(0).uniform(0.015, 0.025, (16, 2))
    >>> volts = np.stack([tx.voltages(sensor, tx.Disc(xy, 0.005, 1.0)) for xy in places])
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> recording = tx.recordings.ArrayRecording(rig, volts, np.arange(4))
    >>> known = tx.calibrate_recording(recording, places)  # of each scan
    >>> len(known.gain), len(known.sheet), known.error <= 1
    (4, 14, True)
    """
    slots = recording.scans * recording.slots
    places = np.asarray(places, float)
    per_scan = places.shape == (recording.scans, 2)
    expected = f"({slots}, 2), one per slot, or ({recording.scans}, 2), one per scan"
    require(per_scan or places.shape == (slots, 2), "places", places.shape, expected)
    if per_scan:
        places = places.repeat(recording.slots, 0)
    before = tare(recording)
    enough = _TOUCHED * nominal_noise(recording.rig.sensor())
    found: list[tuple] = []
    each = max(1, _SLOTS // recording.slots)
    step = max(1, slots // most)
    for start in range(0, recording.scans, each):
        stop = min(start + each, recording.scans)
        _, v, grounds, good, _ = read_chunk(recording, start, stop, "slot")
        number = np.arange(len(v)) + start * recording.slots
        touched = np.abs(before.voltages(v[:, 0])).max(1) > enough
        usable = good.all((1, 2)) & touched & np.isfinite(places[number]).all(1)
        take = usable & (number % step == 0)
        found.append((v[take], grounds[take], places[number[take]]))
    parts = [np.concatenate(p) for p in zip(*found)]
    wanted = f"at least {_FEWEST} slots with a contact and its place"
    require(len(parts[0]) >= _FEWEST, "places", f"{len(parts[0])} usable slots", wanted)
    return calibrate(recording.rig.sensor(), *parts, calibration=before)


def read_places(path: Path) -> Float[np.ndarray, "n 2"]:
    """`xy` of an .npz file, or two columns x, y of a text file (.csv, one header line at
    most), m.

    **Raises:** `ValueError` naming the file.

    **Example:**

    >>> from pathlib import Path
    >>> import numpy as np
    >>> import tomojax as tx
    >>> np.savetxt("places.csv", [[0.03, 0.05], [0.04, 0.04]], delimiter=",")
    >>> print(tx.calibration.read_places(Path("places.csv")))
    [[0.03 0.05]
     [0.04 0.04]]
    """
    try:
        if path.suffix == ".npz":
            with np.load(path) as file:
                places = file["xy"]
        else:
            places = np.genfromtxt(path, delimiter=",", comments="#")
            places = places[1:] if np.isnan(places[:1]).all() else places
    except (OSError, KeyError, ValueError) as error:
        why = str(error).splitlines()[0]
        raise ValueError(f"{path}: places: {why}; give x and y in metres") from None
    fits = places.ndim == 2 and places.shape[1] == 2
    require(fits, f"{path}: places", f"shape {places.shape}", "(n, 2), x and y in metres")
    return np.asarray(places, float)
