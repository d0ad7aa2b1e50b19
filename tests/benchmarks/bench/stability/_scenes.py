"""Scenes for `tomojax stability`: one property gets worse, everything else stays.

A resistor network (`bench.network`) makes voltages, with the errors of a rig. A
reconstruction is told nominal values. All values of a sweep use the same random draws. A
curve therefore shows the value and not the draw.
"""

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bench.network import Contact, Network
from tomojax.paper import exploration
from tomojax.sensor import Sensor

# A usual contact: conductance, S; radius and how far from the edge at least, of the
# shorter side.
CONDUCTANCE, _RADIUS, _MARGIN = 1e-4, 0.03, 0.15

# Further off than this (pitches) a place is not that of the contact; nearer, it is right.
NEAR = 0.5


class SweptScenes(NamedTuple):
    """n scenes at one value of a sweep."""

    volts: Float[np.ndarray, "n M M"]  # as measured under every ground, V
    xy: Float[np.ndarray, "n C 2"]  # m; NaN beyond the contacts
    told: Sensor | None = None  # the sensor that a reconstruction has; None: nominal
    near: float | None = None  # within which a place is right, m; None: NEAR
    lam: float = 1.0  # times the method's own λ
    whole: bool = False  # one large contact: its place is the mean of what is found
    before: Float[np.ndarray, "n M M"] | None = None  # of another contact, until now

    def first(self, count: int | None) -> "SweptScenes":
        """Returns so many of the scenes; None is all."""
        before = None if self.before is None else self.before[:count]
        return self._replace(volts=self.volts[:count], xy=self.xy[:count], before=before)


