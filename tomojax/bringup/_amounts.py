"""Finds faults that have an amount: drive, sheet, gains, settling."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tomojax.bringup._fault import certainty, Fault
from tomojax.bringup.sheet._fit import Fits
from tomojax.bringup.sheet._plane import Plane
from tomojax.bringup.sheet._slots import WINDOW
from tomojax.bringup.sheet._values import old_part, sound, Values

# What a sound rig may have: of a gain; of a drive; of a sheet's resistance; of the slot
# before. And so many deviations of sound channels.
_GAIN, _DRIVE, _SHEET, _OLD, BEYOND = 0.01, 0.06, 0.3, 0.01, 6.0

# A drive lower than this part of the highest voltages is none.
_BELOW = 0.95

# What a second ground adds to the error of the drive, relative.
_SHARED = 0.05

# Contacts that leave so much of the voltages' span tell neither drive nor sheet.
_BAD = 0.03

# What is told of a resistance from less than this many deviations is not told.
_TOLD = 8.0


class Work(NamedTuple):
    """The data that amounts are judged from; all by electrode."""

    plane: Plane
    volts: Float[np.ndarray, "n M"]
    before: Float[np.ndarray, "n M"]  # the slot before, NaN where it is not known
    fits: Fits
    values: Values
    usable: Bool[np.ndarray, " M"]
    channel: np.ndarray  # that reads each electrode
    number: np.ndarray  # of the slots in the recording
    older: np.ndarray  # electrode grounded in the slot before, −1: not known
    drive: float  # as told, V
    always: int | None  # electrode that is grounded in every slot
    time: np.ndarray  # of slots, s
    left: float  # of the voltages' span


def spread(x: np.ndarray) -> float:
    return 1.4826 * float(np.median(np.abs(x - np.median(x)))) if len(x) else 0.0


def gain_faults(work: Work, named: Bool[np.ndarray, " M"]) -> list[Fault]:
    """Finds channels whose gain is off beside the others; skips `named` electrodes."""
    gain, some = work.values.value[:, 0], np.flatnonzero(work.usable & ~named)
    middle, usual = float(np.median(gain[some])), spread(gain[some])
    faults = []
    for e in some:
        off, own = gain[e] - middle, work.values.deviation[e, 0]
        least = max(_GAIN, BEYOND * np.hypot(usual, own))
        if abs(off) <= least:
            continue
        c = int(work.channel[e])
        faults.append(
            Fault(
                "gain",
                (c,),
                round(float(1 + off), 4),
                "of the others'",
                certainty(abs(off) / np.hypot(usual + _GAIN / 3, own)),
                f"channel {c} reads {100 * off:+.1f} % beside the others, ± "
                f"{100 * np.hypot(usual, own):.2f} %",
                f"divide channel {c} by {1 + off:.4f} (tomojax calibrate does), or mend "
                "its divider",
            )
        )
    return faults


def settling(work: Work) -> tuple[float, float]:
    """Computes the part of the slot before that all channels show, and 1 σ."""
    given = work.volts, work.before, work.fits, work.older, work.usable
    part, electrode = old_part(*given)
    told = np.isfinite(part)
    if told.sum() < 10:
        return 0.0, np.inf
    each = [np.median(part[told & (electrode == e)]) for e in np.unique(electrode[told])]
    middle = np.array(each) if len(each) >= 5 else part[told]
    error = max(spread(middle), 1e-3) / np.sqrt(len(middle))
    return float(np.median(middle)), error


def common_settling(common: float, error: float) -> list[Fault]:
    """Reports the part of the slot before that all channels show."""
    if not (common > _OLD and common > 5 * error):
        return []
    return [_lingers((), common, certainty(common / max(error, _OLD / 4)))]


def settling_faults(work: Work) -> list[Fault]:
    """Finds channels that show more of the slot before than all channels do.

    All slots together tell a gain, a place and an old slot apart.
    """
    value, error = work.values.value[:, 4], work.values.deviation[:, 4]
    some = np.flatnonzero(work.usable & (work.values.rows >= 10))
    usual = spread(value[some])
    faults = []
    for e in some:
        own = float(np.hypot(error[e], max(usual, 0.002)))
        if value[e] > max(2 * _OLD, BEYOND * own):
            part, c = float(value[e]), int(work.channel[e])
            faults.append(_lingers((c,), part, certainty(part / np.hypot(own, _OLD / 2))))
    return faults


def _lingers(channels: tuple[int, ...], part: float, sure: float) -> Fault:
    who = f"channel {channels[0]} shows" if channels else "all channels show"
    return Fault(
        "settling",
        channels,
        round(part, 4),
        "of the slot before",
        sure,
        f"{who} {100 * part:.1f} % of the slot before",
        "wait longer between switching the ground and converting: about "
        f"{max(np.log(max(part, 1e-3) / 1e-3), 1) / np.log(1 / min(part, 0.9)) + 1:.1f} "
        "times as long; or make the sources' resistance less"
        if part < 0.9
        else "convert after the ground is switched, not before",
    )


def drive_of(work: Work) -> tuple[float, float]:
    """Estimates the object's potential, V, and 1 σ: the contact's where no current flows.

    In a window the contact's own resistance r is constant. So V0 = φ + r·I, up to a part in
    proportion to I. Here φ is the sheet's potential at the contact.
    """
    fits, plane = work.fits, work.plane
    own = plane.green(plane.xy[fits.ground], fits.xy)
    y, current = fits.level - fits.current * own, fits.current
    if work.always is not None:
        other = plane.green(plane.xy[work.always], fits.xy)
        y = y + fits.second * (own - other)
    use = np.flatnonzero(sound(fits) & (fits.current > 0))
    window = work.number // WINDOW
    estimates, weights = [], []
    for w in np.unique(window[use]):
        some = use[window[use] == w]
        if len(some) < 4 or np.ptp(fits.xy[some], 0).max() > 0.5 * plane.pitch:
            continue
        i, v = current[some], y[some]
        # Slots with a ground near the contact are fitted worse: they count less.
        centred = i - i.mean()
        vary = float((centred**2).sum())
        if vary < (0.05 * i.mean()) ** 2 * len(some):
            continue
        slope = float(centred @ v / vary)
        left = v - v.mean() - slope * centred
        sigma2 = max(float(left @ left) / (len(some) - 2), (2e-3 * work.drive) ** 2)
        variance = sigma2 * (1 / len(some) + i.mean() ** 2 / vary)
        estimates.append(float(v.mean() - slope * i.mean()))
        weights.append(1 / (variance + (0.02 * work.drive) ** 2))
    if len(estimates) < 3:
        return np.nan, np.inf
    x, w = np.array(estimates), np.array(weights)
    order = np.argsort(x)
    middle = x[order][np.searchsorted(np.cumsum(w[order]), w.sum() / 2)]
    error = np.sqrt(1.57 / w.sum()) * max(
        1.0, float(np.sqrt(np.median((x - middle) ** 2 * w) / 0.45))
    )
    return float(middle), float(error)


def drive_faults(work: Work) -> tuple[list[Fault], float, float]:
    """Reports a drive other than the stated one; returns the drive and its 1 σ too, V."""
    found, error = drive_of(work)
    seen = np.quantile(work.volts[:, work.usable], 0.999)
    if not np.isfinite(found) or work.left > _BAD or found < _BELOW * seen:
        return [], np.nan, np.inf
    off = abs(found / work.drive - 1)
    sigma = np.hypot(error / work.drive, 0.01 + work.left)
    if work.always is not None:  # how two grounds share the current is known badly
        sigma = np.hypot(sigma, _SHARED)
    if off <= max(_DRIVE, 4 * sigma):
        return [], found, error
    fault = Fault(
        "drive",
        (),
        round(found, 3),
        "V",
        certainty(off / sigma),
        f"the object is at {found:.2f} V ± {error:.2f} V; {work.drive:g} V is told",
        f"set drive_voltage to {found:.2f} V, or look at the drive",
    )
    return [fault], found, error


def sheet_faults(
    work: Work, ground_resistance: float, sheet_resistance: float, hum: float
) -> tuple[list[Fault], float, float, str]:
    """Judges the sheet's resistance, by the voltage of its current on the ground path.

    Returns faults, the factor, its 1 σ, and a reason where the factor is unknown.
    """
    if not ground_resistance > 0:
        why = "the header's ground_resistance is 0: nothing measures the current"
        return [], np.nan, np.inf, why
    if work.always is not None:
        return [], np.nan, np.inf, "an electrode is grounded all the time: mend that first"
    if work.left > _BAD:
        return [], np.nan, np.inf, "contacts do not fit well enough"
    fits, n = work.fits, len(work.volts)
    row = np.arange(n)
    use = sound(fits) & work.usable[fits.ground] & (fits.current > 0)
    channel = work.channel[fits.ground]
    beside = np.array(work.volts[:, np.argsort(work.channel)])  # by channel again
    earlier = beside[row, np.maximum(channel - 1, 0)]
    older = work.before[row, fits.ground]
    use &= np.isfinite(older) | ~np.isfinite(work.before).any()
    drawn = fits.current - fits.second
    scale = max(float(np.median(drawn[use])), 1e-12) if use.any() else 1.0
    columns = [drawn / scale, earlier, np.nan_to_num(older), np.ones(n)]
    if hum:
        turn = 2 * np.pi * hum * work.time
        columns += [np.cos(turn), np.sin(turn)]
    x = np.stack(columns, 1)[use]
    mine = work.volts[row, fits.ground]
    y = mine[use]
    if len(y) < 30:
        return [], np.nan, np.inf, "too few slots"
    found, error = _line(x, y)
    slope, sigma = found[0] / scale, error[0] / scale
    # Volts at 1 Ω per square over amperes: the sheet, with its discs.
    if not slope > _TOLD * sigma:
        why = (
            f"the ground path's {ground_resistance:g} Ω leave "
            f"{1e6 * max(slope, 0) * scale:.0f} µV, and "
            f"{1e6 * sigma * scale:.0f} µV is 1 σ: a longer rub, or a "
            "sense resistor in the ground path, would tell"
        )
        return [], np.nan, np.inf, why
    shunt = work.plane.least_shunt
    even = np.sqrt(shunt)  # discs in good contact to none
    factor = ground_resistance / slope / sheet_resistance / even
    part = np.hypot(sigma / slope, (1 - shunt) / 4 + 0.03 + 5 * work.left)
    off = abs(np.log(factor))
    if off <= max(np.log1p(_SHEET), 4 * part):
        return [], factor, factor * part, ""
    fault = Fault(
        "sheet_resistance",
        (),
        round(float(factor), 3),
        "times what is told",
        certainty(off / part),
        f"the sheet has {factor * sheet_resistance:.3g} Ω per square ± {100 * part:.0f} % "
        f"if the ground path has its {ground_resistance:g} Ω; "
        f"{sheet_resistance:g} Ω are told",
        f"measure the ground path; if it is right set sheet_resistance to "
        f"{factor * sheet_resistance:.3g} Ω",
    )
    return [fault], factor, factor * part, ""


def _line(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fits Huber's regression; returns values and 1 σ."""
    w, found, inverse, scale = (
        np.ones(len(y)),
        np.zeros(x.shape[1]),
        np.eye(x.shape[1]),
        1.0,
    )
    size = np.sqrt((x**2).mean(0)) + 1e-12
    x = x / size
    for _ in range(20):
        inverse = np.linalg.inv((x * w[:, None]).T @ x + 1e-9 * len(y) * np.eye(x.shape[1]))
        found = inverse @ ((x * w[:, None]).T @ y)
        left = y - x @ found
        scale = max(1.4826 * float(np.median(np.abs(left))), 1e-9)
        w = 1 / np.maximum(1, np.abs(left) / (2 * scale))
    return found / size, scale * np.sqrt(np.diag(inverse)) / size
