"""A rig as a resistor network: voltages that no model of this package made.

Resistors join squares of the sheet, electrodes are single nodes, and sparse LU solves. A
reconstruction is not told the rig's errors. The sheet varies, electrodes are off their
places, and channels have gains, zeros and noise. `tomojax frontier` tries accuracy on these
rigs.
"""

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from jaxtyping import Bool, Float, Integer
from scipy.linalg import solve_triangular

from tomojax.sensor import Sensor

# Sides of a square, of an electrode's diameter: the disc is 31 squares of 0.8 mm.
_SQUARE = 0.16

# The paper's converter: 16 bits over ±5 V, of a drive of 4.5 V.
_CODES, _RANGE = 1 << 16, 5 / 4.5

# Noise and zeros, of the drive (0.3 mV); electrodes off their places, of their diameter.
_NOISE, _OFFSET = 3e-4 / 4.5, 0.03

# Relative conductance per cell, and the total, S.
Contact = tuple[Bool[np.ndarray, " cells"] | Float[np.ndarray, " cells"], float]


class Network:
    """A rig with errors that are drawn, of a sensor with one sheet resistance.

    **Arguments:** `variation` of the sheet, rms; `offset` of electrodes at most, m; `noise`
    and zeros, V; `gain` of channels, rms. `offset` and `noise` follow the electrodes'
    diameter and the drive by default. The `rigs` beside this module draw more. They give
    `sheet`, `place`, `radius`, `contact` and `ground` to `built`.
    """

    def __init__(
        self,
        sensor: Sensor,
        rng: np.random.Generator,
        variation: float | int = 0.02,
        offset: float | int | None = None,
        noise: float | int | None = None,
        gain: float | int = 5e-4,
    ):
        size = np.asarray(sensor.size, float)
        nominal = np.asarray(sensor.electrode_xy, float)
        diameter = float(sensor.electrode_diameter)
        self.drive = float(sensor.drive_voltage)
        offset = _OFFSET * diameter if offset is None else offset
        noise = _NOISE * abs(self.drive) if noise is None else noise
        self.rng, self.noise = rng, noise
        self.cells, shape, self._side = _squares(size, _SQUARE * diameter)
        waves = np.zeros(len(self.cells))
        for i, j in np.ndindex(4, 4):
            if i + j:
                wave = np.cos(np.pi * np.array([i, j]) / size * self.cells).prod(1)
                waves += rng.normal() / np.hypot(i, j) * wave
        resistance = float(np.mean(np.asarray(sensor.sheet_resistance)))
        sheet = resistance * (1 + variation * waves / waves.std())
        m = len(nominal)
        places = nominal + np.clip(rng.normal(0, offset / 2, (m, 2)), -offset, offset)
        self.gain = 1 + gain * rng.normal(size=m)
        self.zero = noise * rng.normal(size=m)
        self.full_scale, self.codes = _RANGE * abs(self.drive), _CODES
        ground = np.broadcast_to(np.asarray(sensor.ground_resistance, float), m)
        self._build(shape, sheet, places, np.full(m, diameter / 2), np.zeros(m), ground)

    @classmethod
    def built(
        cls,
        sensor: Sensor,
        sheet: Callable[[np.ndarray], np.ndarray],
        place: Float[np.ndarray, "m 2"],
        radius: Float[np.ndarray, " m"],
        contact: Float[np.ndarray, " m"],
        ground: Float[np.ndarray, " m"],
        fine: float | int = 1.0,
    ) -> "Network":
        """Makes a rig of given parts.

        - `sheet`: resistance by place, Ω/sq.
        - `place` and `radius`: centres and radii of the faces that touch the sheet, m.
        - `contact`: resistances between faces and sheet, Ω.
        - `ground`: resistances of the ground paths, Ω.
        - `fine`: how many times smaller the squares are than usual; rims cut resistors.

        The rig is not told how voltages are read, so `measure` does not work on it.
        """
        new = cls.__new__(cls)
        new.drive = float(sensor.drive_voltage)
        side = _SQUARE * float(sensor.electrode_diameter) / fine
        new.cells, shape, new._side = _squares(np.asarray(sensor.size, float), side)
        new._build(shape, sheet(new.cells), place, radius, contact, ground, cut=True)
        return new

    @property
    def width(self) -> float:
        """Width of a cell, m."""
        return float(self._side.max())

    def average(
        self, density: Callable[[np.ndarray], np.ndarray], within: Float[np.ndarray, "n 2"]
    ) -> Float[np.ndarray, " n"]:
        """Returns means of a density over the cells with these centres, by 6 × 6 points."""
        part = (np.arange(6) + 0.5) / 6 - 0.5
        points = np.stack(np.meshgrid(part, part), -1).reshape(-1, 1, 2) * self._side
        found = density((points + within).reshape(-1, 2))
        return found.reshape(len(points), -1).mean(0)

    def _build(self, shape, sheet, place, radius, contact, ground, cut=False) -> None:
        self.shape, self.sheet, self.ground = shape, sheet, ground
        m = self.electrodes = len(place)
        # All cells below a face are its node, the first m; below one with a resistance
        # of its own they stay apart and are joined to it.
        node = np.full(len(self.cells), -1)
        faces = []
        for e in range(m):
            away = np.hypot(*(self.cells - place[e]).T)
            if contact[e] > 0:
                near = np.flatnonzero(away <= max(radius[e] + self.width, away.min()))
                share = self._shares(near, place[e], radius[e])
                faces.append((near, np.full(len(near), e), share / contact[e]))
            else:
                node[away <= max(radius[e], away.min())] = e
        free = np.flatnonzero(node < 0)
        node[free] = m + np.arange(len(free))
        self.node, self.count = node, m + len(free)
        cell, face, share = (np.concatenate(v) for v in zip(*faces)) if faces else [[]] * 3
        self._faces = node[np.array(cell, int)], np.array(face, int), np.array(share, float)
        self._pairs, self._squareness = _neighbours(shape, self._side)
        if cut:
            self._squareness /= self._outside(place, radius)
        self.network = self._joined()

    def _shares(self, near: np.ndarray, place: np.ndarray, radius: float) -> np.ndarray:
        """Returns the part of a face on each of some cells; all on the nearest if tiny."""

        def inside(points: np.ndarray) -> np.ndarray:
            return (np.hypot(*(points - place).T) <= radius).astype(float)

        area = self.average(inside, self.cells[near])
        if area.sum() == 0:
            away = np.hypot(*(self.cells[near] - place).T)
            area = (away == away.min()).astype(float)
        return area / area.sum()

    def _outside(self, place: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Returns the part of each resistor that lies outside the face at one of its ends.

        Without this cut, a face acts as if it were smaller by a quarter of a square. The
        error is 1 % of the largest voltage, and 5 % for faces of 3 mm.
        """
        part = np.ones(self._pairs.shape[1])
        for a, b in (self._pairs, self._pairs[::-1]):
            e, other = self.node[a], self.node[b]
            rim = np.flatnonzero((e < len(place)) & (other != e))
            e = e[rim]
            step = self.cells[b[rim]] - self.cells[a[rim]]
            start = self.cells[a[rim]] - place[e]
            # |start + t·step| = radius
            square, mixed = (step**2).sum(1), (step * start).sum(1)
            rest = (start**2).sum(1) - radius[e] ** 2
            t = (np.sqrt(np.maximum(mixed**2 - square * rest, 0)) - mixed) / square
            part[rim] -= np.clip(t, 0, 1)
        return np.maximum(part, 0.02)

    def resist(self, inside: Bool[np.ndarray, " cells"], factor: float | int) -> None:
        """Multiplies the sheet's resistance `inside` by `factor`: a tear, wear."""
        self.sheet = np.where(inside, factor, 1) * self.sheet
        self.network = self._joined()

    def _joined(self) -> sp.csc_array:
        """Returns the network's matrix: the mean resistance joins two neighbours."""
        c = self._squareness * 2 / self.sheet[self._pairs].sum(0)
        a, b = self.node[self._pairs]
        a, b, c = (v[a != b] for v in (a, b, c))
        a, b, c = (np.concatenate([v, w]) for v, w in zip((a, b, c), self._faces))
        rows, columns = np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a])
        values = np.concatenate([c, c, -c, -c])
        return sp.csc_array((values, (rows, columns)), (self.count,) * 2)

    def scene(
        self, *contacts: Contact
    ) -> tuple[Float[np.ndarray, "m m"], list[tuple[Float[np.ndarray, "2"], float]]]:
        """Returns exact voltages (m grounds, m), and each contact's centre and conductance.

        A contact is (inside, S): a mask of the cells, or each cell's part of the
        conductance, and the total.
        """
        volts = self.under(np.arange(self.electrodes), *contacts)
        truth = [
            (np.average(self.cells, 0, np.asarray(inside, float)), total)
            for inside, total in contacts
        ]
        return volts, truth

    def under(
        self, grounds: Integer[np.ndarray, " n"], *contacts: Contact, series: float = 0.0
    ) -> Float[np.ndarray, "n m"]:
        """Returns exact voltages under some grounds; `series`: Ω from drive to object."""
        u, driven = self._loaded(contacts, grounds, series)
        own = np.arange(len(grounds)), grounds
        current = driven[grounds] / (self.ground[grounds] + u[own])
        return driven - current[:, None] * u

    def shared(
        self, to_ground: Float[np.ndarray, "slots m"], *contacts: Contact
    ) -> Float[np.ndarray, "slots m"]:
        """Returns exact voltages with conductances, S, to ground."""
        u, driven = self._loaded(contacts, np.arange(self.electrodes))
        unit = np.eye(self.electrodes)
        return np.stack([np.linalg.solve(unit + u * g, driven) for g in to_ground])

    def _loaded(
        self, contacts: Sequence[Contact], grounds: np.ndarray, series: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns voltages of unit currents into the grounds (n, m), and of the drive (m,).

        Nothing is grounded.
        """
        g = np.zeros(self.count)
        for inside, total in contacts:
            np.add.at(g, self.node, total * (inside / inside.sum()))
        if not g.any():  # no current flows; the matrix is singular
            return np.zeros((len(grounds), self.electrodes)), np.zeros(self.electrodes)
        u, driven = self._solved(g)
        u = u[grounds]
        # A current out of the ground comes through what is in series with the object, too.
        return u + series, self.drive * driven

    def _solved(self, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns voltages of unit currents into each electrode (m, m), and of `g` at 1 V.

        Electrodes are eliminated last. What is left for them is the last block of the
        factors: no current needs a solve of the whole network.
        """
        m, rest = self.electrodes, self.count - self.electrodes
        order = self._order
        matrix = (self.network + sp.diags_array(g)).tocsc()
        lu = factor(matrix[order][:, order].tocsc(), "NATURAL")
        row, column = lu.perm_r[rest:] - rest, lu.perm_c[rest:] - rest
        assert min(*row, *column) >= 0  # all squares hang together
        lower, upper = (one[rest:, rest:].toarray() for one in (lu.L, lu.U))
        inner = solve_triangular(lower, np.eye(m), lower=True, unit_diagonal=True)
        u = solve_triangular(upper, inner)[column][:, row]
        return u.T, lu.solve(g[order])[rest:]

    @cached_property
    def _order(self) -> np.ndarray:
        """The nodes in the order in which they are eliminated, whatever the contacts."""
        m = self.electrodes
        inside = factor(self.network[m:, m:].tocsc()).perm_c
        return np.concatenate([m + np.argsort(inside), np.arange(m)])

    def measure(self, volts: np.ndarray) -> np.ndarray:
        """Returns voltages as the converter reads them."""
        read = volts * self.gain + self.zero
        read = read + self.noise * self.rng.normal(size=volts.shape)
        per_volt, half = self.codes / (2 * self.full_scale), self.codes // 2
        return np.clip(np.round(read * per_volt), -half, half - 1) / per_volt

    def disc(self, xy: Sequence[float] | np.ndarray, radius: float | int) -> np.ndarray:
        """Returns the cells in a disc."""
        return np.hypot(*(self.cells - np.asarray(xy)).T) <= radius

    def ring(self, xy: Sequence[float] | np.ndarray, inner: float, outer: float):
        """Returns the cells between two circles."""
        return self.disc(xy, outer) & ~self.disc(xy, inner)

    def bar(
        self, xy: Sequence[float] | np.ndarray, length: float, width: float, angle: float
    ) -> np.ndarray:
        """Returns the cells in a bar."""
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        along, across = np.abs((self.cells - np.asarray(xy)) @ turn).T
        return (along <= length / 2) & (across <= width / 2)


def factor(matrix: sp.csc_array, order: str = "MMD_AT_PLUS_A") -> spla.SuperLU:
    """Factors a symmetric positive matrix without looking for pivots: half the fill."""
    options = {"SymmetricMode": True}
    return spla.splu(matrix, order, diag_pivot_thresh=0.0, options=options)


def _squares(
    size: np.ndarray, side: float
) -> tuple[np.ndarray, tuple[int, int], np.ndarray]:
    """Returns centres of squares that fill the sheet, how many along each side, and sides.

    The cells are rectangles where no squares fill the sheet.
    """
    nx, ny = (max(8, round(float(length) / side)) for length in size)
    x, y = ((np.arange(n) + 0.5) * length / n for n, length in zip((nx, ny), size))
    cells = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    return cells, (nx, ny), size / (nx, ny)


def _neighbours(shape: tuple[int, int], side: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns pairs of neighbours (2, n), and the width over length of their resistors."""
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    along_x = np.stack([index[1:].ravel(), index[:-1].ravel()])
    along_y = np.stack([index[:, 1:].ravel(), index[:, :-1].ravel()])
    wide = side[1] / side[0]
    counts = along_x.shape[1], along_y.shape[1]
    return np.concatenate([along_x, along_y], 1), np.repeat([wide, 1 / wide], counts)
