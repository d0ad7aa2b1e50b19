"""Calibrates a rig from a recording of a contact that moves over its sheet.

`tare` measures the channels' zeros and noise, in contact-free slots.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Integer

from tomojax._require import require
from tomojax.files import read_csv, read_npz
from tomojax.recordings import CHUNK_SLOTS, read_chunk, Recording
from tomojax.sensor import Calibration, nominal_noise

if TYPE_CHECKING:
    from tomojax.calibration._calibrate import Calibrated

# Slots looked at for zeros, in so many stretches.
_QUIET_SLOTS = 8192
_STRETCHES = 16

# Contact-free slots that there must be.
_LEAST_QUIET = 16

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
    slots, or a touch, leave the calibration (nominal by default) as it is. A channel that
    is seldom good keeps its zero.

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
    if len(v) < _LEAST_QUIET:
        return calibration
    used = np.isfinite(v).any(0)
    v = v[:, used]
    # Of one slot and the next: what changes slowly does not count.
    noise = 1.4826 * np.median(np.abs(np.diff(v, axis=0))) / np.sqrt(2)
    means = v.mean(1) * np.sign(recording.rig.drive_voltage)
    same = means <= np.quantile(means, 0.1) + 5 * noise / np.sqrt(v.shape[1])
    v, grounds = v[same], grounds[same]
    if len(v) < _LEAST_QUIET:
        return calibration
    zero = v.mean(0)
    count = np.bincount(grounds)
    some = np.flatnonzero(count >= 2)
    apart = [count[g] * ((v[grounds == g].mean(0) - zero) ** 2).mean() for g in some]
    noise = float(v.std(0).mean())
    if len(some) > 1 and np.median(apart) > _SAME * noise**2:
        return calibration
    zeros = np.zeros(used.shape)
    zeros[used] = zero
    offset = zeros * np.asarray(calibration.gain) + np.asarray(calibration.offset)
    least = _NO_LESS * nominal_noise(recording.rig.sensor())
    return replace(
        calibration,
        offset=tuple(float(z) for z in offset),
        noise=float(np.hypot(_MORE * noise, least)),
    )


def quiet_slots(
    recording: Recording, calibration: Calibration
) -> tuple[Float[np.ndarray, "n M"], Integer[np.ndarray, " n"]]:
    """Reads slots whose voltages are all within the noise, corrected, and their grounds.

    Channels that are seldom good do not count, and are NaN in all slots.
    """
    each = max(1, _QUIET_SLOTS // _STRETCHES // recording.slots)
    # No slot twice: grounds' means would seem to differ by more than noise lets them.
    count = min(_STRETCHES, max(1, recording.scans // each))
    starts = np.linspace(0, max(0, recording.scans - each), count).astype(int)
    rig = recording.rig
    least = max(_QUIET * nominal_noise(rig.sensor()), _CODES * rig.resolution)
    found, under, sound = [], [], []
    for start in np.unique(starts).tolist():
        stop = min(start + each, recording.scans)
        chunk = read_chunk(recording, start, stop, "slot")
        v = calibration.voltages(chunk.voltages[:, 0].astype(float))
        found.append(v)
        under.append(chunk.grounds[:, 0])
        sound.append(chunk.good[:, 0])
    v, grounds, good = map(np.concatenate, (found, under, sound))
    often = good.sum(0) > _GOOD * max(1, good.any(1).sum())
    quiet = good.any(1) & (good | ~often).all(1)
    with np.errstate(invalid="ignore"):
        quiet &= ((np.abs(v) < least) | ~often).all(1)
    return np.where(often, v, np.nan)[quiet], grounds[quiet].astype(int)


# Slots of a frame, in which a contact hardly moves: as many tell of its place.
_SLOTS = 10

# A scan with no fewer slots is a frame.
_LEAST = 5

# Frames that a calibration is made of, chosen from so many times as many.
_MOST = 1000
_CHOICE = 4

# A contact of use exceeds so many times the noise.
_TOUCHED = 110.0

# A channel must be good in this part of the frames.
_GOOD = 0.9


class Frames(NamedTuple):
    """Stretches of slots that show a contact."""

    number: Integer[np.ndarray, "n S"]  # of the slots in the recording
    times: Float[np.ndarray, "n S"]  # s
    voltages: Float[np.ndarray, "n S M"]  # V, as read
    grounds: Integer[np.ndarray, "n S"]
    good: Bool[np.ndarray, "n S M"]

    def take(self, some: np.ndarray) -> "Frames":
        return Frames(*(a[some] for a in self))

    def usable(self) -> "Frames":
        """Keeps frames without faults; a channel that is seldom good is NaN in all."""
        often = self.good.sum((0, 1)) > _GOOD * self.good[..., 0].size
        kept = self.take(np.asarray(self.good[:, :, often].all((1, 2))))
        return kept._replace(voltages=np.where(often, kept.voltages, np.nan))

    def spread(self, most: int) -> "Frames":
        """Keeps so many frames at most, spread evenly."""
        n = len(self.number)
        return self.take(np.linspace(0, n - 1, min(most, n)).round().astype(int))


def calibrate_recording(
    recording: Recording,
    places: Float[np.ndarray, "n 2"] | None = None,
    most: int = _MOST,
    *,
    calibration: Calibration | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Calibration:
    """Calibrates from a recording of one contact anywhere: see `calibrated_recording`.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(2, 2, divisions=(8, 8), dtype=np.float32)
    >>> places = np.random.default_rng(0).uniform(0.012, 0.028, (16, 2))
    >>> volts = np.stack([tx.voltages(sensor, tx.Disc(xy, 0.004, 1.0)) for xy in places])
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> recording = tx.recordings.ArrayRecording(rig, volts, np.arange(4))
    >>> known = tx.calibrate_recording(recording, places)  # of each scan
    >>> len(known.gain), len(known.sheet), known.error <= 1
    (4, 27, True)
    """
    known = {"calibration": calibration, "progress": progress}
    return calibrated_recording(recording, places, most, **known).calibration


def calibrated_recording(
    recording: Recording,
    places: Float[np.ndarray, "n 2"] | None = None,
    most: int = _MOST,
    *,
    calibration: Calibration | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> "Calibrated":
    """Calibrates from a recording of one contact; returns frames and covariance too.

    Zeros are taken from contact-free slots first, if there are any. `places` (m) are one
    per slot or scan, NaN where not known; None: none is known. Frames are stretches of ten
    slots, or scans of five to ten, in which the contact may move. Frames with faults or
    without a contact are left out. Up to `most` of the others are used, spread evenly.

    **Raises:** `ValueError` for places that are neither one per slot nor one per scan, and
    as `calibrate` does.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(3, 3, divisions=(12, 12), dtype=np.float32)
    >>> places = np.random.default_rng(0).uniform(0.01, 0.05, (40, 2))
    >>> volts = np.stack([tx.voltages(sensor, tx.Disc(xy, 0.005, 0.1)) for xy in places])
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> recording = tx.recordings.ArrayRecording(rig, volts, np.arange(9))
    >>> found = tx.calibration.calibrated_recording(recording)  # nobody knows the places
    >>> print(np.abs(found.calibration.electrodes).max() < 5e-4)  # m
    True
    >>> told = tx.calibration.summary(sensor, found)
    >>> print(told["frames"] > 20, told["squares"])
    True 9
    >>> lines = tx.calibration.text(sensor, found)
    >>> figure = tx.calibration.picture(sensor, found)
    """
    # Here: `tare`, which every run on a recording needs, need not wait for it.
    from tomojax.calibration._calibrate import calibrated, known_frames

    slots, per_scan = recording.scans * recording.slots, recording.slots
    if places is not None:
        places = np.asarray(places, float)
        of_scans = places.shape == (recording.scans, 2)
        expected = f"({slots}, 2), one per slot, or ({recording.scans}, 2), one per scan"
        fits = of_scans or places.shape == (slots, 2)
        require(fits, "places", places.shape, expected)
        places = places.repeat(per_scan, 0) if of_scans else places
    before = tare(recording, calibration)
    # Places of scans are those of their middle, whatever moves in them.
    length = frame_length(recording) if places is None else min(per_scan, _SLOTS)
    frames = touched(recording, before, length, most).usable()
    if places is not None:
        placed = np.isfinite(places[frames.number].mean(1)).all(1)
        require(bool(placed.any()), "places", "0 usable slots", "slots with a contact")
        frames = frames.take(placed)
    frames = frames.spread(most)
    some = len(frames.number) > 0
    require(some, "recording", "no stretch with a contact", "a contact that moves")
    sensor, at = recording.rig.sensor(), None
    if places is not None:
        at = places[frames.number].mean(1)
    known = known_frames(sensor, frames.voltages, frames.grounds, at, times=frames.times)
    return calibrated(sensor, known, before, progress)


def frame_length(recording: Recording) -> int:
    """Counts a frame's slots: ten, or those of a scan of five to ten slots."""
    per_scan = recording.slots
    whole = per_scan >= _LEAST
    return min(per_scan if whole else recording.scans * per_scan, _SLOTS)


