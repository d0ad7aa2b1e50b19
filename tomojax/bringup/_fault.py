"""Defines what `check` returns: faults, parts not judged, and the rig's real wiring."""

import math
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Integer

from tomojax.bringup.sheet._plane import Plane

Kind = Literal[
    "dead",
    "stuck",
    "shorted",
    "swapped",
    "mirrored",
    "turned",
    "ground_permuted",
    "ground_off_by",
    "ground_stuck",
    "leak",
    "drive",
    "sheet_resistance",
    "gain",
    "settling",
    "hum",
    "noise",
    "tear",
    "misplaced",
]

# Nothing is surer than this: physics that no one thought of.
SUREST = 0.999


class Fault(NamedTuple):
    """One thing that is wrong with a rig.

    `channels`: the channels at fault, or ground lines for the kinds of grounds; none: all.
    `value`: how much, in SI (`unit`). `certainty`: the probability of the fault,
    from normal errors as large as sound channels show, 0.999 at most. `text`: the fault in
    words; `mend`: what to do.

    **Example:**

    >>> import tomojax as tx
    >>> fault = tx.bringup.Fault("gain", (5,), 1.1, "1", 0.99, "gain of 1.1", "set it")
    >>> fault.kind, fault.channels
    ('gain', (5,))
    """

    kind: Kind
    channels: tuple[int, ...]
    value: float | str | dict[str, float] | dict[str, int]
    unit: str
    certainty: float
    text: str
    mend: str


class Seen(NamedTuple):
    """The data that the picture shows beside the faults."""

    plane: Plane
    swing: Float[np.ndarray, " M"]  # by electrode, V


class Checked(NamedTuple):
    """A recording's judgement of its rig.

    `unjudged`: parts that could not be judged, and what a recording must hold for them.
    `channels`: the electrode that each channel reads. `grounds`: the electrode that each
    ground line switches; −1 for none, the line's own number if unknown.

    **Example:**

    >>> import tomojax as tx
    >>> "faults" in tx.bringup.Checked._fields
    True
    """

    faults: tuple[Fault, ...]
    unjudged: dict[str, str]
    channels: Integer[np.ndarray, " M"]
    grounds: Integer[np.ndarray, " M"]
    figures: dict[str, float]  # noise V, drive V, …: measured
    contacts: Float[np.ndarray, "n 2"]  # of the slots that were looked at, m
    seen: Seen


def certainty(deviations: float) -> float:
    """Computes the probability of a fault, so many deviations from sound."""
    return float(np.clip(math.erf(abs(deviations) / math.sqrt(2)), 0.5, SUREST))
