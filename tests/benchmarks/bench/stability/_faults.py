"""Faults between a scene and its reconstruction: noise, faults, wrong values.

Sweeps of `tomojax stability` use the lone contacts of a bench. A sweep spoils their
voltages, or tells the reconstruction something wrong.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bench.stability._scenes import Bench, Sweep, SweptScenes


def _spoilt(change: Callable[[Bench, np.ndarray, float], np.ndarray]):
    """Makes a sweep's `make` from a change of voltages (n, M, M)."""

    def make(bench: Bench, value: float) -> SweptScenes:
        volts, xy = bench.lone
        return SweptScenes(change(bench, volts.copy(), value), xy)

    return make


@_spoilt
def _white(bench: Bench, volts: np.ndarray, value: float) -> np.ndarray:
    return volts + value * bench.rng().normal(size=volts.shape)


@_spoilt
def _gain(bench: Bench, volts: np.ndarray, value: float) -> np.ndarray:
    return volts * (1 + value * bench.rng().normal(size=volts.shape[-1]))


@_spoilt
def _common(bench: Bench, volts: np.ndarray, value: float) -> np.ndarray:
    """Adds an offset that all channels of a slot share."""
    return volts + value * bench.rng().normal(size=(*volts.shape[:2], 1))


@_spoilt
def _impulses(bench: Bench, volts: np.ndarray, value: float) -> np.ndarray:
    rng = bench.rng()
    hit = rng.random(volts.shape) < value
    drive = float(bench.sensor.drive_voltage)
    return np.where(hit, rng.uniform(-drive, drive, volts.shape), volts)


def _channels(bench: Bench, value: float) -> np.ndarray:
    return bench.rng().permutation(len(bench.electrodes))[: int(value)]


@_spoilt
def _dead(bench: Bench, volts: np.ndarray, value: float) -> np.ndarray:
    """Sets channels to 0, and tells nobody."""
    volts[:, :, _channels(bench, value)] = 0
    return volts


@_spoilt
def _missing(bench: Bench, volts: np.ndarray, value: float) -> np.ndarray:
    """Sets channels to NaN: they are known to say nothing."""
    volts[:, :, _channels(bench, value)] = np.nan
    return volts


@_spoilt
def _swapped(bench: Bench, volts: np.ndarray, value: float) -> np.ndarray:
    """Moves each of so many channels to the next one's place, in a circle."""
    chosen = _channels(bench, value)
    volts[:, :, chosen] = volts[:, :, np.roll(chosen, 1)]
    return volts


@_spoilt
def _wrong_ground(bench: Bench, volts: np.ndarray, value: float) -> np.ndarray:
    """Grounds, instead of the first corner, the electrode so many numbers after it."""
    first = bench.corners[0]
    volts[:, first] = volts[:, (first + int(value)) % len(bench.electrodes)]
    return volts


@_spoilt
def _late(bench: Bench, volts: np.ndarray, value: float) -> np.ndarray:
    """Switches the ground when so many channels are read already."""
    first, second = bench.corners[:2]
    before = np.full(len(bench.electrodes), first)
    before[first] = second
    count = int(value)
    old = volts.copy()
    volts[:, :, :count] = old[:, before, :count]
    return volts


@_spoilt
def _saturated(bench: Bench, volts: np.ndarray, value: float) -> np.ndarray:
    """Ends the converter's range at so much, V."""
    return np.clip(volts, -value, value)


def _sheet(bench: Bench, value: float) -> SweptScenes:
    """Tells a sheet resistance so many times the true one."""
    told = bench.sensor.sheet_resistance * value
    return SweptScenes(*bench.lone, told=replace(bench.sensor, sheet_resistance=told))


def _ground_path(bench: Bench, value: float) -> SweptScenes:
    """Tells a ground path with so many Ω too much."""
    told = bench.sensor.ground_resistance + value
    return SweptScenes(*bench.lone, told=replace(bench.sensor, ground_resistance=told))


def _misplaced(bench: Bench, value: float) -> SweptScenes:
    """Tells electrodes' places so many mm from the true places, rms."""
    moved = bench.electrodes + 1e-3 * value * bench.rng().normal(
        size=bench.electrodes.shape
    )
    radius = 0.51 * float(np.asarray(bench.sensor.electrode_diameter))
    moved = np.clip(moved, radius, bench.size - radius).astype(bench.sensor.dtype)
    return SweptScenes(*bench.lone, told=replace(bench.sensor, electrode_xy=moved))


def _lam(bench: Bench, value: float) -> SweptScenes:
    return SweptScenes(*bench.lone, lam=value)


_COUNTS = (0, 1, 2, 4, 8, 16, 32)
_REGULAR = ("linear", "source")

# Ways in which what is measured, or told, is wrong.
SWEEPS = {
    "white": Sweep("white noise, V", (3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3), _white),
    "gain": Sweep("errors of gains, rms", (1e-3, 1e-2, 3e-2, 0.1, 0.2, 0.4), _gain),
    "common": Sweep("offsets of slots, V", (1e-3, 1e-2, 3e-2, 0.1, 0.3, 1), _common),
    "impulses": Sweep(
        "readings hit by impulses, part", (0, 1e-3, 3e-3, 1e-2, 3e-2, 0.1), _impulses
    ),
    "dead": Sweep("channels at 0, count", _COUNTS, _dead),
    "missing": Sweep("missing channels, count", (*_COUNTS, 48, 56, 60, 62, 64), _missing),
    "swapped": Sweep("swapped channels, count", (0, 2, 3, 4, 8, 16, 32), _swapped),
    "wrong_ground": Sweep("ground told off by, count", (0, 1, 2, 4, 16, 32), _wrong_ground),
    "late": Sweep("channels read too early, count", _COUNTS, _late),
    "saturated": Sweep("converter's range, V", (5, 3, 2, 1, 0.5, 0.2, 0.05), _saturated),
    "sheet_high": Sweep("told sheet too high, × true", (1, 1.1, 1.25, 1.5, 2, 5), _sheet),
    "sheet_low": Sweep("told sheet too low, × true", (1, 0.9, 0.75, 0.5, 0.2), _sheet),
    "ground_path": Sweep(
        "told ground path too high by, Ω", (0, 4, 20, 100, 500, 2000), _ground_path
    ),
    "misplaced": Sweep("electrodes off by, mm rms", (0, 0.2, 0.5, 1, 2), _misplaced),
    "lam_low": Sweep(
        "λ too small, × its own", (1, 1e-2, 1e-4, 1e-6, 1e-9, 1e-12, 1e-20), _lam,
        False, _REGULAR,
    ),
    "lam_high": Sweep(
        "λ too large, × its own", (1, 10, 1e2, 1e3, 1e4, 1e6, 1e12, 1e30), _lam,
        False, _REGULAR,
    ),
}  # fmt: skip
