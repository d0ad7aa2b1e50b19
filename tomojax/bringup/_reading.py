"""Holds a recording while its rig is judged: usable channels, their order, the fits."""

import numpy as np

from tomojax._require import require
from tomojax.bringup._amounts import Work
from tomojax.bringup._channels import Levels, unresponsive
from tomojax.bringup._fault import Fault
from tomojax.bringup._wiring import (
    floating,
    grounds_to_try,
    lines_of,
    Order,
    order_of,
    quality,
)
from tomojax.bringup.sheet._fit import fitted
from tomojax.bringup.sheet._plane import Plane
from tomojax.bringup.sheet._silence import silence_of
from tomojax.bringup.sheet._slots import chosen, Slots
from tomojax.bringup.sheet._values import before_of, values_of

# Touched slots that are needed.
_TOUCHED = 40

# What contacts leave of voltages where geometry is right, of their span; and of their own
# scatter where nothing is right.
_RIGHT, _WRONG = 0.01, 0.45

# A line that is always on makes fits better by this factor at least, on so many slots. No
# more channels than these are taken for one.
_ON, _TRIED, _LOW = 0.5, 150, 3


class Reading:
    """A rig's slots, and all that is known of the rig so far; stages change both in turn.

    `every`: all slots without zeros, by channel; `volts`, `asked`: the slots that are
    fitted; `number`: their numbers in the recording. `order`: the electrode of each
    channel, and the fits. `always`: a channel whose electrode is grounded in every slot.

    **Raises:** `ValueError` if nothing can be said of the rig.
    """

    order: Order

    def __init__(self, slots: Slots):
        self.slots, self.plane = slots, Plane(slots.rig)
        self.faults: list[Fault] = []
        self.unjudged: dict[str, str] = {}
        self.rng = np.random.default_rng(0)
        self.lingers, self.lingers_error = 0.0, np.inf
        m = self.plane.count
        require(
            int(slots.touched.sum()) >= _TOUCHED,
            "recording",
            f"{int(slots.touched.sum())} slots with a contact",
            f"{_TOUCHED} or more: nothing, then a rub, then two corners",
        )
        self.silent = silence_of(slots)
        self.number = chosen(slots, self.rng)
        raw = slots.volts[self.number].astype(float)
        levels = unresponsive(slots, raw, self.silent)
        if len(np.unique(slots.asked[self.number])) < 2 and levels.dead.sum() == 1:
            # The only ground is low all the time.
            only = int(np.flatnonzero(levels.dead)[0])
            self.unjudged[f"channel {only}"] = "one ground alone: record with --pattern all"
            levels.dead[only] = False
            levels = levels._replace(
                faults=[f for f in levels.faults if f.channels != (only,)]
            )
        self.dead, self.stuck = levels.dead, levels.stuck
        self.usable = ~(levels.dead | levels.stuck)
        require(
            self.usable.sum() > max(6, m // 3),
            "recording",
            f"{int(self.usable.sum())} of {m} channels that follow a touch",
            "more than a third of them: look at the converter and its cable first",
        )
        self.every = slots.volts - self.silent.zero.astype(np.float32)
        self.volts = raw - self.silent.zero
        self.asked = slots.asked[self.number]
        self._always_on(levels)
        self.fit()
        require(
            _unlike(self.order, self.volts, self.usable) < _WRONG,
            "recording",
            f"voltages that fit no contact on this sensor ({m} electrodes on "
            f"{1e3 * self.plane.size[0]:.0f} mm × {1e3 * self.plane.size[1]:.0f} mm)",
            "a recording of this sensor: is it another sensor's electrode_xy?",
        )

    def _always_on(self, levels: Levels) -> None:
        """Tells dead channels from an electrode that is grounded all the time."""
        self.always: int | None = None
        low = np.flatnonzero(levels.dead)
        faults = {f.channels[0]: f for f in levels.faults}
        if len(low) and len(low) <= _LOW:
            n = len(self.volts)
            some = self.rng.choice(n, min(n, _TRIED), replace=False)
            volts, asked = self.volts[some], self.inside(self.asked[some])
            for c in low:
                use = np.broadcast_to(self.usable.astype(float), volts.shape)
                single = quality(fitted(self.plane, volts, use, asked[:, None]))
                both = quality(fitted(self.plane, volts, use, asked[:, None], int(c)))
                if both < _ON * single:
                    self.always = int(c)
                    del faults[int(c)]
                    self.dead[c] = False
                    break
        self.faults += list(faults.values())

    def inside(self, asked: np.ndarray) -> np.ndarray:
        return np.where((asked >= 0) & (asked < self.plane.count), asked, 0)

    def fit(self) -> None:
        given = self.plane, self.volts, self.usable, self.asked, self.always
        self.order = order_of(*given, enough=_RIGHT)

    def again(self) -> None:
        """Fits once more, in the known order of channels."""
        order = self.order.electrode
        back = np.argsort(order)
        weight = np.broadcast_to(self.usable[back].astype(float), self.volts.shape)
        always = None if self.always is None else int(order[self.always])
        known = grounds_to_try(self.asked, order, self.usable)
        told = np.column_stack([known, self.order.fits.ground])
        fits = fitted(self.plane, self.volts[:, back], weight, told, always)
        self.order = self.order._replace(fits=fits)

    def _older(self, before: np.ndarray) -> np.ndarray:
        """Returns the electrode that was grounded in the slot before."""
        flat = floating(self.volts, self.usable, self.slots.drive)
        lines = lines_of(self.order.fits, self.asked, flat)
        known = np.full(max(int(self.slots.asked.max()) + 1, 1), -1)
        known[lines.asked] = np.maximum(lines.ground, -1)
        older = known[self.slots.asked[np.maximum(self.number - 1, 0)]]
        return np.where(np.isfinite(before).any(1), older, -1)

    def work(self) -> Work:
        back = np.argsort(self.order.electrode)
        fits, drive = self.order.fits, self.slots.drive
        volts = self.volts[:, back]
        before = before_of(volts, fits, self.number, self.slots.follows[self.number])
        values = values_of(self.plane, volts, before, fits, drive)
        return Work(
            self.plane,
            volts,
            before,
            fits,
            values,
            self.usable[back],
            back,
            self.number,
            self._older(before),
            drive,
            None if self.always is None else int(self.order.electrode[self.always]),
            self.slots.time[self.number],
            quality(fits),
        )


def _unlike(order: Order, volts: np.ndarray, usable: np.ndarray) -> float:
    """Computes the part of a median slot's scatter that contacts leave, rms: 1 is all."""
    back, fits = np.argsort(order.electrode), order.fits
    v, some = volts[:, back], (fits.far > 0) & usable[back]
    count = np.maximum(some.sum(1), 1)
    mean = (v * some).sum(1) / count
    left = (((v - fits.modelled) ** 2) * some).sum(1)
    whole = (((v - mean[:, None]) ** 2) * some).sum(1)
    return float(np.median(np.sqrt(left / np.maximum(whole, 1e-12))))
