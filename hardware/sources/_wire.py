"""Slots over a wire: sequence numbers into gaps, whatever becomes of the connection."""

import math
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from tomojax._require import require
from tomojax.hardware.sources import _frames as frames
from tomojax.hardware.sources._source import Counters, Got, SlotSource

# After so long without a message the rig is asked to start again, s; and a start that
# nobody answers fails after so long.
_SILENCE, _NO_ANSWER = 0.25, 5.0

# Slots with another ground than asked for, until it is asked for again.
_PATIENCE = 50

_HALF = 2**31


# What a rig may say of itself: slots a second, V of a code at least, V of all at most.
_RATES, _FINEST, _VOLTS = (1e-3, 1e8), 1e-12, 1e6


def _possible(told: frames.Description) -> bool:
    """Whether times and voltages of such a rig are numbers, in float32 too."""
    volts = 32768 * abs(told.scale) + abs(told.offset)
    known = _RATES[0] <= told.rate <= _RATES[1] and abs(told.scale) >= _FINEST
    return known and volts <= _VOLTS


class Link(ABC):
    """Whole messages there and back; `OSError` where it is cut."""

    @abstractmethod
    def open(self) -> None: ...

    @abstractmethod
    def receive(self, timeout: float) -> tuple[list[bytes], float]:
        """Messages, sound or not, that are there within `timeout` s, as soon as one is.

        And when their last byte was here, s of `time.perf_counter`.
        """

    @abstractmethod
    def send(self, message: bytes) -> None: ...

    @abstractmethod
    def close(self) -> None: ...


class WireSource(SlotSource):
    """A rig that speaks the protocol of PROTOCOL.md over a `Link`.

    It goes on through whatever becomes of the line: a link that is cut is opened again, a
    rig that is silent is asked to start again. Slots of a rig that went on meanwhile are
    counted by their numbers, those of one that was switched off by the time that went by.
    """

    def __init__(self, link: Link, electrodes: int = 64):
        require(1 <= electrodes <= 256, "electrodes", electrodes, "1 to 256")
        self.electrodes, self._link = electrodes, link
        self.rate = self.scale = self.offset = float("nan")
        self.counters = Counters()
        self._told: frames.Description | None = None
        self._open = False
        self._grounds: tuple[int, ...] | None = None
        self._unheeded = 0
        self._messages: deque[tuple[bytes, float]] = deque()
        self._next = 0  # sequence number of the next slot
        self._number = self._missed = 0
        self._clock = (0, 0.0)  # µs of the rig's, and the `time` that it is
        self._begins: float | None = 0.0  # the next slot's `time`, where its clock is new
        self._heard = self._asked = self._opened = 0.0
        self._last: Got | None = None

    def start(self) -> None:
        self._link.open()
        self._open = True
        self._ask()
        end = time.perf_counter() + _NO_ANSWER
        while self._told is None:
            if time.perf_counter() > end:
                self.stop()
                seconds = f"{_NO_ANSWER:g} s"
                raise TimeoutError(f"no rig answers within {seconds}; is it switched on?")
            self._pull(0.05)
            while self._messages and self._told is None:
                try:
                    self._take(*self._messages.popleft())
                except ValueError:  # it is not the rig that was asked for
                    self.stop()
                    raise

    def read(self, codes: Int[np.ndarray, " M"], timeout: float = 1.0) -> Got | None:
        end = time.perf_counter() + timeout
        while True:
            while self._messages:
                slot = self._take(*self._messages.popleft())
                if slot is not None:
                    np.copyto(codes, slot[0].codes)
                    return slot[1]
            left = end - time.perf_counter()
            if left <= 0:
                return None
            self._pull(left)

    def set_grounds(self, grounds: Sequence[int]) -> None:
        self._grounds = frames.check_grounds(grounds, self.electrodes)
        self._unheeded = 0
        self._send(frames.pack_command(frames.GROUNDS, self._grounds))

    def stop(self) -> None:
        if self._open:
            self._send(frames.pack_command(frames.STOP))
            self._link.close()
        self._open = False

    @property
    def waiting(self) -> int:
        return len(self._messages)

    def _ask(self) -> None:
        self._asked = time.perf_counter()
        self._send(frames.pack_command(frames.START))
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
        """Waits for messages; opens the link again and asks again where that is due."""
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
        try:
            found, now = self._link.receive(min(timeout, _SILENCE))
        except OSError:
            self._cut()
            return
        if found:
            self._heard = now
            self._messages.extend((message, now) for message in found)
        elif now - max(self._heard, self._asked) > _SILENCE:
            self._ask()

    def _take(self, message: bytes, arrived: float) -> tuple[frames.Slot, Got] | None:
        found = frames.unpack(message, self.electrodes)
        if found is None:
            self.counters.bad += 1
            return None
        if isinstance(found, frames.Description):
            self._describe(found, arrived)
            return None
        if self._told is None:
            self.counters.early += 1
            # It goes on from before this program: it is to say what it is.
            if arrived - self._asked > _SILENCE:
                self._ask()
            return None
        ahead = (found.sequence - self._next) % 2**32
        if ahead >= _HALF:
            self.counters.late += 1
            return None
        return found, self._got(found, ahead, arrived)

    def _got(self, slot: frames.Slot, ahead: int, arrived: float) -> Got:
        lost = ahead + self._missed
        self._missed = 0
        self._next = (slot.sequence + 1) % 2**32
        if self._begins is not None:
            self._clock, self._begins = (slot.microseconds, self._begins), None
        self._number += lost
        began, base = self._clock
        when = base + 1e-6 * (slot.microseconds - began)
        got = Got(slot.ground, lost, self._number, when, arrived)
        self._number += 1
        self.counters.lost += lost
        self.counters.slots += 1
        self._last = got
        self._heed(slot.ground)
        return got

    def _heed(self, ground: int) -> None:
        """Asks for the grounds again where a command seems to have been lost."""
        if self._grounds is None or ground in self._grounds:
            self._unheeded = 0
            return
        self._unheeded += 1
        if self._unheeded >= _PATIENCE:
            self.set_grounds(self._grounds)

    def _describe(self, told: frames.Description, arrived: float) -> None:
        here, m = told.electrodes, f"{self.electrodes}, as the sensor has"
        require(here == self.electrodes, "electrodes", f"a rig with {here}", m)
        numbers = told.rate, told.scale, told.offset
        sound = all(map(math.isfinite, numbers)) and _possible(told)
        require(
            sound, "rate, scale, offset", f"a rig with {numbers}", "a rate, and a scale"
        )
        before, self._told = self._told, told
        if before is not None:
            # What is recorded and worked on would mean something else from here on.
            was = before.rate, before.scale, before.offset
            require(
                numbers == was, "rate, scale, offset", f"a rig with {numbers}", f"{was}"
            )
        self.rate, self.scale, self.offset = numbers
        if before is None:
            self._next = told.sequence
        elif before.session != told.session:
            # Its numbers began anew: what was lost is told by the time.
            self.counters.restarts += 1
            self._next = told.sequence
            last = self._last
            if last is not None:
                away = max(1, round((arrived - last.arrived) * told.rate))
                self._missed += away
                self._begins = last.time + (away + 1) / told.rate
