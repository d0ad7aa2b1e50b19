"""Makes maps from currents to a slot's voltages and back, on the host in float64.

`Pixels` groups a mesh's elements into the pixels of an image.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from tomojax._programs import kept
from tomojax._require import require
from tomojax.kernels.algebra import matmul
from tomojax.kernels.shapes import PixelSites
from tomojax.kernels.sheet import fem_shared_resistances, site_conductance, Slots
from tomojax.sensor import box_in_space, resistances, Sensor, sheet_on_mesh


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
        covered: Array = self._mean(self.parts)
        mean: Array = self._mean(values * self.parts) / jnp.where(covered > 0, covered, 1)
        return jnp.where(covered > 0, mean, 0)

    def _mean(self, values: Any) -> Any:
        (nx, ny), (mx, my) = self.shape, self.sensor.divisions
        split = values.reshape(*values.shape[:-1], nx, mx // nx, ny, my // ny, 2)
        return split.mean((-4, -2, -1)).reshape(*values.shape[:-1], nx * ny)

    @property
    def inside(self) -> Bool[Array, "nx ny"] | None:
        """Tells which pixels have some of the sheet; None: all of them."""
        if self.parts is None:
            return None
        return jnp.asarray(self._mean(np.asarray(self.parts)).reshape(self.shape) > 0)


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
    widest = float(sensor.electrode_diameter) / cells * (1 + 1e-5)
    finer = np.ceil(box_in_space(sensor) / np.array(shape) / widest).astype(int)
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


A = TypeVar("A", Array, np.ndarray)

# Squares of singular values hold these down to this part of the strongest's.
_ROUNDING = 1e-9

# Rows whose singular values are all computed where one is asked for.
_FEW = 256


class Shared(NamedTuple):
    """What all slots' maps T^l = D^l·[r; 1] share: one ampere into a pixel, host, float64.

    A slot's level is its own, so r counts less its electrodes' mean: the rank is M.
    """

    slots: Slots
    rows: Float[np.ndarray, "rows pixels"]  # M of r̃, Ω, and 1; 0 off the sheet

    def basis(self) -> tuple[Float[np.ndarray, "M pixels"], Float[np.ndarray, "rows M"]]:
        """Computes an orthonormal basis of maps' rows, and r̃ in it; strongest first."""
        # The product of a large mat's rows takes seconds, their singular values minutes.
        # The last row, of ones, is far shorter than others: its digits would be lost.
        square = self.rows @ self.rows.T
        weight = np.ones(len(square))
        weight[-1] = np.sqrt(square[0, 0] / square[-1, -1])
        squares, turn = np.linalg.eigh(weight * square * weight[:, None])
        squares, turn = squares[1:], weight[:, None] * turn[:, 1:]
        if squares[0] > _ROUNDING * squares[-1]:
            rows = square @ turn / np.sqrt(squares)
            strong = np.linalg.eigh(rows.T @ rows)[1][:, ::-1]
            return (strong.T / np.sqrt(squares)) @ turn.T @ self.rows, rows @ strong
        basis = np.linalg.svd(self.rows, full_matrices=False)[2][:-1]
        return basis, self.rows @ basis.T


def shared_maps(pixels: Pixels) -> tuple[Shared, Bool[np.ndarray, "L M"]]:
    """Computes what the maps of all grounds share, and which electrodes are grounded."""
    sensor = pixels.sensor
    table = resistances(sensor, "series" if sensor.even else "fem")
    ee, ek = table.electrodes, pixels.mean(table.elements)
    ee, ek = (np.asarray(a, float) for a in (ee, ek))
    slots = sensor.slots(ee)
    rows = np.concatenate([ek - ek.mean(0), np.ones((1, ek.shape[1]))])
    if pixels.inside is not None:
        rows = rows * np.asarray(pixels.inside).ravel()
    return Shared(slots, rows), np.asarray(slots.grounded(sensor.all_grounds()))


def factors_of(
    slots: Slots, shared: Float[A, "rows r"], which: Int[A, " n"]
) -> Float[A, "n M r"]:
    """Computes D·r̃ of some slots, with r̃ in a basis."""
    relative: Any = slots.relative(shared[:-1].T, which)  # (r, n, M)
    return relative.transpose(1, 2, 0) + slots.offset(which)[..., None] * shared[-1]


def each_factors(
    slots: Slots, shared: Float[np.ndarray, "rows r"], which: Int[np.ndarray, " n"]
) -> Iterator[Float[np.ndarray, "M r"]]:
    """Yields `factors_of` some slots one after another: many of a large mat take memory."""
    return (factors_of(slots, shared, which[k : k + 1])[0] for k in range(len(which)))


def strongest(rows: Float[np.ndarray, "n r"]) -> float:
    """Computes the largest singular value."""
    if len(rows) <= _FEW:
        return float(np.sqrt(np.linalg.eigvalsh(rows @ rows.T)[-1]))
    from scipy.sparse.linalg import svds  # takes half a second

    start = np.random.default_rng(0).normal(size=min(rows.shape))
    largest: Any = svds(rows, 1, v0=start, return_singular_vectors=False)
    return float(largest[0])


def centring(
    good: Bool[np.ndarray, " M"], grounded: Bool[np.ndarray, " M"]
) -> Float[np.ndarray, "M M"]:
    """Makes the matrix that subtracts the mean of a slot's good, ungrounded channels.

    A ground path, or an electrode's own resistance to the sheet, is hardly known and lifts
    all of these channels alike.
    """
    used = good & ~grounded
    return np.diag(used.astype(float)) - np.outer(used, used) / max(1, used.sum())


def tikhonov_operator(
    rows: Float[np.ndarray, "n r"], lam: float
) -> Float[np.ndarray, "r n"]:
    """Computes (AᵀA + λI)⁻¹Aᵀ, A the rows; in the smaller of two forms."""
    n, r = rows.shape
    if n <= r:
        return np.linalg.solve(rows @ rows.T + lam * np.eye(n), rows).T
    return np.linalg.solve(rows.T @ rows + lam * np.eye(r), rows.T)


def slots_left(
    misfits: Float[Array, "S M M"],
    voltages: Float[Array, "S M"],
    used: Bool[Array, "S M"],
) -> tuple[Float[Array, ""], Float[Array, " M"]]:
    """Computes what slots' own images leave, V rms: of all voltages, by electrode."""

    # Slot by slot: of a batch each is one product, where a batch of products is slow, and
    # slots in order (`lax.scan`) would be copied first.
    def add(k: Array, total: Array) -> Array:
        misfit, v = (lax.dynamic_index_in_dim(a, k, 0, False) for a in (misfits, voltages))
        return total + matmul(misfit, v) ** 2

    squares = lax.fori_loop(0, len(misfits), add, jnp.zeros_like(voltages[0]))
    count = jnp.sum(used, 0).astype(squares.dtype)
    return jnp.sqrt(squares.sum() / count.sum()), jnp.sqrt(squares / count)
