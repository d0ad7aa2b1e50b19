"""Presses that a response is learned from, and how well others are placed by it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer

from tomojax.ert._learning import learn_places, learned, learned_moves
from tomojax.ert._locator import HIDDEN
from tomojax.ert._response import Response

_FOLDS = 5
# Of the map from readings to moves, in usual distances of two frames' readings: from moves
# that no other frame shares to one for all.
_REACHES = (0.22, 0.32, 0.45, 0.63, 0.9, 1.3, 1.8)
# n places learn a map of Matérn's kernel of ν = 5/2 in two dimensions to n^(−ν/(2ν + 2)):
# van der Vaart and van Zanten, Information rates of nonparametric Gaussian process methods,
# 2011.
_RATE = 2.5 / 7
_FEW = 3  # parts of few places that are told, each left out in turn
_LET_GO = 0.01  # of lone presses, by the limits
# χ² with two degrees of freedom has 68.27 % of its values below this one.
_WITHIN = 2.298


class Presses(NamedTuple):
    """Frames of one press each, and all that is known of where they are."""

    voltages: Float[np.ndarray, "N C R"]
    values: Float[np.ndarray, "N K"]  # the readings as they count
    told: Bool[np.ndarray, " N"]
    xy: Float[np.ndarray, "N 2"]  # true where told
    deviation: Float[np.ndarray, " N"]  # along an axis, 0 where told
    at: Float[np.ndarray, "G 2"]
    scale: Float[np.ndarray, " S"]
    width: float  # of the sheet, m

    def of(self, rows: Integer[np.ndarray, " n"] | Bool[np.ndarray, " N"]) -> "Presses":
        """Returns some of the presses."""
        names = ("voltages", "values", "told", "xy", "deviation")
        return self._replace(**{name: getattr(self, name)[rows] for name in names})

    def placed(self, progress: Callable[[str], None] | None = None) -> "Presses":
        """Returns the presses with places by rounds where they are not told."""
        xy, deviation = learn_places(
            self.values, self.xy, self.deviation, self.at, self.width, progress
        )
        return self._replace(xy=xy, deviation=deviation)

    def mapped(self, lengths: Sequence[float]) -> tuple[Response, float]:
        """Returns the response by the map alone, and the likeliest of its lengths, m."""
        made = [
            learned(self.xy, self.values, self.deviation, self.at, self._as(length))
            for length in lengths
        ]
        best = int(np.argmax([float(one.map.evidence) for one in made]))
        response = Response(
            at=self.at,
            readings=np.asarray(made[best].map.readings),
            spread=np.asarray(made[best].map.spread),
            whitener=np.asarray(made[best].whitener),
            scale=self.scale,
            limit=np.inf,
            own=0.0,
            known=int(self.told.sum()),
        )
        return response, lengths[best]

    def corrected(self, by: Response, length: float) -> Response:
        """Adds how far places are off to a response by the map alone of these presses.

        Maps without them, in turn, say it of the presses whose place is told.
        """
        seen = np.flatnonzero(self.told)
        if len(seen) < HIDDEN:
            return by
        away = np.zeros((len(seen), 2), self.xy.dtype)
        size = -(-len(seen) // _FOLDS)
        for fold in range(_FOLDS):  # all of one size: one program
            out = (fold * size + np.arange(size)) % len(seen)
            others = self.of(np.setdiff1d(np.arange(len(self.told)), seen[out]))
            found = others.mapped([length])[0].locate(self.voltages[seen[out]])
            away[out] = found.xy - self.xy[seen[out]]
        taught = self.values[seen]
        apart = np.linalg.norm(taught - np.roll(taught, 1, 0), axis=1)
        reaches = [self._as(reach * np.median(apart)) for reach in _REACHES]
        made = [learned_moves(taught, away, reach) for reach in reaches]
        best = int(np.argmax([float(one.evidence) for one in made]))
        left, before = (np.linalg.norm(each, axis=1) for each in (made[best].left, away))
        if left.mean() >= before.mean():  # each without its own move
            return by
        weights = np.asarray(made[best].weights)
        return replace(by, taught=taught, weights=weights, reach=float(reaches[best]))

    def limits(self, length: float, random: np.random.Generator) -> dict[str, float]:
        """Returns the limits of a lone press, by each half's map of the other half."""
        halves = np.array_split(random.permutation(len(self.told)), 2)
        found = []
        for half, rest in (halves, halves[::-1]):
            by, volts = self.of(half).mapped([length])[0], self.voltages[rest]
            placed, gain = by.placed(volts)
            found.append([placed.residual**2, gain])
        limits = np.quantile(np.concatenate(found, 1), 1 - _LET_GO, axis=1)
        return dict(zip(("limit", "alone"), limits.tolist(), strict=True))

    def deviations(
        self, length: float, progress: Callable[[str], None] | None = None
    ) -> dict[str, float]:
        """Returns the share of deviations, or the map's own one, m: 68 % are within 1 σ.

        They are the least of either. Some of the presses whose place is told are left out
        of all the learning and found, and then others. What all teach is as much nearer to
        the truth as maps of this kernel come nearer with the number of places.
        """
        told = np.flatnonzero(self.told)
        # A third of few, so that all judge; a fifth of many, which is nearly the whole.
        step = int(np.clip(len(told) // HIDDEN, 3, 5))
        away, moments = [], []
        for first in range(_FEW if step == _FEW else 2):
            out = told[first::step][: len(told) // step]
            others = self.of(np.setdiff1d(np.arange(len(self.told)), out)).placed(progress)
            by = others.corrected(others.mapped([length])[0], length)
            found = by.locate(self.voltages[out])
            away.append(found.xy - self.xy[out])
            moments.append(found.covariance)
        found = _deviations(np.concatenate(away), np.concatenate(moments), self.width)
        nearer = (1 - 1 / step) ** _RATE
        return {name: nearer * value for name, value in found.items()}

    def _as(self, number: Any) -> np.ndarray:
        return np.asarray(number, self.values.dtype)


def _deviations(
    away: Float[np.ndarray, "n 2"], covariance: Float[np.ndarray, "n 2 2"], width: float
) -> dict[str, float]:
    def excess(own: float) -> float:
        inverse = np.linalg.inv(covariance + own**2 * np.eye(2))
        squares = np.einsum("ni,nij,nj->n", away, inverse, away)
        return float(np.quantile(squares, 0.6827)) / _WITHIN

    # Above 0: a covariance may be none.
    tried = np.linspace(1e-6 * width, width / 4, 500)
    own = float(next((own for own in tried if excess(own) <= 1), tried[-1]))
    return {"share": min(1.0, excess(own) ** 0.5), "own": own}
