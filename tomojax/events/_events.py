"""Finds touch-down and lift-off: numbers the contacts of rows, from first row to last."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Integer

from tomojax._require import require
from tomojax.kernels.flags import NO_ANSWER

# A contact shows itself in so many rows before it is told; noise alone rarely does twice.
_CONFIRM = 2

# Rows that a contact may be missing from and still be there; as `track` holds it.
_HOLD_ROWS = 3

# Times the hold: a longer time without a row is told with the event at its end.
_GAP = 2

# A contact is the one of the row before that is no farther, pitches; as of `track`.
_REACH = 0.75


class Event(NamedTuple):
    """The beginning or the end of a contact, or a mark.

    **Example:**

    >>> from tomojax import events
    >>> event = events.Event(0.25, "touch_down", 1, (0.03, 0.05), 1e-4)
    >>> event.kind, event.contact
    ('touch_down', 1)
    """

    t: float  # s: of the first row that shows the contact, or the last
    kind: str  # "touch_down", "lift_off"; or "mark", which somebody has set
    contact: int  # its number, from 1; 0 of a mark
    xy: tuple[float, float]  # m, in that row
    conductance: float  # S, in that row
    force: float = math.nan  # N, in that row, where forces are calibrated
    text: str = ""  # of a mark; or "no row for 0.5 s" beside a gap of the recording


class _Seen:
    """A contact that may still be there."""

    __slots__ = ("first", "last", "missed", "number", "rows", "text")

    def __init__(self, event: Event):
        self.first = self.last = event
        self.number, self.rows, self.missed, self.text = 0, 1, 0, ""


class EventFinder:
    """A finder that numbers the contacts of rows, one row after another, and tells events.

    A contact keeps its number while each row shows a contact within `reach` of the last
    place, and gets the number once `confirm` rows show the contact. The contact is gone
    once `rows` rows in a row miss it, and `hold` seconds have passed since a row showed
    it. Time without a row ends nothing, nor does a row without an answer
    (`Flag.NO_DATA`, `Flag.SOLVE_FAILED`). An event beside a gap of more than two holds
    says so in its `text`.

    **Arguments:** `reach` m; `hold` s; `confirm` and `rows`, numbers of rows.
    **Raises:** `ValueError` for a reach or a hold below 0, and for no rows.

    **Example:**

    >>> from tomojax import events
    >>> finder = events.EventFinder(reach=0.015, hold=0.001)
    >>> for k in range(3):
    ...     numbers, found = finder.row(1e-4 * k, [(0.03, 0.05)], [1e-4])
    >>> numbers
    [1]
    >>> found = finder.row(0.01, [], [])[1] + finder.row(0.011, [], [])[1]
    >>> [(event.kind, round(event.t, 6), event.text) for event in found]
    [('lift_off', 0.0002, 'no row for 0.0098 s')]
    """

    def __init__(
        self, reach: float, hold: float, confirm: int = _CONFIRM, rows: int = _CONFIRM
    ):
        for name, value in (("reach", reach), ("hold", hold)):
            fine = math.isfinite(value) and value >= 0
            require(fine, name, value, "a number, 0 or more")
        for name, count in (("confirm", confirm), ("rows", rows)):
            require(count >= 1, name, count, "a number of rows, 1 or more")
        self._reach, self._hold, self._confirm, self._rows = reach, hold, confirm, rows
        self._there: list[_Seen] = []
        self._before = math.inf  # the time of the last row
        self._numbered = 0

    @classmethod
    def of_rows(cls, pitch: float, interval: float) -> "EventFinder":
        """Makes a finder for electrodes at `pitch`, m, and a row each `interval`, s.

        A contact moves less than 0.75 of a pitch from row to row, and may be missing for
        three rows.
        """
        return cls(_REACH * pitch, _HOLD_ROWS * interval, rows=_HOLD_ROWS + 1)

    def rows(
        self,
        t: Float[np.ndarray, " n"],
        count: Integer[np.ndarray, " n"],
        xy: Float[np.ndarray, "n C 2"],
        conductance: Float[np.ndarray, "n C"],
        flags: Integer[np.ndarray, " n"] | None = None,
        force: Float[np.ndarray, "n C"] | None = None,
    ) -> list[Event]:
        """Finds the events of a stretch of rows, NaN-padded as in results."""
        bits = np.zeros(len(t), int) if flags is None else flags
        found = []
        for k, n in enumerate(count.tolist()):
            here = None if force is None else force[k, :n].tolist()
            places, g = xy[k, :n].tolist(), conductance[k, :n].tolist()
            found += self.row(float(t[k]), places, g, int(bits[k]), here)[1]
        return found

    def row(
        self,
        t: float,
        xy: Sequence[Any],
        conductance: Sequence[float],
        flags: int = 0,
        force: Sequence[float] | None = None,
    ) -> tuple[list[int], list[Event]]:
        """Takes one row; returns each contact's number (0: not yet), and the events.

        **Arguments:** `t` s; `xy` m and `conductance` S of the row's contacts, no padding;
        `flags` of the row; `force` N.
        """
        if flags & NO_ANSWER:
            return [0] * len(xy), []
        gap, self._before = t - self._before, t
        text = f"no row for {gap:.2g} s" if gap > _GAP * self._hold > 0 else ""
        if not (len(xy) or self._there):
            return [], []
        found: list[Event] = []
        forces = [math.nan] * len(xy) if force is None else force
        seen = [
            Event(t, "", 0, (float(x), float(y)), float(g), float(f))
            for (x, y), g, f in zip(xy, conductance, forces)
        ]
        numbers = [0] * len(seen)
        pairs = dict(self._pairs(seen))
        for k, contact in pairs.items():
            contact.last, contact.missed, contact.text = seen[k], 0, ""
            contact.rows += 1
            numbers[k] = self._number(contact, found)
        for contact in self._there:
            if contact not in pairs.values():
                contact.missed += 1
                contact.text = contact.text or text
        found += self._ended(t - self._hold, self._rows)
        for k, event in enumerate(seen):
            if k not in pairs:
                new = _Seen(event._replace(text=text))
                self._there.append(new)
                numbers[k] = self._number(new, found)
        return numbers, found

    def finish(self) -> list[Event]:
        """Ends the contacts that are still there."""
        return self._ended(math.inf, 0)

    def _number(self, contact: _Seen, found: list[Event]) -> int:
        if not contact.number and contact.rows >= self._confirm:
            self._numbered += 1
            contact.number = self._numbered
            event = contact.first._replace(kind="touch_down", contact=contact.number)
            found.append(event)
        return contact.number

    def _ended(self, before: float, missed: int) -> list[Event]:
        gone = [c for c in self._there if c.last.t < before and c.missed >= missed]
        self._there = [one for one in self._there if one not in gone]
        return [
            one.last._replace(kind="lift_off", contact=one.number, text=one.text)
            for one in gone
            if one.number
        ]

    def _pairs(self, seen: list[Event]) -> Iterable[tuple[int, _Seen]]:
        """Pairs contacts of the row with contacts before, the nearest first."""
        apart = sorted(
            (math.dist(event.xy, contact.last.xy), k, j)
            for k, event in enumerate(seen)
            for j, contact in enumerate(self._there)
        )
        rows, theirs = set(), set()
        for distance, k, j in apart:
            if distance > self._reach:
                break
            if k not in rows and j not in theirs:
                rows.add(k)
                theirs.add(j)
                yield k, self._there[j]


def find_events(
    t: Float[np.ndarray, " n"],
    count: Integer[np.ndarray, " n"],
    xy: Float[np.ndarray, "n C 2"],
    conductance: Float[np.ndarray, "n C"],
    flags: Integer[np.ndarray, " n"] | None = None,
    force: Float[np.ndarray, "n C"] | None = None,
    *,
    pitch: float,
) -> list[Event]:
    """Finds all events of rows, in order of time.

    **Arguments:** `t` s; `count` of contacts; `xy` m; `conductance` S; `force` N; `pitch`
    of the electrodes, m: a contact moves less than 0.75 pitches from row to row. A contact
    may be missing for three rows.

    **Example:**

    >>> import numpy as np
    >>> from tomojax import events
    >>> t, count = 0.1 * np.arange(6), np.array([0, 1, 1, 1, 0, 0])
    >>> xy = np.full((6, 1, 2), 0.05)
    >>> found = events.find_events(t, count, xy, np.full((6, 1), 1e-4), pitch=0.02)
    >>> [(event.kind, round(event.t, 3)) for event in found]
    [('touch_down', 0.1), ('lift_off', 0.3)]
    """
    interval = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    finder = EventFinder.of_rows(pitch, interval)
    found = finder.rows(t, count, xy, conductance, flags, force) + finder.finish()
    return sorted(found, key=lambda event: event.t)


def events_of_tracks(
    t: Float[np.ndarray, " n"],
    track: Integer[np.ndarray, "n C"],
    xy: Float[np.ndarray, "n C 2"],
    conductance: Float[np.ndarray, "n C"],
    force: Float[np.ndarray, "n C"] | None = None,
) -> list[Event]:
    """Finds events of contacts that `track` has numbered: each number's first and last row.

    **Arguments:** `t` s; `track` the numbers, 0 without a contact; `xy` m; `conductance` S;
    `force` N.

    **Example:**

    >>> import numpy as np
    >>> from tomojax import events
    >>> t, track = 0.1 * np.arange(4), np.array([[0], [7], [7], [0]])
    >>> found = events.events_of_tracks(t, track, np.full((4, 1, 2), 0.05), track * 1e-4)
    >>> [(event.kind, event.contact, round(event.t, 3)) for event in found]
    [('touch_down', 7, 0.1), ('lift_off', 7, 0.2)]
    """
    row, column = np.nonzero(track)
    numbers = track[row, column]
    first = np.unique(numbers, return_index=True)[1]
    last = len(numbers) - 1 - np.unique(numbers[::-1], return_index=True)[1]
    found = []
    for kind, index in (("touch_down", first), ("lift_off", last)):
        for k in index:
            r, c = row[k], column[k]
            x, y = xy[r, c].tolist()
            g = float(conductance[r, c])
            f = math.nan if force is None else float(force[r, c])
            found.append(Event(float(t[r]), kind, int(numbers[k]), (x, y), g, f))
    return sorted(found, key=lambda event: event.t)
