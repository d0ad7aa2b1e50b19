"""Runs `follow` on a recording: slots in order; the memory is kept beside the rows.

A chunk depends on the chunks before. OUT.partial.state lies beside OUT.partial: the step's
memory after the marked chunks. So a resumed run gives the results of an uninterrupted run.
"""

from typing import Any

import numpy as np

from tomojax.kernels.flags import Flag
from tomojax.methods import Rows
from tomojax.recordings import Chunk, read_chunk, Recording
from tomojax.results._settings import Settings
from tomojax.results._solving import AbstractSolver
from tomojax.sensor import Calibration
from tomojax.step import make_step, Packed


class Following(AbstractSolver):
    """A step on a recording's chunks, in order from `start`."""

    # As of `AbstractMethod`, for the file's layout.
    image_unit = "1"
    tells_covariance = True
    tells_rung = False

    def __init__(
        self, recording: Recording, settings: Settings, calibration: Calibration, size: int
    ):
        rig = recording.rig
        self._step = make_step(
            rig.sensor(),
            # Recorded grounds are what they are; those that a policy asks for are not used.
            policy="around_contacts" if rig.conditions is None else "all",
            contacts=settings.contacts,
            f_switch=rig.f_switch,
            calibration=calibration,
        )
        self._recording, self._size = recording, size
        self.state = self._step.state
        self._last: np.ndarray | None = None  # time of the slot before, s

    def sizes(self, contacts: int, images: bool) -> dict[str, int]:
        return {"C": contacts}

    def scale(self) -> float:
        return 1.0

    def remembered(self) -> dict[str, np.ndarray]:
        numbers, whole = (np.asarray(a) for a in self.state)
        return {"numbers": numbers, "whole": whole}

    def resume(self, kept: dict[str, np.ndarray]) -> None:
        self.state, self._last = self._step.state, None
        if kept:
            self.state = Packed(kept["numbers"], kept["whole"])  # pyright: ignore

    def __call__(self, chunk: int, frames: Chunk) -> tuple[Rows, dict[str, Any]]:
        good, grounds = frames.good[:, 0], frames.grounds[:, 0].astype(np.int32)
        volts = np.where(good, frames.voltages[:, 0], np.nan)
        lost = self._lost(chunk, frames)
        self.state, out = self._step.replay(self.state, volts, grounds, lost)
        n = len(volts)
        # A voltage left out is NaN to the step; why it is, the recording's rules say.
        own = out.flags.astype(np.uint32) & ~np.uint32(Flag.BAD_VOLTAGES)
        flags = own | frames.flags.astype(np.uint32)
        rung = np.zeros(n, np.uint8)
        rows = Rows.of(out.contacts, residual=out.residual, flags=flags, rung=rung)
        return rows, {"chunk": chunk + 1, **self.remembered()}

    def _lost(self, chunk: int, frames: Chunk) -> np.ndarray:
        """Counts the slots lost before each slot, one at least where scans are missing."""
        start, recording = chunk * self._size, self._recording
        before = frames.t[:1]
        if self._last is not None:
            before = self._last
        elif start > 0:
            before = read_chunk(recording, start - 1, start, "slot").t[-1:]
        self._last = frames.t[-1:]
        apart = np.diff(frames.t, prepend=before) * recording.rig.f_switch
        gone = np.clip(np.round(apart) - 1, 1, 1 << 30).astype(np.int32)
        return np.where(frames.flags & np.uint32(Flag.GAP), gone, 0).astype(np.int32)
