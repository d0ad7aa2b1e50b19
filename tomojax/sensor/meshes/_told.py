"""Takes a sheet's resistances from another code, or from a measurement."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.scipy.ndimage import map_coordinates
from jaxtyping import Array, Float, Int

from tomojax._checks import checked, float_array, known, require, require_shape
from tomojax._custom_types import Numbers


class ToldSheet(eqx.Module):
    """Transfer resistances that another code or a measurement tells, Ω.

    **Arguments:**

    - `electrodes` (M, M): R_ee', the potential at e' per ampere into e.
    - `potentials` (M, nx, ny): R_e at a grid of points from corner to corner of the box,
      its edges included; NaN off the sheet.

    Any place may be the zero: what is added to all electrodes of a point, or to a row and
    column of R_ee' and to its R_e, changes no voltage. What it fixes, and an object's own
    resistance, are the nominal sheet's. A coarse grid is enough, as what is interpolated is
    the difference from the nominal sheet.

    **Raises:** `ValueError` for shapes that do not fit, or R_ee' that is not symmetric.

    **Example:**

    >>> from dataclasses import replace
    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(2, 2, divisions=(16, 16))
    >>> told = tx.sensor.ToldSheet(1e4 * np.eye(4), np.zeros((4, 5, 5)))
    >>> table = tx.sensor.resistances(replace(sensor, told=told)).electrodes
    >>> print(np.diff(np.asarray(table[0] - table[1])[:2]).round())  # R_01 − R_00 − …
    [-20000.]
    """

    electrodes: Float[Array, "M M"]
    potentials: Float[Array, "M nx ny"]
    nearest: Int[np.ndarray, " points"]  # the point on the sheet that each stands for

    def __init__(self, electrodes: Numbers, potentials: Numbers):
        ee = self.electrodes = checked("electrodes", electrodes, "finite", (None, None))
        require_shape("electrodes", ee, (len(ee), len(ee)))
        rows = float_array("potentials", potentials, ee.dtype)
        require_shape("potentials", rows, (len(ee), None, None))
        require(min(rows.shape) >= 2, "potentials", f"shape {rows.shape}", "2 × 2 or more")
        self.nearest = np.arange(rows[0].size)
        if known(ee, rows):
            apart = float(jnp.abs(ee - ee.T).max() / jnp.abs(ee).max())
            require(apart < 1e-2, "electrodes", f"{apart:.0%} off its transpose", "R = Rᵀ")
            off = np.isnan(np.asarray(rows)).any(0)
            require(not off.all(), "potentials", "NaN alone", "numbers on the sheet")
            index = scipy.ndimage.distance_transform_edt(
                off, return_distances=False, return_indices=True
            )
            self.nearest = np.ravel_multi_index(tuple(index), off.shape).ravel()  # pyright: ignore
        self.potentials = jnp.nan_to_num(rows)

    def beside(
        self, ee: Float[Array, "M M"], rows: Float[Array, "M nx ny"], inset: float = 0.0
    ) -> tuple[Float[Array, "M M"], Float[Array, "M nx ny"]]:
        """Returns what to add to nominal R_ee' and R_e at a grid of the box's points.

        `inset`: of the grid's first point from the edge, of its spacing.
        """
        told_ee, told = _centred(self.electrodes, self.potentials)
        nominal_ee, nominal = _centred(ee, rows)
        here, there = told.shape[1:], nominal.shape[1:]
        by = told - _resampled(nominal, here, 0.0, inset)
        by = by.reshape(len(by), -1)[:, self.nearest].reshape(by.shape)
        return told_ee - nominal_ee, _resampled(by, there, inset, 0.0)


def _centred(ee: Array, rows: Array) -> tuple[Array, Array]:
    """Takes the mean over electrodes away, which no voltage depends on."""
    mean = ee.mean(0)
    rows = rows - mean[:, None, None]
    return ee - mean - mean[:, None] + mean.mean(), rows - rows.mean(0)


def _resampled(rows: Array, shape: tuple, inset: float, of: float) -> Array:
    """Interpolates rows, whose grid has the inset `of`, at another grid with `inset`."""
    index = []
    for n, m in zip(shape, rows.shape[1:]):
        part = (np.arange(n) + inset) / (n - 1 + 2 * inset)
        index.append(part * (m - 1 + 2 * of) - of)
    at = [jnp.asarray(a, rows.dtype) for a in np.meshgrid(*index, indexing="ij")]
    return jax.vmap(lambda row: map_coordinates(row, at, 1, "nearest"))(rows)
