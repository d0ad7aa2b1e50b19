"""Finds tears and bad joints of the sheet, and electrodes that lie elsewhere."""

import numpy as np
from jaxtyping import Bool, Float

from tomojax.bringup._amounts import BEYOND, spread
from tomojax.bringup._fault import certainty, Fault
from tomojax.bringup._reading import Work
from tomojax.bringup.sheet._fit import sound
from tomojax.bringup.sheet._values import Pairs, pairs_of, slopes_of

# A place is off by so much of the pitch at least.
_PLACE = 0.12

# A pair of electrodes drops so many times an even sheet's voltage where it is torn, as a
# logarithm.
_TORN = np.log(1.35)

# Pairs that agree are beyond that by so much of a logarithm.
_AGREED = 0.05

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
    plane, unexplained = work.plane, work.values.unexplained
    pairs = pairs_of(plane, work.volts, work.fits, work.usable)
    log = np.log(np.maximum(pairs.ratio, 0.05))
    usual = spread(log)
    over = log - float(np.median(log))
    # A tear makes all pairs of a small array spread: several that agree need less.
    torn = over > max(_TORN, min(BEYOND * usual, _TORN + _AGREED))
    if torn.sum() < 2:
        torn = over > max(_TORN, BEYOND * usual)
    # What a channel's own gain or old slots explain is no tear.
    alone = slow & (unexplained < _EXPLAINED)
    torn &= ~(alone[pairs.first] | alone[pairs.second])
    shift, sure = _shifts(work)
    moved = (sure > 0) & ~slow
    # Another place explains nearly all residuals of its electrode.
    own_place = moved & (unexplained < 0.6 * _EXPLAINED)
    lone, named = moved.copy(), np.zeros(plane.count, bool)
    for a, b in zip(pairs.first[torn].tolist(), pairs.second[torn].tolist()):
        # One electrode off makes its pairs unlike; a tear moves both sides apart.
        if moved[a] != moved[b] and _explained(pairs, over, a if moved[a] else b):
            continue
        if own_place[a] or own_place[b]:
            continue
        lone[[a, b]] = False
        named[[a, b]] = True
    faults: list[Fault] = []
    if named.any():
        beside = plane.distance(plane.xy[named]).min(0) < 2.1
        lone &= ~beside
        faults.append(_tear(work, pairs, over, torn & named[pairs.first], usual))
        named |= moved & ~lone
    for e in np.flatnonzero(lone):
        (x, y), c = 1e3 * shift[e], int(work.channel[e])
        text = (
            f"the electrode of channel {c} lies {np.hypot(x, y):.1f} mm from its place: "
            f"{x:+.1f} mm along x, {y:+.1f} mm along y"
        )
        mend = "put it back, or correct electrode_xy (tomojax calibrate finds all places)"
        value = {"x_mm": round(float(x), 2), "y_mm": round(float(y), 2)}
        known = certainty(sure[e])
        faults.append(Fault("misplaced", (c,), value, "mm", known, text, mend))
    return faults, named | lone


def _shifts(work: Work) -> tuple[Float[np.ndarray, "M 2"], Float[np.ndarray, " M"]]:
    """Returns how far electrodes are off, m, and in how many σ; 0 σ where they are not."""
    usable, pitch = work.usable, work.plane.pitch
    shift = work.values.value[:, 2:4]
    far = np.hypot(*shift.T) / pitch
    own = np.hypot(*work.values.deviation[:, 2:4].T) / pitch
    typical = 1.2 * float(np.median(far[usable])) if usable.any() else 0.0
    moved = usable & (far > np.maximum(_PLACE, BEYOND * np.hypot(own, typical)))
    # In a corner the potential is level: a place that is badly known moves far.
    effect = _effect(work)
    moved &= effect > BEYOND * max(float(np.median(effect[usable])), 1e-4)
    return shift, np.where(moved, far / np.hypot(own, typical + 0.02), 0)


