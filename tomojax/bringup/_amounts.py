"""Finds faults that have an amount: gains, drive, sheet."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from tomojax.bringup._fault import certainty, Fault
from tomojax.bringup._reading import Work
from tomojax.bringup.sheet._fit import sound
from tomojax.bringup.sheet._slots import WINDOW
from tomojax.recordings import Rig

# A fault is beyond so many deviations of sound channels.
BEYOND = 6.0

# A sound rig may have so much of a gain, of a drive, and of a sheet's resistance.
_GAIN = 0.01
_LOOSE = 0.1  # a lower gain is a loose electrode rather than a divider
_DRIVE = 0.06
_SHEET = 0.3

# A drive lower than this part of the highest voltages is none.
_BELOW = 0.95

# What a second ground adds to the error of the drive, relative.
_SHARED = 0.05

# Contacts that leave so much of the voltages' span tell neither drive nor sheet.
_BAD = 0.03

# What is told of a resistance from less than this many deviations is not told.
_TOLD = 8.0


def spread(x: np.ndarray) -> float:
    return 1.4826 * float(np.median(np.abs(x - np.median(x)))) if len(x) else 0.0


def gain_faults(work: Work, named: Bool[np.ndarray, " M"]) -> list[Fault]:
    """Finds channels whose gain is off beside the others; skips `named` electrodes."""
    gain, some = work.values.value[:, 0], np.flatnonzero(work.usable & ~named)
    middle, usual = float(np.median(gain[some])), spread(gain[some])
    faults = []
    for e in some:
        off, own, c = gain[e] - middle, work.values.deviation[e, 0], int(work.channel[e])
        known = np.hypot(usual, own)
        if abs(off) <= max(_GAIN, BEYOND * known):
            continue
        sure = certainty(abs(off) / np.hypot(usual + _GAIN / 3, own))
        seen = f"{100 * off:+.1f} % beside the others, ± {100 * known:.2f} %"
        how = f"divide channel {c} by {1 + off:.4f} (tomojax calibrate does)"
        text, mend = f"channel {c} reads {seen}", f"{how}, or mend its divider"
        if off < -_LOOSE:
            text = f"{text}: its electrode may hardly touch the sheet"
            mend = f"press or glue the sheet on the electrode there; else {how}"
        value = round(float(1 + off), 4)
        faults.append(Fault("gain", (c,), value, "of the others'", sure, text, mend))
    return faults


def drive_of(work: Work) -> tuple[float, float]:
    """Estimates the object's potential, V, and 1 σ; NaN and ∞ where nothing tells.

    The potential is the contact's where no current flows.

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
    seen = np.quantile(work.volts[:, work.usable], 0.999)
    if work.left > _BAD or middle < _BELOW * seen:
        return np.nan, np.inf
    scatter = float(np.sqrt(np.median((x - middle) ** 2 * w) / 0.45))
    return float(middle), float(np.sqrt(1.57 / w.sum()) * max(1.0, scatter))


def drive_faults(work: Work, found: float, error: float) -> list[Fault]:
    """Reports a drive, V, with its 1 σ, other than the stated one."""
    off = abs(found / work.drive - 1)
    sigma = np.hypot(error / work.drive, 0.01 + work.left)
    if work.always is not None:  # how two grounds share the current is known badly
        sigma = np.hypot(sigma, _SHARED)
    if not off > max(_DRIVE, 4 * sigma):
        return []
    seen = f"the object is at {found:.2f} V ± {error:.2f} V"
    text = f"{seen}; {work.drive:g} V is told"
    mend = f"set drive_voltage to {found:.2f} V, or look at the drive"
    sure = certainty(off / sigma)
    return [Fault("drive", (), round(found, 3), "V", sure, text, mend)]


class SheetFactor(NamedTuple):
    """The sheet's resistance over the stated one, if the ground path is as stated."""

    factor: float = np.nan
    deviation: float = np.inf
    why: str = ""  # the factor is unknown


