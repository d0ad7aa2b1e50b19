"""Faults that have an amount: drive, sheet, gains, places, tears, slots that linger."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tomojax.bringup._fault import certainty, Fault
from tomojax.bringup._fit import Fits
from tomojax.bringup._plane import Plane
from tomojax.bringup._slots import WINDOW
from tomojax.bringup._values import old_part, Pairs, pairs_of, sound, Values

# What a sound rig may have: of a gain; of a place, in pitches; of a drive; of a sheet's
# resistance; of the slot before. And so many deviations of sound channels.
_GAIN, _PLACE, _DRIVE, _SHEET, _OLD, _BEYOND = 0.01, 0.12, 0.06, 0.3, 0.01, 6.0

# A pair of electrodes drops so many times an even sheet's voltage where it is torn.
_TORN = 1.35

# A joint between electrode and sheet, in squares of the sheet.
_JOINT = 0.5

# What a channel's own fault leaves of what was left is less than this part.
_EXPLAINED = 0.3

# A drive lower than this part of the highest voltages is none.
_BELOW = 0.95

# What a second ground adds to the error of the drive, relative.
_SHARED = 0.05

# Contacts that leave so much of the voltages' span tell neither drive nor sheet.
_BAD = 0.03

# What is told of a resistance from less than this many deviations is not told.
_TOLD = 8.0


class Work(NamedTuple):
    """What the amounts are judged from; all by electrode."""

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
    """Channels whose gain is off, beside the others; but electrodes that are `named`."""
    gain, some = work.values.value[:, 0], np.flatnonzero(work.usable & ~named)
    middle, usual = float(np.median(gain[some])), spread(gain[some])
    faults = []
    for e in some:
        off, own = gain[e] - middle, work.values.deviation[e, 0]
        least = max(_GAIN, _BEYOND * np.hypot(usual, own))
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
    """The part of the slot before that all channels show, and 1 σ."""
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
    """The part of the slot before that all channels show."""
    if not (common > _OLD and common > 5 * error):
        return []
    return [_lingers((), common, certainty(common / max(error, _OLD / 4)))]


def settling_faults(work: Work) -> list[Fault]:
    """Channels that show the slot before, beside what all channels do.

    A gain, a place and an old slot are told apart by all slots together.
    """
    value, error = work.values.value[:, 4], work.values.deviation[:, 4]
    some = np.flatnonzero(work.usable & (work.values.rows >= 10))
    usual = spread(value[some])
    faults = []
    for e in some:
        own = float(np.hypot(error[e], max(usual, 0.002)))
        if value[e] > max(2 * _OLD, _BEYOND * own):
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
    """The object's potential, V, and 1 σ: what the contact has once no current flows.

    In a window the contact's own resistance r is one: V0 = φ + r·I with the potential φ
    that the sheet has at the contact, but for a part in I.
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
    """The drive, where it is another than told."""
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
    """The sheet's resistance, by the voltage that its current leaves on the ground path.

    Returns faults, the factor, its 1 σ, and why it is not told where it is not.
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
            f"{1e6 * max(slope, 0) * scale:.0f} µV, and {1e6 * sigma * scale:.0f} µV is 1 σ: "
            "a longer rub, or a sense resistor in the ground path, would tell"
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
        f"if the ground path has its {ground_resistance:g} Ω; {sheet_resistance:g} Ω are told",
        f"measure the ground path; if it is right set sheet_resistance to "
        f"{factor * sheet_resistance:.3g} Ω",
    )
    return [fault], factor, factor * part, ""


def _line(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Huber's regression, and 1 σ."""
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


def place_faults(
    work: Work, slow: Bool[np.ndarray, " M"]
) -> tuple[list[Fault], Bool[np.ndarray, " M"]]:
    """Misplaced electrodes and tears; and the electrodes that are named.

    `slow`: electrodes whose channels linger, which is no place.
    """
    plane, usable = work.plane, work.usable
    pairs = pairs_of(plane, work.volts, work.fits, usable)
    log = np.log(np.maximum(pairs.ratio, 0.05))
    middle, usual = float(np.median(log)), spread(log)
    over = log - middle
    torn = over > max(np.log(_TORN), _BEYOND * usual)
    # What a channel's own gain or old slots explain is no tear.
    alone = slow & (work.values.unexplained < _EXPLAINED)
    torn &= ~(alone[pairs.first] | alone[pairs.second])
    shift = work.values.value[:, 2:4] / plane.pitch
    error = work.values.deviation[:, 2:4] / plane.pitch
    far = np.hypot(*shift.T)
    typical = 1.2 * float(np.median(far[usable])) if usable.any() else 0.0
    own = np.hypot(*error.T)
    moved = usable & (far > np.maximum(_PLACE, _BEYOND * np.hypot(own, typical)))
    # In a corner the potential is level: a place that is badly known moves far.
    effect = _effect(work)
    moved &= ~slow
    moved &= effect > _BEYOND * max(float(np.median(effect[usable])), 1e-4)
    named = np.zeros(plane.count, bool)
    faults: list[Fault] = []
    lone = moved.copy()
    for a, b in zip(pairs.first[torn], pairs.second[torn]):
        # One electrode off makes its pairs unlike; a tear moves both sides apart.
        if moved[a] != moved[b] and _explained(pairs, over, a if moved[a] else b):
            continue
        if _own_place(work, moved, a) or _own_place(work, moved, b):
            continue
        lone[[a, b]] = False
        named[[a, b]] = True
    if named.any():
        lone[_beside(plane, named)] = False
        faults.append(_tear(work, pairs, over, torn & named[pairs.first], usual))
        named |= moved & ~lone
    for e in np.flatnonzero(lone):
        named[e] = True
        by = 1e3 * plane.pitch * shift[e]
        c = int(work.channel[e])
        faults.append(
            Fault(
                "misplaced",
                (c,),
                {"x_mm": round(float(by[0]), 2), "y_mm": round(float(by[1]), 2)},
                "mm",
                certainty(far[e] / np.hypot(own[e], typical + 0.02)),
                f"the electrode of channel {c} lies {np.hypot(*by):.1f} mm from its place: "
                f"{by[0]:+.1f} mm along x, {by[1]:+.1f} mm along y",
                "put it back, or correct electrode_xy (tomojax calibrate finds all places)",
            )
        )
    return faults, named


