"""A recording in chunks: how it is cut, and each chunk's frames with their faults."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from tomojax._batch import check_limits
from tomojax._checks import require
from tomojax._faults import find_faults, HALO
from tomojax._recording import Recording
from tomojax.kernels import Flag

Rate = Literal["slot", "scan"]

# Of a chunk: slots (an int16 code, a float32 voltage and their masks take 1 kB a slot), and
# bytes of its images.
CHUNK_SLOTS, _CHUNK_IMAGES = 1 << 16, 1 << 26

# A scan that starts later than this after the one before: scans were lost.
_LATE = 1.5


@dataclass(frozen=True)
class Settings:
    """What decides the rows of a results file, beside the recording.

    `lam` None is the method's own choice from the first frames with a contact; `grid` None
    is 32 × 32 pixels, or 24 × 24 for a row per slot (places are then 2.3 instead of 1.6 mm
    off on a recorded drag, at about one and a half times the speed); `chunk` None fits the
    memory; `threshold` None is the method's own. `calibration`: a file of
    `Calibration.save`; `tare`: channels' zeros from contact-free slots, where there are;
    `policy`: a file of `save_policy`, whose slots alone are used, with its λ.
    """

    method: str = "source"
    rate: Rate = "scan"
    images: bool = True
    lam: float | None = None
    grid: int | None = None
    contacts: int = 4
    threshold: float | None = None
    chunk: int | None = None  # scans
    calibration: str | None = None
    tare: bool = True
    policy: str | None = None

    @property
    def pixels(self) -> int:
        """Of a side of the image."""
        return self.grid or (24 if self.rate == "slot" else 32)

    def check(self) -> None:
        """**Raises:** `ValueError` naming the setting."""
        rates = ("slot", "scan")
        require(self.rate in rates, "rate", repr(self.rate), "'slot' or 'scan'")
        require(
            self.chunk is None or self.chunk > 0, "chunk", self.chunk, "scans, 1 or more"
        )
        apart = self.policy is None or self.rate == "scan"
        require(apart, "policy", "a row per slot", "rate 'scan'")
        lam = 1.0 if self.lam is None else self.lam
        check_limits(lam, self.contacts, self.threshold or 0.0)


class Chunk(NamedTuple):
    """Frames of a stretch of a recording, judged."""

    t: np.ndarray  # (n,) s
    voltages: np.ndarray  # (n, S, M); S is 1 with a row per slot
    grounds: np.ndarray  # (n, S)
    good: np.ndarray  # (n, S, M)
    flags: np.ndarray  # (n,)


def read_chunk(recording: Recording, start: int, stop: int, rate: Rate = "scan") -> Chunk:
    """Scans `start` to `stop` as frames, with their faults."""
    # As many scans around as the rules for faults look at.
    halo = -(-HALO // recording.slots) + 1
    first, last = max(0, start - halo), min(recording.scans, stop + halo)
    scans = recording.read(first, last)
    rig = recording.rig
    faults = find_faults(scans.voltages, scans.grounds, rig.drive_voltage, rig.rails)
    keep = slice(start - first, stop - first)
    v, grounds, good, bits = (
        a[keep] for a in (scans.voltages, scans.grounds, faults.good, faults.flags)
    )
    bits = bits.copy()
    bits[_after_gaps(recording, scans.t0, first)[keep], 0] |= np.uint32(Flag.GAP)
    t0 = scans.t0[keep]
    if rate == "scan":
        return Chunk(t0, v, grounds, good, np.bitwise_or.reduce(bits, 1))
    t = t0[:, None] + np.arange(recording.slots) / rig.f_switch
    m = recording.electrodes
    return Chunk(
        t.ravel(),
        v.reshape(-1, 1, m),
        grounds.reshape(-1, 1),
        good.reshape(-1, 1, m),
        bits.ravel(),
    )


def _after_gaps(recording: Recording, t0: np.ndarray, first: int) -> np.ndarray:
    """Which of these scans come after lost ones, as listed or by their times."""
    after = np.zeros(len(t0), bool)
    listed = recording.rows_after_gaps() - first
    after[listed[(listed >= 0) & (listed < len(t0))]] = True
    after[1:] |= np.diff(t0) > _LATE * recording.interval
    return after


def chunk_scans(recording: Recording, settings: Settings) -> int:
    """Scans of a chunk."""
    if settings.chunk:
        return settings.chunk
    slots = recording.slots
    # A row per slot has a group for each ground, which has to fill its blocks; a row per
    # scan has few, and a quarter of the memory does.
    scans = (CHUNK_SLOTS if settings.rate == "slot" else CHUNK_SLOTS // 4) // slots
    if settings.images:
        rows = slots if settings.rate == "slot" else 1
        scans = min(scans, _CHUNK_IMAGES // (4 * settings.pixels**2 * rows))
    return max(1, scans)
