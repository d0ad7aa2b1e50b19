"""Makes maps from currents to a slot's voltages and back, on the host in float64."""

from collections.abc import Iterator
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
    found = shared_of(slots, ek)
    if pixels.inside is not None:
        found = found._replace(rows=found.rows * np.asarray(pixels.inside).ravel())
    return found, np.asarray(slots.grounded(sensor.all_grounds()))


def shared_of(slots: Slots, elements: Float[np.ndarray, "M K"]) -> Shared:
    """Makes `Shared` of R_ek, Ω."""
    one = np.ones((1, elements.shape[1]))
    return Shared(slots, np.concatenate([elements - elements.mean(0), one]))


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

    # Slot by slot: of a batch each is one product, where a batch of products is slow.
    def add(total: Array, slot: tuple[Array, Array]) -> tuple[Array, None]:
        misfit, v = slot
        return total + matmul(misfit, v) ** 2, None

    squares, _ = lax.scan(add, jnp.zeros_like(voltages[0]), (misfits, voltages))
    count = jnp.sum(used, 0).astype(squares.dtype)
    return jnp.sqrt(squares.sum() / count.sum()), jnp.sqrt(squares / count)