def touched(recording: Recording, before: Calibration, length: int, most: int) -> Frames:
    """Reads stretches of `length` slots that show a contact throughout."""
    enough = _TOUCHED * nominal_noise(recording.rig.sensor())
    slots = recording.scans * recording.slots
    every = max(1, slots // length // (_CHOICE * most))
    # Whole stretches in each chunk.
    each = max(1, CHUNK_SLOTS // (recording.slots * length)) * length
    found = []
    for start in range(0, recording.scans, each):
        stop = min(start + each, recording.scans)
        chunk = read_chunk(recording, start, stop, "slot")
        first = np.arange(0, len(chunk.t) // length, every) * length
        number = first[:, None] + np.arange(length)
        frames = Frames(
            number=number + start * recording.slots,
            times=chunk.t[number],
            voltages=chunk.voltages[number, 0],
            grounds=chunk.grounds[number, 0],
            good=chunk.good[number, 0],
        )
        level = np.where(frames.good, np.abs(before.voltages(frames.voltages)), 0)
        found.append(frames.take((level.max(-1) > enough).all(1)))
    return Frames(*(np.concatenate(a) for a in zip(*found)))


def read_places(path: Path) -> Float[np.ndarray, "n 2"]:
    """Reads places, m: `xy` of an .npz file, or columns x, y of a text file.

    A text file (.csv) has one header line at most.
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
            places = read_npz(path, "places", ["xy"])["xy"]
        else:
            places = read_csv(path, "places").values
    except ValueError as error:
        raise ValueError(f"{error}; give x and y in metres") from None
    fits = places.ndim == 2 and places.shape[1] == 2
    require(fits, f"{path}: places", f"shape {places.shape}", "(n, 2), x and y in metres")
    return np.asarray(places, float)
