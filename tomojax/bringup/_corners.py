"""Tells which way round the array is, by the last two touches that hold still."""

from typing import Any, NamedTuple

import numpy as np

from tomojax._require import require
from tomojax.bringup._wiring import lattice, symmetries
from tomojax.bringup.sheet._fit import fitted
from tomojax.bringup.sheet._plane import Plane
from tomojax.bringup.sheet._slots import Slots, WINDOW

# A touch has as many slots at least; it holds still to this part of a pitch (in a corner
# the potential is level, and places scatter), and is at a corner to this many pitches.
_FEW, _STILL, _NEAR = 8, 0.7, 1.3

# Slots of a touch that are looked at.
_SOME = 30


class Corners(NamedTuple):
    image: str | None  # the symmetry that brings the touches to their corners
    why: str  # where there is none


def named(plane: Plane) -> tuple[int, int]:
    """Returns the electrodes at whose corners touches are by default."""
    grid = lattice(plane)
    if grid is not None:
        return 0, grid[1] - 1
    x, y = plane.xy.T
    return int(np.argmin(x + y)), int(np.argmin(x - y))


def events(slots: Slots) -> list[np.ndarray]:
    """Lists each contact's touched slots; pauses of a window or more divide contacts."""
    at = np.flatnonzero(slots.touched)
    calm = np.concatenate([[0], np.cumsum(slots.quiet)])
    split = np.flatnonzero(calm[at[1:]] - calm[at[:-1]] >= WINDOW) + 1
    return [part for part in np.split(at, split) if len(part) >= _FEW]


def corners_of(
    slots: Slots,
    volts: np.ndarray,
    plane: Plane,
    electrode: np.ndarray,
    usable: np.ndarray,
    always: int | None,
    corners: Any,
) -> Corners:
    """Compares the last two still touches with the corners that were to be touched."""
    m = plane.count
    if corners == "auto":
        first, second = named(plane)
    else:
        first, second = (int(c) for c in corners)
        inside = 0 <= first < m and 0 <= second < m and first != second
        require(inside, "corners", (first, second), f"two electrodes of 0 to {m - 1}")
    need = f"touches that hold still at the corners of electrodes {first} and {second}"
    last = events(slots)[-2:]
    if len(last) < 2:
        return Corners(
            None, f"no pauses between touches: the recording must end with {need}"
        )
    places = []
    for touch in last:
        some = touch[np.linspace(0, len(touch) - 1, min(_SOME, len(touch))).astype(int)]
        back = np.argsort(electrode)
        own = volts[some].astype(float)[:, back]
        weight = np.broadcast_to(usable[back].astype(float), own.shape)
        on = None if always is None else int(electrode[always])
        xy = fitted(plane, own, weight, always=on).xy
        middle = np.median(xy, 0)
        wide = np.median(np.hypot(*(xy - middle).T)) / plane.pitch
        if wide > _STILL:
            return Corners(
                None, f"the last touches move: the recording must end with {need}"
            )
        places.append(middle)
    ends = plane.xy[[first, second]]
    return _matched(plane, np.array(places), ends, need)


def _matched(plane: Plane, places: np.ndarray, ends: np.ndarray, need: str) -> Corners:
    """Finds the symmetry under which both places are at their corners."""
    fits = {}
    for name, image in symmetries(plane).items():
        # An electrode's image tells what becomes of a place beside it.
        nearest = np.hypot(*(places[:, None] - plane.xy).transpose(2, 0, 1)).argmin(1)
        away = np.hypot(*(plane.xy[image[nearest]] - ends).T) / plane.pitch
        if away.max() < _NEAR:
            fits[name] = float(away.sum())
    if not fits:
        where = " and ".join(f"({1e3 * x:.0f}, {1e3 * y:.0f}) mm" for x, y in places)
        return Corners(
            None, f"the last two touches are at {where}: the recording must end with {need}"
        )
    least = min(fits.values())
    equal = [name for name, away in fits.items() if away <= least + 0.5]
    if len(equal) > 1 and "identity" not in equal:
        return Corners(
            None, f"{need} do not tell {' from '.join(equal)}: two adjacent corners do"
        )
    return Corners("identity" if "identity" in equal else equal[0], "")
