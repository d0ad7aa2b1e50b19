"""The live loop: moves slots from a source into the step and the ring, and grounds back."""

import time
from collections.abc import Callable
from typing import Any, TYPE_CHECKING

import numpy as np

from tomojax._require import require
from tomojax.hardware.loop._ring import LONGEST, SlotRing
from tomojax.hardware.loop.in_c import loop_in_c
from tomojax.hardware.sources import SlotSource

if TYPE_CHECKING:
    import tomojax.step

_PATIENCE = 0.1  # s that nothing may come until the loop looks about
_IMAGE = 0.1  # s between images
_MEANWHILE = 0.2  # s between calls of `meanwhile`
_IN_C = 0.05  # s that C works on slots without looking about
_AGAIN = 20  # slots after which a ground that is not obeyed is asked for again

_SAID = "count", "xy", "conductance"  # of contacts
_NOTHING = {"latency": np.nan, "next": -1, "flags": 0, "count": 0}


def run(
    source: SlotSource,
    step: "tomojax.step.Step | None",
    ring: SlotRing,
    *,
    policy: str | None = None,
    budget: float | None = None,
    until: Callable[[], bool] = lambda: False,
    meanwhile: Callable[[], None] = lambda: None,
    images: bool = True,
) -> None:
    """Runs the loop until the source ends or `until` says so; `source` is started.

    The loop puts each slot into the `ring` before it reads the next slot. Without a `step`,
    the loop does nothing else. If a newer slot waits already, this one is older than the
    time of one slot, and answers usually take more than half that time, the loop skips the
    step for this slot ("skipped"). The step is later told the number of skipped slots, as
    lost. Quicker answers catch up by themselves, sooner than the loop fell behind.

    A step that runs as C gets the slots of a serial line or a UDP port from C too, as long
    as all is in order there; `until` is asked twenty times a second then.

    A slot is late if it is older than `budget` (s; by default the time of one slot). The
    step's cheaper method, if there is one, answers a late slot. `meanwhile` is called a few
    times a second, between slots. The loop also reads the ring's `trim` then, which
    corrects the voltages for drift. Without `images`, another process draws the ring's
    image.
    """
    m = source.electrodes
    require(ring.electrodes == m, "ring", f"{ring.electrodes} electrodes", f"{m}")
    if step is not None:
        here, there = ring.contacts, step.contact_count
        require(here == there, "ring", f"{here} contacts", f"{there}, as the step has")
        channels = step.electrode_count
        require(channels == m, "step", f"{channels} channels", f"{m}")
    loop = _Loop(source, step, ring, policy, budget)
    image_due, other_due = 0.0, 0.0
    try:
        while not until():
            now = time.perf_counter()
            if now > other_due:
                other_due = now + _MEANWHILE
                loop.count()
                meanwhile()
                loop.look_at_trim()
            if step is not None and images and loop.answered and now > image_due:
                image_due, loop.answered = now + _IMAGE, False
                _draw(ring, step, loop.state)
            if not loop.ordinary(now + _IN_C):
                loop.one_slot()
    except EOFError:
        pass
    finally:
        loop.end()


class _Loop:
    """A source's slots through a step into a ring: in C while all is in order."""

    def __init__(
        self,
        source: SlotSource,
        step: "tomojax.step.Step | None",
        ring: SlotRing,
        policy: str | None,
        budget: float | None,
    ):
        self._source, self._step, self._ring = source, step, ring
        m, self._period = source.electrodes, 1 / source.rate
        self._hurry = self._period if budget is None else budget
        self._codes, self._volts = np.zeros(m, np.int16), np.zeros(m, np.float32)
        self.state: Any = None
        if step is not None:
            self.state = step.state if policy is None else step.switch(step.state, policy)
        self.answered = False  # since the last image
        self._usual = 0.0  # s that an answer takes: follows the median
        # Slots that no step has seen, and those that newer ones overtook.
        self._missed = self._skipped = 0
        # The ground that was asked for, and slots that had another.
        self._asked, self._unheeded = -1, 0
        self.look_at_trim()
        self._in_c = loop_in_c(source, step, ring, self._period, self._hurry, _AGAIN)

    def count(self) -> None:
        self._ring.count(**self._source.counters.as_dict(), skipped=self._skipped)

    def look_at_trim(self) -> None:
        """Reads each channel's volts per code and volts at 0, corrected for drift."""
        factor, more = self._ring.trim
        scale, offset = np.float32(self._source.scale), np.float32(self._source.offset)
        self._scales, self._offsets = scale * factor, offset * factor + more

    def ordinary(self, until: float) -> bool:
        """Lets C work until then, s; returns whether all that came was ordinary."""
        quick, source = self._in_c, self._source
        if quick is None or not quick.take_over(source, self.state, **self._where()):
            return False
        before = source.counters.slots
        done = quick.run(source, until)
        self.answered |= source.counters.slots > before
        self._missed, self._skipped, self._asked, self._unheeded = quick.where
        self.state = quick.state
        if not done:
            quick.give_back(source)
        return done

    def _where(self) -> dict[str, int]:
        return {
            "missed": self._missed,
            "skipped": self._skipped,
            "asked": self._asked,
            "unheeded": self._unheeded,
        }

    def one_slot(self) -> None:
        """Reads a slot and answers it. **Raises:** `EOFError` where slots have ended."""
        source, step, codes, ring = self._source, self._step, self._codes, self._ring
        got = source.read(codes, _PATIENCE)
        if got is None:
            return
        waited = time.perf_counter() - got.arrived
        self._missed += got.lost
        slow = self._usual > self._period / 2
        if step is None or (slow and source.waiting and waited > self._period):
            ring.put(got, codes, _NOTHING)
            if step is not None:
                self._skipped += 1
                self._missed += 1
            return
        volts = self._volts
        np.multiply(codes, self._scales, out=volts)
        np.add(volts, self._offsets, out=volts)
        lost, late = min(self._missed, 1 << 30), waited > self._hurry
        self.state, out = step(self.state, volts, got.ground, lost, late)
        self._missed, self.answered = 0, True
        ground = int(out.ground)
        self._unheeded = 0 if got.ground == self._asked else self._unheeded + 1
        if ground != self._asked or self._unheeded >= _AGAIN:
            source.set_grounds((ground,))
            self._asked, self._unheeded = ground, 0
        latency = time.perf_counter() - got.arrived
        longer = latency - waited > self._usual
        self._usual += self._period / (32 if longer else -32)
        ring.head["latency"][min(int(1e6 * latency), LONGEST - 1)] += 1
        said = {name: getattr(out.contacts, name) for name in _SAID}
        said |= {"latency": latency, "next": ground, "flags": out.flags}
        ring.put(got, codes, said)

    def end(self) -> None:
        """Takes the wire back from C, and counts a last time."""
        if self._in_c is not None:
            self._in_c.give_back(self._source)
        self.count()


def _draw(ring: SlotRing, step: "tomojax.step.Step", state: Any) -> None:
    image = np.asarray(step.image(state))
    shown = ring.head["image"]
    shown[: image.shape[0], : image.shape[1]] = image[: shown.shape[0], : shown.shape[1]]
