"""Follows zeros and gains along a recording: chunks in order.

The adapter corrects each stretch of a chunk with the zeros and gains so far. The adapter
then learns from the stretch's rows. A file beside OUT.partial holds the adapter's memory
after the marked chunks. The results hold zeros and gains at the end of each chunk.
"""

from functools import partial
from typing import Any

import numpy as np

from tomojax.calibration import Adapter, lone_places, stretches
from tomojax.methods import Points, Rows
from tomojax.recordings import Chunk, Recording
from tomojax.results._solving import AbstractSolver
from tomojax.sensor import Calibration


class Adapting(AbstractSolver):
    """Applies `solver` to readings of a recording, corrected for the rig's drift.

    `points` is the solver's own model of contacts, if it has one.
    """

    def __init__(
        self,
        recording: Recording,
        calibration: Calibration,
        points: Points | None,
        solver: AbstractSolver,
    ):
        self._adapter = partial(Adapter, recording.rig.sensor(), calibration, points=points)
        self.adapter = self._adapter()
        self._before, self._solver = calibration, solver

    def remembered(self) -> dict[str, np.ndarray]:
        return {**self._solver.remembered(), **self.adapter.state()}

    def resume(self, kept: dict[str, np.ndarray]) -> None:
        self._solver.resume(kept)
        self.adapter = self._adapter()
        if kept:
            self.adapter.restore(kept)

    def __call__(self, chunk: int, frames: Chunk) -> tuple[Rows, dict[str, Any]]:
        parts, state = [], None
        for some in stretches(frames.t):
            part = Chunk(*(a[some] for a in frames))
            volts = self._before.readings(self.adapter.voltages(part.voltages))
            rows, state = self._solver(chunk, part._replace(voltages=volts))
            places = lone_places(rows)
            self.adapter.observe(part.t, part.voltages, part.grounds, places, part.good)
            parts.append(rows)
        rows = Rows.joined(parts)
        kept = {**(state or {}), "chunk": chunk + 1, **self.adapter.state()}
        # Beside what is remembered, what the results log.
        log = {"t": self.adapter.time, "zero": self.adapter.offset}
        log["gain"] = self.adapter.gain
        return rows, kept | {f"adapted_{name}": np.asarray(a) for name, a in log.items()}
