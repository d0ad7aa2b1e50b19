"""Finds tears and bad joints of the sheet, and electrodes that lie elsewhere."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tomojax.bringup._amounts import BEYOND, spread, Work
from tomojax.bringup._fault import certainty, Fault
from tomojax.bringup.sheet._plane import Plane
from tomojax.bringup.sheet._values import Pairs, pairs_of, sound

# A place is off by so much of the pitch at least.
_PLACE = 0.12

# A pair of electrodes drops so many times an even sheet's voltage where it is torn. Pairs
# that agree are beyond that by so much of a logarithm.
_TORN, _AGREED = 1.35, 0.05

# A joint between electrode and sheet, in squares of the sheet.
_JOINT = 0.5

# What a channel's own fault leaves of what was left is less than this part.
_EXPLAINED = 0.3


def place_faults(
    work: Work, slow: Bool[np.ndarray, " M"]
) -> tuple[list[Fault], Bool[np.ndarray, " M"]]:
    """Finds misplaced electrodes and tears; returns the electrodes that are named, too.

    `slow`: electrodes whose channels linger, which is no sign of another place.
    """
    plane, usable = work.plane, work.usable
    pairs = pairs_of(plane, work.volts, work.fits, usable)
    log = np.log(np.maximum(pairs.ratio, 0.05))
    middle, usual = float(np.median(log)), spread(log)
    over = log - middle
    # A tear makes all pairs of a small array spread: several that agree need less.
    high = max(np.log(_TORN), BEYOND * usual)
    several = over > max(np.log(_TORN), min(BEYOND * usual, np.log(_TORN) + _AGREED))
    torn = several if several.sum() > 1 else over > high
    # What a channel's own gain or old slots explain is no tear.
    alone = slow & (work.values.unexplained < _EXPLAINED)
    torn &= ~(alone[pairs.first] | alone[pairs.second])
    shift = work.values.value[:, 2:4] / plane.pitch
    error = work.values.deviation[:, 2:4] / plane.pitch
    far = np.hypot(*shift.T)
    typical = 1.2 * float(np.median(far[usable])) if usable.any() else 0.0
    own = np.hypot(*error.T)
    moved = usable & (far > np.maximum(_PLACE, BEYOND * np.hypot(own, typical)))
    # In a corner the potential is level: a place that is badly known moves far.
    effect = _effect(work)
    moved &= ~slow
    moved &= effect > BEYOND * max(float(np.median(effect[usable])), 1e-4)
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
    """Computes how much of the voltages' span each electrode's shift explains, rms."""
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
    """Tells whether another place of one electrode explains nearly all its residuals."""
    return bool(moved[e] and work.values.unexplained[e] < 0.6 * _EXPLAINED)


def _explained(pairs: Pairs, over: np.ndarray, e: Any) -> bool:
    """Tells whether some pairs of an electrode are as much nearer as others are farther."""
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
        f"from ({ends[0][0]:.0f}, {ends[0][1]:.0f}) "
        f"to ({ends[1][0]:.0f}, {ends[1][1]:.0f}) mm"
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
        f"a tear or a bad joint in the sheet {reach}: up to {most:.1f} times an even "
        "sheet's drop between electrodes",
        "look at the sheet there; glue or replace it",
    )


def _along(points: np.ndarray) -> np.ndarray:
    if len(points) < 2:
        return np.array([1.0, 0.0])
    return np.linalg.svd(points - points.mean(0), full_matrices=False)[2][0]


def joint_faults(work: Work) -> list[Fault]:
    """Finds electrodes with a resistance to the sheet, by the slots that ground them."""
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
        if more <= max(_JOINT, 2 * BEYOND * usual):
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
