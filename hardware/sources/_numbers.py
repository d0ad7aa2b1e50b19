"""Orders slots by a rig's sequence numbers and clock, and trusts neither alone.

A slot whose number is far from the expected number waits, and counts as late meanwhile. The
slot is released when its clock shows that it is new. Slots that wait are also released when
enough of them follow each other: then the rig's counter has jumped.
"""

from typing import NamedTuple

from tomojax.hardware.sources._frames import Slot
from tomojax.hardware.sources._source import Counters

# So many lost slots are believed without another sign.
TRUSTED = 50

# More have to agree with the clock, or with the time that went by, within these factors.
_LEAST = 0.3
_MOST = 4.0

# Slots in a row by which a counter has jumped.
_SURE = 8  # where the clock went on
_UNSURE = 256  # where it fell too, as in old slots that are sent again

_ROUND = 2**32
_DAY = 86400e6  # µs


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
        """Takes from the rig's description the number of the next slot."""
        self._odd = []
        self._next, self._last, self._said = sequence, None, arrived

    def add(self, slot: Slot, arrived: float) -> list[Placed]:
        """Takes a slot, and returns the slots that can now be released."""
        ahead = (slot.sequence - self._next) % _ROUND
        if ahead <= TRUSTED or self._agrees(slot, ahead, arrived):
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

    @property
    def next(self) -> int | None:
        """The number that the next slot has; None where some wait, or none was there."""
        return None if self._odd or self._last is None else self._next

    def goes_on(self, last: Slot, arrived: float) -> None:
        """Goes on after a slot that was placed by others."""
        self._placed([Placed(last, 0, arrived)])

    def _placed(self, found: list[Placed]) -> list[Placed]:
        last = found[-1]
        self._next = (last.slot.sequence + 1) % _ROUND
        self._last = last.slot, last.arrived
        return found

    def _agrees(self, slot: Slot, ahead: int, arrived: float) -> bool:
        """Tells whether the clock or the time agrees that so many slots were lost."""
        if ahead >= _ROUND // 2:
            return False
        due = ahead / self.rate
        if self._last is None:
            return arrived - self._said >= _LEAST * due
        before, when = self._last
        clock = 1e-6 * ((slot.microseconds - before.microseconds) % _ROUND)
        return _LEAST * due <= clock <= _MOST * due or arrived - when >= _LEAST * due

    def _between(self, slot: Slot) -> list[tuple[Slot, float]]:
        """Returns waiting slots that the clock places just before this slot."""
        waited, self._odd = self._odd, []
        first = self._last[0].microseconds if self._last else -1
        times = [first, *(odd.microseconds for odd, _ in waited), slot.microseconds]
        if all(a < b for a, b in zip(times, times[1:])) and times[-1] - first < _DAY:
            self._counters.late -= len(waited)
            return waited
        return []

    def _goes_on(self, slot: Slot) -> bool:
        """Tells whether a slot joins those that wait; a slot far off them replaces them."""
        step = (slot.sequence - self._odd[-1][0].sequence) % _ROUND
        if 1 <= step <= TRUSTED:
            return True
        if step == 0 or step >= _ROUND - TRUSTED:  # again, or out of order
            self._counters.late += 1
            return False
        self._odd = []
        return True

    def _jumped(self) -> list[Placed]:
        """Releases the waiting slots after the counter began anew.

        The clock, or else the time that went by, tells how many slots were lost.
        """
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
    """A rig's clock as received, carried on where its bits begin anew."""

    def __init__(self, counters: Counters):
        self._counters = counters
        self._began: int | None = None
        self._last, self._more, self._base = 0, 0, 0.0

    def begin(self, time: float) -> None:
        """Sets the next slot's time, s, since the clock is a new one."""
        self._base, self._began, self._more = time, None, 0

    @property
    def state(self) -> tuple[int, int, float] | None:
        """The last slot's µs, those of time 0, and s to be added; None before a slot."""
        if self._began is None:
            return None
        return self._last, self._began - self._more, self._base

    def goes_on(self, microseconds: int) -> None:
        """Goes on after a slot of this time, which rose as it should."""
        self._last = microseconds

    def __call__(self, microseconds: int, seconds: float) -> float:
        """Returns a slot's time, s, about so many `seconds` after the slot before."""
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
