"""Finds out what is wrong with a new rig, from a recording of it."""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.signal import lfilter

from tomojax._require import require
from tomojax.bringup._amounts import (
    drive_faults,
    gain_faults,
    joint_faults,
    place_faults,
    common_settling,
    settling,
    settling_faults,
    sheet_faults,
    Work,
)
from tomojax.bringup._channels import hum_faults, noise_faults, unresponsive
from tomojax.bringup._corners import Corners, corners_of
from tomojax.bringup._fault import Checked, Fault
from tomojax.bringup._fit import fitted, Fits
from tomojax.bringup._naming import (
    best_image,
    channel_faults,
    line_faults,
    line_groups,
)
from tomojax.bringup._plane import Plane
from tomojax.bringup._silence import Silence, silence_of
from tomojax.bringup._slots import chosen, Slots, slots_of
from tomojax.bringup._values import before_of, values_of
from tomojax.bringup._wiring import (
    floating,
    grounds_to_try,
    Lines,
    lines_of,
    Order,
    order_of,
    quality,
    symmetries,
)
from tomojax.recordings import Recording

# Touched slots that are needed; the part of them that must be elsewhere than half of them,
# so many pitches away.
_TOUCHED, _ELSEWHERE, _APART = 40, 0.1, 1.0

# Grounds that gains and places need.
_GROUNDS = 2

# What contacts leave of voltages where geometry is right, of their span; and of their own
# scatter where nothing is right.
_RIGHT, _WRONG = 0.01, 0.45

# A settling that is so large is taken off before all else, if contacts fit so much better.
# Parts that are tried, on so many slots.
_TAKEN, _HALF, _BETTER = 0.008, 0.9, 0.97
_PARTS, _SOME = (0.01, 0.03, 0.07, 0.15, 0.25, 0.35, 0.42, 0.6, 0.75, 0.9), 60

# Beyond this part of the slot before the order of channels is looked at again.
_MUCH = 0.1

# A line that is always on makes fits better by this factor at least.
_ON = 0.5


def check(
    recording: Recording,
    corners: tuple[int, int] | Literal["auto"] | None = "auto",
    progress: Callable[[str], None] = lambda text: None,
) -> Checked:
    """Judges the rig that made a recording of nothing, of a rub and of two corners.

    The quiet stretch, the rub and the corner touches are found in the recording. The last
    two separate touches that hold still are corners: by default first that of electrode 0
    (x and y least), then that at the end of row 0 (x least, y most). `corners` names other
    electrodes, or None: there are no such touches, and a mirrored or turned array is not
    told. Parts that are missing are told in `unjudged`.

    **Raises:** `ValueError` where nothing can be said: no contact, one touch alone, or
    voltages that are of no such sensor.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> rng = np.random.default_rng(0)
    >>> places = rng.uniform(0.012, 0.068, (24, 2))
    >>> volts = [tx.voltages(sensor, tx.Disc(xy, 0.004, 1.0)) for xy in places]
    >>> volts = np.stack([np.zeros((16, 16))] * 24 + volts)  # nothing, then the rub
    >>> volts = volts + 3e-4 * rng.normal(size=volts.shape)
    >>> volts[:, :, [5, 6]] = volts[:, :, [6, 5]]  # two wires
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> recording = tx.recordings.ArrayRecording(rig, volts, np.arange(16))
    >>> found = tx.bringup.check(recording, corners=None)
    >>> [(fault.kind, fault.channels) for fault in found.faults]
    [('swapped', (5, 6))]
    """
    state = _State(slots_of(recording), progress)
    state.look(corners)
    return state.told(corners)


class _Seen(NamedTuple):
    """For the picture."""

    plane: Plane
    swing: np.ndarray
    shift: np.ndarray


