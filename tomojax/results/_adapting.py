"""Follows zeros and gains along a recording: chunks in order, by one process.

The adapter corrects each stretch of a chunk with the zeros and gains so far. The adapter
then learns from the stretch's rows. A file beside OUT.partial holds the adapter's memory
after the marked chunks. The results hold zeros and gains at the end of each chunk.
"""

from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.calibration import Adapter, lone_places, stretches
from tomojax.methods import Points, Rows
from tomojax.recordings import Chunk, Recording
from tomojax.sensor import Calibration

Solve = Any  # of a chunk's number and frames, to its rows and what is kept


class Adapting:
    """Applies `solve` to readings of a recording, corrected for the rig's drift."""

    def __init__(
        self, recording: Recording, calibration: Calibration, model: Any, solve: Solve
    ):
        points = model if isinstance(model, Points) else getattr(model, "points", None)
        sensor = recording.rig.sensor()
        self.adapter = Adapter(sensor, calibration, points=points)
        self._before, self._solve, self.start = calibration, solve, 0

    def remembered(self) -> dict[str, np.ndarray]:
        """Returns the present state, for `resume`."""
        own = self._solve.remembered() if hasattr(self._solve, "resume") else {}
        return {**own, **self.adapter.state()}

    def resume(self, kept: dict[str, np.ndarray]) -> None:
        """Goes on from the state after a chunk; an empty state means the beginning."""
        if hasattr(self._solve, "resume"):
            self._solve.resume(kept)
        if kept:
            self.start = int(kept["chunk"])
            self.adapter.restore(kept)

    def __call__(self, chunk: int, frames: Chunk) -> tuple[Rows, dict[str, Any]]:
        """Returns the rows of the next chunk, and the state after them."""
        parts, state = [], None
        for some in stretches(frames.t):
            part = Chunk(*(a[some] for a in frames))
            volts = self._before.readings(self.adapter.voltages(part.voltages))
            rows, state = self._solve(chunk, part._replace(voltages=volts))
            places = lone_places(rows)
            given = part.voltages, part.grounds, places, part.good
            self.adapter.observe(part.t, *given)
            parts.append(rows)
        rows = Rows(*(None if a[0] is None else np.concatenate(a) for a in zip(*parts)))  # pyright: ignore
        kept = {**(state or {}), "chunk": chunk + 1, **self.adapter.state()}
        # Beside what is remembered, what the results log.
        log = {"t": self.adapter.time, "zero": self.adapter.offset}
        log["gain"] = self.adapter.gain
        return rows, kept | {f"adapted_{name}": np.asarray(a) for name, a in log.items()}


def require_alone(share: tuple[int, int]) -> None:
    """Refuses several processes: drift is followed in order. **Raises:** `ValueError`."""
    alone = "one process: --adapt follows a recording in order"
    require(share[1] == 1, "--processes", share[1], alone)
