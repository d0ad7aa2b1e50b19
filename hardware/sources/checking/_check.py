"""Runs a source for a second and says what breaks the contract of `SlotSource`."""

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tomojax.hardware.sources._source import Counters, Got, SlotSource

# What an array holds before a read: no source writes that into every channel.
_BEFORE = 12345

# Seconds.
_LATE = 1.0  # that a read may take beyond its timeout
_START = 10.0  # that a start may take
_TIMEOUT = 0.1  # of one read
_ARRIVED = 1.0  # by which a time of arrival may be off

# A converter of a larger range, V, is none: codes are volts by mistake.
_RANGE = 1000.0

_CLOCK = 0.05  # within this part a rig's clock and rate agree
_OBEYED = 0.9  # in this part of the later slots grounds are obeyed

# What a source tells after its start: what is expected, and whether a number is that.
_TOLD: dict[str, tuple[str, Callable[[float], bool]]] = {
    "rate": ("slots/s above 0", lambda value: value > 0),
    "scale": ("V per code, not 0", lambda value: value != 0),
    "offset": ("V at code 0", lambda value: True),
}

# Units that a time may be in by mistake.
_UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}


def check_source(
    source: SlotSource,
    seconds: float = 1.0,
    grounds: Sequence[int] | None = None,
    obeys: bool = True,
) -> list[str]:
    """Starts a source, reads for so many seconds, stops it, and lists what is wrong.

    **Arguments:** `grounds` to ask for, by default the first electrode and the last;
    `obeys`: False of a source that cannot switch grounds, such as a recording.
    **Returns:** a sentence for each broken promise of `SlotSource`; none of a right one.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> from tomojax.hardware.sources import check_source, ReplaySource
    >>> rig = tx.recordings.Rig.of(tx.Sensor.grid(4, 4, divisions=(16, 16)))
    >>> recording = tx.recordings.ArrayRecording(rig, np.zeros((50, 2, 16)), [0, 15])
    >>> check_source(ReplaySource(recording), obeys=False)
    []
    """
    trial = _Trial(source, seconds, grounds, obeys)
    # A call that does not come back is told, and left behind.
    thread = threading.Thread(target=trial.run, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(0.02)
        if time.perf_counter() > trial.due:
            trial.say(f"{trial.call} has not come back: {trial.mend}")
            break
    return list(trial.found.values())


class _Trial:
    """One run: what was found, and the call that is under way."""

    def __init__(self, source: Any, seconds: float, grounds: Any, obeys: bool):
        self.source, self.seconds, self.obeys = source, seconds, obeys
        self.grounds = grounds
        self.found: dict[str, str] = {}  # by what a sentence is about
        self.got: list[Got] = []
        self._enter("start()", _START, "it raises OSError where no rig answers")

    def say(self, text: str, about: str = "") -> None:
        """Adds a sentence; of several `about` the same the first."""
        self.found.setdefault(about or text, text)

    def _enter(self, call: str, seconds: float, mend: str) -> None:
        self.call, self.mend = call, mend
        self.due = time.perf_counter() + seconds

    def run(self) -> None:
        try:
            if self._before() and self._start():
                self._wrong_grounds()
                self._ask()
                self._read()
                self._look()
        except Exception as error:  # a source's mistakes are what is looked for
            self.say(f"{self.call} raised {type(error).__name__}: {error}")
        self._stop()

    def _before(self) -> bool:
        m = getattr(self.source, "electrodes", None)
        whole = isinstance(m, int | np.integer) and 1 <= m <= 256
        if not whole:
            self.say(f"electrodes is {m!r}, expected a whole number from 1 to 256")
        counted = isinstance(getattr(self.source, "counters", None), Counters)
        if not counted:
            self.say("counters is not a Counters; make one in __init__")
        return bool(whole) and counted

    def _start(self) -> bool:
        self.source.start()
        fine = True
        for name, (expected, right) in _TOLD.items():
            value: Any = getattr(self.source, name, None)
            if not (_is_finite(value) and right(value)):
                self.say(f"{name} is {value!r} after start(), expected {expected}")
                fine = False
        full = 32768 * abs(float(self.source.scale)) if fine else 0.0
        if full > _RANGE:
            text = f"scale is {self.source.scale:g} V per code, so that codes reach "
            self.say(f"{text}{full:g} V; codes are a converter's, not volts")
        return fine

    def _wrong_grounds(self) -> None:
        m = int(self.source.condition_count)
        for wrong in ([], [m], [-1]):
            self._enter(f"set_grounds({wrong})", 1.0, "it must not wait")
            try:
                self.source.set_grounds(wrong)
            except ValueError:
                continue
            self.say(f"set_grounds({wrong}) raised no ValueError; check_grounds does")

    def _ask(self) -> None:
        m = int(self.source.condition_count)
        asked = self.grounds if self.grounds is not None else sorted({0, m - 1})
        self.asked = [int(g) for g in asked]
        self._enter(f"set_grounds({self.asked})", 1.0, "it must not wait")
        self.source.set_grounds(self.asked)

    def _read(self) -> None:
        """Reads as the loop does, into two arrays in turn: neither may change later."""
        m = int(self.source.electrodes)
        room = np.zeros((2, m), np.int16)
        kept: np.ndarray | None = None
        end, turn, reads = time.perf_counter() + self.seconds, 0, 0
        untouched = np.ones(m, bool)
        while (began := time.perf_counter()) < end:
            codes, other = room[turn], room[1 - turn]
            codes[:] = _BEFORE
            # Now and then without waiting, as who has other work to do.
            reads += 1
            timeout = _TIMEOUT if reads % 10 else 0.0
            within = "it returns None where no slot comes within the timeout"
            self._enter(f"read(codes, {timeout:g})", timeout + 3.0, within)
            try:
                got = self.source.read(codes, timeout)
            except EOFError:
                break
            spent = time.perf_counter() - began
            if spent > timeout + _LATE:
                self.say(f"read(codes, {timeout:g}) took {spent:.2g} s: {within}", within)
            if kept is not None and (other != kept).any():
                self.say("an array was changed after read() returned; write into it once")
                kept = None
            if got is None:
                continue
            if not self._kind(got):
                return
            untouched &= codes == _BEFORE
            self.got.append(got)
            self._arrival(got)
            kept, turn = codes.copy(), 1 - turn
        if not self.got:
            self.say(f"no slot came in {self.seconds:g} s")
        elif untouched.any():
            some = "nothing" if untouched.all() else f"{m - untouched.sum()} of {m} codes"
            self.say(f"read() wrote {some} into the array given: codes[:] = …")

    def _kind(self, got: Any) -> bool:
        if not isinstance(got, Got):
            self.say(f"read() returned {type(got).__name__}, expected a Got or None")
            return False
        for name, value in got._asdict().items():
            seconds = name in ("time", "arrived")
            whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
            if not (_is_finite(value) if seconds else whole):
                expected = "seconds" if seconds else "a whole number"
                self.say(f"{name} of a Got is {value!r}, expected {expected}")
                return False
        return True

    def _arrival(self, got: Got) -> None:
        away = time.perf_counter() - got.arrived
        if not -1e-3 <= away <= self.seconds + _ARRIVED:
            text = f"arrived is {away:.3g} s before read() returned; take "
            text += "time.perf_counter() when the slot's last byte is here"
            self.say(text, "arrived")

    def _look(self) -> None:
        """Judges the slots together."""
        if not self.got:
            return
        self._enter("counters", 1.0, "they are numbers")
        judged = _numbers(self.got), _clock(self.got, float(self.source.rate))
        for text in filter(None, (*judged, self._grounds_of(self.got))):
            self.say(text)
        counted, given = self.source.counters, len(self.got)
        lost = sum(int(got.lost) for got in self.got)
        for name, seen in (("slots", given), ("lost", lost)):
            told = getattr(counted, name)
            if told < seen:
                self.say(f"counters.{name} is {told} after {seen}; add to it in read()")

    def _grounds_of(self, got: list[Got]) -> str:
        m = int(self.source.condition_count)
        out = sorted({int(g.ground) for g in got if not 0 <= g.ground < m})
        if out:
            text = f"ground is {out[:5]} in some slots, expected electrodes from 0 to "
            return f"{text}{m - 1}: what was grounded, whatever was asked for"
        if not self.obeys:
            return ""
        later = [int(g.ground) for g in got[len(got) // 2 :]]
        heeded = sum(ground in self.asked for ground in later) / len(later)
        each = set(self.asked) <= set(later) or len(later) < 2 * len(self.asked)
        if heeded >= _OBEYED and each:
            return ""
        seen = sorted(set(later))[:8]
        text = f"set_grounds({self.asked}) is not obeyed: later slots ground {seen}"
        return f"{text}; a source that cannot switch is checked with obeys=False"

    def _stop(self) -> None:
        for call in ("stop()", "a second stop()"):
            self._enter(call, 5.0, "it ends the work, and can be called twice")
            try:
                self.source.stop()
            except Exception as error:
                self.say(f"{call} raised {type(error).__name__}: {error}")


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and bool(np.isfinite(value))


def _numbers(got: list[Got]) -> str:
    """Whether numbers count up, lost slots too."""
    number = np.array([int(g.number) for g in got])
    lost = np.array([int(g.lost) for g in got])
    if (lost < 0).any():
        return f"lost is {lost.min()} in a slot, expected 0 or more"
    step = np.diff(number)
    wrong = np.flatnonzero(step != 1 + lost[1:])
    if not len(wrong):
        return ""
    k = int(wrong[0])
    text = f"number goes from {number[k]} to {number[k + 1]} where lost is {lost[k + 1]}"
    return f"{text}; it counts every slot since the start, lost ones too"


def _clock(got: list[Got], rate: float) -> str:
    """Whether times are seconds that rise by 1/`rate` a slot, from 0 on."""
    t = np.array([float(g.time) for g in got])
    slots = int(got[-1].number) - int(got[0].number)
    if (np.diff(t) <= 0).any():
        k = int(np.argmin(np.diff(t)))
        return f"time goes from {t[k]:g} to {t[k + 1]:g}, expected a clock that rises"
    if len(t) > 1 and slots > 0:
        passed = slots / rate
        factor = float(t[-1] - t[0]) / passed
        for unit, name in _UNITS.items():
            if abs(factor / unit - 1) < 0.5:
                return f"time is in {name}, expected seconds"
        if abs(factor - 1) > _CLOCK:
            text = f"time passes {t[-1] - t[0]:.4g} s over {slots} slots"
            return f"{text}, expected {passed:.4g} s at a rate of {rate:g} slots/s"
    if abs(t[0]) > _ARRIVED:
        return f"time begins at {t[0]:g} s, expected 0 at the first slot"
    return ""
