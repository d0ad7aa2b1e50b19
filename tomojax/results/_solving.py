"""Solves a chunk of a recording; a design by place may choose the slots, and λ."""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tomojax._require import require
from tomojax.methods import Batch, method as make_method, Rows
from tomojax.recordings import Chunk, Recording
from tomojax.sensor import Calibration

# Methods whose λ/σ₁² a table has.
_WITH_LAMBDA = "linear", "source"


class Chosen:
    """The slots of each scan that a table holds for the places of the scan's contacts.

    `points` finds the contacts in the two exploratory slots, like the paper's adaptive
    scan. The table is looked up like in a step, several contacts in turn. A scan without a
    contact keeps all slots. The methods "linear" and "source" also use the table's λ.
    **Raises:** `ValueError` for a table of another rig, and a scan that lacks a ground of
    the table or of the exploration.
    """

    def __init__(self, path: Path | str, recording: Recording, contacts: int, method: str):
        from tomojax.paper import exploration
        from tomojax.step import load_policy  # which runs without a table need not

        sensor = recording.rig.sensor()
        policy = load_policy(path, sensor)
        self.table = np.asarray(policy.table)
        # What λ is to the other methods is something else.
        known = policy.lam is not None and method in _WITH_LAMBDA
        self.lam = np.asarray(policy.lam) if known else None
        self.size, self.corners = np.asarray(sensor.size), np.asarray(exploration(sensor))
        asked = np.union1d(self.table, self.corners)
        missing = np.setdiff1d(asked, recording.read(0, 1).grounds)
        told = f"grounds that the recording lacks: {', '.join(map(str, missing[:8]))}"
        expected = "a recording with all of them in each scan"
        require(not len(missing), f"{path}: table", told, expected)
        points = make_method(sensor, "points", 8)
        self._find = Batch(points, 1.0, contacts, images=False)

    @property
    def median(self) -> float | None:
        """Returns the median λ/σ₁² of the table's places."""
        return None if self.lam is None else float(np.median(self.lam))

    def __call__(
        self, chunk: Chunk, volts: Float[np.ndarray, "n S M"]
    ) -> tuple[Bool[np.ndarray, "n S"], Float[np.ndarray, " n"] | None]:
        """Returns the slots to use of a chunk's frames, and λ/σ₁² of each frame."""
        explores = np.isin(chunk.grounds, self.corners)
        order = np.argsort(~explores, 1, kind="stable")[:, : len(self.corners)]
        at = np.arange(len(order))[:, None], order
        found = self._find(volts[at], chunk.grounds[at], chunk.good[at])
        used = np.ones(chunk.grounds.shape, bool)
        lams = None if self.lam is None else np.full(len(used), self.median)
        shape = np.array(self.table.shape[:2])
        for k in np.flatnonzero(found.contact_count):
            some = int(found.contact_count[k])
            at = np.nan_to_num(found.contact_xy[k, :some]) / self.size * shape
            cells = np.clip(at.astype(int), 0, shape - 1)
            turn = np.arange(self.table.shape[2])
            each = self.table[cells[:, 0], cells[:, 1]]
            used[k] = np.isin(chunk.grounds[k], each[turn % some, turn])
            if lams is not None and self.lam is not None:
                lams[k] = self.lam[cells[0, 0], cells[0, 1]]
        return used, lams


class AbstractSolver(ABC):
    """Finds the rows of chunks. A solver that needs chunks in order has a memory."""

    @abstractmethod
    def __call__(self, chunk: int, frames: Chunk) -> tuple[Rows, dict[str, Any] | None]:
        """Returns the rows of a chunk, and what is kept after them, if anything."""

    def remembered(self) -> dict[str, np.ndarray]:
        """Returns the present state, for `resume`."""
        return {}

    def resume(self, kept: dict[str, np.ndarray]) -> None:  # noqa: B027
        """Goes on from the state after a chunk; an empty state means the beginning."""


class EachAlone(AbstractSolver):
    """Applies a method to each chunk alone; λ is the table's where `own_lam` is true."""

    def __init__(
        self, batch: Batch, calibration: Calibration, chosen: Chosen | None, own_lam: bool
    ):
        self._batch, self._calibration = batch, calibration
        self._chosen, self._own_lam = chosen, own_lam

    def __call__(self, chunk: int, frames: Chunk) -> tuple[Rows, None]:
        _, voltages, grounds, good, flags = frames
        volts, batch = self._calibration.voltages(voltages), self._batch
        if self._chosen is None:
            return batch(volts, grounds, good, flags), None
        used, lams = self._chosen(frames, volts)
        rows, counts = batch.empty(len(volts)), used.sum(1)
        for count in np.unique(counts):  # frames that use the same number of slots
            some = np.flatnonzero(counts == count)
            at = some[:, None], np.nonzero(used[some])[1].reshape(-1, count)
            lam = None
            if lams is not None and self._own_lam:
                lam = lams[some] * batch.method.scale()
            rows.put(some, batch(volts[at], grounds[at], good[at], flags[some], lam))
        return rows, None