def _effect(work: Work) -> Float[np.ndarray, " M"]:
    """Computes how much of the voltages' span each electrode's shift explains."""
    fits, shift = work.fits, work.values.value[:, 2:4]
    some = sound(fits)[:, None] & (fits.far > 0)
    moved = (slopes_of(work.plane, fits) * shift.T[:, None]).sum(0)
    part = np.abs(moved / np.maximum(fits.span, 1e-12)[:, None])
    # A high quantile is not moved by slots next to the electrode.
    shown = np.where(some.sum(0) > 1, np.where(some, part, np.nan), 0.0)
    with np.errstate(all="ignore"):
        return np.nan_to_num(np.nanquantile(shown, 0.8, axis=0))


def _explained(pairs: Pairs, over: np.ndarray, e: int) -> bool:
    """Tells whether some pairs of an electrode are as much nearer as others are farther."""
    own = over[(pairs.first == e) | (pairs.second == e)]
    return len(own) > 1 and own.min() < -0.4 * own.max()


def _tear(
    work: Work, pairs: Pairs, over: np.ndarray, torn: np.ndarray, usual: float
) -> Fault:
    first, second, over = pairs.first[torn], pairs.second[torn], over[torn]
    middle = 1e3 * (work.plane.xy[first] + work.plane.xy[second]) / 2
    x, y = over @ middle / over.sum()
    reach = f"at ({x:.0f}, {y:.0f}) mm"
    if len(middle) > 1:
        centred = middle - middle.mean(0)
        along = middle @ np.linalg.svd(centred, full_matrices=False)[2][0]
        ends = middle[[along.argmin(), along.argmax()]]
        reach = "from ({:.0f}, {:.0f}) to ({:.0f}, {:.0f}) mm".format(*ends.ravel())
    most = float(np.exp(over.max()))
    text = (
        f"a tear or a bad joint in the sheet {reach}: up to {most:.1f} times an even "
        "sheet's drop between electrodes"
    )
    channels = tuple(np.unique(work.channel[np.r_[first, second]]).tolist())
    value = {
        "x_mm": round(float(x), 1),
        "y_mm": round(float(y), 1),
        "times": round(most, 2),
    }
    sure = certainty(float(over.max()) / max(usual + _TORN / 4, 1e-6))
    mend = "look at the sheet there; glue or replace it"
    return Fault("tear", channels, value, "mm", sure, text, mend)


def joint_faults(work: Work) -> list[Fault]:
    """Finds electrodes with a resistance to the sheet, by the slots that ground them."""
    fits, plane = work.fits, work.plane
    row = np.arange(len(work.volts))
    sink = plane.green(plane.xy[fits.ground], fits.xy)
    inside = fits.level + fits.current * (sink - np.diag(plane.between)[fits.ground])
    mine = np.where(work.usable[fits.ground], work.volts[row, fits.ground], 0.0)
    squares = (inside - mine) / np.maximum(fits.current, 1e-12)
    use = sound(fits) & (fits.current > 0)
    electrode, count = np.unique(fits.ground[use], return_counts=True)
    electrode = electrode[count >= 4]
    if len(electrode) < 3:
        return []
    x = np.array([np.median(squares[use & (fits.ground == e)]) for e in electrode])
    more, usual = x - np.median(x), spread(x)
    faults = []
    for k in np.flatnonzero(more > max(_JOINT, 2 * BEYOND * usual)):
        c, squares_more = int(work.channel[electrode[k]]), float(more[k])
        x, y = (1e3 * plane.xy[electrode[k]]).tolist()
        value = {"x_mm": x, "y_mm": y, "squares": round(squares_more, 2)}
        text = (
            f"a bad joint between the electrode of channel {c} and the sheet: "
            f"{squares_more:.1f} squares of the sheet's resistance"
        )
        sure, unit = certainty(squares_more / (usual + _JOINT / 4)), "squares of the sheet"
        mend = "clean or glue the joint there"
        faults.append(Fault("tear", (c,), value, unit, sure, text, mend))
    return faults
