"""Rigs with one fault that method makers seldom think of, and how they read their voltages.

A rig's loaded sheet is made once for each scene: the voltages with nothing grounded, and
the resistances that the electrodes see. Any conductances between electrodes, and from them
to ground, follow from these by one small solve.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bench.rigs import draw_touch, make_rig, network_of, Rig, Touch
from tomojax.sensor import Sensor

# Of a converter's input, Ω, for electrodes that hardly touch the sheet.
_INPUT = 1e6


class Loaded(NamedTuple):
    """A scene's sheet as its electrodes see it."""

    rig: Rig
    xy: Float[np.ndarray, "contacts 2"]  # m
    seen: Float[np.ndarray, "M M"]  # Ω, between electrodes and drive

    def under(self, to: Float[np.ndarray, "S M M"]) -> Float[np.ndarray, "S M"]:
        """Returns voltages with conductances Γ, S: V = (I + ZΓ)⁻¹ V0."""
        m = len(self.seen)
        drive = np.full((m, 1), float(self.rig.sensor.drive_voltage))
        return np.linalg.solve(np.eye(m) + self.seen @ to, drive)[..., 0]

    def grounded(self, grounds: np.ndarray) -> Float[np.ndarray, "S M M"]:
        """Returns Γ of slots with one ground each, through the rig's own paths."""
        to = np.zeros((len(grounds), len(self.seen), len(self.seen)))
        to[np.arange(len(grounds)), grounds, grounds] = 1 / self.rig.ground[grounds]
        return to


def loaded(rig: Rig, touches: Sequence[Touch], exact=None) -> Loaded:
    """Solves the sheet with contacts on it."""
    exact = network_of(rig) if exact is None else exact
    each = [(exact.weights(touch), touch.conductance) for touch in touches]
    m = rig.sensor.electrode_count
    seen, _ = exact.network._loaded(each, np.arange(m))
    return Loaded(rig, np.array([touch.xy for touch in touches]).reshape(-1, 2), seen)


def lone(sensor: Sensor, seed: int, rigs: int, each: int, place=None) -> list[Loaded]:
    """Lone contacts on usual rigs; `place` draws a place, anywhere by default."""
    rng, found = np.random.default_rng([seed, 51]), []
    for _ in range(rigs):
        rig = make_rig(sensor, "usual", rng)
        exact = network_of(rig)
        for _ in range(each):
            touch = draw_touch(sensor, "usual", rng)
            if place is not None:
                touch = touch._replace(xy=np.array(place(rng)))
            found.append(loaded(rig, [touch], exact))
    return found


def pairs(sensor: Sensor, seed: int, rigs: int, each: int, apart: float, ratio=1.0):
    """Two contacts at least `apart` from each other, m; one `ratio` times the other."""
    rng, found = np.random.default_rng([seed, 52]), []
    for _ in range(rigs):
        rig = make_rig(sensor, "usual", rng)
        exact = network_of(rig)
        while sum(scene.rig is rig for scene in found) < each:
            one, two = (draw_touch(sensor, "usual", rng) for _ in range(2))
            if np.hypot(*np.subtract(one.xy, two.xy)) < apart:
                continue
            if ratio != 1.0:
                one = one._replace(conductance=max(one.conductance, 3e-4))
                two = two._replace(conductance=one.conductance / ratio)
            found.append(loaded(rig, [one, two], exact))
    return found


Attack = Callable[[Loaded, np.ndarray, np.random.Generator], np.ndarray]


def _read(scene: Loaded, volts: np.ndarray, rng, **chain) -> np.ndarray:
    return replace(scene.rig.chain, **chain).read(volts, rng)