class _State:
    """The stages one after the other: what is named is left out of the next."""

    def __init__(self, slots: Slots, progress: Callable[[str], None]):
        self.slots, self.progress = slots, progress
        self.plane = Plane(slots.rig)
        self.faults: list[Fault] = []
        self.unjudged: dict[str, str] = {}
        self.figures: dict[str, float] = {}
        self.rng = np.random.default_rng(0)

    def look(self, corners: Any) -> None:
        slots, m = self.slots, self.plane.count
        require(
            int(slots.touched.sum()) >= _TOUCHED,
            "recording",
            f"{int(slots.touched.sum())} slots with a contact",
            f"{_TOUCHED} or more: nothing, then a rub, then two corners",
        )
        self.progress("silence")
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
        self.progress("order of channels")
        self._fit()
        require(
            _unlike(self.order, self.volts, self.usable) < _WRONG,
            "recording",
            f"voltages that fit no contact on this sensor ({m} electrodes on "
            f"{1e3 * self.plane.size[0]:.0f} mm × {1e3 * self.plane.size[1]:.0f} mm)",
            "a recording of this sensor: is it another sensor's electrode_xy?",
        )
        self._settle()
        self._moved()
        self._lines()
        self._corners(corners)
        self.progress("what channels leave")
        self._amounts()

    def _always_on(self, levels) -> None:
        """A dead channel, or an electrode that is grounded all the time."""
        self.always: int | None = None
        low = np.flatnonzero(levels.dead)
        faults = {f.channels[0]: f for f in levels.faults}
        if len(low) and len(low) <= 3:
            n = len(self.volts)
            some = self.rng.choice(n, min(n, 150), replace=False)
            volts, asked = self.volts[some], self._inside(self.asked[some])
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

    def _inside(self, asked: np.ndarray) -> np.ndarray:
        return np.where((asked >= 0) & (asked < self.plane.count), asked, 0)

    def _fit(self) -> None:
        given = self.plane, self.volts, self.usable, self.asked, self.always
        self.order = order_of(*given, enough=_RIGHT)

    def _again(self) -> None:
        """Fits once more in the order that is known."""
        order = self.order.electrode
        back = np.argsort(order)
        weight = np.broadcast_to(self.usable[back].astype(float), self.volts.shape)
        always = None if self.always is None else int(order[self.always])
        known = grounds_to_try(self.asked, order, self.usable)
        told = np.column_stack([known, self.order.fits.ground])
        fits = fitted(self.plane, self.volts[:, back], weight, told, always)
        self.order = self.order._replace(fits=fits)

    def _older(self, before: np.ndarray) -> np.ndarray:
        """The electrode that was grounded in the slot before."""
        flat = floating(self.volts, self.usable, self.slots.drive)
        lines = lines_of(self.order.fits, self.asked, flat)
        known = np.full(max(int(self.slots.asked.max()) + 1, 1), -1)
        known[lines.asked] = np.maximum(lines.ground, -1)
        older = known[self.slots.asked[np.maximum(self.number - 1, 0)]]
        return np.where(np.isfinite(before).any(1), older, -1)

    def _work(self) -> Work:
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

    def _settle(self) -> None:
        """Takes off what all channels show of the slot before.

        It is a part of what the slot before was (then it is taken off slot after slot), or
        of what was read then: whichever leaves less.
        """
        self.lingers, self.lingers_error = 0.0, np.inf
        common, error = settling(self._work())
        self.lingers_error = error
        if not (np.isfinite(error) and _TAKEN < common < _HALF):
            return
        plain = self.volts, self.order, self.every
        some = np.sort(
            self.rng.choice(len(self.number), min(len(self.number), _SOME), False)
        )
        start = self._misfit(some, plain[2])
        tried = []
        for recursive in (False, True):
            for part in (common, *_PARTS):
                every = _unsettled(plain[2], self.slots, part, recursive)
                tried.append((self._misfit(some, every), part, recursive))
        least, total, recursive = min(tried)
        if least > _BETTER * start:
            return
        best = None
        for _ in range(3):
            self.every = _unsettled(plain[2], self.slots, total, recursive)
            self.volts = self.every[self.number].astype(float)
            self._again()
            left = self._misfit(some, self.every)
            if left > least * (1 + 1e-9):
                break
            more, error = settling(self._work())
            best, least = (self.volts, self.order, self.every, total, error), left
            total = float(np.clip(total + (1 - total) * more, 0.0, _HALF))
            if abs(more) < 1e-3:
                break
        if best is None:
            self.volts, self.order, self.every = plain
        else:
            self.volts, self.order, self.every, self.lingers, self.lingers_error = best

    def _misfit(self, some: np.ndarray, every: np.ndarray) -> float:
        """What contacts leave of some slots: a mean, in which single channels count."""
        back = np.argsort(self.order.electrode)
        volts = every[self.number[some]].astype(float)[:, back]
        weight = np.broadcast_to(self.usable[back].astype(float), volts.shape)
        told = grounds_to_try(self.asked[some], self.order.electrode, self.usable)
        always = None if self.always is None else int(self.order.electrode[self.always])
        fits = fitted(self.plane, volts, weight, told, always)
        part = np.abs(volts - fits.modelled) / np.maximum(fits.span, 1e-12)[:, None]
        return float(np.minimum(part, 0.05)[fits.far * weight > 0].mean())

    def _moved(self) -> None:
        """Once the old slot is taken off, orders are looked at again."""
        if self.lingers > _MUCH:
            self._fit()

    def _lines(self) -> None:
        flat = floating(self.volts, self.usable, self.slots.drive)
        self.lines: Lines = lines_of(self.order.fits, self.asked, flat)
        if self.always is not None:
            own = self.lines.asked == self.order.electrode[self.always]
            self.lines.ground[own] = self.lines.asked[own]
        unsure = self.lines.asked[self.lines.ground == -2]
        if len(unsure):
            self.unjudged["ground lines " + ", ".join(map(str, unsure))] = (
                "their slots do not agree: more slots of these lines with a contact"
            )
        m = self.plane.count
        never = np.setdiff1d(np.arange(m), self.lines.asked)
        if len(never):
            self.unjudged["ground lines not commanded"] = (
                f"{len(never)} of {m} were never commanded: record with --pattern all"
            )

    def _corners(self, corners: Any) -> None:
        fits = self.order.fits
        away = np.hypot(*(fits.xy - np.median(fits.xy, 0)).T) / self.plane.pitch
        require(
            (away > _APART).mean() > _ELSEWHERE,
            "recording",
            "one touch alone",
            "a rub over the sheet: touches in many places",
        )
        found = Corners(None, "corner touches: told that there are none")
        if corners is not None:
            found = corners_of(
                self.slots, self.every, self.plane, self.order.electrode, self.usable,
                self.always, corners,
            )  # fmt: skip
        electrode, ground = self.order.electrode, self.lines.ground
        unknown_which = False
        names = symmetries(self.plane)
        if found.image is None:
            self.unjudged["mirrored or turned array"] = found.why
            image, unknown_which = self._likeliest(electrode, ground)
        else:
            image = names[found.image]
        self.electrode = image[electrode]
        self.ground = np.where(ground >= 0, image[np.maximum(ground, 0)], ground)
        self._name(unknown_which)

    def _likeliest(self, electrode, ground) -> tuple[np.ndarray, bool]:
        """Which way round, where no corners tell: lines right, then channels."""
        names = symmetries(self.plane)
        told = ground >= 0
        asked = self._inside(self.lines.asked[told])
        m = self.plane.count

        def wrong(image):
            lines = (image[ground[told]] != asked).sum() if told.any() else 0
            return int(lines), int((image[electrode] != np.arange(m)).sum())

        plain = wrong(names["identity"])
        best = min(names.values(), key=wrong)
        better = wrong(best)
        # Lines that are off by some are no mirrored lines.
        if plain[0] <= 0.5 * max(told.sum(), 1) or better[0] > 0.4 * max(told.sum(), 1):
            return names["identity"], False
        return best, True

    def _name(self, unknown_which: bool) -> None:
        asked, ground, share = self.lines.asked, self.ground, self.lines.share
        told = ground >= 0
        plane, m = self.plane, self.plane.count
        name, _ = best_image(plane, self.electrode, np.arange(m))
        same = "identity"
        if told.any():
            same, _ = best_image(plane, ground[told], self._inside(asked[told]))
        whole = name != "identity" and name == same
        image = symmetries(plane)[name]
        # Groups that are exchanged in channels and in lines: wires of electrodes.
        back = np.argsort(image)
        lines = np.where(told, back[np.maximum(ground, 0)] if whole else ground, ground)
        groups = line_groups(asked, lines)
        sure = 0.999 if len(self.number) > 200 else 0.95
        channels = channel_faults(plane, self.electrode, whole, sure, unknown_which, groups)
        wires = [f.channels for f in channels if f.kind == "swapped"]
        self.faults += channels
        self.faults += line_faults(plane, asked, lines, share, wires, False)
        if self.always is not None:
            e = int(self.electrode[self.always])
            self.faults.append(
                Fault(
                    "ground_stuck",
                    (e,),
                    "on",
                    "",
                    0.99,
                    f"electrode {e} is grounded in every slot",
                    f"look at the switch of ground line {e}: it never opens",
                )
            )

    def _amounts(self) -> None:
        """Gains, places, tears, old slots: in turn, without what is named already."""
        slots, silent = self.slots, self.silent
        sane = self.usable
        self.faults += noise_faults(slots, silent, sane)
        self.faults += hum_faults(slots, silent, sane)
        if np.isnan(silent.noise).any():
            self.unjudged["zeros, noise and hum"] = (
                f"{silent.slots} contact-free slots: leave the sheet alone for some seconds"
            )
        elif not silent.seconds:
            self.unjudged["hum"] = "the contact-free stretch is too short"
        self.faults += common_settling(self.lingers, self.lingers_error)
        work, every = self._work(), self.usable
        few = len(np.unique(self.asked)) < _GROUNDS
        if few:
            self.unjudged["gains, places and tears"] = (
                f"fewer than {_GROUNDS} grounds: record with --pattern all"
            )
        gains: list[Fault] = []
        slow: list[Fault] = []
        places: list[Fault] = []
        now = every
        for _ in range(0 if few else 3):
            work = work._replace(usable=every[work.channel])
            slow = settling_faults(work)
            odd = np.zeros(self.plane.count, bool)
            odd[[f.channels[0] for f in slow]] = True
            places, named = place_faults(work, odd[work.channel])
            slow = [f for f in slow if not named[work.channel == f.channels[0]].any()]
            gains = gain_faults(work, named & ~_lone(places, work))
            odd[:] = False
            odd[[f.channels[0] for f in (*gains, *slow)]] = True
            odd[[f.channels[0] for f in places if f.kind == "misplaced"]] = True
            left = every & ~odd
            if (left == now).all() or left.sum() < self.plane.count // 2:
                break
            now = self.usable = left
            self._again()
            self.usable = every
            work = self._work()
        self.faults += [*gains, *slow, *places]
        if not np.isfinite(self.lingers_error):
            self.unjudged["settling"] = "no slots that follow each other with other grounds"
        drive, self.drive, error = drive_faults(work)
        self.faults += drive
        if not np.isfinite(self.drive):
            self.unjudged["drive"] = "no contact that holds still under several grounds"
        sheet, factor, sigma, why = sheet_faults(
            work,
            slots.rig.ground_resistance,
            slots.rig.sheet_resistance,
            silent.frequency,
        )
        self.faults += sheet
        if why:
            self.unjudged["sheet_resistance"] = why
        if not any(f.kind == "tear" for f in places):
            self.faults += joint_faults(work)
        self.work = work
        self.figures |= {
            "drive_V": self.drive,
            "drive_known_V": error,
            "sheet_factor": factor,
            "sheet_factor_known": sigma,
            "noise_V": float(np.median(silent.noise)),
            "residual_percent": 100 * quality(self.order.fits),
            "settling": self.lingers,
            "slots_quiet": float(silent.slots),
            "slots_touched": float(slots.touched.sum()),
        }

    def told(self, corners: Any) -> Checked:
        m = self.plane.count
        grounds = np.arange(m)
        inside = (self.lines.asked >= 0) & (self.lines.asked < m)
        judged = inside & (self.ground != -2)
        grounds[self.lines.asked[judged]] = self.ground[judged]
        swing = np.median(np.abs(self.volts), 0)[np.argsort(self.electrode)]
        shift = self.work.values.value[:, 2:4]
        figures = {k: v for k, v in self.figures.items() if np.isfinite(v)}
        return Checked(
            tuple(self.faults),
            self.unjudged,
            self.electrode,
            grounds,
            figures,
            self.order.fits.xy,
            _Seen(self.plane, swing, shift),
        )


