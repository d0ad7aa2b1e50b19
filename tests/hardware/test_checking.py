"""`check_source`: a right source passes, and each wrong one is told what is wrong."""

import threading
import time

import numpy as np
import pytest

from tomojax.hardware import Counters, Got, SlotSource
from tomojax.hardware.sources import check_grounds, check_source

M, RATE = 6, 1000.0


class Steady(SlotSource):
    """A right source: a slot each millisecond, every hundredth lost."""

    electrodes = M

    def __init__(self):
        self.counters = Counters()
        self.rate = self.scale = self.offset = float("nan")
        self.grounds, self.number, self.began = (0,), 0, 0.0

    def start(self):
        self.rate, self.scale, self.offset = RATE, 1e-4, 0.0
        self.number, self.began = 0, time.perf_counter()

    def read(self, codes, timeout=1.0):
        lost = int(self.number % 100 == 99)
        due = self.began + (self.number + lost) / self.rate
        left = due - time.perf_counter()
        time.sleep(max(0.0, min(left, timeout)))
        if left > timeout:
            return None
        self.number += lost
        codes[:] = np.arange(M)
        got = self.got(lost)
        self.number += 1
        self.counters.slots += 1
        self.counters.lost += lost
        return got

    def got(self, lost):
        ground = self.grounds[self.number % len(self.grounds)]
        when = self.number / self.rate
        return Got(ground, lost, self.number, when, time.perf_counter())

    def set_grounds(self, grounds):
        self.grounds = check_grounds(grounds, M)

    def stop(self):
        pass


def test_a_right_source_passes():
    assert check_source(Steady()) == []


class LostUncounted(Steady):
    def got(self, lost):
        return super().got(lost)._replace(number=self.number - self.counters.lost - lost)


class Microseconds(Steady):
    def got(self, lost):
        got = super().got(lost)
        return got._replace(time=1e6 * got.time)


class Deaf(Steady):
    def set_grounds(self, grounds):
        check_grounds(grounds, M)


class Credulous(Steady):
    def set_grounds(self, grounds):
        self.grounds = tuple(g for g in grounds if 0 <= g < M) or (0,)


class Waiting(Steady):
    def read(self, codes, timeout=1.0):
        threading.Event().wait(60)


class Silent(Steady):
    def read(self, codes, timeout=1.0):
        time.sleep(timeout)


class OwnArray(Steady):
    def read(self, codes, timeout=1.0):
        return super().read(np.zeros(M), timeout)


class Late(Steady):
    """Keeps the array and writes into it once more."""

    kept = None

    def read(self, codes, timeout=1.0):
        if self.kept is not None:
            self.kept[0] += 1
        self.kept = codes
        return super().read(codes, timeout)


class WallClock(Steady):
    def got(self, lost):
        return super().got(lost)._replace(arrived=time.time())


class LineNumbers(Steady):
    def got(self, lost):
        got = super().got(lost)
        return got._replace(ground=got.ground + M)


class Uncounted(Steady):
    def got(self, lost):
        self.counters.slots -= 1
        return super().got(lost)


class Tuples(Steady):
    def got(self, lost):
        return tuple(super().got(lost))


class Fractions(Steady):
    def got(self, lost):
        return super().got(lost)._replace(ground=0.5)


class Volts(Steady):
    def start(self):
        super().start()
        self.scale = 1.0


class NoRate(Steady):
    def start(self):
        pass


class Broken(Steady):
    def read(self, codes, timeout=1.0):
        raise RuntimeError("no such register")


class Once(Steady):
    stopped = False

    def stop(self):
        if self.stopped:
            raise OSError("closed already")
        self.stopped = True


@pytest.mark.parametrize(
    "wrong, told",
    [
        (LostUncounted, "number goes from 98 to 99 where lost is 1"),
        (Microseconds, "time is in microseconds, expected seconds"),
        (Deaf, "set_grounds([0, 5]) is not obeyed: later slots ground [0]"),
        (Credulous, "set_grounds([6]) raised no ValueError"),
        (Waiting, "read(codes, 0.1) has not come back"),
        (Silent, "no slot came in 0.4 s"),
        (OwnArray, "read() wrote nothing into the array given"),
        (Late, "an array was changed after read() returned"),
        (WallClock, "take time.perf_counter()"),
        (LineNumbers, "ground is [6, 11] in some slots, expected electrodes from 0 to 5"),
        (Uncounted, "counters.slots is"),
        (Tuples, "read() returned tuple, expected a Got or None"),
        (Fractions, "ground of a Got is 0.5, expected a whole number"),
        (Volts, "codes are a converter's, not volts"),
        (NoRate, "rate is nan after start()"),
        (Broken, "raised RuntimeError: no such register"),
        (Once, "a second stop() raised OSError"),
    ],
)
def test_each_mistake_is_told(wrong, told):
    said = check_source(wrong(), 0.4)
    assert any(told in text for text in said), said
    # One mistake is one sentence, but where the others follow from it.
    assert len(said) <= 3, said
