"""Judges wires: order of channels, ground lines, and which way round the array is."""

from typing import Any

import numpy as np
from jaxtyping import Integer

from tomojax._require import require
from tomojax.bringup._corners import Corners, corners_of
from tomojax.bringup._fault import Fault
from tomojax.bringup._naming import (
    best_image,
    channel_faults,
    line_faults,
    line_groups,
)
from tomojax.bringup._reading import Reading
from tomojax.bringup._wiring import floating, Lines, lines_of, symmetries

# The part of the slots that must be elsewhere than half of them are, so many pitches away.
_ELSEWHERE, _APART = 0.1, 1.0

# Lines that differ from what was commanded and are no mirror's; that a mirror leaves.
_WRONG, _LEFT = 0.5, 0.4

# Slots from which on an order is as sure as anything; how sure it is before.
_MANY, _FEW_SURE = 200, 0.95


def judge_wires(reading: Reading, corners: Any) -> Lines:
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
    found = Corners(None, "told that no corners were touched")
    if corners is not None:
        given = reading.slots, reading.every, plane, reading.order.electrode
        found = corners_of(*given, reading.usable, reading.always, corners)
    if found.image is None:
        reading.unjudged["mirrored or turned array"] = found.why
        image, unknown_which = _likeliest(reading, lines)
    else:
        image, unknown_which = symmetries(plane)[found.image], False
    lines = _turned(reading, lines, image)
    _name(reading, lines, unknown_which)
    return lines


def _lines(reading: Reading) -> Lines:
    flat = floating(reading.volts, reading.usable, reading.slots.drive)
    lines = lines_of(reading.order.fits, reading.asked, flat)
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
        reading.unjudged["ground lines not commanded"] = (
            f"{len(never)} of {m} ({_few(never)}) were never commanded: "
            "record with --pattern all"
        )
    return lines


def _few(numbers: Integer[np.ndarray, " n"]) -> str:
    """Names the first numbers, and tells that more follow."""
    return ", ".join(map(str, numbers[:5])) + (", …" if len(numbers) > 5 else "")


def _turned(reading: Reading, lines: Lines, image: Integer[np.ndarray, " M"]) -> Lines:
    """Moves contacts to their true places, if the array is mirrored or turned."""
    ground = np.where(lines.ground >= 0, image[np.maximum(lines.ground, 0)], lines.ground)
    if (image != np.arange(len(image))).any():
        order, fits = reading.order, reading.order.fits
        fits = fits._replace(ground=image[fits.ground])
        reading.order = order._replace(electrode=image[order.electrode], fits=fits)
        reading.again()
    return lines._replace(ground=ground)


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
    asked, ground, plane = lines.asked, lines.ground, reading.plane
    electrode, told = reading.order.electrode, ground >= 0
    name, image = best_image(plane, electrode, np.arange(plane.count))
    same = "identity"
    if told.any():
        same, _ = best_image(plane, ground[told], reading.inside(asked[told]))
    whole = name != "identity" and name == same
    # Groups that are exchanged in channels and in lines: wires of electrodes.
    back = np.argsort(image)
    ground = np.where(told, back[np.maximum(ground, 0)] if whole else ground, ground)
    groups = line_groups(asked, ground)
    sure = 0.999 if len(reading.number) > _MANY else _FEW_SURE
    channels = channel_faults(plane, electrode, whole, sure, unknown_which, groups)
    wires = [f.channels for f in channels if f.kind == "swapped"]
    reading.faults += channels
    reading.faults += line_faults(plane, asked, ground, lines.share, wires)
    if reading.always is not None:
        e = int(electrode[reading.always])
        reading.faults.append(
            Fault(
                "ground_stuck",
                (e,),
                "on",
                "",
                0.99,
                f"electrode {e} is grounded in every slot",
                f"look at the switch of ground line {e}: it never opens",
            )
        )