def sound(scene: Loaded, grounds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """As usual."""
    return _read(scene, scene.under(scene.grounded(grounds)), rng)


def _of_rig(scene: Loaded) -> np.random.Generator:
    """A fault is its rig's: the same in all of the rig's scenes."""
    return np.random.default_rng(int(1e9 * abs(scene.rig.place[0, 0])) + 7)


def neighbours(scene: Loaded, rng: np.random.Generator) -> tuple[int, int]:
    """Two electrodes side by side."""
    xy = np.asarray(scene.rig.sensor.electrode_xy, float)
    one = int(rng.integers(len(xy)))
    away = np.hypot(*(xy - xy[one]).T)
    near = np.flatnonzero((away > 0) & (away < 1.2 * scene.rig.sensor.mean_pitch))
    return one, int(rng.choice(near))


def short_of(one: int, other: int, resistance: float = 1.0) -> Attack:
    """A wire of so many Ω between two electrodes."""

    def attack(scene: Loaded, grounds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        to = scene.grounded(grounds)
        to[:, [one, other], [one, other]] += 1 / resistance
        to[:, [one, other], [other, one]] -= 1 / resistance
        return _read(scene, scene.under(to), rng)

    return attack


def shorted(scene: Loaded, grounds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """An electrode shorted to its neighbour, anywhere."""
    return short_of(*neighbours(scene, _of_rig(scene)))(scene, grounds, rng)


def shorted_ground(scene: Loaded, grounds: np.ndarray, rng) -> np.ndarray:
    """The electrode that is grounded first, shorted to its neighbour."""
    xy = np.asarray(scene.rig.sensor.electrode_xy, float)
    away = np.hypot(*(xy - xy[grounds[0]]).T)
    other = int(np.argsort(away)[1 + int(_of_rig(scene).integers(2))])
    return short_of(int(grounds[0]), other)(scene, grounds, rng)


def same_channel(scene: Loaded, grounds: np.ndarray, rng) -> np.ndarray:
    """A multiplexer whose address line sticks: one channel reads its neighbour."""
    v = sound(scene, grounds, rng)
    a, b = neighbours(scene, _of_rig(scene))
    noise = scene.rig.chain.noise
    v[:, a] = v[:, b] + noise * rng.normal(size=len(v))
    return v


def crosstalk(part: float, ways: Sequence[int] = (-1, 1), lost: bool = True) -> Attack:
    """`part` of the channels so many numbers away is in each; the channels are a ring."""

    def attack(scene: Loaded, grounds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        v = scene.under(scene.grounded(grounds))
        each = [np.roll(v, -way, 1) - (v if lost else 0) for way in ways]
        return _read(scene, v + part * sum(each), rng)

    return attack


def bits(count: int) -> Attack:
    """A converter of so many bits; unipolar."""

    def attack(scene: Loaded, grounds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        v = scene.under(scene.grounded(grounds))
        chain = scene.rig.chain
        v = v * chain.gain + chain.zero + chain.noise * rng.normal(size=v.shape)
        step = chain.full_scale / 2**count
        return np.clip(np.round(v / step), 0, 2**count - 1) * step

    return attack


def leaky(resistance: float) -> Attack:
    """A switch that does not open: so many Ω from one electrode to ground."""

    def attack(scene: Loaded, grounds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        to, e = scene.grounded(grounds), int(_of_rig(scene).integers(len(scene.seen)))
        to[:, e, e] = np.maximum(to[:, e, e], 1 / resistance)
        return _read(scene, scene.under(to), rng)

    return attack


def film(resistance: float) -> Attack:
    """A film of water: so many Ω from each electrode to ground."""

    def attack(scene: Loaded, grounds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        to = scene.grounded(grounds) + np.eye(len(scene.seen)) / resistance
        return _read(scene, scene.under(to), rng)

    return attack


def lifted(joint: float) -> Attack:
    """Four electrodes side by side hardly touch: so many Ω, beside a converter's 1 MΩ."""

    def attack(scene: Loaded, grounds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        v = scene.under(scene.grounded(grounds))
        xy = np.asarray(scene.rig.sensor.electrode_xy, float)
        size = np.asarray(scene.rig.sensor.size, float)
        middle = _of_rig(scene).uniform(0.2, 0.8, 2) * size
        off = np.argsort(np.hypot(*(xy - middle).T))[:4]
        off = off[~np.isin(off, grounds)]
        v[:, off] *= _INPUT / (_INPUT + joint)
        return _read(scene, v, rng)

    return attack


ATTACKS: dict[str, Attack] = {
    "none": sound,
    "short to a neighbour": shorted,
    "short of the grounded corner": shorted_ground,
    "one channel reads its neighbour": same_channel,
    "crosstalk 1 %": crosstalk(0.01),
    "crosstalk 0.5 %": crosstalk(0.005),
    "crosstalk 1 %, added": crosstalk(0.01, lost=False),
    "crosstalk 1 % from the channel before": crosstalk(0.01, (-1,)),
    "crosstalk 0.5 % from the channel before": crosstalk(0.005, (-1,)),
    "crosstalk 1 % from the next channel": crosstalk(0.01, (1,)),
    "8 bits": bits(8),
    "leaky switch, 1 kΩ": leaky(1e3),
    "leaky switch, 10 kΩ": leaky(1e4),
    "film, 50 kΩ": film(5e4),
    "lifted over four, 10 MΩ": lifted(1e7),
    "lifted over four, 1 MΩ": lifted(1e6),
}