def sheet_factor(work: Work, rig: Rig, hum: float) -> SheetFactor:
    """Estimates the sheet's resistance, by the voltage of its current on the ground path.

    `hum`: its frequency, Hz; 0 where there is none.
    """
    if not rig.ground_resistance > 0:
        why = "the header's ground_resistance is 0: nothing measures the current"
        return SheetFactor(why=why)
    if work.always is not None:
        return SheetFactor(why="an electrode is grounded all the time: mend that first")
    if work.left > _BAD:
        return SheetFactor(why="contacts do not fit well enough")
    fits, row = work.fits, np.arange(len(work.volts))
    use = sound(fits) & work.usable[fits.ground] & (fits.current > 0)
    channel = work.channel[fits.ground]
    beside = work.volts[:, np.argsort(work.channel)]  # by channel again
    earlier = beside[row, np.maximum(channel - 1, 0)]
    older = work.before[row, fits.ground]
    use &= np.isfinite(older) | ~np.isfinite(work.before).any()
    drawn = fits.current - fits.second
    scale = max(float(np.median(drawn[use])), 1e-12) if use.any() else 1.0
    columns = [drawn / scale, earlier, np.nan_to_num(older), np.ones(len(row))]
    if hum:
        turn = 2 * np.pi * hum * work.time
        columns += [np.cos(turn), np.sin(turn)]
    y = work.volts[row, fits.ground][use]
    if len(y) < 30:
        return SheetFactor(why="too few slots")
    found, error = _line(np.stack(columns, 1)[use], y)
    slope, sigma = found[0] / scale, error[0] / scale
    # Volts at 1 Ω per square over amperes: the sheet, with its discs.
    if not slope > _TOLD * sigma:
        why = (
            f"the ground path's {rig.ground_resistance:g} Ω leave "
            f"{1e6 * max(slope, 0) * scale:.0f} µV, and {1e6 * sigma * scale:.0f} µV is "
            "1 σ: a longer rub, or a sense resistor in the ground path, would tell"
        )
        return SheetFactor(why=why)
    shunt = work.plane.least_shunt
    even = np.sqrt(shunt)  # discs in good contact to none
    factor = rig.ground_resistance / slope / rig.sheet_resistance / even
    part = np.hypot(sigma / slope, (1 - shunt) / 4 + 0.03 + 5 * work.left)
    return SheetFactor(factor, factor * part)


def sheet_faults(found: SheetFactor, rig: Rig) -> list[Fault]:
    """Reports a sheet's resistance other than the stated one."""
    off, part = abs(np.log(found.factor)), found.deviation / found.factor
    if found.why or off <= max(np.log1p(_SHEET), 4 * part):
        return []
    true = found.factor * rig.sheet_resistance
    text = (
        f"the sheet has {true:.3g} Ω per square ± {100 * part:.0f} % if the ground path "
        f"has its {rig.ground_resistance:g} Ω; {rig.sheet_resistance:g} Ω are told"
    )
    how = f"if it is right set sheet_resistance to {true:.3g} Ω"
    mend, sure = f"measure the ground path; {how}", certainty(off / part)
    value, unit = round(float(found.factor), 3), "times what is told"
    return [Fault("sheet_resistance", (), value, unit, sure, text, mend)]


def _line(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fits Huber's regression; returns values and 1 σ."""
    size = np.sqrt((x**2).mean(0)) + 1e-12
    x, w = x / size, np.ones(len(y))
    floor = 1e-9 * len(y) * np.eye(x.shape[1])
    found, inverse, scale = 0 * size, floor, 1.0
    for _ in range(20):
        weighed = (x * w[:, None]).T
        inverse = np.linalg.inv(weighed @ x + floor)
        found = inverse @ (weighed @ y)
        left = y - x @ found
        scale = max(1.4826 * float(np.median(np.abs(left))), 1e-9)
        w = 1 / np.maximum(1, np.abs(left) / (2 * scale))
    return found / size, scale * np.sqrt(np.diag(inverse)) / size
