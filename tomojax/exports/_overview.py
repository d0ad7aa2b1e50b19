"""Computes a file's overview for pictures: contacts' strength over time, and circles."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from tomojax._pictures import BLUE, VERMILION
from tomojax.exports._source import Source
from tomojax.kernels.flags import DOUBT
from tomojax.results.loading import strength

# Columns of a picture: more bins would fall on the same pixel.
_BINS = 1000

_CORNERS = 25  # of a ring that looks round
_RADIUS = 3.0  # mm, of a contact that tells none


class Overview(NamedTuple):
    """The lowest and highest sum over contacts, in bins of time."""

    t: Float[np.ndarray, " b"]  # s
    low: Float[np.ndarray, " b"]
    high: Float[np.ndarray, " b"]
    doubted: Float[np.ndarray, " d"]  # s: bins with rows in doubt
    step: float  # s
    words: str


def overview(source: Source) -> Overview:
    """Sums forces where these are calibrated; strengths of presses, or conductances."""
    name, unit, words = strength(source.names)
    t = source.times()
    begin, length = float(t[0]), max(float(t[-1] - t[0]), 1e-9)
    bins = min(_BINS, len(t))
    low, high = np.full(bins, np.inf), np.full(bins, -np.inf)
    doubt = np.zeros(bins, bool)
    for block in source.blocks(["t", name, "flags"]):
        at = np.minimum(((block["t"] - begin) / length * bins).astype(int), bins - 1)
        total = unit * np.nansum(block[name].astype(float), 1)
        np.minimum.at(low, at, total)
        np.maximum.at(high, at, total)
        doubt[at[block["flags"] & int(DOUBT) > 0]] = True
    step = length / bins
    centres = begin + step * (np.arange(bins) + 0.5)
    there = np.isfinite(low)
    starts = begin + step * np.flatnonzero(doubt)
    return Overview(centres[there], low[there], high[there], starts, step, words)


def draw_overview(axes: Any, told: Overview) -> None:
    """Draws the sum over contacts against time, and which rows are in doubt."""
    axes.plot(told.t, told.high, lw=0.8, color=BLUE)
    axes.fill_between(told.t, told.low, told.high, alpha=0.5, lw=0, color=BLUE)
    for k, t in enumerate(told.doubted):
        span = axes.axvspan(t, t + told.step, color=VERMILION, alpha=0.25, lw=0)
        span.set_label("in doubt" if k == 0 else "")
    if len(told.doubted):
        axes.legend(loc="upper right", fontsize=8)
    axes.set(xlabel="time, s", ylabel=told.words, title="All contacts together")
    axes.set(xlim=(told.t[0], max(told.t[-1], told.t[0] + 1e-9)), ylim=(0, None))


def rings(
    xy: Float[np.ndarray, "n 2"], radius: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "m 2"]:
    """Returns circles as one line with breaks; mm."""
    turn = np.linspace(0, 2 * np.pi, _CORNERS)
    circle = np.stack([np.cos(turn), np.sin(turn)], 1)
    wide = np.where(np.isfinite(radius), radius, _RADIUS)
    each = xy[:, None] + wide[:, None, None] * circle
    broken = np.concatenate([each, np.full((len(xy), 1, 2), np.nan)], 1)
    return broken.reshape(-1, 2)
