"""Describes a rig as it really is, for each model to take, and draws rigs."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tomojax.sensor import Sensor

# Random waves that a sheet's unevenness is a sum of: its spectrum is told by as many.
_WAVES = 400

Sheet = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]


@dataclass(frozen=True)
class Chain:
    """How the voltages of M channels are read, slot after slot."""

    gain: Float[np.ndarray, " M"]
    zero: Float[np.ndarray, " M"]  # V
    noise: float  # V rms
    full_scale: float  # V
    bits: int = 16
    hum: float = 0.0  # amplitude, V, the same in all channels
    hum_frequency: float = 0.005  # of the slots' rate: 50 Hz at 10 kHz
    drift: float = 0.0  # of all zeros, V: a random walk's step in a slot
    crosstalk: float = 0.0  # part of the channel before that is read
    settling: float = 0.0  # part of the slot before that is still there

    def read(
        self, volts: Float[np.ndarray, "*before S M"], rng: np.random.Generator
    ) -> Float[np.ndarray, "*before S M"]:
        """Reads slots that follow each other; the slot before the first is like the first.

        The last channel of the slot before is read just before a slot's first channel.
        """
        v = (1 - self.settling) * volts + self.settling * _slot_before(volts)
        last = _slot_before(v)[..., -1:]
        v = v + self.crosstalk * (np.concatenate([last, v[..., :-1]], -1) - v)
        v = v * self.gain + self.zero + self.noise * rng.normal(size=v.shape)
        slots = np.arange(v.shape[-2])[:, None]
        phase = rng.uniform(0, 2 * np.pi, (*v.shape[:-2], 1, 1))
        v = v + self.hum * np.sin(2 * np.pi * self.hum_frequency * slots + phase)
        steps = self.drift * rng.normal(size=(*v.shape[:-1], 1))
        v = v + steps.cumsum(-2)
        per_volt, half = 2 ** (self.bits - 1) / self.full_scale, 2 ** (self.bits - 1)
        return np.clip(np.round(v * per_volt), -half, half - 1) / per_volt


def _slot_before(volts: np.ndarray) -> np.ndarray:
    return np.concatenate([volts[..., :1, :], volts[..., :-1, :]], -2)


@dataclass(frozen=True)
class Rig:
    """A rig as it is; `sensor` has the nominal values, which alone are told to a method."""

    sensor: Sensor
    sheet: Sheet  # Ω/sq at points (n, 2), m
    place: Float[np.ndarray, "M 2"]  # of the faces that touch the sheet, m
    radius: Float[np.ndarray, " M"]  # of these faces, m
    contact: Float[np.ndarray, " M"]  # between face and sheet, Ω; 0: one potential
    ground: Float[np.ndarray, " M"]  # of each ground path, Ω
    chain: Chain


def draw_rig(
    sensor: Sensor,
    rng: np.random.Generator,
    *,
    uneven: float = 0.02,
    patch: float | None = None,
    stretch: float = 1.0,
    gradient: float = 0.0,
    seam: float = 0.0,
    off: float = 0.03,
    face: tuple[float, float] = (1.0, 0.0),
    decentred: float = 0.0,
    contact: float = 0.0,
    more_ground: float = 0.0,
    unlike_grounds: float = 0.0,
    gain: float = 5e-4,
    noise: float = 6.7e-5,
    **chain: Any,
) -> Rig:
    """Draws a rig from stated distributions.

    **Arguments:**

    - `uneven`: rms of the sheet's resistance, normal with a Gaussian covariance. Its length
      is `patch` (m; a quarter of the sheet by default), `stretch` times longer along x.
    - `gradient`: from one side to the other, of the mean.
    - `seam`: of a strip an electrode wide, anywhere.
    - `off`: σ of electrodes along each axis, of their diameter.
    - `face`: the part of a disc's radius that touches, mean and spread (uniform).
    - `decentred`: how far a face is off its disc's centre, of the room that is left.
    - `contact`: the mean of an exponential distribution, Ω.
    - `more_ground`: Ω more in each ground path; `unlike_grounds`: σ of ln of each path.
    - `gain`: rms; `noise`: of noise and zeros, of the drive; `chain`: as in `Chain`.
    """
    m, diameter = sensor.electrode_count, float(sensor.electrode_diameter)
    size, drive = np.asarray(sensor.size, float), abs(float(sensor.drive_voltage))
    sheet = _sheet(sensor, rng, uneven, patch, stretch, gradient, seam)
    part = np.clip(face[0] + face[1] * rng.uniform(-1, 1, m), 0.1, 1.0)
    radius = part * diameter / 2
    turn, far = rng.uniform(0, 2 * np.pi, m), decentred * np.sqrt(rng.uniform(0, 1, m))
    beside = (diameter / 2 - radius) * far * np.stack([np.cos(turn), np.sin(turn)])
    place = np.asarray(sensor.electrode_xy, float) + beside.T
    place = place + np.clip(off * rng.normal(size=(m, 2)), -2 * off, 2 * off) * diameter
    place = np.clip(place, radius[:, None], size - radius[:, None])
    nominal = np.broadcast_to(np.asarray(sensor.ground_resistance, float), m)
    ground = (nominal + more_ground) * np.exp(unlike_grounds * rng.normal(size=m))
    touching = contact * rng.exponential(size=m)
    channels = 1 + gain * rng.normal(size=m), noise * drive * rng.normal(size=m)
    given: dict[str, Any] = {"noise": noise * drive, "full_scale": drive / 0.9}
    return Rig(
        sensor, sheet, place, radius, touching, ground, Chain(*channels, **given | chain)
    )


def _sheet(sensor, rng, uneven, patch, stretch, gradient, seam) -> Sheet:
    size = np.asarray(sensor.size, float)
    nominal = float(np.mean(np.asarray(sensor.sheet_resistance)))
    length = (patch or size.min() / 4) * np.array([stretch, 1.0])
    waves = rng.normal(size=(_WAVES, 2)) / length
    phase = rng.uniform(0, 2 * np.pi, _WAVES)
    uphill, along = (rng.uniform(0, 2 * np.pi) for _ in range(2))
    through = size * rng.uniform(0.2, 0.8, 2)
    wide = float(sensor.electrode_diameter)

    def waved(points: np.ndarray) -> np.ndarray:
        return np.sqrt(2 / _WAVES) * np.cos(points @ waves.T + phase).sum(1)

    # What is drawn has the stated rms, not its expectation alone.
    some = waved(rng.uniform(0, 1, (2000, 2)) * size)

    def sheet(points: np.ndarray) -> np.ndarray:
        # Block by block: a model has 10⁵ points.
        blocks = np.array_split(points, -(-len(points) // 4096))
        relative = np.concatenate([waved(b) for b in blocks])
        relative = uneven * (relative - some.mean()) / some.std()
        slope = (points / size - 0.5) @ np.array([np.cos(uphill), np.sin(uphill)])
        away = (points - through) @ np.array([np.cos(along), np.sin(along)])
        strip = seam * np.exp(-((2 * away / wide) ** 2))
        return nominal * (1 + np.maximum(relative + gradient * slope + strip, -0.7))

    return sheet
