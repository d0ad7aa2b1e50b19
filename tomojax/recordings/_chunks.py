"""Cuts a recording into chunks; reads each chunk's frames with their faults."""

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer

from tomojax.kernels.flags import Flag
from tomojax.recordings._faults import find_faults, HALO
from tomojax.recordings._recording import Recording

Rate = Literal["slot", "scan"]

Progress = Callable[[int, int], None]  # is told how much is done, and how much there is

# Slots of a chunk: an int16 code, a float32 voltage and their masks take 1 kB a slot.
CHUNK_SLOTS = 1 << 16

# A scan that starts later than this after the one before: scans were lost.
_LATE = 1.5


class Chunk(NamedTuple):
    """Frames of a stretch of a recording, judged.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> volts = np.full((3, 2, 16), 0.1)  # three scans of two slots, V
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> recording = tx.recordings.ArrayRecording(rig, volts, [0, 15])
    >>> chunk = tx.recordings.read_chunk(recording, 0, 3)
    >>> chunk.voltages.shape, chunk.good.shape, chunk.flags.shape
    ((3, 2, 16), (3, 2, 16), (3,))
    """

    t: Float[np.ndarray, " n"]  # s
    voltages: Float[np.ndarray, "n S M"]  # V; S is 1 with a row per slot
    grounds: Integer[np.ndarray, "n S"]
    good: Bool[np.ndarray, "n S M"]
    flags: Integer[np.ndarray, " n"]


def read_chunk(recording: Recording, start: int, stop: int, rate: Rate = "scan") -> Chunk:
    """Reads scans `start` to `stop` as frames, with their faults.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> volts = np.full((3, 2, 16), 0.1)  # three scans of two slots, V
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> recording = tx.recordings.ArrayRecording(rig, volts, [0, 15])
    >>> tx.recordings.read_chunk(recording, 1, 3).voltages.shape  # frames are scans
    (2, 2, 16)
    >>> tx.recordings.read_chunk(recording, 1, 3, "slot").voltages.shape
    (4, 1, 16)
    """
    # As many scans around as the rules for faults look at.
    halo = -(-HALO // recording.slots) + 1
    first, last = max(0, start - halo), min(recording.scans, stop + halo)
    scans = recording.read(first, last)
    rig = recording.rig
    good, bits = find_faults(
        scans.voltages,
        scans.grounds,
        rig.drive_voltage,
        rig.rails,
        resolution=rig.resolution,
        conditions=rig.condition_count,
    )
    bits[_after_gaps(recording, scans.t0, first), 0] |= np.uint32(Flag.GAP)
    if len(recording.retimed):
        bits[recording.retimed[first:last]] |= np.uint32(Flag.CLOCK_MENDED)
    keep = slice(start - first, stop - first)
    (v, grounds, t0), good, bits = scans.part(keep.start, keep.stop), good[keep], bits[keep]
    if rate == "scan":
        return Chunk(t0, v, grounds, good, np.bitwise_or.reduce(bits, 1))
    t = t0[:, None] + np.arange(recording.slots) / rig.f_switch
    v, good = (a.reshape(-1, 1, recording.electrodes) for a in (v, good))
    return Chunk(t.ravel(), v, grounds.reshape(-1, 1), good, bits.ravel())


def _after_gaps(recording: Recording, t0: np.ndarray, first: int) -> np.ndarray:
    """Tells which scans come after lost scans, as listed or by their times."""
    after = np.zeros(len(t0), bool)
    listed = recording.rows_after_gaps() - first
    after[listed[(listed >= 0) & (listed < len(t0))]] = True
    after[1:] |= np.diff(t0) > _LATE * recording.interval
    return after
