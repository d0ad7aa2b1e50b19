"""A rig as a resistor network, with shapes for contacts and laws for their currents."""

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from jaxtyping import Float, Integer

from bench.network import factor, Network
from bench.rigs._rig import Rig
from bench.rigs._shapes import Touch
from bench.rigs._strokes import Strokes

# Steps of the fixed point, how many share a factor, and how much of the current the last
# one may change.
_STEPS, _SHARE, _SETTLED = 200, 4, 1e-6


class Networked:
    """The exact voltages of a rig by `Network`; `fine` as in `Network.built`."""

    def __init__(self, rig: Rig, fine: float | int = 1.0):
        self.rig = rig
        self.network = Network.built(
            rig.sensor, rig.sheet, rig.place, rig.radius, rig.contact, rig.ground, fine
        )

    def touched(
        self, touch: Touch | Strokes, grounds: Integer[np.ndarray, " S"]
    ) -> Float[np.ndarray, "S M"]:
        """Returns exact voltages, V, under some grounds."""
        weights = self.weights(touch)
        if touch.exponent == 1:
            contact = weights, touch.conductance
            return self.network.under(grounds, contact, series=touch.series)
        g = np.bincount(self.network.node, weights, self.network.count)
        g = g * (touch.conductance / weights.sum())
        return np.stack([self._under_law(touch, g, int(e)) for e in grounds])

    def weights(self, touch: Touch | Strokes) -> Float[np.ndarray, " cells"]:
        """Returns the part of the contact's conductance that each cell has, relative."""
        cells = self.network.cells
        near = np.hypot(*(cells - touch.xy).T) <= max(touch.half_axes) + self.network.width
        weights = np.zeros(len(cells))
        weights[near] = self.network.average(touch.density, cells[near])
        if not weights.sum() > 0:
            raise ValueError(f"xy: got {touch.xy}, expected a contact on the sheet")
        return weights

    def _under_law(self, touch: Touch | Strokes, g: np.ndarray, ground: int) -> np.ndarray:
        """Finds the voltages under one ground by a fixed point of each node's conductance.

        A current I drawn from the ground lowers node k by I (series + u_k) below V0. The
        same current lowers the object by I·series. The law takes the voltage between them,
        I u_k. In logarithms a step goes the 1/n-th part of the way. That is the whole way
        where the current is given.
        """
        drive, n = self.network.drive, touch.exponent
        matrix = self.network.network
        drawn = np.zeros(len(g))
        drawn[ground] = 1
        fed = g > 0
        law, u, near = g.copy(), None, None
        for step in range(_STEPS):
            system = (matrix + sp.diags_array(law)).tocsc()
            if step % _SHARE == 0:
                solve = factor(system).solve
                near = spla.LinearOperator(matrix.shape, solve)
            u, failed = spla.cg(system, drawn, u, rtol=1e-10, M=near, maxiter=500)
            if failed:
                break
            own = self.network.ground[ground] + touch.series + u[ground]
            drop = np.maximum(np.abs(u[fed] / own), 1e-12)  # of the drive
            wanted = g[fed] * drop ** (n - 1)
            change = np.abs(wanted - law[fed]) @ drop
            settled = change <= _SETTLED * (law[fed] @ drop)
            law[fed] = law[fed] ** (1 - 1 / n) * wanted ** (1 / n)
            if settled:
                return drive * (1 - (touch.series + u[: self.network.electrodes]) / own)
        raise RuntimeError(f"exponent: got {n}, with which the network found no solution")


def network_of(rig: Rig, fine: float | int = 1.0) -> Networked:
    """Returns the rig as a resistor network."""
    return Networked(rig, fine)
