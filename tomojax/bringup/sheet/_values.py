"""Explains what is left of each channel by a gain, a zero, a place and the slot before."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer

from tomojax.bringup.sheet._fit import Fits, sound
from tomojax.bringup.sheet._plane import Plane

# What is known beforehand, 1 σ. These are wide: they keep what nothing tells at 0.
_GAIN = 0.5
_ZERO = 0.01  # of the drive
_PLACE = 0.5  # of the pitch
_BEFORE = 0.5  # the part of the slot before

# Lines' electrodes under which an electrode has to be seen.
_GROUNDS = 2

# Rows whose residual is beyond so many of the usual ones count less; rounds of that.
_WILD = 2.0
_ROUNDS = 20


class Values(NamedTuple):
    """Values of each electrode: gain − 1, zero V, x, y m, and the part of the slot before.

    The last axis of `value` and `deviation` holds these five values.
    """

    value: Float[np.ndarray, "M 5"]
    deviation: Float[np.ndarray, "M 5"]
    rows: Float[np.ndarray, " M"]  # slots that tell
    unexplained: Float[np.ndarray, " M"]  # what these ways leave, of what was there


def slopes_of(plane: Plane, fits: Fits) -> Float[np.ndarray, "2 n M"]:
    """Computes how voltages change as an electrode moves along x and y, V/m."""
    apart = plane.slopes(fits.xy) - plane.slopes(plane.xy)[:, fits.ground]
    return fits.current[:, None] * apart


def values_of(
    plane: Plane,
    volts: Float[np.ndarray, "n M"],
    before: Float[np.ndarray, "n M"],
    fits: Fits,
    ground: Integer[np.ndarray, " n"],
    drive: float,
) -> Values:
    """Regresses each electrode's residuals on its values; `before`: NaN where unknown.

    `ground`: the electrode that each slot's line grounds.

    If `before` is unknown everywhere, the part of the slot before is 0 ± its prior.
    """
    m = plane.count
    place = _PLACE * plane.pitch
    size = np.array([_GAIN, _ZERO * drive, place, place, _BEFORE])
    slope = slopes_of(plane, fits)
    use = sound(fits)
    known = np.isfinite(before)
    older = np.where(known, before - fits.modelled, 0.0)
    value, deviation, rows = np.zeros((m, 5)), np.zeros((m, 5)), np.zeros(m)
    unexplained = np.ones(m)
    for e in range(m):
        some = np.flatnonzero(use & (fits.far[:, e] > 0) & (ground != e))
        if known[some, e].sum() >= 20:
            some = some[known[some, e]]
        if len(np.unique(ground[some])) < _GROUNDS:
            some = some[:0]  # its gain, or place, and the ground's path look alike
        rows[e] = len(some)
        y = (volts - fits.modelled)[some, e]
        columns = [fits.modelled[some, e], np.ones(len(some)), *slope[:, some, e]]
        x = np.stack([*columns, older[some, e]], 1) * size
        span = np.maximum(fits.span[some], 1e-12)
        x, y = x / span[:, None], y / span
        value[e], deviation[e] = _robust(x, y)
        if len(y):
            # A mean of bounded residuals: rare ones count, wild ones do not rule.
            parts = [np.minimum(np.abs(r), 0.1).mean() for r in (y - x @ value[e], y)]
            unexplained[e] = parts[0] / max(parts[1], 1e-9)
    return Values(value * size, deviation * size, rows, unexplained)


def _robust(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fits values in units of their priors, and 1 σ; unusual residuals count less."""
    k = x.shape[1]
    if len(y) < 3:
        return np.zeros(k), np.ones(k)
    left, found, inverse = y, np.zeros(k), np.eye(k)
    for _ in range(_ROUNDS):
        scale = max(1.4826 * float(np.median(np.abs(left))), 1e-6)
        w = 1 / np.maximum(1, np.abs(left) / (_WILD * scale))
        weighed = (x * w[:, None]).T
        inverse = np.linalg.inv(weighed @ x / scale**2 + np.eye(k))
        found = inverse @ (weighed @ y) / scale**2
        left = y - x @ found
    return found, np.sqrt(np.diag(inverse))


def before_of(
    volts: Float[np.ndarray, "n M"], fits: Fits, number: np.ndarray, follows: np.ndarray
) -> Float[np.ndarray, "n M"]:
    """Returns each electrode's voltage in the slot before, as fitted; NaN where unknown.

    Readings do not serve: a channel that lingers shows an older slot. A grounded
    electrode's voltage is its current times the usual resistance of a ground path.
    """
    n, m = volts.shape
    row = np.arange(n)
    good = sound(fits) & (fits.current > 0)
    own = volts[row, fits.ground] / np.maximum(fits.current - fits.second, 1e-12)
    path = float(np.median(own[good])) if good.any() else 0.0
    there = np.where(fits.far > 0, fits.modelled, np.nan)
    there[row, fits.ground] = path * (fits.current - fits.second)
    there[~good] = np.nan
    before = np.full((n, m), np.nan)
    next_ = np.flatnonzero((np.diff(number) == 1) & follows[1:]) + 1
    before[next_] = there[next_ - 1]
    return before


class Pairs(NamedTuple):
    """Neighbours, and the excess of their voltages' difference over an even sheet's."""

    first: np.ndarray
    second: np.ndarray
    ratio: np.ndarray  # 1: as on an even sheet


def pairs_of(plane: Plane, volts: np.ndarray, fits: Fits, usable: np.ndarray) -> Pairs:
    """Computes the drop between neighbouring electrodes, over that of an even sheet."""
    apart = np.hypot(*(plane.xy[:, None] - plane.xy).transpose(2, 0, 1))
    np.fill_diagonal(apart, np.inf)
    nearest = apart.min(1)
    near = apart < 1.3 * np.maximum(nearest[:, None], nearest)
    first, second = np.nonzero(np.triu(near))
    kept = usable[first] & usable[second]
    first, second = first[kept], second[kept]
    use = sound(fits)
    ratio = np.ones(len(first))
    for i, (a, b) in enumerate(zip(first, second)):
        some = use & (fits.far[:, a] * fits.far[:, b] > 0)
        span = np.maximum(fits.span[some], 1e-12)
        x = (fits.modelled[some, a] - fits.modelled[some, b]) / span
        y = (volts[some, a] - volts[some, b]) / span
        found, _ = _robust(np.stack([x, np.ones_like(x) * 0.01], 1), y - x)
        ratio[i] = 1 + found[0]
    return Pairs(first, second, ratio)
