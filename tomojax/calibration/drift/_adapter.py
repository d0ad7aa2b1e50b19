"""Follows zeros and gains that drift slowly, by what contacts and silence leave.

Zeros follow slots without a contact. Zeros do not depend on the ground, and a contact's
voltages do: so a light touch differs from a zero. Gains follow lone contacts that move. A
contact that is held still repeats the model's error at its place. So such a contact counts
once, and counts again only after contacts in other squares.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Integer

from tomojax.calibration._frames import points_of
from tomojax.calibration.drift._filter import Drift
from tomojax.calibration.drift._fitted import left_of
from tomojax.methods import Points
from tomojax.sensor import Calibration, nominal_noise, Sensor

# Drift, 1 σ of its rate an hour: of zeros, of the nominal noise (1 mV where that is
# 0.3 mV), and of a gain.
_ZERO = 3.3
_GAIN = 0.01

# A gain may run away from its own mean of the last hour by so many rates: contacts tell of
# it through the model. Silence tells of zeros themselves.
_FASTEST = 5.0

# By how much a value may differ from the calibration's in all.
_FARTHEST_ZERO = 100.0  # of the nominal noise
_FARTHEST_GAIN = 0.3

# What is known at first, 1 σ.
_TARED = 0.3  # of the noise: zeros from contact-free slots
_UNTARED = 1.1  # of the noise: nominal zeros
_KNOWN = 1e-3  # a gain

# An older calibration's values have walked for so many hours at most.
_OLDEST = 24.0

# Silence: no voltage above so many times the noise.
_QUIET = 5.0

# Silence: so many slots, so many of each of two grounds or more.
_SLOTS = 16
_EACH = 2

# The grounds' means in silence may differ by what noise makes, and a part of the noise.
_APART = 0.05

# A mean of many slots is no better than this part of the noise.
_FLOOR = 0.1

# Where most channels are off by more than so many σ the contact is none that a disc
# describes; silence may be off by as many σ of zeros.
_OUTLYING = 3.0

# Squares that have to be touched before one counts again.
_OTHERS = 8

# Slots of a fit.
_FITTED = 10

# Contacts that are fitted at once, at most.
_MOST = 32

# A fit takes up this part of what is looked for.
_TAKEN = 0.2

# Frames are observed in stretches of so long, s: zeros that wander 3 mV a minute, as a
# cheap amplifier's do, move by half a millivolt. Fewer frames wait for more, up to the
# longest: each call has its costs, and silence needs slots.
_STRETCH, _LONGEST = 2.0, 60.0
_FRAMES = 64


class Adapter:
    """Follows zeros and gains from a calibration on: see the module.

    Contacts do not show a common part of all gains, because their current is free. So the
    common part stays as it was calibrated.

    **Arguments:** `calibration` to begin with, nominal by default; its `age`, hours;
    `points`: the method made with that calibration, if the caller has one.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16), dtype=np.float32)
    >>> adapter = tx.calibration.Adapter(sensor)
    >>> silence = 1e-3 + 3e-4 * np.random.default_rng(0).normal(size=(40, 2, 16))
    >>> grounds, nobody = np.tile([0, 15], (40, 1)), np.full((40, 2), np.nan)
    >>> for minute in range(60):  # all zeros are 1 mV off
    ...     adapter.observe(60.0 * minute + np.arange(40) / 1e3, silence, grounds, nobody)
    >>> print(f"{1e3 * np.mean(adapter.calibration.offset):.1f} mV")
    1.0 mV
    """

    def __init__(
        self,
        sensor: Sensor,
        calibration: Calibration | None = None,
        *,
        age: float = 0.0,
        points: Points | None = None,
    ):
        self.begun = calibration or Calibration()
        m = sensor.electrode_count
        points = points or points_of(sensor, self.begun)
        self._points, self._pitch = points, float(sensor.mean_pitch)
        self._unit, self._noise = nominal_noise(sensor), float(points.noise)
        self._codes = float(sensor.resolution)
        self._offset = np.broadcast_to(np.asarray(self.begun.offset, float), m)
        self._gain = np.broadcast_to(np.asarray(self.begun.gain, float), m)
        self._zero_rate = _ZERO * self._unit
        tared = _TARED if np.size(self.begun.offset) == m else _UNTARED
        stated = (self.begun.deviation or {}).get("gain", _KNOWN)
        hours, each = float(np.clip(age, 0, _OLDEST)), np.ones(m)
        self.zeros = Drift.of(each * (tared * self._noise) ** 2, self._zero_rate, hours)
        self.gains = Drift.of(each * np.square(stated), _GAIN, hours)
        self.time = np.nan  # of the last frame that was observed, s
        self._recent = np.full((min(_OTHERS, m // 4), 2), -1)
        # Stretches of silence and contacts that were made use of; those that were not.
        self.counts = np.zeros(4, int)

    @property
    def calibration(self) -> Calibration:
        """Returns the present calibration."""
        offset, gain = self.offset, self.gain
        return replace(self.begun, offset=tuple(offset.tolist()), gain=tuple(gain.tolist()))

    @property
    def offset(self) -> Float[np.ndarray, " M"]:
        """Returns the present zeros, V."""
        return self._offset + self.zeros.value

    @property
    def gain(self) -> Float[np.ndarray, " M"]:
        """Returns the present gains."""
        return self._gain * np.exp(self.gains.value)

    @property
    def doubtful(self) -> Bool[np.ndarray, " M"]:
        """Finds doubtful channels: gain or zero is as far off as it may be."""
        far = np.abs(self.zeros.value) >= (1 - 1e-6) * _FARTHEST_ZERO * self._unit
        return far | (np.abs(self.gains.value) >= (1 - 1e-6) * _FARTHEST_GAIN)

    def voltages(self, readings: Float[np.ndarray, "*n M"]) -> Float[np.ndarray, "*n M"]:
        """Corrects readings for the present zeros and gains, in the readings' dtype."""
        offset, gain = (a.astype(readings.dtype) for a in (self.offset, self.gain))
        return (readings - offset) / gain

    def observe(
        self,
        t: Float[np.ndarray, " n"],
        readings: Float[np.ndarray, "n S M"],
        grounds: Integer[np.ndarray, "n S"],
        places: Float[np.ndarray, "n 2"],
        good: Bool[np.ndarray, "n S M"] | None = None,
    ) -> None:
        """Learns from frames that follow each other.

        **Arguments:** `t` of each frame, s; `readings` V, as read; `places` of a lone
        contact, m, NaN where there is no contact or more than one.
        """
        if not len(t):
            return
        good = np.isfinite(readings) if good is None else good
        passed = 0.0 if np.isnan(self.time) else float(t[-1]) - self.time
        hours = max(0.0, passed) / 3600
        self.time = float(t[-1])
        # Hour by hour, so that what is believed is bounded in a long pause too.
        while hours > 0:
            some, hours = min(hours, 1.0), hours - 1
            self.zeros = self._zero(self.zeros.later(some, self._zero_rate))
            self.gains = self._bounded(self.gains.later(some, _GAIN))
        wide = np.where(good, self.voltages(readings.astype(float)), np.nan)
        self._follow_zeros(wide, grounds)
        self._follow_gains(wide, grounds, places)

    def _follow_zeros(self, volts: np.ndarray, grounds: np.ndarray) -> None:
        known = np.isfinite(volts)
        most = float(np.sqrt(self.zeros.variance.max()))
        threshold = max(float(self._points.threshold), _QUIET * self._noise)
        with np.errstate(invalid="ignore"):
            loud = (np.abs(volts) > threshold + _OUTLYING * most) & known
        quiet = ~loud.any((1, 2)) & known.any((1, 2))
        m = volts.shape[-1]
        slots, under = volts[quiet].reshape(-1, m), grounds[quiet].ravel()
        whole = np.isfinite(slots).sum(1) * 2 > m
        slots, under = slots[whole], under[whole]
        if len(slots) < _SLOTS:
            return
        silent = silence(slots, under, self._noise, self._codes)
        self.counts[0 if silent else 2] += 1
        if not silent:
            return
        told = np.isfinite(slots).sum(0)
        count = np.maximum(told, 1)
        mean = np.nansum(slots, 0) / count
        variance = self._noise**2 * (_FLOOR**2 + 1 / count)
        variance = np.where(told >= _SLOTS, variance, np.inf)
        off = mean * self.gain
        self.zeros = self._zero(self.zeros.widened(off, variance).told(off, variance))

    def _follow_gains(
        self, volts: np.ndarray, grounds: np.ndarray, places: np.ndarray
    ) -> None:
        some = self._visits(places, volts.shape[1])
        if not len(some):
            return
        v, under = (_slots_of(a, some) for a in (volts, grounds))
        # A channel that is bad now and then is left out.
        used = np.isfinite(v).all(1).mean(0) > 0.9
        whole = np.isfinite(v[..., used]).all((1, 2))
        v, under = np.where(used, v, np.nan)[whole], under[whole]
        at = places[some[:, some.shape[1] // 2]][whole]
        if not used.any() or not len(v):
            return
        left = left_of(self._points, v.astype(np.float32), under, at)
        for off, variance, misfit in zip(left.relative, left.variance, left.misfit):
            told = np.isfinite(variance)
            fits = bool(np.isfinite(misfit)) and 2 * told.sum() > len(told)
            # What all have in common is the contact's current.
            off = np.where(told, off - off[told].mean() if fits else 0, 0)
            variance = variance + _TAKEN**2 * self.gains.variance
            off_by = off[told] ** 2 / (self.gains.variance + variance)[told]
            fits = fits and float(np.median(off_by)) < _OUTLYING**2
            self.counts[1 if fits else 3] += 1
            if not fits:
                continue
            old, new = self.gains, self._bounded(self.gains.told(off, variance))
            # All gains together stay: nothing tells of them.
            value, rate = new.value - old.value, new.rate - old.rate
            self.gains = new._replace(
                value=old.value + np.where(told, value - value[told].mean(), 0),
                rate=old.rate + np.where(told, rate - rate[told].mean(), 0),
            )

    def _zero(self, zeros: Drift) -> Drift:
        return zeros.bounded(self._zero_rate, _FARTHEST_ZERO * self._unit, np.inf)

    def _bounded(self, gains: Drift) -> Drift:
        return gains.bounded(_GAIN, _FARTHEST_GAIN, _FASTEST * _GAIN)

    def _visits(self, places: np.ndarray, slots: int) -> Integer[np.ndarray, "k f"]:
        """Picks middle frames of each visit of a square that counts, as many as a fit has.

        A contact that is held, or goes to and fro between a few squares, visits nothing.
        """
        alone = np.isfinite(places[:, 0]) & np.isfinite(places[:, 1])
        cells = np.floor(np.where(alone[:, None], places, 0) / self._pitch).astype(int)
        cells = np.where(alone[:, None], cells, -1)
        ends = np.flatnonzero((cells[1:] != cells[:-1]).any(1)) + 1
        need, found = max(1, -(-_FITTED // slots)), []
        for run in np.split(np.arange(len(cells)), ends):
            cell = cells[run[0]]
            if cell[0] < 0 or 2 * len(run) * slots < _FITTED:
                continue
            if (self._recent == cell).all(1).any() or len(found) >= _MOST:
                continue
            self._recent = np.concatenate([self._recent[1:], cell[None]])
            middle = max(0, (len(run) - need) // 2)
            found.append(np.resize(run[middle : middle + need], need))
        return np.array(found, int).reshape(-1, need)

    def state(self) -> dict[str, np.ndarray]:
        """Returns all that the adapter remembers, to be restored."""
        return {
            "adapted_zeros": np.stack(self.zeros),
            "adapted_gains": np.stack(self.gains),
            "adapted_time": np.array(self.time),
            "adapted_recent": self._recent,
            "adapted_counts": self.counts,
        }

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Restores a `state`, to go on from there."""
        self.zeros = Drift(*state["adapted_zeros"])
        self.gains = Drift(*state["adapted_gains"])
        self.time = float(state["adapted_time"])
        self._recent, self.counts = state["adapted_recent"], state["adapted_counts"].copy()


def stretches(t: Float[np.ndarray, " n"]) -> list[np.ndarray]:
    """Splits frames by their time, into stretches of some frames or a minute."""
    short, long = (np.floor(t / each) for each in (_STRETCH, _LONGEST))
    ends = [0]
    for end in np.flatnonzero(np.diff(short)) + 1:
        if end - ends[-1] >= _FRAMES or long[end] != long[end - 1]:
            ends.append(int(end))
    return np.split(np.arange(len(t)), ends[1:])


def lone_places(rows: Any) -> Float[np.ndarray, "n 2"]:
    """Returns places of contacts that are alone and compact, of `Rows`; else NaN."""
    alone = (rows.contact_count == 1) & ~np.isfinite(rows.contact_angle[:, 0])
    return np.where(alone[:, None], rows.contact_xy[:, 0].astype(float), np.nan)


def silence(
    slots: Float[np.ndarray, "n M"],
    grounds: Integer[np.ndarray, " n"],
    noise: float,
    codes: float = 0.0,
) -> bool:
    """Tells whether slots' means are independent of the ground; in a touch they are not."""
    steps = np.abs(np.diff(slots, axis=0))
    own = 1.4826 * float(np.nanmedian(steps)) / np.sqrt(2)
    own = float(np.clip(own, max(0.1 * noise, 0.3 * codes), 2 * noise))
    whole = np.nanmean(slots, 0)
    total, free, each = 0.0, 0, []
    for ground in np.unique(grounds):
        some = slots[grounds == ground]
        if len(some) < _EACH:
            continue
        apart = np.nanmean(some, 0) - whole
        told = np.isfinite(apart)
        total += len(some) * float((apart[told] ** 2).sum()) / own**2
        free += int(told.sum())
        each.append(len(some))
    if len(each) < 2:
        return False
    free = free * (len(each) - 1) / len(each)
    limit = 1 + 4 * np.sqrt(2 / free) + _APART**2 * float(np.mean(each))
    return bool(total / free < limit)


def _slots_of(frames: np.ndarray, some: np.ndarray) -> np.ndarray:
    """Picks as many slots as a fit has, spread evenly over some frames in a row."""
    found = frames[some].reshape(len(some), -1, *frames.shape[2:])
    spread = np.linspace(0, found.shape[1] - 1, min(_FITTED, found.shape[1]))
    return found[:, spread.round().astype(int)]