def _effect(work: Work) -> Float[np.ndarray, " M"]:
    """How much of the voltages' span the shift of each electrode explains, rms."""
    fits, plane = work.fits, work.plane
    slope = fits.current[:, None] * (
        plane.slopes(fits.xy) - plane.slopes(plane.xy)[:, fits.ground]
    )
    some = sound(fits)[:, None] * fits.far
    shift = work.values.value[:, 2:4]
    moved = (slope * shift.T[:, None]).sum(0) / np.maximum(fits.span, 1e-12)[:, None]
    count = np.maximum(some.sum(0), 1)
    # The median is not moved by slots next to the electrode.
    shown = np.where(some > 0, np.abs(moved), np.nan)
    with np.errstate(all="ignore"):
        middle = np.nanquantile(np.where(count > 1, shown, 0.0), 0.8, axis=0)
    return np.nan_to_num(middle)


def _own_place(work: Work, moved: np.ndarray, e: Any) -> bool:
    """Whether another place of one electrode explains nearly all that it leaves."""
    return bool(moved[e] and work.values.unexplained[e] < 0.6 * _EXPLAINED)


def _explained(pairs: Pairs, over: np.ndarray, e: Any) -> bool:
    """Whether some pairs of an electrode are as much nearer as others are farther."""
    own = over[(pairs.first == e) | (pairs.second == e)]
    return len(own) > 1 and own.min() < -0.4 * own.max()


def _beside(plane: Plane, named: np.ndarray) -> np.ndarray:
    apart = np.hypot(*(plane.xy[:, None] - plane.xy[named]).transpose(2, 0, 1))
    return np.flatnonzero((apart < 2.1 * plane.pitch).any(1))


def _tear(work: Work, pairs, over: np.ndarray, torn: np.ndarray, usual: float) -> Fault:
    plane = work.plane
    middle = (plane.xy[pairs.first[torn]] + plane.xy[pairs.second[torn]]) / 2
    weight = over[torn]
    centre = weight @ middle / weight.sum()
    channels = np.unique(work.channel[np.r_[pairs.first[torn], pairs.second[torn]]])
    ends = (
        1e3
        * middle[[np.argmin(middle @ _along(middle)), np.argmax(middle @ _along(middle))]]
    )
    x, y = 1e3 * centre
    reach = (
        f"from ({ends[0][0]:.0f}, {ends[0][1]:.0f}) to ({ends[1][0]:.0f}, {ends[1][1]:.0f}) mm"
        if len(middle) > 1
        else f"at ({x:.0f}, {y:.0f}) mm"
    )
    most = float(np.exp(over[torn].max()))
    return Fault(
        "tear",
        tuple(int(c) for c in channels),
        {"x_mm": round(float(x), 1), "y_mm": round(float(y), 1), "times": round(most, 2)},
        "mm",
        certainty(float(over[torn].max()) / max(usual + np.log(_TORN) / 4, 1e-6)),
        f"a tear or a bad joint in the sheet {reach}: up to {most:.1f} times an even sheet's "
        "drop between electrodes",
        "look at the sheet there; glue or replace it",
    )


def _along(points: np.ndarray) -> np.ndarray:
    if len(points) < 2:
        return np.array([1.0, 0.0])
    return np.linalg.svd(points - points.mean(0), full_matrices=False)[2][0]


def joint_faults(work: Work) -> list[Fault]:
    """Electrodes with a resistance between them and the sheet, as their grounds tell."""
    fits, plane = work.fits, work.plane
    row = np.arange(len(work.volts))
    sink = plane.green(plane.xy[fits.ground], fits.xy)
    inside = fits.level + fits.current * (sink - np.diag(plane.between)[fits.ground])
    mine = np.where(work.usable[fits.ground], work.volts[row, fits.ground], 0.0)
    squares = (inside - mine) / np.maximum(fits.current, 1e-12)
    use = sound(fits) & (fits.current > 0)
    found = {
        int(e): float(np.median(squares[use & (fits.ground == e)]))
        for e in np.unique(fits.ground[use])
        if (use & (fits.ground == e)).sum() >= 4
    }
    x = np.array(list(found.values()))
    if len(x) < 3:
        return []
    middle, usual = float(np.median(x)), spread(x)
    faults = []
    for e, value in found.items():
        more = value - middle
        if more <= max(_JOINT, 2 * _BEYOND * usual):
            continue
        c = int(work.channel[e])
        place = 1e3 * plane.xy[e]
        faults.append(
            Fault(
                "tear",
                (c,),
                {
                    "x_mm": float(place[0]),
                    "y_mm": float(place[1]),
                    "squares": round(more, 2),
                },
                "squares of the sheet",
                certainty(more / (usual + _JOINT / 4)),
                f"a bad joint between the electrode of channel {c} and the sheet: "
                f"{more:.1f} squares of the sheet's resistance",
                "clean or glue the joint there",
            )
        )
    return faults
