"""Names what is wrong with a rig, by voltages that a sound rig cannot give."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer

from tomojax.bringup._channels import alike
from tomojax.bringup._wiring import floating, Lines, lines_of, order_of, quality
from tomojax.bringup.sheet._plane import Plane, starts
from tomojax.bringup.sheet._slots import nominal_noise
from tomojax.kernels.flags import Flag
from tomojax.kernels.levels import level_bits, TELLS
from tomojax.recordings import find_faults, Recording

# Stretches that are read, and slots of each at least; what is kept is bounded, however long
# the recording.
_STRETCHES = 48
_SLOTS = 32


class Some(NamedTuple):
    """Some slots; voltages are multiplied by the drive's sign."""

    volts: Float[np.ndarray, "n M"]  # V; 0 where not good
    good: Bool[np.ndarray, "n M"]
    asked: Integer[np.ndarray, " n"]  # the ground that was commanded
    drive: float  # V, as told
    noise: float  # V rms

    def take(self, which: np.ndarray) -> "Some":
        return self._replace(
            volts=self.volts[which], good=self.good[which], asked=self.asked[which]
        )

    @property
    def high(self) -> Float[np.ndarray, " n"]:
        return np.where(self.good, self.volts, -np.inf).max(1)

    @property
    def low(self) -> Float[np.ndarray, " n"]:
        return np.where(self.good, self.volts, np.inf).min(1)

    @property
    def at_ground(self) -> Float[np.ndarray, " n"]:
        """Returns voltages of grounded electrodes; −∞ where that channel is not good."""
        row = np.arange(len(self.asked))
        there = self.good[row, self.asked]
        return np.where(there, self.volts[row, self.asked], -np.inf)


