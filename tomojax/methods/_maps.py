"""Makes maps from currents to a slot's voltages and back, on the host in float64."""

from typing import Any, NamedTuple, TypeVar

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels.algebra import matmul
from tomojax.kernels.sheet import Slots
from tomojax.methods._pixels import Pixels
from tomojax.sensor import resistances

A = TypeVar("A", Array, np.ndarray)


class Shared(NamedTuple):
    """What all slots' maps T^l = D^l·[r; 1] share: one ampere into a pixel, host, float64.

    A slot's level is its own, so r counts less its electrodes' mean: the rank is M.
    """

    slots: Slots
    rows: Float[np.ndarray, "rows pixels"]  # M of r̃, Ω, and 1; 0 off the sheet

    def basis(self) -> tuple[Float[np.ndarray, "M pixels"], Float[np.ndarray, "rows M"]]:
        """Computes an orthonormal basis of all maps' rows, and r̃ in it."""
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

    # Slot by slot: of a batch each is one product, where a batch of products is slow.
    def add(total: Array, slot: tuple[Array, Array]) -> tuple[Array, None]:
        misfit, v = slot
        return total + matmul(misfit, v) ** 2, None

    squares, _ = lax.scan(add, jnp.zeros_like(voltages[0]), (misfits, voltages))
    count = jnp.sum(used, 0).astype(squares.dtype)
    return jnp.sqrt(squares.sum() / count.sum()), jnp.sqrt(squares / count)
