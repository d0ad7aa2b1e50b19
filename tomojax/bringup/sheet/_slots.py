"""Reads the slots of a recording that `check` looks at: quiet ones and touched ones."""

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
