"""Pixels of an image as groups of a mesh's elements."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax._require import require
from tomojax.sensor import Sensor


class Pixels(NamedTuple):
    """Pixels as groups of elements on a mesh that is fine enough for the electrodes."""

    sensor: Sensor
    shape: tuple[int, int]
    cell: Float[Array, "2"]

    def mean(self, values: jax.Array) -> Float[Array, "*before pixels"]:
        """The mean over the elements of each pixel, of values (..., K)."""
        (nx, ny), (mx, my) = self.shape, self.sensor.divisions
        split = values.reshape(*values.shape[:-1], nx, mx // nx, ny, my // ny, 2)
        return split.mean((-4, -2, -1)).reshape(*values.shape[:-1], nx * ny)


def pixels_of(sensor: Sensor, shape: tuple[int, int], cells: int = 1) -> Pixels:
    """Pixels of `shape`, with the mesh refined until `cells` are no wider than a disc."""
    divisions = pixel_divisions(sensor, shape, cells)
    # A sheet with a value per element keeps the mesh that they are given on.
    if sensor.sheet_resistance.ndim:
        fits = all(m % n == 0 for m, n in zip(sensor.divisions, shape))
        require(fits, "grid", shape, f"divisors of the sensor's mesh, {sensor.divisions}")
    else:
        sensor = replace(sensor, divisions=divisions)
    cell = sensor.size / jnp.asarray(shape, sensor.dtype)
    return Pixels(sensor, shape, cell)


def pixel_divisions(
    sensor: Sensor, shape: tuple[int, int], cells: int = 1
) -> tuple[int, int]:
    """A mesh whose cells are parts of pixels; so many are no wider than an electrode."""
    size = np.asarray(sensor.size, float)
    widest = float(sensor.electrode_diameter) / cells * (1 + 1e-5)
    finer = np.ceil(size / np.array(shape) / widest).astype(int)
    nx, ny = np.array(shape) * finer
    return int(nx), int(ny)
