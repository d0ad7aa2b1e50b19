"""Tells which way round the array is, by the last two touches that hold still."""

from typing import Literal, NamedTuple

import numpy as np

from tomojax._require import require
from tomojax.bringup._reading import Reading
from tomojax.bringup.sheet._orders import lattice, symmetries
from tomojax.bringup.sheet._plane import Plane
from tomojax.bringup.sheet._slots import Slots, WINDOW

# A touch has as many slots at least.
_FEW = 8

# A touch holds still to this part of a pitch: in a corner the potential is level, and
# places scatter.
_STILL = 0.7

# A touch is at a corner to this many pitches.
_NEAR = 1.3

# Slots of a touch that are looked at.
_SOME = 30

Corners = tuple[int, int] | Literal["auto"]


class Turn(NamedTuple):
    """Which way round the array is."""

    image: str | None = None  # the symmetry that brings the touches to their corners
    why: str = ""  # where there is none


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


def turn_of(reading: Reading, corners: Corners) -> Turn:
    """Compares the last two still touches with the corners that were to be touched."""
    plane, m = reading.plane, reading.plane.count
    first, second = named(plane) if corners == "auto" else map(int, corners)
    inside = 0 <= first < m and 0 <= second < m and first != second
    require(inside, "corners", (first, second), f"two electrodes of 0 to {m - 1}")
    need = f"touches that hold still at the corners of electrodes {first} and {second}"
    must = f"the recording must end with {need}"
    last = events(reading.slots)[-2:]
    if len(last) < 2:
        return Turn(why=f"no pauses between touches: {must}")
    places = []
    for touch in last:
        some = touch[np.linspace(0, len(touch) - 1, min(_SOME, len(touch))).astype(int)]
        xy = reading.fits_of(reading.every[some].astype(float)).xy
        middle = np.median(xy, 0)
        if np.median(np.hypot(*(xy - middle).T)) > _STILL * plane.pitch:
            return Turn(why=f"the last touches move: {must}")
        places.append(middle)
    fits = {}
    for name, image in symmetries(plane).items():
        # An electrode's image tells what becomes of a place beside it.
        nearest = plane.distance(np.array(places)).argmin(1)
        off = plane.xy[image[nearest]] - plane.xy[[first, second]]
        away = np.hypot(*off.T) / plane.pitch
        if away.max() < _NEAR:
            fits[name] = float(away.sum())
    if not fits:
        where = " and ".join(f"({1e3 * x:.0f}, {1e3 * y:.0f}) mm" for x, y in places)
        return Turn(why=f"the last two touches are at {where}: {must}")
    least = min(fits.values())
    equal = [name for name, away in fits.items() if away <= least + 0.5]
    if "identity" in equal:
        return Turn("identity")
    if len(equal) > 1:
        names = " from ".join(equal)
        return Turn(why=f"{need} do not tell {names}: two adjacent corners do")
    return Turn(equal[0])
