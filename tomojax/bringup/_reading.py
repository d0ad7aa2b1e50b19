"""Holds a recording while its rig is judged: usable channels, their order, the fits."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer

from tomojax._require import require
from tomojax.bringup._channels import unresponsive
from tomojax.bringup._fault import Fault
from tomojax.bringup._wiring import (
    fit_in_order,
    floating,
    grounds_to_try,
    Lines,
    lines_of,
    Order,
    order_of,
    quality,
)
from tomojax.bringup.sheet._fit import Fits, sound
from tomojax.bringup.sheet._plane import Plane
from tomojax.bringup.sheet._slots import chosen, silence_of, Slots
from tomojax.bringup.sheet._values import before_of, Values, values_of

# Touched slots that are needed.
_TOUCHED = 40

# Contacts leave so much of voltages where geometry is right, of their span.
_RIGHT = 0.01

# Contacts leave so much of voltages where nothing is right, of their own scatter.
_WRONG = 0.45

# A line that is always on makes fits better by this factor at least, on so many slots. No
# more channels than these are taken for one.
_ON = 0.5
_TRIED = 150
_LOW = 3

# Neighbours are nearer than so many times the nearest.
_NEXT = 1.3

# A path to ground is a switch that is closed below this part of the sheet's resistance.
CLOSED = 0.02

# Quartiles of a leak's resistance over slots are so near to each other, of their median: up
# to 0.5 where a leak has ten times the sheet's resistance. A tear or a slow channel: 1.5.
_ALIKE = 0.8

# A loose electrode's channel reads at most this part of what others tell of its place, and
# a multiple of that leaves at most so much of its scatter, rms. Swapped channels leave all.
_PART = 0.95
_FOLLOWS = 0.5


class Work(NamedTuple):
    """The data that amounts are judged from; all by electrode."""

    plane: Plane
    volts: Float[np.ndarray, "n M"]
    before: Float[np.ndarray, "n M"]  # the slot before, NaN where it is not known
    fits: Fits
    values: Values
    usable: Bool[np.ndarray, " M"]
    channel: Integer[np.ndarray, " M"]  # that reads each electrode
    number: Integer[np.ndarray, " n"]  # of the slots in the recording
    older: Integer[np.ndarray, " n"]  # electrode grounded in the slot before, −1: not known
    drive: float  # as told, V
    always: int | None  # electrode that is grounded in every slot
    time: Float[np.ndarray, " n"]  # of slots, s
    left: float  # of the voltages' span


class Reading:
    """A rig's slots, and all that is known of the rig so far; stages change both in turn.

    `every`: all slots without zeros, by channel; `volts`, `asked`: the slots that are
    fitted; `number`: their numbers in the recording. `order`: the electrode of each
    channel, and the fits. `loose`: channels that hardly follow their electrode. `always`: a
    channel whose electrode is grounded in every slot.

    **Raises:** `ValueError` if nothing can be said of the rig.
    """

    order: Order

    def __init__(self, slots: Slots):
        rig = slots.rig
        alone, table = rig.conditions is None, "a table of conditions"
        require(alone, "recording", table, "one ground a slot, which `check` needs")
        self.slots, self.plane = slots, Plane(rig)
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
        self.asked = slots.asked[self.number]
        raw = slots.volts[self.number].astype(float)
        faults = {f.channels[0]: f for f in unresponsive(slots, raw, self.silent)}
        dead = [c for c, fault in faults.items() if fault.kind == "dead"]
        if len(np.unique(self.asked)) < 2 and len(dead) == 1:
            # The only ground is low all the time.
            only = dead.pop()
            self.unjudged[f"channel {only}"] = "one ground alone: record with --pattern all"
            del faults[only]
        self.usable = ~np.isin(np.arange(m), list(faults))
        require(
            self.usable.sum() > max(6, m // 3),
            "recording",
            f"{int(self.usable.sum())} of {m} channels that follow a touch",
            "more than a third of them: look at the converter and its cable first",
        )
        self.every = slots.volts - self.silent.zero.astype(np.float32)
        self.volts = raw - self.silent.zero
        usable, touching = self.usable, self._touching()
        self.always = self._always_on(list(faults), touching)
        self.loose, self.usable = usable & ~touching, touching
        self.faults += [fault for c, fault in faults.items() if c != self.always]
        self.fit()
        require(
            _unlike(self.order, self.volts, self.usable) < _WRONG,
            "recording",
            f"voltages that fit no contact on this sensor ({m} electrodes on "
            f"{1e3 * self.plane.size[0]:.0f} mm × {1e3 * self.plane.size[1]:.0f} mm)",
            "a recording of this sensor: is it another sensor's electrode_xy?",
        )
        self.usable = usable

    def _always_on(self, silent: list[int], touching: Bool[np.ndarray, " M"]) -> int | None:
        """Finds the channel whose electrode drains current in every slot, if one does.

        That may be a channel that follows no touch, grounded all the time, or one that lies
        lower than its neighbours: a leak.
        """
        lowest = np.where(self.usable, self._dips(), -np.inf)
        low = [*silent[:_LOW], *np.argsort(-lowest, kind="stable")[:_LOW].tolist()]
        for c in low:
            rest = touching & (np.arange(self.plane.count) != c)
            (order, volts), without = self._some(rest, c), self._some(rest)[0].fits
            # Current through a resistance is in proportion to the voltage; a tear's is not.
            low, middle, high = np.quantile(paths_of(order, volts, c), [0.25, 0.5, 0.75])
            alike = high - low < max(_ALIKE * middle, CLOSED)
            if alike and quality(order.fits) < _ON * quality(without):
                return c
        return None

    def _some(
        self, usable: np.ndarray, always: int | None = None
    ) -> tuple[Order, Float[np.ndarray, "k M"]]:
        """Fits some slots in the order told; returns their voltages as well."""
        some = np.linspace(0, len(self.volts) - 1, min(len(self.volts), _TRIED)).astype(int)
        told, as_told = self.inside(self.asked[some])[:, None], np.arange(self.plane.count)
        volts = self.volts[some]
        fits = fit_in_order(self.plane, volts, as_told, usable, told, always)
        return Order(as_told, fits), volts

    def _touching(self) -> Bool[np.ndarray, " M"]:
        """Leaves out channels that read a part of what others tell of their electrode."""
        whole = _unlike(*self._some(self.usable), self.usable)
        dips = np.where(self.usable, self._dips(), -np.inf)
        most = self.plane.count // 4
        for k in 2 ** np.arange(int(np.log2(most)) + 1) - 1:
            # Those that lie half as low are of the same kind.
            rest = self.usable & (dips < max(np.sort(dips)[-1 - k] / 2, 1e-12))
            if self.usable.sum() - rest.sum() > most:
                continue
            order, volts = self._some(rest)
            loose = self.usable & ~rest & _read_in_part(order.fits, volts)
            if loose.any() and _unlike(order, volts, rest) < _ON * whole:
                return self.usable & ~loose
        return self.usable

    def _dips(self) -> Float[np.ndarray, " M"]:
        """Computes how far channels lie below their neighbours, of the slot's highest.

        A median over the slots that do not ground the channel.
        """
        table = self.plane.distance(self.plane.xy)
        near = ((table < _NEXT * np.sort(table, 1)[:, 1:2]) & (table > 0)) * self.usable
        mean = self.volts @ (near / np.maximum(near.sum(1), 1)[:, None]).T
        level = np.maximum(np.abs(self.volts).max(1, keepdims=True), 1e-12)
        dip = (mean - self.volts) / level
        dip[np.arange(len(dip)), self.inside(self.asked)] = np.nan
        return np.nanmedian(np.vstack([dip, np.where(np.isnan(dip).all(0), 0, np.nan)]), 0)

    def inside(self, asked: np.ndarray) -> np.ndarray:
        return np.where((asked >= 0) & (asked < self.plane.count), asked, 0)

    def fit(self) -> None:
        """Finds the order of channels, and fits contacts."""
        given = self.plane, self.volts, self.usable, self.asked, self.always
        self.order = order_of(*given, enough=_RIGHT)

    def again(self) -> None:
        """Fits once more, in the known order of channels."""
        known = grounds_to_try(self.asked, self.order.electrode, self.usable)
        told = np.column_stack([known, self.order.fits.ground])
        self.order = self.order._replace(fits=self.fits_of(self.volts, told))

    def fits_of(
        self,
        volts: Float[np.ndarray, "n M"],
        told: Integer[np.ndarray, "n k"] | None = None,
    ) -> Fits:
        """Fits contacts to voltages by channel, in the known order of channels."""
        given = self.plane, volts, self.order.electrode, self.usable
        return fit_in_order(*given, told, self.always)

    def lines(self) -> Lines:
        """Finds the electrode that each commanded line grounds."""
        flat = floating(self.volts, self.usable, self.slots.drive)
        return lines_of(self.order.fits, self.asked, flat)

    def _older(self, before: np.ndarray) -> np.ndarray:
        """Returns the electrode that was grounded in the slot before."""
        lines = self.lines()
        known = np.full(max(int(self.slots.asked.max()) + 1, 1), -1)
        known[lines.asked] = np.maximum(lines.ground, -1)
        older = known[self.slots.asked[np.maximum(self.number - 1, 0)]]
        return np.where(np.isfinite(before).any(1), older, -1)

    def work(self) -> Work:
        """Sorts all that is known by electrode, with the values that fits leave."""
        order, fits, drive = self.order.electrode, self.order.fits, self.slots.drive
        back = np.argsort(order)
        volts = self.volts[:, back]
        before = before_of(volts, fits, self.number, self.slots.follows[self.number])
        lines = self.lines()
        ground = lines.ground[np.searchsorted(lines.asked, self.asked)]
        return Work(
            plane=self.plane,
            volts=volts,
            before=before,
            fits=fits,
            values=values_of(self.plane, volts, before, fits, ground, drive),
            usable=self.usable[back],
            channel=back,
            number=self.number,
            older=self._older(before),
            drive=drive,
            always=None if self.always is None else int(order[self.always]),
            time=self.slots.time[self.number],
            left=quality(fits),
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


def paths_of(order: Order, volts: Float[np.ndarray, "n M"], channel: int) -> np.ndarray:
    """Computes the resistance of a channel's path to ground in sound slots, in squares."""
    fits = order.fits
    told = sound(fits) & (fits.ground != order.electrode[channel])
    second = fits.second[told]
    path = volts[told, channel] / np.where(second == 0, 1e-12, second)
    return path if len(path) else np.zeros(1)


def _read_in_part(fits: Fits, volts: np.ndarray) -> Bool[np.ndarray, " M"]:
    """Finds channels that read less than is modelled at their electrodes, in proportion."""
    told = (fits.far > 0) & sound(fits)[:, None]
    count = np.maximum(told.sum(0), 1)
    part = (told * fits.modelled * volts).sum(0)
    part = part / np.maximum((told * fits.modelled**2).sum(0), 1e-12)
    left = (told * (volts - part * fits.modelled) ** 2).sum(0)
    scatter = (told * (volts - (told * volts).sum(0) / count) ** 2).sum(0)
    return (part < _PART) & (left < _FOLLOWS**2 * scatter)