def _unlike(order: Order, volts: np.ndarray, usable: np.ndarray) -> float:
    """What contacts leave of the voltages' scatter in the median slot, rms: 1 is nothing."""
    back, fits = np.argsort(order.electrode), order.fits
    v, some = volts[:, back], (fits.far > 0) & usable[back]
    count = np.maximum(some.sum(1), 1)
    mean = (v * some).sum(1) / count
    left = (((v - fits.modelled) ** 2) * some).sum(1)
    whole = (((v - mean[:, None]) ** 2) * some).sum(1)
    return float(np.median(np.sqrt(left / np.maximum(whole, 1e-12))))


def _lone(places: list[Fault], work: Work) -> np.ndarray:
    """Electrodes that are misplaced, each alone."""
    alone = [f.channels[0] for f in places if f.kind == "misplaced"]
    return np.isin(work.channel, alone)


def _unsettled(volts: np.ndarray, slots: Slots, part: float, recursive: bool) -> np.ndarray:
    """Slots without a part of the slot before: of what was there, or of what was read."""
    before = np.concatenate([volts[:1], volts[:-1]])
    if not recursive:
        follows = slots.follows[:, None]
        return np.where(follows, (volts - part * before) / (1 - part), volts)
    if part < 0.5:
        found = np.empty_like(volts)
        for a, b in slots.runs(slots.follows | np.roll(slots.follows, -1)):
            start = volts[a : a + 1] * part / (1 - part)
            given = [1 / (1 - part)], [1, part / (1 - part)], volts[a:b]
            found[a:b] = lfilter(*given, axis=0, zi=-start)[0]
        alone = ~(slots.follows | np.roll(slots.follows, -1))
        found[alone] = volts[alone]
        return found.astype(volts.dtype)
    # Beyond a half that is not stable forwards: backwards it is.
    found = np.copy(volts)
    after = volts[-1]
    for s in range(len(volts) - 1, 0, -1):
        after = (volts[s] - (1 - part) * after) / part if slots.follows[s] else volts[s - 1]
        found[s - 1] = after
    return found
