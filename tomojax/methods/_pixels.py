"""Groups a mesh's elements into the pixels of an image."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from tomojax._programs import kept
from tomojax._require import require
from tomojax.kernels.shapes import PixelSites
from tomojax.kernels.sheet import fem_shared_resistances, site_conductance
from tomojax.sensor import Sensor, sheet_on_mesh


class Pixels(NamedTuple):
    """Pixels as groups of elements on a mesh that is fine enough for the electrodes."""

    sensor: Sensor
    shape: tuple[int, int]
    cell: Float[Array, "2"]
    parts: Float[Array, " K"] | None  # of each element that is on the sheet; None: all

    def mean(self, values: jax.Array) -> Float[Array, "*before pixels"]:
        """Computes the mean over each pixel's elements, of values (..., K).

        Off the sheet it is 0.
        """
        if self.parts is None:
            return self._mean(values)
        covered = self._mean(self.parts)
        mean = self._mean(values * self.parts) / jnp.where(covered > 0, covered, 1)
        return jnp.where(covered > 0, mean, 0)

    def _mean(self, values: jax.Array) -> Float[Array, "*before pixels"]:
        (nx, ny), (mx, my) = self.shape, self.sensor.divisions
        split = values.reshape(*values.shape[:-1], nx, mx // nx, ny, my // ny, 2)
        return split.mean((-4, -2, -1)).reshape(*values.shape[:-1], nx * ny)

    @property
    def inside(self) -> Bool[Array, "nx ny"] | None:
        """Tells which pixels have some of the sheet; None: all of them."""
        if self.parts is None:
            return None
        return self._mean(self.parts).reshape(self.shape) > 0


def pixels_of(sensor: Sensor, shape: tuple[int, int], cells: int = 1) -> Pixels:
    """Makes pixels of `shape`; `cells` cells of the mesh are no wider than an electrode."""
    divisions = pixel_divisions(sensor, shape, cells)
    # A sheet with a value per element keeps the mesh that they are given on.
    if sensor.sheet_resistance.ndim:
        fits = all(m % n == 0 for m, n in zip(sensor.divisions, shape))
        require(fits, "grid", shape, f"divisors of the sensor's mesh, {sensor.divisions}")
    else:
        sensor = replace(sensor, divisions=divisions)
    cell = sensor.size / jnp.asarray(shape, sensor.dtype)
    return Pixels(sensor, shape, cell, sensor.parts())


def pixel_divisions(
    sensor: Sensor, shape: tuple[int, int], cells: int = 1
) -> tuple[int, int]:
    """Finds a mesh that divides pixels; `cells` cells are no wider than an electrode."""
    size = np.asarray(sensor.size, float)
    widest = float(sensor.electrode_diameter) / cells * (1 + 1e-5)
    finer = np.ceil(size / np.array(shape) / widest).astype(int)
    nx, ny = np.array(shape) * finer
    return int(nx), int(ny)


@kept
def pixel_sites(sensor: Sensor, shape: tuple[int, int]) -> PixelSites:
    """Computes resistances between all pixels and electrodes, for `reduce_sites`.

    A pixel's current is even over its nodes, except nodes on metal.
    """
    fem, (mx, my) = sheet_on_mesh(sensor), (m // n for m, n in zip(sensor.divisions, shape))
    part = sensor.parts()
    part = 1.0 if part is None else part

    def spread(pixel: Float[Array, "nx ny"]) -> Float[Array, " sites"]:
        each = jnp.repeat(jnp.repeat(pixel / (2 * mx * my), mx, 0), my, 1)
        return site_conductance(fem, jnp.repeat(each.ravel(), 2) * part, sensor.divisions)

    (n, m), pixels = fem.feeds.shape, shape[0] * shape[1]
    unit = jnp.eye(pixels, dtype=sensor.dtype).reshape(pixels, *shape)
    parts = jax.vmap(spread)(unit)
    on_sheet = parts[:, :n].sum(1)
    # A pixel all on metal has no current of its own: anything will do.
    none = on_sheet < jnp.finfo(on_sheet.dtype).eps ** 0.5
    own = jnp.where(
        none[:, None], 1 / n, parts[:, :n] / jnp.where(none, 1, on_sheet)[:, None]
    )
    shares = jnp.zeros((pixels + m, n + m), sensor.dtype)
    shares = shares.at[:pixels, :n].set(own)
    shares = shares.at[pixels:, n:].set(jnp.eye(m, dtype=sensor.dtype))
    _, table = fem_shared_resistances(fem, shares.T, sensor.divisions)
    return PixelSites(table, jnp.where(none, 0, on_sheet), parts[:, n:])
