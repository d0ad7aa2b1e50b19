"""Reads some slots of a recording, spread over all of it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer

from tomojax.bringup.sheet._slots import nominal_noise
from tomojax.recordings import find_faults, Recording

# Stretches that are read, and slots of each at least; what is kept is bounded, however long
# the recording.
_STRETCHES = 48
_SLOTS = 32


class Some(NamedTuple):
    """Some slots; voltages are multiplied by the drive's sign."""

    volts: Float[np.ndarray, "n M"]  # V; 0 where not good
    good: Bool[np.ndarray, "n M"]
    asked: Integer[np.ndarray, " n"]  # the ground that was commanded
    drive: float  # V, as told
    noise: float  # V rms

    def take(self, which: np.ndarray) -> "Some":
        return self._replace(
            volts=self.volts[which], good=self.good[which], asked=self.asked[which]
        )

    @property
    def high(self) -> Float[np.ndarray, " n"]:
        return np.where(self.good, self.volts, -np.inf).max(1)

    @property
    def low(self) -> Float[np.ndarray, " n"]:
        return np.where(self.good, self.volts, np.inf).min(1)

    @property
    def at_ground(self) -> Float[np.ndarray, " n"]:
        """Returns voltages of grounded electrodes; −∞ where that channel is not good."""
        row = np.arange(len(self.asked))
        there = self.good[row, self.asked]
        return np.where(there, self.volts[row, self.asked], -np.inf)


def some_of(recording: Recording) -> Some:
    """Reads some slots, and keeps those with half of their channels good."""
    rig, m = recording.rig, recording.electrodes
    scans = -(-_SLOTS // recording.slots)
    starts = np.linspace(0, max(0, recording.scans - scans), _STRETCHES).astype(int)
    volts, good, asked = [], [], []
    for start in np.unique(starts):
        read = recording.read(int(start), min(int(start) + scans, recording.scans))
        # Against the drive or beyond it is what is looked for here: no limit but the rails.
        given = read.voltages, read.grounds, np.inf, rig.rails
        found = find_faults(*given, resolution=rig.resolution)
        volts.append(read.voltages.reshape(-1, m))
        good.append(found.good.reshape(-1, m))
        asked.append(read.grounds.ravel())
    v, sound, lines = np.concatenate(volts), np.concatenate(good), np.concatenate(asked)
    drive = abs(rig.drive_voltage)
    enough = 2 * sound.sum(1) >= m
    v = np.where(sound, v * np.sign(rig.drive_voltage), 0).astype(float)
    some = Some(v, sound, lines, drive, nominal_noise(rig))
    return some.take(np.flatnonzero(enough))
