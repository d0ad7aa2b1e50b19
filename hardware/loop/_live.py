"""The live loop: moves slots from a source into the step and the ring, and grounds back."""

import time
from collections.abc import Callable
from typing import Any, TYPE_CHECKING

import numpy as np

from tomojax._require import require
from tomojax.hardware.loop._ring import LONGEST, SlotRing
from tomojax.hardware.sources import SlotSource

if TYPE_CHECKING:
    import tomojax.step

_PATIENCE = 0.1  # s that nothing may come until the loop looks about
_IMAGE = 0.1  # s between images
_MEANWHILE = 0.2  # s between calls of `meanwhile`
_AGAIN = 20  # slots after which a ground that is not obeyed is asked for again

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
    the loop does nothing else. If newer slots wait already, the loop skips the step for
    this slot ("skipped"). The step is later told the number of skipped slots, as lost.

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
    codes, volts = np.zeros(m, np.int16), np.zeros(m, np.float32)
    scale, offset = np.float32(source.scale), np.float32(source.offset)
    scales, offsets = _trimmed(ring, scale, offset)
    hurry = 1 / source.rate if budget is None else budget
    state: Any = None
    if step is not None:
        require(
            step.electrode_count == m, "step", f"{step.electrode_count} channels", f"{m}"
        )
        state = step.state if policy is None else step.switch(step.state, policy)
    skipped = missed = unheeded = 0
    asked, image_due, other_due = -1, 0.0, 0.0
    latencies = ring.head["latency"]
    while not until():
        try:
            got = source.read(codes, _PATIENCE)
        except EOFError:
            break
        now = time.perf_counter()
        if now > other_due:
            other_due = now + _MEANWHILE
            ring.count(**source.counters.as_dict(), skipped=skipped)
            meanwhile()
            scales, offsets = _trimmed(ring, scale, offset)
        if got is None:
            continue
        missed += got.lost
        if step is None or (source.waiting and now - got.arrived > hurry):
            ring.put(got, codes, _NOTHING)
            if step is not None:
                skipped += 1
                missed += 1
            continue
        np.multiply(codes, scales, out=volts)
        np.add(volts, offsets, out=volts)
        late = now - got.arrived > hurry
        state, out = step(state, volts, got.ground, min(missed, 1 << 30), late)
        missed = 0
        ground = int(out.ground)
        unheeded = 0 if got.ground == asked else unheeded + 1
        if ground != asked or unheeded >= _AGAIN:
            source.set_grounds((ground,))
            asked, unheeded = ground, 0
        latency = time.perf_counter() - got.arrived
        latencies[min(int(1e6 * latency), LONGEST - 1)] += 1
        ring.put(got, codes, _said(out, latency, ground))
        if images and now > image_due:
            image_due = now + _IMAGE
            _draw(ring, step, state)
    ring.count(**source.counters.as_dict(), skipped=skipped)


def _trimmed(ring: SlotRing, scale: np.float32, offset: np.float32) -> tuple:
    """Returns each channel's volts per code and volts at 0, corrected for drift."""
    factor, more = ring.trim
    return scale * factor, offset * factor + more


def _said(out: Any, latency: float, ground: int) -> dict[str, Any]:
    contacts = out.contacts
    return {
        "latency": latency,
        "next": ground,
        "flags": out.flags,
        "count": contacts.count,
        "xy": contacts.xy,
        "conductance": contacts.conductance,
    }


def _draw(ring: SlotRing, step: "tomojax.step.Step", state: Any) -> None:
    image = np.asarray(step.image(state))
    shown = ring.head["image"]
    shown[: image.shape[0], : image.shape[1]] = image[: shown.shape[0], : shown.shape[1]]
