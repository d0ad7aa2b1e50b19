"""Explains what is left of each channel by a gain, a zero, a place and the slot before."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tomojax.bringup.sheet._fit import Fits
from tomojax.bringup.sheet._plane import Plane

# What is known beforehand, 1 σ: a gain; a zero, of the drive; a place, of the pitch; the
# part of the slot before. Wide: they keep what nothing tells at 0.
_GAIN, _ZERO, _PLACE, _BEFORE = 0.5, 0.01, 0.5, 0.5

# Rows whose residual is beyond so many of the usual ones count less; rounds of that.
_WILD, _ROUNDS = 2.0, 20

# Slots that fit so many times worse than usual are not counted.
_SOUND = 4.0


class Values(NamedTuple):
    """Values of each electrode: gain − 1, zero V, x, y m, and the part of the slot before.

    The last axis of `value` and `deviation` holds these five values.
    """

    value: Float[np.ndarray, "M 5"]
    deviation: Float[np.ndarray, "M 5"]
    rows: Float[np.ndarray, " M"]  # slots that tell
    unexplained: Float[np.ndarray, " M"]  # what these ways leave, of what was there


def sound(fits: Fits) -> Bool[np.ndarray, " n"]:
    """Finds slots that one contact explains about as well as usual."""
    relative = fits.left / np.maximum(fits.span, 1e-12)
    return relative < _SOUND * np.median(relative)


def values_of(
    plane: Plane,
    volts: Float[np.ndarray, "n M"],
    before: Float[np.ndarray, "n M"],
    fits: Fits,
    drive: float,
) -> Values:
    """Regresses each electrode's residuals on its values; `before`: NaN where unknown.

    If `before` is unknown everywhere, the part of the slot before is 0 ± its prior.
    """
    m = plane.count
    size = _scales(plane, drive)
    slope = fits.current[:, None] * (
        plane.slopes(fits.xy) - plane.slopes(plane.xy)[:, fits.ground]
    )
    use = sound(fits)
    known = np.isfinite(before)
    older = np.where(known, before - fits.modelled, 0.0)
    value, deviation, rows = np.zeros((m, 5)), np.zeros((m, 5)), np.zeros(m)
    unexplained = np.ones(m)
    for e in range(m):
        some = np.flatnonzero(use & (fits.far[:, e] > 0))
        if known[some, e].sum() >= 20:
            some = some[known[some, e]]
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


def _scales(plane: Plane, drive: float) -> np.ndarray:
    place = _PLACE * plane.pitch
    return np.array([_GAIN, _ZERO * drive, place, place, _BEFORE])


def _robust(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fits values in units of their priors, and 1 σ; unusual residuals count less."""
    k = x.shape[1]
    if len(y) < 3:
        return np.zeros(k), np.ones(k)
    w, found, inverse, scale = np.ones(len(y)), np.zeros(k), np.eye(k), 1.0
    left = y
    for _ in range(_ROUNDS):
        scale = max(1.4826 * float(np.median(np.abs(left))), 1e-6)
        w = 1 / np.maximum(1, np.abs(left) / (_WILD * scale))
        normal = (x * w[:, None]).T @ x / scale**2 + np.eye(k)
        inverse = np.linalg.inv(normal)
        found = inverse @ ((x * w[:, None]).T @ y) / scale**2
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


def old_part(
    volts: Float[np.ndarray, "n M"],
    before: Float[np.ndarray, "n M"],
    fits: Fits,
    older: np.ndarray,
    usable: np.ndarray,
) -> tuple[Float[np.ndarray, " n"], np.ndarray]:
    """Computes how much of the slot before a channel shows, if its electrode was grounded.

    No other reading shows the part as well: (V − P)/(V_before − P) with V_before near 0.
    `older`: the electrode that was grounded in the slot before, −1 where none is known.
    **Returns:** the part in each slot, NaN where unknown, and the electrode.
    """
    n = len(volts)
    e = np.where(older >= 0, older, 0)
    row = np.arange(n)
    clear = (older >= 0) & (older != fits.ground) & usable[e] & (fits.far[row, e] > 0)
    clear &= np.isfinite(before[row, e]) & sound(fits)
    drop = before[row, e] - fits.modelled[row, e]
    clear &= -drop > 0.3 * fits.span
    part = (volts - fits.modelled)[row, e] / np.where(clear, drop, 1)
    return np.where(clear, part, np.nan), e


class Pairs(NamedTuple):
    """Neighbours, and the excess of their voltages' difference over an even sheet's."""

    first: np.ndarray
    second: np.ndarray
    ratio: np.ndarray  # 1: as on an even sheet
    deviation: np.ndarray


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
    ratio, deviation = np.ones(len(first)), np.ones(len(first))
    for i, (a, b) in enumerate(zip(first, second)):
        some = use & (fits.far[:, a] * fits.far[:, b] > 0)
        span = np.maximum(fits.span[some], 1e-12)
        x = (fits.modelled[some, a] - fits.modelled[some, b]) / span
        y = (volts[some, a] - volts[some, b]) / span
        found, sigma = _robust(np.stack([x, np.ones_like(x) * 0.01], 1), y - x)
        ratio[i], deviation[i] = 1 + found[0], sigma[0]
    return Pairs(first, second, ratio, deviation)
