"""Makes maps from currents to a slot's voltages and back, on the host in float64."""

import numpy as np
from jaxtyping import Bool, Float

from tomojax.methods._pixels import Pixels
from tomojax.sensor import resistances


def slot_maps(
    pixels: Pixels,
) -> tuple[Float[np.ndarray, "L M pixels"], Bool[np.ndarray, "L M"]]:
    """Computes T^l of every ground, volts per ampere into a pixel; float64 on the host.

    A pixel off the sheet has 0. Tells too which electrodes are `grounded`.
    """
    sensor = pixels.sensor
    table = resistances(sensor, "series" if sensor.even else "fem")
    ee, ek = table.electrodes, pixels.mean(table.elements)
    ee, ek = (np.asarray(a, float) for a in (ee, ek))
    slots, which = sensor.slots(ee), sensor.all_grounds()
    maps, grounded = slots.maps(ek, which), np.asarray(slots.grounded(which))
    if pixels.inside is not None:
        maps = maps * np.asarray(pixels.inside).ravel()
    return maps, grounded


def row_basis(maps: Float[np.ndarray, "L M n"]) -> Float[np.ndarray, "r n"]:
    """Computes an orthonormal basis of all T^l from a few slots: every slot's rows span the
    same M dimensions."""
    some = maps[:: max(1, len(maps) // 4)].reshape(-1, maps.shape[-1])
    return np.linalg.svd(some, full_matrices=False)[2][: maps.shape[1]]


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
    """Computes (AᵀA + λI)⁻¹Aᵀ, A the rows."""
    return np.linalg.solve(rows.T @ rows + lam * np.eye(rows.shape[1]), rows.T)