def some_of(recording: Recording) -> Some:
    """Reads some slots, and keeps those with half of their channels good."""
    rig, m = recording.rig, recording.electrodes
    scans = -(-_SLOTS // recording.slots)
    starts = np.linspace(0, max(0, recording.scans - scans), _STRETCHES).astype(int)
    volts, good, asked = [], [], []
    for start in np.unique(starts):
        read = recording.read(int(start), min(int(start) + scans, recording.scans))
        # Against the drive or beyond it is what is looked for here: no limit but the rails.
        given = read.voltages, read.grounds, np.inf, rig.rails
        found = find_faults(*given, resolution=rig.resolution)
        volts.append(read.voltages.reshape(-1, m))
        good.append(found.good.reshape(-1, m))
        asked.append(read.grounds.ravel())
    v, sound, lines = np.concatenate(volts), np.concatenate(good), np.concatenate(asked)
    drive = abs(rig.drive_voltage)
    enough = 2 * sound.sum(1) >= m
    v = np.where(sound, v * np.sign(rig.drive_voltage), 0).astype(float)
    some = Some(v, sound, lines, drive, nominal_noise(rig))
    return some.take(np.flatnonzero(enough))


# A slot is touched where its voltages span this part of the drive.
_TOUCHED = 0.02

# A slot is quiet where its voltages span no more than this part of the drive.
_QUIET = 0.005

# Slots that are needed to say anything.
_FEW = 8

# Slots, at most, that contacts are fitted to.
_MOST = 150

# A level is an offset from these parts of the drive, and of a slot's highest voltage, on.
_OFFSET = 0.01
_LIFTED = 0.05

# A level of so much of the drive is no offset but a ground that is missing.
_FLOATING = 0.5

# Parts of the touched slots in which something holds that no chance explains.
_AGAINST = 0.5
_OFTEN = 0.1

# What lone contacts leave of a slot's span where the order of channels is right; more, and
# the contacts are others.
_FITS = 0.03

# The part of the lines, or channels, that a shift by one explains.
_SHIFTED = 0.6

# The part of the slots from which on a grounded channel is hardly read.
_SELDOM = 0.2


class Sign(NamedTuple):
    """A fault that a recording shows by itself.

    **Example:**

    >>> import tomojax as tx
    >>> sign = tx.bringup.signs.Sign("offset", "all codes are 1 V too high", 40)
    >>> sign.kind
    'offset'
    """

    kind: str
    text: str
    slots: int  # that were looked at


def find_signs(recording: Recording) -> list[Sign]:
    """Looks at some slots of a recording for signs of a fault.

    Kinds: "drive" (voltages against the drive), "offset" (of all codes), "ground" (lines
    ground other electrodes than is told, or none), "channels" (in another order), "alike"
    (two channels read the same in every slot). Fewer than eight touched slots show an
    offset at most.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> rng = np.random.default_rng(0)
    >>> places = rng.uniform(0.012, 0.068, (24, 2))
    >>> volts = [tx.voltages(sensor, tx.Disc(xy, 0.004, 1.0)) for xy in places]
    >>> volts = np.stack(volts) + 3e-4 * rng.normal(size=(24, 16, 16))
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> recording = tx.recordings.ArrayRecording(rig, volts, (np.arange(16) + 1) % 16)
    >>> [sign.kind for sign in tx.bringup.signs.find_signs(recording)]
    ['ground']
    """
    some = some_of(recording)
    signs: list[Sign] = []
    touched = some.high - some.low > _TOUCHED * some.drive
    for judge in (_against, _offset):
        some, more = judge(some, touched)
        signs += more
    some = some.take(np.flatnonzero(touched))
    signs += _alike(some)
    # What a wire ends at is judged on a rectangle with one ground a slot.
    if len(some.asked) < _FEW or recording.rig.version > 1:
        return signs
    return signs + _wired(some, Plane(recording.rig))


def _alike(some: Some) -> list[Sign]:
    """Finds channels that a short, or a multiplexer that hangs, makes the same."""
    pairs = alike(some.volts, some.good, some.drive, some.noise)
    if not pairs:
        return []
    told = ", ".join(f"{a} and {b}" for a, b in pairs[:4])
    text = f"channels {told} read the same in every slot: look for a short between them"
    return [Sign("alike", text, len(some.asked))]


def _against(some: Some, touched: Bool[np.ndarray, " n"]) -> tuple[Some, list[Sign]]:
    """Finds voltages against the drive, and turns them round for the next tests."""
    # With an offset alone voltages may be below 0 as well; but then the ground is lowest.
    span = some.high - some.low
    upside_down = some.at_ground - some.low > _AGAINST * span
    against = (-some.low > some.high) & upside_down & touched
    if touched.sum() < _FEW or against.sum() <= _AGAINST * touched.sum():
        return some, []
    sign = Sign(
        "drive",
        "voltages are against the drive: look at the signs of drive_voltage and scale",
        int(touched.sum()),
    )
    return some._replace(volts=-some.volts), [sign]


def _offset(some: Some, touched: Bool[np.ndarray, " n"]) -> tuple[Some, list[Sign]]:
    """Finds an offset of all codes, and takes the offset off for the next tests."""
    least = _OFFSET * some.drive + 10 * some.noise
    quiet = some.high - some.low < _QUIET * some.drive + 10 * some.noise
    level = 0.0
    count = int(quiet.sum())
    if count >= _FEW:
        level = float(np.median((some.high + some.low)[quiet]) / 2)
    if (count < _FEW or level > _FLOATING * some.drive) and touched.sum() >= _FEW:
        count = int(touched.sum())
        level = _floor(some.take(np.flatnonzero(touched)), least)
    if abs(level) <= least:
        return some, []
    sign = Sign(
        "offset",
        f"all codes are about {level:+.3g} V off: look at the attribute offset, or at the "
        "converter's zero",
        count,
    )
    return some._replace(volts=np.where(some.good, some.volts - level, 0)), [sign]


def _floor(some: Some, least: float) -> float:
    """Estimates the level that the lowest channels of touched slots share.

    A ground path lifts these channels in proportion to a slot's current. The current rises
    with the slot's highest voltage less the lowest. An offset lifts all these channels
    equally.
    """
    low, span = some.low, some.high - some.low
    floor = float(np.median(low))
    if floor < -least:
        return floor
    if floor <= _LIFTED * float(np.median(some.high)):
        return 0.0
    x = np.stack([np.ones_like(span), span], 1)
    weight = np.ones_like(span)
    found = np.zeros(2)
    for _ in range(10):
        found = np.linalg.lstsq(x * weight[:, None], low * weight, rcond=None)[0]
        left = np.abs(low - x @ found)
        weight = np.sqrt(1 / (1 + (left / max(np.median(left), 1e-9)) ** 2))
    return float(found[0]) if found[0] > max(least, floor / 2) else 0.0


def _wired(some: Some, plane: Plane) -> list[Sign]:
    """Judges grounds and channels, by the levels of every slot and by fits to some."""
    n = len(some.asked)
    bits = level_bits(some.low, some.high, some.at_ground, some.noise, np)
    wrong = (bits & Flag.GROUND_NOT_LOWEST.value > 0) & (some.high > TELLS * some.noise)
    chosen = some.take(np.unique(np.linspace(0, n - 1, min(n, _MOST)).astype(int)))
    usable = chosen.good.mean(0) > 0.5
    signs = []
    lower = [_ground(n, wrong, "another electrode is lower")]
    lower = lower if wrong.mean() > _OFTEN else []
    judged = _order(chosen, plane, usable)
    if judged is None:
        return lower
    electrode, lines = judged
    moved = np.flatnonzero((electrode != np.arange(plane.count)) & usable)
    # Channels that are grounded most of the time are seldom read.
    seldom = lines.ground[lines.slots > _SELDOM * len(chosen.asked)]
    if not np.isin(electrode[moved], seldom).all():
        signs.append(Sign("channels", _moved(electrode, moved, plane), len(chosen.asked)))
    off = (lines.ground != lines.asked) & (lines.ground >= -1)
    if off.any() and wrong.mean() > _OFTEN / 2:
        signs.append(_ground(n, wrong, _shift(lines.asked, lines.ground, plane.count)))
    return signs or lower


def _order(some: Some, plane: Plane, usable: np.ndarray) -> tuple[np.ndarray, Lines] | None:
    """Finds the electrode of each channel and what lines ground; None if nothing fits."""
    if usable.sum() < max(7, plane.count // 2):
        return None
    order = order_of(plane, some.volts, usable, some.asked, enough=_FITS / 3)
    if quality(order.fits) > _FITS:
        return None
    lines = lines_of(order.fits, some.asked, floating(some.volts, usable, some.drive))
    return order.electrode, lines


def _ground(n: int, wrong: np.ndarray, how: str) -> Sign:
    part = 100 * wrong.mean()
    return Sign(
        "ground",
        f"the electrode told as grounded is none in {part:.0f} % of touched slots: {how}",
        n,
    )


def _shift(asked: np.ndarray, ground: np.ndarray, count: int) -> str:
    for by in (1, -1):
        if ((asked + by) % count == ground).mean() > _SHIFTED:
            return f"the index is off by {by:+d}"
    off = asked != ground
    some = zip(asked[off][:4], ground[off][:4])
    return ", ".join(f"line {g} grounds {e if e >= 0 else 'none'}" for g, e in some)


def _moved(electrode: np.ndarray, moved: np.ndarray, plane: Plane) -> str:
    for name, order in starts(plane).items():
        if name != "as told" and (order == electrode).mean() > _SHIFTED:
            return f"channels are in another order: {name}"
    told = ", ".join(f"{c} reads electrode {electrode[c]}" for c in moved[:4])
    more = ", …" if len(moved) > 4 else ""
    return f"channels are in another order: {told}{more}"
