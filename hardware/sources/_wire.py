"""Reads slots over a wire: finds gaps by sequence numbers, and mends a cut connection."""

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from tomojax._require import require
from tomojax.hardware.sources import _frames as frames
from tomojax.hardware.sources._numbers import Clock, Numbers, Placed, TRUSTED
from tomojax.hardware.sources._source import Counters, Got, Handed, SlotSource

_SILENCE = 0.25  # s without a message after which the rig is asked to start again
_NO_ANSWER = 5.0  # s after which a start that nobody answers fails

# Slots with another ground than asked for, until it is asked for again.
_PATIENCE = 50

# A clock that C does not carry on, µs.
_LATE = 1 << 62

# What a rig may say of itself.
_RATES = 1e-3, 1e8  # slots a second
_FINEST = 1e-12  # V of a code at least
_VOLTS = 1e6  # V of all codes at most


def _possible(told: frames.Description) -> bool:
    """Tells whether such a rig's times and voltages are numbers, in float32 too."""
    volts = 32768 * abs(told.scale) + abs(told.offset)
    known = _RATES[0] <= told.rate <= _RATES[1] and abs(told.scale) >= _FINEST
    return known and volts <= _VOLTS


class Link(ABC):
    """Sends and receives whole messages; raises `OSError` if the link is cut."""

    @abstractmethod
    def open(self) -> None: ...

    @abstractmethod
    def receive(self, timeout: float) -> tuple[list[bytes], float]:
        """Returns the messages that come within `timeout` s, as soon as there is one.

        Messages may be unsound. Also returns when their last byte came, s of
        `time.perf_counter`.
        """

    @abstractmethod
    def send(self, message: bytes) -> None: ...

    @abstractmethod
    def close(self) -> None: ...

    def hand_over(self) -> tuple[int, bool, bytes] | None:
        """Returns the descriptor, whether it is serial, and bytes of half a message."""
        return None

    def take_back(self, rest: bytes) -> list[bytes]:
        """Returns the whole messages of bytes that C has not worked on."""
        return []


