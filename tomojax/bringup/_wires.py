"""Judges wires: order of channels, ground lines, and which way round the array is.

The last two touches that hold still tell which way round the array is.
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Integer

from tomojax._require import require
from tomojax.bringup._fault import Fault, SUREST
from tomojax.bringup._naming import (
    best_image,
    channel_faults,
    line_faults,
    line_groups,
    whole_fault,
)
from tomojax.bringup._reading import CLOSED, paths_of, Reading
from tomojax.bringup._wiring import Lines
from tomojax.bringup.sheet._plane import lattice, Plane, symmetries
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


# The part of the slots that must be elsewhere than half of them are, so many pitches away.
_ELSEWHERE = 0.1
_APART = 1.0

# The part of the lines that differ from what was commanded and are no mirror's.
_WRONG = 0.5

# The part of the lines that a mirror leaves wrong.
_LEFT = 0.4

# Slots from which on an order is as sure as anything; how sure it is before.
_MANY = 200
_FEW_SURE = 0.95


def judge_wires(reading: Reading, corners: Corners | None) -> Lines:
    """Names faults of wires; turns the reading to true places if corners show them.

    **Raises:** `ValueError` if all contacts are in one place.
    """
    fits, plane = reading.order.fits, reading.plane
    away = np.hypot(*(fits.xy - np.median(fits.xy, 0)).T) / plane.pitch
    require(
        (away > _APART).mean() > _ELSEWHERE,
        "recording",
        "one touch alone",
        "a rub over the sheet: touches in many places",
    )
    lines = _lines(reading)
    turn = Turn(why="told that no corners were touched")
    if corners is not None:
        turn = turn_of(reading, corners)
    if turn.image is None:
        reading.unjudged["mirrored or turned array"] = turn.why
        image, unknown_which = _likeliest(reading, lines)
    else:
        image, unknown_which = symmetries(plane)[turn.image], False
    lines = _turned(reading, lines, image)
    _name(reading, lines, unknown_which)
    return lines


def _lines(reading: Reading) -> Lines:
    lines = reading.lines()
    if reading.always is not None:
        own = lines.asked == reading.order.electrode[reading.always]
        lines.ground[own] = lines.asked[own]
    unsure = lines.asked[lines.ground == -2]
    if len(unsure):
        reading.unjudged["ground lines " + ", ".join(map(str, unsure))] = (
            "their slots do not agree: more slots of these lines with a contact"
        )
    m = reading.plane.count
    never = np.setdiff1d(np.arange(m), lines.asked)
    if len(never):
        some = ", ".join(map(str, never[:5])) + (", …" if len(never) > 5 else "")
        reading.unjudged["ground lines not commanded"] = (
            f"{len(never)} of {m} ({some}) were never commanded: record with --pattern all"
        )
    return lines


def _turned(reading: Reading, lines: Lines, image: Integer[np.ndarray, " M"]) -> Lines:
    """Moves contacts to their true places, if the array is mirrored or turned."""
    if (image != np.arange(len(image))).any():
        order, fits = reading.order, reading.order.fits
        fits = fits._replace(ground=image[fits.ground])
        reading.order = order._replace(electrode=image[order.electrode], fits=fits)
        reading.again()
    return lines.moved(image)


def _likeliest(reading: Reading, lines: Lines) -> tuple[np.ndarray, bool]:
    """Guesses which way round the array is without corners: by lines, then by channels.

    Also returns whether lines or channels are mirrored, if nobody knows which of the two.
    """
    names, electrode = symmetries(reading.plane), reading.order.electrode
    told = lines.ground >= 0
    ground, asked = lines.ground[told], reading.inside(lines.asked[told])
    count = max(int(told.sum()), 1)

    def wrong(image: np.ndarray) -> tuple[int, int]:
        off = image[electrode] != np.arange(len(electrode))
        return int((image[ground] != asked).sum()), int(off.sum())

    best = min(names.values(), key=wrong)
    # Lines that are off by some are no mirrored lines.
    plain = wrong(names["identity"])[0] <= _WRONG * count
    if plain or wrong(best)[0] > _LEFT * count:
        return names["identity"], False
    return best, True


def _name(reading: Reading, lines: Lines, unknown_which: bool) -> None:
    plane, electrode, told = reading.plane, reading.order.electrode, lines.ground >= 0
    name, image = best_image(plane, electrode, np.arange(plane.count))
    sure = SUREST if len(reading.number) > _MANY else _FEW_SURE
    if name != "identity":
        asked = reading.inside(lines.asked[told])
        whole = bool(told.any()) and name == best_image(plane, lines.ground[told], asked)[0]
        if whole:
            lines = lines.moved(np.argsort(image))
        reading.faults.append(whole_fault(name, whole, unknown_which, sure))
    # Groups that are exchanged in channels and in lines: wires of electrodes.
    channels = channel_faults(plane, electrode, image, sure, line_groups(lines))
    wires = [f.channels for f in channels if f.kind == "swapped"]
    reading.faults += channels + line_faults(plane, lines, wires)
    if reading.always is not None:
        reading.faults.append(_drain(reading, reading.always))


def _drain(reading: Reading, channel: int) -> Fault:
    """Names an electrode that drains current in every slot: by its path's resistance."""
    order, rig = reading.order, reading.slots.rig
    e, path = int(order.electrode[channel]), paths_of(order, reading.volts, channel)
    path = path[path > 0]
    ohm = float(rig.sheet_resistance * np.median(path)) if len(path) else 0.0
    near = f"look at the switch of ground line {e}"
    if ohm < CLOSED * rig.sheet_resistance:
        text = f"electrode {e} is grounded in every slot"
        return Fault("ground_stuck", (e,), "on", "", 0.99, text, f"{near}: it never opens")
    text = f"electrode {e} leaks to ground through some {ohm:.2g} Ω in every slot"
    mend = f"{near}, and for water or dirt between its wire and ground"
    return Fault("leak", (e,), float(f"{ohm:.2g}"), "Ω", 0.99, text, mend)
