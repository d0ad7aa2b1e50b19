"""Reads the slots of a recording that `check` looks at: quiet ones and touched ones.

While nothing touches the sheet, slots tell zeros, noise and hum of the channels.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer

from tomojax.recordings import Recording, Rig

# Slots of a window, in which a contact hardly moves.
WINDOW = 10

# Windows, and slots of silence, that are looked at, at most.
_WINDOWS = 120
_SILENCE = 1 << 15

# Half of the channels are lower than this part of the drive where nothing touches.
_LOW = 0.015

# A slot is touched where they exceed this part of the drive, or so many deviations of those
# levels.
_TOUCHED = 0.005
_RISES = 5.0

# A slot is no longer quiet where they exceed this part of the drive, or so many deviations.
_QUIET = 0.002
_STAYS = 3.5

# Slots between a touch and what counts as silence, windows.
_APART = 1

# Noise of a reading, of the drive.
_NOISE = 1e-4

# Slots whose starts differ from one slot's time by more than this part do not follow.
_FOLLOWS = 0.5


class Slots(NamedTuple):
    """All slots in order: voltages, grounds, and whether each follows the one before."""

    rig: Rig
    volts: Float[np.ndarray, "n M"]  # float32, times the drive's sign
    asked: Integer[np.ndarray, " n"]  # ground that was commanded
    time: Float[np.ndarray, " n"]  # s
    follows: Bool[np.ndarray, " n"]  # the slot before is the one measured before
    quiet: Bool[np.ndarray, " n"]
    touched: Bool[np.ndarray, " n"]

    @property
    def drive(self) -> float:
        """Returns the stated drive, V."""
        return abs(self.rig.drive_voltage)

    @property
    def nominal_noise(self) -> float:
        return nominal_noise(self.rig)

    def runs(self, which: Bool[np.ndarray, " n"]) -> list[tuple[int, int]]:
        """Lists stretches where `which` holds: first slot, and the slot behind the last."""
        steps = np.diff(np.concatenate([[0], which.astype(int), [0]]))
        ends = (np.flatnonzero(steps == by).tolist() for by in (1, -1))
        return list(zip(*ends))


def nominal_noise(rig: Rig) -> float:
    """Computes the same as `tomojax.sensor.nominal_noise`, V rms, without JAX."""
    return max(_NOISE * abs(rig.drive_voltage), rig.resolution / np.sqrt(12))


def slots_of(recording: Recording) -> Slots:
    """Reads a recording, and distinguishes touched slots from quiet ones."""
    rig = recording.rig
    scans = recording.read(0, recording.scans)
    m = recording.electrodes
    sign = np.float32(np.sign(rig.drive_voltage))
    volts = np.nan_to_num(scans.voltages.reshape(-1, m), posinf=0, neginf=0) * sign
    time = (scans.t0[:, None] + np.arange(recording.slots) / rig.f_switch).ravel()
    follows = np.zeros(len(time), bool)
    follows[1:] = np.abs(np.diff(time) * rig.f_switch - 1) < _FOLLOWS
    after = recording.rows_after_gaps() * recording.slots
    follows[after[after < len(time)]] = False
    quiet, touched = _contact(volts, abs(rig.drive_voltage))
    asked = np.asarray(scans.grounds).reshape(-1).astype(int)
    return Slots(rig, volts, asked, time, follows, quiet, touched)


def _contact(volts: np.ndarray, drive: float) -> tuple[np.ndarray, np.ndarray]:
    """Tells which slots are quiet and which are touched; slots between are neither.

    The channels' median over a window decides: a contact on the grounded electrode leaves
    the other channels low for a slot.
    """
    level = np.median(volts, 1)
    low = level[np.abs(level) < _LOW * drive]
    middle = float(np.median(low)) if len(low) else 0.0
    # Hum is in all channels: as large as its amplitude is what silence spreads by.
    wide = 1.4826 * float(np.median(np.abs(low - middle))) if len(low) else 0.0
    level = level - middle
    windows = -(-len(level) // WINDOW)
    padded = np.pad(level, (0, windows * WINDOW - len(level)), "edge")
    parts = padded.reshape(windows, WINDOW)
    high = np.repeat(np.median(parts, 1), WINDOW)[: len(level)]
    most = np.repeat(np.abs(parts).max(1), WINDOW)[: len(level)]
    enough = max(_TOUCHED * drive, _RISES * wide)
    touched = (level > enough) & (high > enough)
    calm = most < max(_QUIET * drive, _STAYS * wide)
    # What is beside a touch may be one.
    reach = _APART * WINDOW
    near = np.convolve((level > enough).astype(float), np.ones(2 * reach + 1))
    return calm & (near[reach : len(level) + reach] < 0.5), touched


def chosen(slots: Slots, rng: np.random.Generator) -> Integer[np.ndarray, " n"]:
    """Picks numbers of touched slots to fit: windows anywhere, without a common period."""
    runs = [(a, b) for a, b in slots.runs(slots.touched) if b - a >= 2]
    ends = {k: min(k + WINDOW, b) for a, b in runs for k in range(a, b, WINDOW)}
    starts = list(ends)
    if len(starts) > _WINDOWS:
        starts = sorted(rng.choice(starts, _WINDOWS, replace=False).tolist())
    return np.concatenate([np.zeros(0, int), *(np.arange(a, ends[a]) for a in starts)])


def silence(slots: Slots) -> Integer[np.ndarray, " n"]:
    """Picks numbers of quiet slots: the longest stretch first, no more than needed."""
    runs = sorted(slots.runs(slots.quiet), key=lambda run: run[0] - run[1])
    every = np.concatenate([np.zeros(0, int), *(np.arange(a, b) for a, b in runs)])
    return np.sort(every[:_SILENCE])


# Slots of silence that zeros need.
_FEW = 16

# Slots of silence, in one stretch, that a spectrum needs.
_ENOUGH = 256

# Hum repeats so often in the stretch.
_CYCLES = 4

# Hum's power is so many times the power at so many frequencies on each side.
_PEAK = 40.0
_BESIDE = 24

# Its frequency is refined so often.
_REFINED = 3

# Lengths of spectra, at most.
_LONGEST = 1 << 15


class Silence(NamedTuple):
    """Zeros, noise and hum of M channels; NaN where unknown."""

    slots: int
    zero: Float[np.ndarray, " M"]  # V
    noise: Float[np.ndarray, " M"]  # V rms, without hum and drift
    hum: Float[np.ndarray, " M"]  # amplitude, V
    frequency: float  # of hum, Hz; 0: none stands out
    prominence: float  # its power over what is beside it
    seconds: float  # how long a stretch hum was looked for in


def silence_of(slots: Slots) -> Silence:
    """Measures zeros, noise and hum in the contact-free slots."""
    some, m = silence(slots), slots.volts.shape[1]
    none = np.full(m, np.nan)
    if len(some) < _FEW:
        return Silence(len(some), np.zeros(m), none, none, 0.0, 0.0, 0.0)
    v, t = slots.volts[some].astype(float), slots.time[some] - slots.time[some[0]]
    zero = np.median(v, 0)
    frequency, prominence, seconds, hum = 0.0, 0.0, 0.0, np.zeros(m)
    ends = np.r_[np.flatnonzero(np.diff(some) > 1) + 1, len(some)]
    lengths = np.diff(np.r_[0, ends])
    if lengths.max() >= _ENOUGH:
        # One stretch: holes would make a peak's sides as high as others.
        end = int(ends[lengths.argmax()])
        long = slice(end - int(lengths.max()), end)
        frequency, prominence, seconds = _peak((v - zero)[long], some[long], slots)
        if frequency:
            frequency = _refined((v - zero)[long], t[long], frequency, seconds)
            zero, hum, v = _without(v, t, frequency)
    joined = np.diff(some) == 1
    step = np.diff(v, axis=0)[joined]
    noise = 1.4826 * np.median(np.abs(step - np.median(step, 0)), 0) / np.sqrt(2)
    # Where codes hardly change the median of steps is 0.
    noise = np.maximum(noise, np.minimum(step.std(0) / np.sqrt(2), 2 * noise + 1e-12))
    noise = np.where(noise > 1e-9, noise, step.std(0) / np.sqrt(2))
    return Silence(len(some), zero, noise, hum, frequency, prominence, seconds)


def _peak(
    v: np.ndarray, some: Integer[np.ndarray, " n"], slots: Slots
) -> tuple[float, float, float]:
    """Finds the frequency at which all channels together have most power beside others.

    Also returns the power over what is beside it, and the stretch's length, s.
    """
    rate = slots.rig.f_switch
    at = np.round((slots.time[some] - slots.time[some[0]]) * rate).astype(int)
    kept = at < _LONGEST
    at, v = at[kept], v[kept]
    length = int(at[-1]) + 1
    filled = np.zeros((length, v.shape[1]), np.float32)
    filled[at] = v
    # The window forgets the ends; holes stay, of a quarter of the stretch or so.
    window = np.hanning(length + 2)[1:-1]
    scale = 1.4826 * np.median(np.abs(v), 0) + 1e-12
    filled = filled / np.maximum(scale, np.median(scale) / 10) * window[:, None]
    half = filled @ np.ones(v.shape[1]) / np.sqrt(v.shape[1])
    size = 2 * length
    common = np.abs(np.fft.rfft(half, size)) ** 2
    each = np.mean([np.abs(np.fft.rfft(column, size)) ** 2 for column in filled.T], axis=0)
    best, seconds = (0.0, 0.0), length / rate
    first = 2 * _CYCLES
    for power in (common, each):
        if len(power) < first + 4 * _BESIDE:
            continue
        k = first + int(power[first:].argmax())
        low = power[max(k - _BESIDE, 1) : max(k - 5, 1)]
        near = np.r_[low, power[k + 6 : k + _BESIDE]]
        # Drift rises towards lower frequencies: those alone are the measure then.
        beside = max(np.median(near), np.median(low) if len(low) else 0.0, 1e-30)
        prominence = float(power[k] / beside)
        if prominence > max(_PEAK, best[1]):
            best = k * rate / size, prominence
    return *best, seconds


def _without(
    v: np.ndarray, t: np.ndarray, frequency: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fits zeros and amplitudes of hum, and takes hum off readings; holes do no harm."""
    turn = 2 * np.pi * frequency * t
    x = np.stack([np.ones_like(t), np.cos(turn), np.sin(turn)], 1)
    found = np.linalg.lstsq(x, v, rcond=None)[0]
    return found[0], np.hypot(*found[1:]), v - x[:, 1:] @ found[1:]


def _refined(v: np.ndarray, t: np.ndarray, frequency: float, seconds: float) -> float:
    """Refines the frequency of hum, Hz, to a small part of 1/duration."""
    kept = t - t[0] <= seconds
    v, t = v[kept] - v[kept].mean(0), t[kept]
    step = 0.5 / seconds
    for _ in range(_REFINED):
        tried = frequency + step * np.linspace(-1, 1, 21)
        power = (np.abs(np.exp(-2j * np.pi * tried[:, None] * t) @ v) ** 2).sum(1)
        frequency, step = float(tried[power.argmax()]), step / 5
    return frequency
