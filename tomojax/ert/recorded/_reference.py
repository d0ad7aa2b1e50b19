"""Finds the voltages without a press, which readings are changes against."""

from typing import Any

import numpy as np
from jaxtyping import Float

from tomojax._require import one_of, require, require_whole

_WAYS = "first", "quiet", "running"

# A quiet stretch has at most so many times the least deviation of any; presses make more
# than that many times as much.
_QUIET, _PRESSED = 2.0, 4.0

# The part of all stretches that is the least: some are quiet by chance.
_LEAST = 0.02

# A running reference is computed so many times in its own length.
_KNOTS = 4


def reference_of(
    volts: Float[np.ndarray, "n C R"],
    times: Float[np.ndarray, " n"],
    reference: Any,
    frames: int,
    seconds: float,
) -> Float[np.ndarray, "either C R"]:
    """Returns each frame's voltages without a press, as broadcasts to the frames.

    **Arguments:** `reference` is an array (C, R); "first", the mean of the first `frames`;
    "quiet", the mean of the first stretch of so many frames in which nothing is pressed; or
    "running", the median over `seconds`, for presses that are shorter than half of them.
    **Raises:** `ValueError` for another reference, and where no stretch is quiet.
    """
    if not isinstance(reference, str):
        found = np.asarray(reference, float)
        fits = found.shape == volts.shape[1:]
        require(fits, "reference", f"shape {found.shape}", f"{volts.shape[1:]}, a frame")
        return found[None]
    require(reference in _WAYS, "reference", repr(reference), one_of(reference, _WAYS))
    if reference == "running":
        fits = bool(0 < seconds < np.inf)
        require(fits, "seconds", seconds, "a time, s")
        return _running(volts, times, seconds)
    require_whole("frames", frames, 2, len(volts))
    first = 0 if reference == "first" else _quiet(volts, frames)
    return _mean(volts[first : first + frames])[None]


def _mean(volts: np.ndarray) -> np.ndarray:
    good = np.isfinite(volts)
    with np.errstate(invalid="ignore"):  # NaN where no reading is good
        return np.where(good, volts, 0).sum(0) / good.sum(0)


def _quiet(volts: np.ndarray, frames: int) -> int:
    """Finds the first of `frames` frames that deviate from their mean by noise alone."""
    flat = volts.reshape(len(volts), -1)
    flat = np.nan_to_num(flat - np.nanmedian(flat, 0))
    sums = np.cumsum(np.concatenate([np.zeros((1, flat.shape[1])), flat]), 0)
    squares = np.concatenate([[0.0], np.cumsum((flat**2).sum(1))])
    means = (sums[frames:] - sums[:-frames]) / frames
    spread = (squares[frames:] - squares[:-frames]) / frames - (means**2).sum(1)
    spread = np.sqrt(np.maximum(spread, 0))
    least, usual = np.quantile(spread, [_LEAST, 1 - _LEAST])
    told = f"no stretch of {frames} frames that is quieter than the others"
    require(usual > _PRESSED * least, "reference", told, "a reference of your own")
    return int(np.flatnonzero(spread <= _QUIET * least)[0])


def _running(volts: np.ndarray, times: np.ndarray, seconds: float) -> np.ndarray:
    """Computes medians over stretches, and between their middles a line."""
    step = seconds / _KNOTS
    middles = np.arange(times[0], times[-1] + step, step)
    ends = np.searchsorted(times, [middles - seconds / 2, middles + seconds / 2])
    flat = volts.reshape(len(volts), -1)
    whole = [(a, b) for a, b in ends.T if b > a]
    middles = np.array([times[a:b].mean() for a, b in whole])
    medians = np.stack([np.nanmedian(flat[a:b], 0) for a, b in whole])
    found = [np.interp(times, middles, column) for column in medians.T]
    return np.stack(found, 1).reshape(volts.shape)
