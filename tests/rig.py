"""A rig that is not ours: `bench.network` with the paper's sensor.

Its model is no other's: squares instead of elements, SciPy's LU instead of our solves.
"""

import numpy as np

import tomojax as tx
from bench.network import Network

SIDE = 0.16
NOMINAL = 0.01 + 0.02 * np.indices((8, 8)).reshape(2, -1).T


class Rig(Network):
    """With electrodes at `nominal` places, m; nominal values alone are told to a method."""

    def __init__(
        self, rng, variation=0.02, offset=1.5e-4, noise=3e-4, gain=5e-4, nominal=NOMINAL
    ):
        sensor = tx.Sensor([SIDE, SIDE], nominal, divisions=(64, 64))
        super().__init__(sensor, rng, variation, offset, noise, gain)
