"""Sums results of files of any length over time: from few rows first, then from all."""

import time
from bisect import bisect_right
from pathlib import Path
from threading import Thread
from typing import NamedTuple

import numpy as np

from tomojax._require import require
from tomojax._stretch import stretch_of
from tomojax.results.loading import LoadedResults, strength

_PARTS = 16384  # of the whole file that are kept
_PLACES = 256  # that are looked at before the first picture
_FEW = 8  # rows at each of these
_EXACT = 200_000  # rows that are read exactly
_PIECE = 1 << 19  # rows that are read in one piece


class Parts(NamedTuple):
    """Stretches of rows: the time of their first row, s, and what the rows hold."""

    t: np.ndarray
    contacts: np.ndarray  # the most
    low: np.ndarray  # of the sum over the contacts, in the unit of what is summed
    high: np.ndarray
    flags: np.ndarray  # all that any of its rows has


class _Times:
    """The times of a file's rows, s: only those that are asked for are read."""

    def __init__(self, file: LoadedResults):
        self._file = file

    def __len__(self) -> int:
        return self._file.rows

    def __getitem__(self, k: int) -> float:
        return float(self._file.row("t", range(len(self))[k]))


class Timeline:
    """Rows `first` to `last` of a results file; a separate thread reads all of them.

    `name`: the dataset whose values are summed over the contacts.
    """

    def __init__(self, path: Path, since: float | None, until: float | None):
        self.path = path
        with LoadedResults(path) as file:
            names = file.names
            for needed in ("contact_count", "contact_conductance", "flags"):
                require(needed in names, f"{path}: {needed}", "none", "this dataset")
            self.name, self.factor, self.words = strength(names)
            t = _Times(file)
            self.first, self.last = stretch_of(t, since, until)
            self.span = t[self.first], t[self.last - 1]
            count = min(_PARTS, self.last - self.first)
            steps = np.arange(count + 1) * (self.last - self.first) // count
            self._edges = self.first + steps
            self._thin(file)
        self._left, self.failed = count, ""
        Thread(target=self._refine, daemon=True).start()

    @property
    def read(self) -> float:
        """Returns the share of the file that the parts cover so far, 0 to 1."""
        return 1 - self._left / max(1, len(self._parts.t))

    def row(self, file: LoadedResults, t: float) -> int:
        """Returns the last row that is not after `t`."""
        after = bisect_right(_Times(file), t) - 1
        return min(max(after, self.first), self.last - 1)

    def _taken(
        self, file: LoadedResults, start: int, stop: int, edges: np.ndarray
    ) -> Parts:
        """Sums rows into parts, from each of `edges` (rows from `start` on) to the next."""
        t, count, each, flags = (
            file.stretch(name, start, stop)
            for name in ("t", "contact_count", self.name, "flags")
        )
        there = np.arange(each.shape[1]) < count[:, None]
        total = np.where(there & np.isfinite(each), each, 0).sum(1)
        at = edges - start
        return Parts(
            t[at],
            np.maximum.reduceat(count, at),
            np.minimum.reduceat(total, at),
            np.maximum.reduceat(total, at),
            np.bitwise_or.reduceat(flags.astype(np.uint32), at),
        )

    def _thin(self, file: LoadedResults) -> None:
        """Fills all parts from a few rows here and there."""
        count = len(self._edges) - 1
        starts = np.unique(np.linspace(0, count - 1, min(count, _PLACES)).astype(int))
        some = []
        for k in starts:
            row = int(self._edges[k])
            stop = min(row + _FEW, self.last)
            some.append(self._taken(file, row, stop, np.array([row])))
        looked = Parts(*(np.concatenate(c) for c in zip(*some)))
        nearest = np.searchsorted(starts, np.arange(count), "right") - 1
        self.strongest = int(self._edges[starts[int(np.argmax(looked.high))]])
        self._parts = Parts(*(column[nearest].copy() for column in looked))
        self._parts.t[:] = np.interp(np.arange(count), starts, looked.t)

    def _refine(self) -> None:
        """Reads all rows piece by piece; only the parts stay in memory."""
        try:
            with LoadedResults(self.path) as file:
                each = max(1, _PIECE * len(self._parts.t) // (self.last - self.first))
                for k in range(0, len(self._parts.t), each):
                    edges = self._edges[k : k + each + 1]
                    start, stop = int(edges[0]), int(edges[-1])
                    found = self._taken(file, start, stop, edges[:-1])
                    for mine, new in zip(self._parts, found):
                        mine[k : k + len(new)] = new
                    self._left -= len(edges) - 1
                    time.sleep(0.002)  # the page has a word in between
        except (OSError, ValueError) as error:
            self.failed = str(error)

    def parts(self, file: LoadedResults, since: float, until: float, most: int) -> Parts:
        """Returns up to `most` parts between two times."""
        start, stop = self.row(file, since), self.row(file, until) + 1
        if stop - start <= _EXACT:
            count = min(most, stop - start)
            edges = start + np.arange(count) * (stop - start) // count
            return self._taken(file, start, stop, edges)
        first, last = np.searchsorted(self._edges, (start, stop - 1), "right") - 1
        count = min(most, last + 1 - first)
        at = np.arange(count) * (last + 1 - first) // count
        t, *rest = (column[first : last + 1] for column in self._parts)
        ways = np.maximum, np.minimum, np.maximum, np.bitwise_or
        return Parts(t[at], *(way.reduceat(column, at) for way, column in zip(ways, rest)))