class Bench:
    """A rig, `count` lone contacts on it, and what is drawn for them."""

    def __init__(self, sensor: Sensor, count: int, seed: int = 0):
        self.sensor, self.count, self.seed = sensor, count, seed
        self.size = np.asarray(sensor.size, float)
        self.side = float(self.size.min())
        self.electrodes = np.asarray(sensor.electrode_xy, float)
        # Of the square that an electrode has to itself, m.
        self.pitch = float(np.sqrt(self.size.prod() / len(self.electrodes)))
        self.corners = np.asarray(exploration(sensor))
        self.radius = _RADIUS * self.side

    def rng(self) -> np.random.Generator:
        """Returns a generator that gives the same draws each time."""
        return np.random.default_rng(self.seed)

    @cached_property
    def rig(self) -> Network:
        return Network(self.sensor, self.rng())

    @cached_property
    def places(self) -> Float[np.ndarray, "n 2"]:
        """Places of the lone contacts, anywhere but at the edge, m."""
        margin = _MARGIN * self.side
        return self.rng().uniform(margin, self.size - margin, (self.count, 2))

    @cached_property
    def exact(self) -> tuple[np.ndarray, np.ndarray]:
        """Voltages of the lone contacts before the converter, and their places."""
        made = [self.scene([self.disc(p)]) for p in self.places]
        volts, xy = zip(*made)
        return np.array(volts), np.array(xy)

    @cached_property
    def lone(self) -> tuple[np.ndarray, np.ndarray]:
        """Voltages of the lone contacts as measured, and their places."""
        volts, xy = self.exact
        return self.measured(volts), xy

    def measured(self, volts: np.ndarray, rig: Network | None = None) -> np.ndarray:
        """Returns voltages read by the rig's converter, with the same noise each time."""
        rig = rig or self.rig
        rig.rng = np.random.default_rng([self.seed, 1])
        return rig.measure(volts)

    def disc(
        self,
        place: np.ndarray,
        radius: float | None = None,
        conductance: float = CONDUCTANCE,
        rig: Network | None = None,
    ) -> Contact:
        """Returns a disc of that total conductance, S; parts off the sheet are left out."""
        rig = rig or self.rig
        inside = rig.disc(place, radius or self.radius)
        if not inside.any():
            inside[np.argmin(((rig.cells - place) ** 2).sum(1))] = True
        return inside, conductance

    def scene(
        self, contacts: list[Contact], rig: Network | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns exact voltages, and centres (C, 2)."""
        volts, truth = (rig or self.rig).scene(*contacts)
        return volts, np.array([xy for xy, _ in truth])

    def scenes(
        self, contacts: list[list[Contact]], rig: Network | None = None
    ) -> SweptScenes:
        """Returns scenes as measured."""
        volts, xy = zip(*(self.scene(some, rig) for some in contacts))
        return SweptScenes(self.measured(np.array(volts), rig), np.array(xy))


class Sweep(NamedTuple):
    """Values from harmless to hopeless, and the scenes that they make."""

    title: str  # and, after the last comma, the unit of the values
    values: tuple[float, ...]
    make: Callable[[Bench, float], SweptScenes]
    follows: bool = True  # whether the scenes mean something to a step
    only: tuple[str, ...] = ()  # methods; none: all


def _conductance(bench: Bench, value: float) -> SweptScenes:
    return bench.scenes([[bench.disc(p, None, value)] for p in bench.places])


def _size(bench: Bench, value: float) -> SweptScenes:
    """Makes ever larger metal, of about the same conductance per area."""
    radius = value * 1e-3
    total = CONDUCTANCE * max(1.0, (radius / bench.radius) ** 2)
    found = bench.scenes([[bench.disc(p, radius, total)] for p in bench.places])
    return found._replace(whole=True)


def _from_electrode(bench: Bench, value: float) -> SweptScenes:
    """Puts contacts so many mm from an electrode's centre, but for those grounded first."""
    rng = bench.rng()
    inner = np.setdiff1d(np.arange(len(bench.electrodes)), bench.corners)
    chosen = rng.permutation(inner)[: bench.count]
    angle = rng.uniform(0, 2 * np.pi, (len(chosen), 1))
    away = 1e-3 * value * np.concatenate([np.cos(angle), np.sin(angle)], 1)
    places = np.clip(bench.electrodes[chosen] + away, 2e-3, bench.size - 2e-3)
    return bench.scenes([[bench.disc(p, bench.radius / 2)] for p in places])


def _from_ground(bench: Bench, value: float) -> SweptScenes:
    """Puts contacts so many mm from the electrode grounded first, towards the middle."""
    ground = bench.electrodes[bench.corners[0]]
    inwards = np.arctan2(*(bench.size / 2 - ground)[::-1])
    angles = inwards + np.linspace(-0.6, 0.6, bench.count)
    away = 1e-3 * value * np.stack([np.cos(angles), np.sin(angles)], 1)
    return bench.scenes([[bench.disc(ground + a, bench.radius / 2)] for a in away])


def _from_edge(bench: Bench, value: float) -> SweptScenes:
    """Puts contacts so many mm from an edge; any part off the sheet is left out."""
    along = bench.rng().uniform(0.2, 0.8, bench.count) * bench.size[1]
    places = [np.array([1e-3 * value, y]) for y in along]
    return bench.scenes([[bench.disc(p)] for p in places])


def _from_corner(bench: Bench, value: float) -> SweptScenes:
    """Puts contacts so many mm from both edges, in a corner that is not explored."""
    steps = np.linspace(0, 1e-3, bench.count)
    places = [np.array([1e-3 * value + s, bench.size[1] - 1e-3 * value]) for s in steps]
    return bench.scenes([[bench.disc(p)] for p in places])


def _contacts(bench: Bench, value: float) -> SweptScenes:
    """Makes so many contacts, a seventh of the side apart or more, of one conductance."""
    rng, made = bench.rng(), []
    for _ in range(bench.count):
        places: list[np.ndarray] = []
        while len(places) < 10:
            new = rng.uniform(0.1 * bench.size, 0.9 * bench.size)
            if all(np.hypot(*(new - p)) > bench.side / 7 for p in places):
                places.append(new)
        made.append([bench.disc(p, bench.radius / 2) for p in places[: int(value)]])
    return bench.scenes(made)


def _apart(bench: Bench, value: float) -> SweptScenes:
    """Makes two contacts so many mm apart; both must be found within a third of that."""
    angles = bench.rng().uniform(0, np.pi, bench.count)
    half = 0.5e-3 * value * np.stack([np.cos(angles), np.sin(angles)], 1)
    radius = min(bench.radius / 2, 0.4e-3 * value)
    middle = bench.size / 2 + 0.5 * (bench.places - bench.size / 2)
    made = [[bench.disc(m + s * h, radius) for s in (1, -1)] for m, h in zip(middle, half)]
    return bench.scenes(made)._replace(near=1e-3 * value / 3)


def _uneven(bench: Bench, value: float) -> SweptScenes:
    rig = Network(bench.sensor, bench.rng(), variation=value)
    return bench.scenes([[bench.disc(p, None, rig=rig)] for p in bench.places], rig)


def _tear(bench: Bench, value: float) -> SweptScenes:
    """Cuts a slit of so many mm, from an edge inwards across the middle of the sheet."""
    rig = Network(bench.sensor, bench.rng())
    x, y = rig.cells.T
    width = 1.5 * bench.size[0] / rig.shape[0]
    rig.resist((np.abs(x - bench.size[0] / 2) < width) & (y < 1e-3 * value), 1e4)
    return bench.scenes([[bench.disc(p, None, rig=rig)] for p in bench.places], rig)


def _motion(bench: Bench, value: float) -> SweptScenes:
    """Moves contacts at so many m/s while a scan of all grounds goes on at 10 kHz."""
    slots, lasting = np.array([0, 1, 2, 4, 8, 16, 32, 64]), 1e-4
    made, xy = [], []
    order = _scan_order(bench)
    for place, angle in zip(bench.places, bench.rng().uniform(0, 2 * np.pi, bench.count)):
        along = np.array([np.cos(angle), np.sin(angle)]) * value * lasting
        # Turned back at the edge.
        path = place + slots[:, None] * along
        path = np.abs(np.mod(path + bench.size, 2 * bench.size) - bench.size)
        volts = np.array([bench.scene([bench.disc(p)])[0] for p in path])
        when = np.minimum(np.argsort(order), slots[-1])
        upper = np.clip(np.searchsorted(slots, when), 1, len(slots) - 1)
        low, high = slots[upper - 1], slots[upper]
        part = ((when - low) / (high - low))[:, None]
        ground = np.arange(len(order))
        made.append((1 - part) * volts[upper - 1, ground] + part * volts[upper, ground])
        xy.append(path[:1])
    return SweptScenes(bench.measured(np.array(made)), np.array(xy))


def _scan_order(bench: Bench) -> np.ndarray:
    """Returns grounds in the order of their slots: the corners, then the others."""
    every = np.arange(len(bench.electrodes))
    return np.concatenate([bench.corners, np.setdiff1d(every, bench.corners)])


def _jump(bench: Bench, value: float) -> SweptScenes:
    """Moves a followed contact by so many mm at once."""
    volts, xy = bench.lone
    angle = bench.rng().uniform(0, 2 * np.pi, bench.count)
    away = 1e-3 * value * np.stack([np.cos(angle), np.sin(angle)], 1)
    margin = 0.05 * bench.side
    places = np.clip(bench.places + away, margin, bench.size - margin)
    before = bench.scenes([[bench.disc(p)] for p in places])
    return SweptScenes(volts, xy, before=before.volts)


# Ways in which a scene itself gets hard.
SWEEPS = {
    "conductance_low": Sweep(
        "weak contact: conductance, S", (1e-4, 1e-5, 1e-6, 1e-7, 3e-8, 1e-8), _conductance
    ),
    "conductance_high": Sweep(
        "strong contact: conductance, S", (1e-4, 1e-3, 1e-2, 1e-1, 1.0), _conductance
    ),
    "size": Sweep("wide contact: radius, mm", (2, 5, 10, 15, 20, 30, 45, 70, 120), _size),
    "from_electrode": Sweep(
        "distance to an electrode, mm", (10, 7, 5, 3, 1.5, 0), _from_electrode
    ),
    "from_ground": Sweep("distance to the ground, mm", (40, 20, 10, 5, 2, 0), _from_ground),
    "from_edge": Sweep("distance to an edge, mm", (30, 15, 10, 5, 2, 0), _from_edge),
    "from_corner": Sweep("distance to two edges, mm", (30, 20, 10, 5, 2, 0), _from_corner),
    "contacts": Sweep("contacts at once, count", (1, 2, 3, 4, 5, 7, 10), _contacts),
    "apart": Sweep("distance of two contacts, mm", (80, 60, 40, 30, 20, 15, 10), _apart),
    "uneven": Sweep("uneven sheet, rms", (0.02, 0.05, 0.1, 0.2, 0.35, 0.5), _uneven),
    "tear": Sweep("length of a tear, mm", (0, 10, 20, 40, 80, 120), _tear),
    "motion": Sweep("speed in a scan, m/s", (0.1, 1, 3, 10, 30), _motion, follows=False),
    "jump": Sweep(
        "jump of a contact, mm", (0, 5, 15, 40, 80, 120), _jump,
        only=("follow",),
    ),
}  # fmt: skip
