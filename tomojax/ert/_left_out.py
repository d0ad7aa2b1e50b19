"""Rates conditions by how far left-out presses are placed by them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from tomojax._require import require
from tomojax.ert._learning import learned_moves, place
from tomojax.ert._locator import LEAST_KNOWN
from tomojax.ert._presses import Presses
from tomojax.ert._response import compressed, Response
from tomojax.ert._teaching import LENGTHS
from tomojax.ert.recorded._recording import PairRecording


class LeftOut(NamedTuple):
    """Presses at known places, and each half's map of the other half's presses.

    Some readings tell nothing of a place by themselves, but how far the others' places are
    off. The map's slopes do not show that; presses do.
    """

    presses: Presses
    halves: list[tuple[Int[np.ndarray, " n"], Response]]
    reach: float  # of the map from readings to moves, in usual distances; 0 for none

    @classmethod
    def of(cls, response: Response, recording: PairRecording) -> "LeftOut":
        """Takes a recording's presses of a known place whose frame is whole."""
        use = response.used
        flat = recording.voltages.reshape(len(recording.voltages), -1)
        require(
            flat.shape[1] == len(use), "presses", f"{flat.shape[1]}", f"{len(use)} a frame"
        )
        rows = np.flatnonzero(recording.known & np.isfinite(flat[:, use]).all(1))
        told = f"{len(rows)} known places"
        require(len(rows) >= LEAST_KNOWN, "presses", told, f"at least {LEAST_KNOWN}")
        assert recording.places is not None
        dtype, width = response.at.dtype, float(np.ptp(response.at[:, 0]))
        presses = Presses(
            voltages=recording.voltages[rows],
            values=compressed(flat[rows][:, use], response.scale[use]).astype(dtype),
            told=np.ones(len(rows), bool),
            xy=recording.places[rows].astype(dtype),
            deviation=np.zeros(len(rows), dtype),
            at=response.at,
            scale=response.scale,
            width=width,
        )
        one, other = np.array_split(np.random.default_rng(0).permutation(len(rows)), 2)
        lengths = [share * width for share in LENGTHS]
        maps = [presses.of(half).mapped(lengths)[0] for half in (one, other)]
        taught = response.taught
        reach = 0.0 if taught is None else response.reach / _usual_distance(taught)
        return cls(presses, [(other, maps[0]), (one, maps[1])], reach)

    def error(self, keep: Bool[np.ndarray, " K"]) -> float:
        """Returns the mean place error by some of the readings, m."""
        values = self.presses.values[:, keep]
        away = np.empty((len(values), 2), values.dtype)
        for half, by in self.halves:
            white = np.asarray(by.whitener, float)
            low = np.linalg.cholesky(np.linalg.inv(white.T @ white)[np.ix_(keep, keep)])
            whitener = np.linalg.inv(low).astype(values.dtype)
            found = place(values[half], by.readings[:, keep], by.spread, whitener, by.at)
            away[half] = found.xy - self.presses.xy[half]
        errors = [np.linalg.norm(away, axis=1).mean()]
        if self.reach:
            reach = np.asarray(self.reach * _usual_distance(values), values.dtype)
            left = learned_moves(values, away, reach).left
            errors.append(np.linalg.norm(left, axis=1).mean())
        return float(min(errors))

    def choose(
        self, of: Int[np.ndarray, " K"], count: int, after: Sequence[int]
    ) -> list[int]:
        """Chooses conditions one after another, each the best beside those before."""
        chosen: list[int] = []
        for _ in range(count):
            free = [int(k) for k in np.unique(of) if k not in (*after, *chosen)]
            errors = [self.error(np.isin(of, [*after, *chosen, k])) for k in free]
            chosen.append(free[int(np.argmin(errors))])
        return chosen


def _usual_distance(values: Float[np.ndarray, "n K"]) -> float:
    return float(np.median(np.linalg.norm(values - np.roll(values, 1, 0), axis=1)))
