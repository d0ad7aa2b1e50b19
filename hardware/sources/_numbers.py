"""Which slot comes next: by a rig's sequence numbers and its clock, neither believed alone.

A slot whose number is far from the one that is due waits, and counts as late meanwhile.
It is given out when its clock shows that it is new, or when those after it go on from it:
then the rig's counter jumped.
"""

from typing import NamedTuple

from tomojax.hardware.sources._frames import Slot
from tomojax.hardware.sources._source import Counters

# So many lost slots are believed without another sign; more have to agree with the clock,
# or with the time that went by, within these factors.
_TRUSTED, _LEAST, _MOST = 50, 0.3, 4.0

# Slots in a row by which a counter has jumped: where the clock went on, and where it fell
# too, as in old slots that are sent again.
_SURE, _UNSURE = 8, 256

_ROUND, _DAY = 2**32, 86400e6


class Placed(NamedTuple):
    """A slot in its place."""

    slot: Slot
    lost: int  # slots just before it
    arrived: float
    anew: bool = False  # its clock does not go on from the slot's before


class Numbers:
    """Puts slots in order; `begin` with each description, then `add` each slot."""

    def __init__(self, counters: Counters):
        self._counters, self.rate = counters, 1.0
        self._next, self._said = 0, 0.0
        self._last: tuple[Slot, float] | None = None
        self._odd: list[tuple[Slot, float]] = []

    def begin(self, sequence: int, arrived: float) -> None:
        """The next slot has this number, so the rig said."""
        self._odd = []
        self._next, self._last, self._said = sequence, None, arrived

    def add(self, slot: Slot, arrived: float) -> list[Placed]:
        """What is given out now that `slot` has come."""
        ahead = (slot.sequence - self._next) % _ROUND
        if ahead <= _TRUSTED or self._agrees(slot, ahead, arrived):
            waited = self._between(slot)
            found = [Placed(odd, 0, when) for odd, when in waited]
            self._counters.jumps += bool(waited)
            found.append(Placed(slot, max(0, ahead - len(waited)), arrived))
            return self._placed(found)
        if self._odd and not self._goes_on(slot):
            return []
        self._odd.append((slot, arrived))
        self._counters.late += 1
        rises = self._last is None or slot.microseconds > self._last[0].microseconds
        if len(self._odd) < (_SURE if rises else _UNSURE):
            return []
        return self._jumped()

    def _placed(self, found: list[Placed]) -> list[Placed]:
        last = found[-1]
        self._next = (last.slot.sequence + 1) % _ROUND
        self._last = last.slot, last.arrived
        return found

    def _agrees(self, slot: Slot, ahead: int, arrived: float) -> bool:
        """Whether clock or time say as well that so many slots were lost."""
        if ahead >= _ROUND // 2:
            return False
        due = ahead / self.rate
        if self._last is None:
            return arrived - self._said >= _LEAST * due
        before, when = self._last
        clock = 1e-6 * ((slot.microseconds - before.microseconds) % _ROUND)
        return _LEAST * due <= clock <= _MOST * due or arrived - when >= _LEAST * due

    def _between(self, slot: Slot) -> list[tuple[Slot, float]]:
        """Those that waited, where the clock says that they were measured just before."""
        waited = self._odd
        if not waited:
            return []
        first = self._last[0].microseconds if self._last else -1
        times = [first, *(odd.microseconds for odd, _ in waited), slot.microseconds]
        if all(a < b for a, b in zip(times, times[1:])) and times[-1] - first < _DAY:
            self._counters.late -= len(waited)
            self._odd = []
            return waited
        self._odd = []
        return []

    def _goes_on(self, slot: Slot) -> bool:
        """Whether a slot follows those that wait; they are given up where it does not."""
        step = (slot.sequence - self._odd[-1][0].sequence) % _ROUND
        if 1 <= step <= _TRUSTED:
            return True
        if step == 0 or step >= _ROUND - _TRUSTED:  # again, or out of order
            self._counters.late += 1
            return False
        self._odd = []
        return True

    def _jumped(self) -> list[Placed]:
        """The counter began anew: what was lost is told by the clock, or by the time."""
        (first, arrived), lost, anew = self._odd[0], 0, False
        if self._last is not None:
            before, when = self._last
            clock = first.microseconds - before.microseconds
            anew = not 0 < clock < _DAY
            away = arrived - when if anew else 1e-6 * clock
            lost = max(0, round(away * self.rate) - 1)
        found, sequence = [], first.sequence - 1
        for slot, when in self._odd:
            gone = (slot.sequence - sequence - 1) % _ROUND
            found.append(Placed(slot, gone, when))
            sequence = slot.sequence
        found[0] = Placed(first, lost, arrived, anew)
        self._counters.late -= len(self._odd)
        self._odd = []
        self._counters.jumps += 1
        return self._placed(found)


class Clock:
    """A rig's clock as it is received: carried on where its bits begin anew."""

    def __init__(self, counters: Counters):
        self._counters = counters
        self._began: int | None = None
        self._last, self._more, self._base = 0, 0, 0.0

    def begin(self, time: float) -> None:
        """The next slot's time is this one, s: its clock is another."""
        self._base, self._began, self._more = time, None, 0

    def __call__(self, microseconds: int, seconds: float) -> float:
        """The time of a slot, s, about so many `seconds` after the slot before."""
        if self._began is None:
            self._began = microseconds
        else:
            step = microseconds - self._last
            least = max(1e6, 1e8 * seconds)
            turn = next((r for r in (_ROUND, _ROUND**2) if 0 <= step + r < least), 0)
            if step < 0 and turn:
                self._more += turn
            elif step <= 0:
                self._counters.clock += 1
        self._last = microseconds
        return self._base + 1e-6 * (microseconds + self._more - self._began)
