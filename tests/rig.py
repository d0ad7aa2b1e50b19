"""A rig that is not ours: a resistor network on squares, electrodes as single nodes.

Its sheet varies, its electrodes are off their places, its channels have gains, offsets
and noise. What reconstructs is told nominal values alone.
"""

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

SIDE, CELLS, DRIVE, GROUND = 0.16, 200, 4.5, 4.0
NOMINAL = 0.01 + 0.02 * np.indices((8, 8)).reshape(2, -1).T


class Rig:
    """`variation` of the sheet, rms; `offset` of electrodes, m; `noise` and zero, V.

    `nominal` places of electrodes, m, which are discs of 5 mm.
    """

    def __init__(
        self, rng, variation=0.02, offset=1.5e-4, noise=3e-4, gain=5e-4, nominal=NOMINAL
    ):
        self.rng, self.noise, h = rng, noise, SIDE / CELLS
        x = (np.arange(CELLS) + 0.5) * h
        self.cells = np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2)
        waves = np.zeros(len(self.cells))
        for i, j in np.ndindex(4, 4):
            if i + j:
                wave = np.cos(np.pi * np.array([i, j]) / SIDE * self.cells).prod(1)
                waves += rng.normal() / np.hypot(i, j) * wave
        self.sheet = sheet = 10e3 * (1 + variation * waves / waves.std())
        m = self.electrodes = len(nominal)
        places = nominal + np.clip(rng.normal(0, offset / 2, (m, 2)), -offset, offset)
        self.gain = 1 + gain * rng.normal(size=m)
        self.zero = noise * rng.normal(size=m)
        # All cells within an electrode are one node; those are the first m.
        node = np.full(len(self.cells), -1)
        for e, place in enumerate(places):
            node[((self.cells - place) ** 2).sum(1) <= 0.0025**2] = e
        free = np.flatnonzero(node < 0)
        node[free] = m + np.arange(len(free))
        self.node, self.count = node, m + len(free)
        index = np.arange(len(self.cells)).reshape(CELLS, CELLS)
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
        self.network = sp.csc_array(
            (np.concatenate([c, c, -c, -c]), (rows, columns)), (self.count,) * 2
        )

    def scene(self, *contacts):
        """Exact voltages (m grounds, m) and, of each contact, centre and conductance.

        A contact is (inside, S): a mask of the cells and its total conductance.
        """
        u, driven = self._loaded(contacts)
        current = driven / (GROUND + np.diagonal(u))
        truth = [(self.cells[inside].mean(0), total) for inside, total in contacts]
        return driven - current[:, None] * u, truth

    def shared(self, to_ground, *contacts):
        """Exact voltages (slots, m) with conductances (slots, m), S, to ground."""
        u, driven = self._loaded(contacts)
        unit = np.eye(self.electrodes)
        return np.stack([np.linalg.solve(unit + u * g, driven) for g in to_ground])

    def _loaded(self, contacts):
        """Of currents into electrodes (m, m), and of the drive (m,); nothing grounded."""
        g = np.zeros(self.count)
        for inside, total in contacts:
            np.add.at(g, self.node[inside], total / inside.sum())
        m = self.electrodes
        loads = np.zeros((self.count, m + 1))
        loads[np.arange(m), np.arange(m)] = 1
        loads[:, m] = g * DRIVE
        u = spla.splu((self.network + sp.diags_array(g)).tocsc()).solve(loads)[:m]
        return u[:, :m], u[:, m]

    def measure(self, volts):
        """As the converter reads them: 16 bits over ±5 V."""
        read = volts * self.gain + self.zero
        read = read + self.noise * self.rng.normal(size=volts.shape)
        return np.clip(np.round(read * 6553.6), -32768, 32767) / 6553.6

    def disc(self, xy, radius):
        """The cells in a disc."""
        return np.hypot(*(self.cells - xy).T) <= radius

    def ring(self, xy, inner, outer):
        """The cells between two circles."""
        return self.disc(xy, outer) & ~self.disc(xy, inner)

    def bar(self, xy, length, width, angle):
        """The cells in a bar."""
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        along, across = np.abs((self.cells - xy) @ turn).T
        return (along <= length / 2) & (across <= width / 2)