class WireSource(SlotSource):
    """A rig that speaks the protocol of PROTOCOL.md over a `Link`.

    The source goes on after faults of the line. It opens a cut link again, and asks a
    silent rig to start again. If the rig kept running meanwhile, slot numbers count the
    lost slots. If the rig was switched off, the time that went by counts them. `Numbers`
    and `Clock` handle numbers that jump and a clock that falls.

    `conditions` (L, M): a table of conductances to ground, S, for a rig that takes one;
    grounds are then rows of the table.
    """

    def __init__(
        self, link: Link, electrodes: int = 64, conditions: np.ndarray | None = None
    ):
        require(1 <= electrodes <= 256, "electrodes", electrodes, "1 to 256")
        # A table goes to the rig row by row, each in a START.
        rows = [] if conditions is None else frames.rows_of(conditions, electrodes)
        self._starts = [frames.pack_row(row) for row in rows]
        self._table, self._held = rows[0].table if rows else None, 0
        self.electrodes, self._link = electrodes, link
        self.rate = self.scale = self.offset = float("nan")
        self.counters = Counters()
        self._told: frames.Description | None = None
        self._open = self._answered = False
        self._grounds: tuple[int, ...] | None = None
        self._unheeded = 0
        self._messages: deque[tuple[bytes, float]] = deque()
        self._ready: deque[tuple[frames.Slot, Got]] = deque()
        self._order, self._clock = Numbers(self.counters), Clock(self.counters)
        self._missed = 0
        # When a slot was last given out, or the rig described itself.
        self._heard = self._asked = self._opened = 0.0
        self._last: Got | None = None

    def start(self) -> None:
        self._link.open()
        self._open = True
        self._ask()
        end, held = time.perf_counter() + _NO_ANSWER, 0
        while self._told is None:
            if self._held > held:
                end, held = time.perf_counter() + _NO_ANSWER, self._held
            if time.perf_counter() > end:
                self.stop()
                raise TimeoutError(self._unanswered())
            self._pull(0.05)
            while self._messages and self._told is None:
                try:
                    self._take(*self._messages.popleft())
                except ValueError:  # it is not the rig that was asked for
                    self.stop()
                    raise

    def _unanswered(self) -> str:
        if self._answered:
            took = f"the rig took {self._held} of {len(self._starts)} ground conditions"
            return f"{took}; has it room for them, and such paths to ground?"
        more = ", and does it know tables of ground conditions" if self._starts else ""
        return f"no rig answers within {_NO_ANSWER:g} s; is it switched on{more}?"

    def read(self, codes: Int[np.ndarray, " M"], timeout: float = 1.0) -> Got | None:
        end = time.perf_counter() + timeout
        while True:
            while self._messages and not self._ready:
                self._take(*self._messages.popleft())
            if self._ready:
                slot, got = self._ready.popleft()
                np.copyto(codes, slot.codes)
                return got
            left = end - time.perf_counter()
            if left <= 0:
                return None
            self._pull(left)

    def set_grounds(self, grounds: Sequence[int]) -> None:
        self._grounds = frames.check_grounds(grounds, self.condition_count)
        self._unheeded = 0
        self._send(frames.pack_command(frames.GROUNDS, self._grounds))

    def stop(self) -> None:
        if self._open:
            self._send(frames.pack_command(frames.STOP))
            self._link.close()
        self._open = False

    @property
    def condition_count(self) -> int:
        return len(self._starts) or self.electrodes

    @property
    def waiting(self) -> int:
        return len(self._messages) + len(self._ready)

    def hand_over(self) -> Handed | None:
        number, clock = self._order.next, self._clock.state
        if self.waiting or self._missed or not self._open:
            return None
        if number is None or clock is None or clock[0] >= _LATE:
            return None
        line = self._link.hand_over()
        if line is None:
            return None
        descriptor, serial, rest = line
        numbers = number, self._number, *clock
        lines = np.arange(self.condition_count)
        same = np.arange(self.electrodes), lines, lines
        return Handed(descriptor, serial, TRUSTED, *numbers, rest, same)

    def take_back(self, handed: Handed, arrived: float, ground: int, asked: int) -> None:
        came = handed.number - self._number
        self._grounds, self._unheeded = (asked,) if asked >= 0 else self._grounds, 0
        if came:
            sequence = (handed.next - 1) % (1 << 32)
            last = frames.Slot(ground, sequence, handed.last, np.zeros(0, np.int16))
            self._order.goes_on(last, arrived)
            self._clock.goes_on(handed.last)
            self._number, self._heard = handed.number, arrived
            when = handed.base + 1e-6 * (handed.last - handed.origin)
            self._last = Got(ground, 0, handed.number - 1, when, arrived)
        found = self._link.take_back(handed.rest)
        self._messages.extend((message, arrived) for message in found)

    def _ask(self) -> None:
        self._asked = time.perf_counter()
        starts = self._starts or [frames.pack_command(frames.START)]
        self._send(starts[min(self._held, len(starts) - 1)])
        if self._grounds:
            self._send(frames.pack_command(frames.GROUNDS, self._grounds))

    def _send(self, message: bytes) -> None:
        try:
            if self._open:
                self._link.send(message)
        except BlockingIOError:  # no room: it is asked for again where it is not heeded
            pass
        except OSError:
            self._cut()

    def _cut(self) -> None:
        # One that said nothing yet is still the cut before it.
        self.counters.disconnects += self._heard > self._opened
        self._link.close()
        self._open = False

    def _pull(self, timeout: float) -> None:
        """Waits for messages; opens the link again, and asks the rig again, if needed."""
        if not self._open:
            time.sleep(min(timeout, 0.02))
            try:
                self._link.open()
            except OSError:
                return
            self._open, self._opened = True, time.perf_counter()
            self._ask()
        if not self._open:  # cut again by what was just sent
            return
        # Whatever else comes: noise, or slots of another rig, are no answer.
        if time.perf_counter() - max(self._heard, self._asked) > _SILENCE:
            self._ask()
            if not self._open:
                return
        try:
            found, now = self._link.receive(min(timeout, _SILENCE))
        except OSError:
            self._cut()
            return
        self._messages.extend((message, now) for message in found)

    def _take(self, message: bytes, arrived: float) -> None:
        found = frames.unpack(message, self.electrodes, self.condition_count)
        if found is None:
            self.counters.bad += 1
        elif isinstance(found, frames.Description):
            if found.table != self._table:
                self.counters.bad += 1
            elif found.held < len(self._starts):
                self._answered = True
                if found.held != self._held:  # the next row, else again after a silence
                    self._held = found.held
                    self._ask()
            else:
                self._describe(found, arrived)
        elif self._told is None:
            # It goes on from before this program: it is asked again what it is.
            self.counters.early += 1
        else:
            for placed in self._order.add(found, arrived):
                self._ready.append((placed.slot, self._got(placed)))

    def _got(self, placed: Placed) -> Got:
        slot, arrived = placed.slot, placed.arrived
        lost = placed.lost + self._missed
        self._missed, self._heard = 0, arrived
        away = (lost + 1) / self.rate
        if placed.anew and self._last is not None:
            self._clock.begin(self._last.time + away)
        when = self._clock(slot.microseconds, away)
        self._last = self._counted(slot.ground, lost, when, arrived)
        self._heed(slot.ground)
        return self._last

    def _heed(self, ground: int) -> None:
        """Asks for the grounds again if a command seems to be lost."""
        if self._grounds is None or ground in self._grounds:
            self._unheeded = 0
            return
        self._unheeded += 1
        if self._unheeded >= _PATIENCE:
            self.set_grounds(self._grounds)

    def _describe(self, told: frames.Description, arrived: float) -> None:
        before = self._told
        another = before is not None and before.session != told.session
        if another and arrived - self._asked > _NO_ANSWER:
            self.counters.bad += 1  # nobody asked: it is another rig's
            return
        here, m = told.electrodes, f"{self.electrodes}, as the sensor has"
        require(here == self.electrodes, "electrodes", f"a rig with {here}", m)
        numbers = told.rate, told.scale, told.offset
        names, got = "rate, scale, offset", f"a rig with {numbers}"
        require(_possible(told), names, got, "a rate, and a scale")
        self._told = told
        if before is not None:
            # What is recorded and worked on would mean something else from here on.
            was = before.rate, before.scale, before.offset
            require(numbers == was, names, got, f"{was}")
        self.rate, self.scale, self.offset = numbers
        self._order.rate, self._heard = told.rate, arrived
        if before is None:
            self._order.begin(told.sequence, arrived)
        elif another:
            # Its numbers began anew: what was lost is told by the time.
            self.counters.restarts += 1
            self._order.begin(told.sequence, arrived)
            last = self._last
            if last is not None:
                away = max(1, round((arrived - last.arrived) * told.rate))
                self._missed += away
                self._clock.begin(last.time + (self._missed + 1) / told.rate)
