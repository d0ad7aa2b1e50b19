"""Runs `follow` on a recording: slots in order; the memory is kept beside the rows.

A chunk depends on the chunks before, so one process does chunks in order. OUT.partial.state
lies beside OUT.partial: the step's memory after the marked chunks. So a resumed run gives
the results of an uninterrupted run.
"""

from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.kernels.flags import Flag
from tomojax.methods import Rows
from tomojax.recordings import Chunk, read_chunk, Recording
from tomojax.results._file import ResultsFile
from tomojax.results._settings import Settings
from tomojax.sensor import Calibration
from tomojax.step import make_step, Packed


class Following:
    """A step on a recording's chunks, in order from `start`."""

    # As of `AbstractMethod`, for the file's layout.
    image_unit, tells_covariance, tells_rung = "1", True, False

    def __init__(
        self, recording: Recording, settings: Settings, calibration: Calibration, size: int
    ):
        rig = recording.rig
        self._step = make_step(
            rig.sensor(),
            contacts=settings.contacts,
            f_switch=rig.f_switch,
            calibration=calibration,
        )
        self._recording, self._size = recording, size
        self.start, self.state = 0, self._step.state
        self._last: np.ndarray | None = None  # time of the slot before, s

    def sizes(self, contacts: int, images: bool) -> dict[str, int]:
        return {"C": contacts}

    def scale(self) -> float:
        return 1.0

    def remembered(self) -> dict[str, np.ndarray]:
        """Returns the present state, for `resume`."""
        numbers, whole = (np.asarray(a) for a in self.state)
        return {"numbers": numbers, "whole": whole}

    def resume(self, kept: dict[str, np.ndarray]) -> None:
        """Goes on from the state after a chunk; an empty state means the beginning."""
        if kept:
            self.start = int(kept["chunk"])
            self.state = Packed(kept["numbers"], kept["whole"])  # pyright: ignore

    def __call__(self, chunk: int, frames: Chunk) -> tuple[Rows, dict[str, Any]]:
        """Returns the rows of the next chunk's slots, and the state after them."""
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


def require_alone(share: tuple[int, int]) -> None:
    """Refuses several processes: a slot needs earlier slots. **Raises:** `ValueError`."""
    alone = "one process: follow goes from slot to slot"
    require(share[1] == 1, "--processes", share[1], alone)


def checked(file: ResultsFile, now: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Reads the state that `file` kept; compares the state with a run's first, `now`.

    **Raises:** `ValueError` for a state of another kind of run.
    """
    kept = file.kept()
    if not kept:
        return kept
    where, again = f"{file.partial}.state", "; begin anew with --overwrite"
    for name, own in now.items():
        found = kept.get(name)
        told = "none" if found is None else f"{found.dtype} {found.shape}"
        fits = found is not None and (found.dtype, found.shape) == (own.dtype, own.shape)
        require(fits, f"{where}: {name}", told, f"{own.dtype} {own.shape}{again}")
    chunk, done = kept.get("chunk", np.array(np.nan)), file.done()
    # Chunks are marked before what is remembered after them is kept.
    whole = chunk.shape == () and chunk.dtype.kind in "iu"
    fits = whole and 1 <= chunk <= file.chunks and done[: int(chunk)].all()
    require(fits, f"{where}: chunk", chunk, f"1 to {done.sum()}, as are done{again}")
    return kept
