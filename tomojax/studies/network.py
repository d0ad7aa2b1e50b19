"""A rig as a resistor network: voltages that no model of this package made.

Squares of the sheet, joined by resistors; electrodes as single nodes; sparse LU. What a
reconstruction is not told: its sheet varies, its electrodes are off their places, its
channels have gains, zeros and noise. For trials of accuracy (`tomojax frontier`).
"""

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from jaxtyping import Bool, Float

from tomojax.sensor import Sensor

# Sides of a square, of an electrode's diameter: the disc is 31 squares of 0.8 mm.
_SQUARE = 0.16

# The converter's: 16 bits over ±5 V.
_CODES_PER_VOLT, _LARGEST = 6553.6, 32768

Contact = tuple[Bool[np.ndarray, " cells"], float]


class Network:
    """`variation` of the sheet, rms; `offset` of electrodes at most, m; `noise` and zeros,
    V; `gain` of channels, rms; of a sensor with one sheet resistance."""

    def __init__(
        self,
        sensor: Sensor,
        rng: np.random.Generator,
        variation: float | int = 0.02,
        offset: float | int = 1.5e-4,
        noise: float | int = 3e-4,
        gain: float | int = 5e-4,
    ):
        self.rng, self.noise = rng, noise
        size = np.asarray(sensor.size, float)
        nominal = np.asarray(sensor.electrode_xy, float)
        radius = float(sensor.electrode_diameter) / 2
        self.drive, self.ground = float(sensor.drive_voltage), _one(sensor)
        self.cells, shape = _squares(size, 2 * _SQUARE * radius)
        waves = np.zeros(len(self.cells))
        for i, j in np.ndindex(4, 4):
            if i + j:
                wave = np.cos(np.pi * np.array([i, j]) / size * self.cells).prod(1)
                waves += rng.normal() / np.hypot(i, j) * wave
        resistance = float(np.mean(np.asarray(sensor.sheet_resistance)))
        self.sheet = resistance * (1 + variation * waves / waves.std())
        m = self.electrodes = len(nominal)
        places = nominal + np.clip(rng.normal(0, offset / 2, (m, 2)), -offset, offset)
        self.gain = 1 + gain * rng.normal(size=m)
        self.zero = noise * rng.normal(size=m)
        # All cells within an electrode are one node; those are the first m.
        node = np.full(len(self.cells), -1)
        for e, place in enumerate(places):
            node[((self.cells - place) ** 2).sum(1) <= radius**2] = e
        free = np.flatnonzero(node < 0)
        node[free] = m + np.arange(len(free))
        self.node, self.count = node, m + len(free)
        self.shape = shape
        self.network = _joined(self.sheet, node, shape, self.count)

    def resist(self, inside: Bool[np.ndarray, " cells"], factor: float | int) -> None:
        """The sheet's resistance there, so many times what it was: a tear, wear."""
        self.sheet = np.where(inside, factor, 1) * self.sheet
        self.network = _joined(self.sheet, self.node, self.shape, self.count)

    def scene(
        self, *contacts: Contact
    ) -> tuple[Float[np.ndarray, "m m"], list[tuple[Float[np.ndarray, "2"], float]]]:
        """Exact voltages (m grounds, m) and, of each contact, centre and conductance.

        A contact is (inside, S): a mask of the cells and its total conductance.
        """
        u, driven = self._loaded(contacts)
        current = driven / (self.ground + np.diagonal(u))
        truth = [(self.cells[inside].mean(0), total) for inside, total in contacts]
        return driven - current[:, None] * u, truth

    def shared(
        self, to_ground: Float[np.ndarray, "slots m"], *contacts: Contact
    ) -> Float[np.ndarray, "slots m"]:
        """Exact voltages with conductances, S, to ground."""
        u, driven = self._loaded(contacts)
        unit = np.eye(self.electrodes)
        return np.stack([np.linalg.solve(unit + u * g, driven) for g in to_ground])

    def _loaded(self, contacts: Sequence[Contact]) -> tuple[np.ndarray, np.ndarray]:
        """Of currents into electrodes (m, m), and of the drive (m,); nothing grounded."""
        g = np.zeros(self.count)
        for inside, total in contacts:
            np.add.at(g, self.node[inside], total / inside.sum())
        m = self.electrodes
        loads = np.zeros((self.count, m + 1))
        loads[np.arange(m), np.arange(m)] = 1
        loads[:, m] = g * self.drive
        u = spla.splu((self.network + sp.diags_array(g)).tocsc()).solve(loads)[:m]
        return u[:, :m], u[:, m]

    def measure(self, volts: np.ndarray) -> np.ndarray:
        """As the converter reads them."""
        read = volts * self.gain + self.zero
        read = read + self.noise * self.rng.normal(size=volts.shape)
        codes = np.clip(np.round(read * _CODES_PER_VOLT), -_LARGEST, _LARGEST - 1)
        return codes / _CODES_PER_VOLT

    def disc(self, xy: Sequence[float] | np.ndarray, radius: float | int) -> np.ndarray:
        """The cells in a disc."""
        return np.hypot(*(self.cells - np.asarray(xy)).T) <= radius

    def ring(self, xy: Sequence[float] | np.ndarray, inner: float, outer: float):
        """The cells between two circles."""
        return self.disc(xy, outer) & ~self.disc(xy, inner)

    def bar(
        self, xy: Sequence[float] | np.ndarray, length: float, width: float, angle: float
    ) -> np.ndarray:
        """The cells in a bar."""
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        along, across = np.abs((self.cells - np.asarray(xy)) @ turn).T
        return (along <= length / 2) & (across <= width / 2)


def _one(sensor: Sensor) -> float:
    return float(np.mean(np.asarray(sensor.ground_resistance)))


def _squares(size: np.ndarray, side: float) -> tuple[np.ndarray, tuple[int, int]]:
    """Centres of squares that fill the sheet, and how many along each side."""
    nx, ny = (max(8, round(float(length) / side)) for length in size)
    x, y = ((np.arange(n) + 0.5) * length / n for n, length in zip((nx, ny), size))
    return np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2), (nx, ny)


def _joined(
    sheet: np.ndarray, node: np.ndarray, shape: tuple[int, int], count: int
) -> sp.csc_array:
    """The network's matrix: neighbours joined by the mean of their resistances."""
    index = np.arange(len(sheet)).reshape(shape)
    pairs = np.concatenate(
        [
            np.stack([index[1:].ravel(), index[:-1].ravel()]),
            np.stack([index[:, 1:].ravel(), index[:, :-1].ravel()]),
        ],
        1,
    )
    c = 2 / sheet[pairs].sum(0)
    a, b = node[pairs]
    a, b, c = (v[a != b] for v in (a, b, c))
    rows, columns = np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a])
    values = np.concatenate([c, c, -c, -c])
    return sp.csc_array((values, (rows, columns)), (count,) * 2)
