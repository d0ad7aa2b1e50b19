"""Rigs, contacts and seeds to try methods on, with more errors than methods assume.

Each row of `FAMILY` changes one property of the rig that `draw_rig` draws by default. Seeds
below `JUDGING` are for developing methods. Higher seeds are used once, for figures that are
shown.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bench.rigs._networked import network_of
from bench.rigs._rig import draw_rig, Rig
from bench.rigs._shapes import Touch
from tomojax.paper import exploration
from tomojax.sensor import Sensor

JUDGING = 1_000_000


class Row(NamedTuple):
    """The properties of the rig, and of each lone contact, that differ from the default."""

    title: str
    rig: dict[str, Any]
    touch: dict[str, Any]


FAMILY = {
    "usual": Row("as drawn by default", {}, {}),
    "patches": Row("sheet 5 % uneven, patches of a quarter pitch",
                   {"uneven": 0.05, "patch": 0.25}, {}),
    "ellipse": Row("contact an ellipse, 2 : 1", {}, {"ratio": 2.0}),
    "face_60": Row("electrodes touch over 60 % of their radius", {"face": (0.6, 0.0)}, {}),
    "face_40": Row("electrodes touch over 40 %", {"face": (0.4, 0.0)}, {}),
    "ground": Row("0.2 squares more in the ground path", {"more_ground": 0.2}, {}),
    "faces": Row("30 to 100 % of the radius, off centre, 0.1 squares of contact resistance",
                 {"face": (0.65, 0.35), "decentred": 1.0, "contact": 0.1}, {}),
    "grounds": Row("ground paths of 0.1 squares, unlike by a factor",
                   {"more_ground": 0.1, "unlike_grounds": 0.7}, {}),
    "gradient": Row("sheet 20 % from side to side, waves longer along x",
                    {"gradient": 0.2, "stretch": 3.0}, {}),
    "seam": Row("a seam of 50 % more", {"seam": 0.5}, {}),
    "profile": Row("Hertz's pressure, soft edges, lopsided; with 1 square in series", {},
                   {"profile": ("hertz", "soft", "lopsided"), "series": 1.0}),
    "reading": Row("12 bits, hum, drift, crosstalk, settling",
                   {"bits": 12, "hum": 1e-4, "drift": 1e-5, "crosstalk": 1e-3,
                    "settling": 1e-3}, {}),
    "bits_10": Row("10 bits", {"bits": 10}, {}),
    "bits_18": Row("18 bits, a tenth of the noise", {"bits": 18, "noise": 6.7e-6}, {}),
}  # fmt: skip


class LoneContacts(NamedTuple):
    """n lone contacts as measured under some grounds, and their true values."""

    volts: Float[np.ndarray, "n S M"]  # V
    grounds: np.ndarray  # (S,)
    xy: Float[np.ndarray, "n 2"]  # m
    conductance: Float[np.ndarray, " n"]  # S
    rig: np.ndarray  # (n,) which of the rigs


def make_rig(sensor: Sensor, row: str, rng: np.random.Generator) -> Rig:
    """Draws a rig of that row; its values follow the pitch, the sheet and the drive."""
    words = dict(FAMILY[row].rig)
    if "patch" in words:
        words["patch"] *= sensor.mean_pitch
    square = float(np.mean(np.asarray(sensor.sheet_resistance)))
    for name in {"contact", "more_ground"} & words.keys():
        words[name] *= square
    for name in {"hum", "drift"} & words.keys():
        words[name] *= abs(float(sensor.drive_voltage))
    return draw_rig(sensor, rng, **words)


def draw_touch(sensor: Sensor, row: str, rng: np.random.Generator) -> Touch:
    """Draws a contact anywhere but at the edge: radius 0.15 to 0.6 pitches.

    The conductance is 10⁻¹·⁵ to 10¹·⁵ times that of a square of the sheet.
    """
    pitch, size = sensor.mean_pitch, np.asarray(sensor.size, float)
    words = FAMILY[row].touch
    radius = pitch * rng.uniform(0.15, 0.6)
    square = float(np.mean(np.asarray(sensor.sheet_resistance)))
    conductance = 10 ** rng.uniform(-1.5, 1.5) / square
    ratio = float(words.get("ratio", 1.0))
    axes = radius * np.sqrt(ratio), radius / np.sqrt(ratio)
    margin = axes[0] + 0.05 * pitch
    place = rng.uniform(margin, size - margin)
    profile = rng.choice(words.get("profile", ("flat",)))
    series = words.get("series", 0.0) * square
    angle = rng.uniform(0, np.pi)
    return Touch(place, axes, angle, conductance, str(profile), series)  # pyright: ignore


def lone_contacts(
    sensor: Sensor,
    row: str,
    seed: int,
    rigs: int = 12,
    each: int = 10,
    grounds: np.ndarray | None = None,
    model: Callable[[Rig], Any] | None = None,
) -> LoneContacts:
    """Makes `each` lone contacts on each of `rigs` rigs of that row.

    The grounds are the two corners by default. `model` makes the exact voltages:
    `network_of` by default, or `Elements`.
    """
    rng = np.random.default_rng([seed, *row.encode()])
    grounds = np.asarray(exploration(sensor)) if grounds is None else grounds
    make = network_of if model is None else model
    volts, xy, conductance, number = [], [], [], []
    for k in range(rigs):
        rig = make_rig(sensor, row, rng)
        exact = make(rig)
        for _ in range(each):
            touch = draw_touch(sensor, row, rng)
            v = exact.touched(touch, grounds)
            volts.append(rig.chain.read(v, rng))
            xy.append(touch.centre)
            conductance.append(1 / (1 / touch.conductance + touch.series))
            number.append(k)
    return LoneContacts(*(np.array(a) for a in (volts, grounds, xy, conductance, number)))
