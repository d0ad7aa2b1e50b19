"""Computes how the table of electrodes' potentials changes with places and the sheet."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax.kernels.contacts import field_at
from tomojax.kernels.sheet import (
    heights,
    rectangle_grid_fields,
    rectangle_slope,
    rectangle_wave_fields,
    smooth_orders,
)
from tomojax.sensor._cut_field import cut_of, wave_fields
from tomojax.sensor._field import averaged_field, averaged_radii, make_field, parts_of
from tomojax.sensor._sensor import Sensor

# An electrode's step that gives the slopes by its place, of its diameter.
_MOVE = 1e-3

# The same where potentials are solved on a mesh, whose rounding is larger.
_FAR = 0.04

# Half periods in a pitch that waves are followed to.
_FOLLOWED = 8

# Which of the table's radii the waves' potentials are averaged over: they hardly depend on
# it.
_RADIUS = 3


def make_moves(sensor: Sensor) -> tuple[Float[Array, "2 nx ny A M"], Float[Array, "2 M M"]]:
    """Computes slopes of `make_field`'s tables as electrodes move along x and y, Ω/m.

    The slopes are R_e(x, a) and R_ee' by the place of electrode e; R_ee changes by twice
    its entry. The sheet is even, with its resistance as electrodes lower it. The effect of
    each electrode, as metal, on the others' potentials is left out.
    """
    sensor, even, cells, every = parts_of(sensor)
    places, step = np.asarray(sensor.electrode_xy, float), _MOVE * _diameter(even)
    if not sensor.flat:
        return _cut_moves(sensor)
    size, rho = np.asarray(sensor.size, float), _effective(even)
    x, y = (np.linspace(0, s, n + 1) for s, n in zip(size, cells))
    values = []
    for unit in np.eye(2):
        (ee, one, _), (_, other, _) = (
            rectangle_grid_fields(
                places + side * step * unit, x, y, _diameter(even) / 2, size
            )
            for side in (1, -1)
        )
        slope = rho * (one - other) / (2 * step)
        values.append(averaged_field(sensor, ee, slope, every).values)
    at, radius = jnp.asarray(places, sensor.dtype), sensor.electrode_diameter / 2
    slope = rho * rectangle_slope(at[:, None], at, radius, sensor.size)
    return jnp.stack(values), jnp.moveaxis(slope, -1, 0).astype(sensor.dtype)


def _cut_moves(sensor: Sensor) -> tuple[Float[Array, "2 nx ny A M"], Float[Array, "2 M M"]]:
    """Computes `make_moves` on a mesh: all electrodes move at once."""
    step, xy = _FAR * _diameter(sensor), sensor.electrode_xy
    values, among = [], []
    for unit in np.eye(2):
        moved = [
            make_field(eqx.tree_at(lambda s: s.electrode_xy, sensor, xy + by)).values
            for by in jnp.asarray(step * np.stack([unit, -unit]), sensor.dtype)
        ]
        slope = (moved[0] - moved[1]) / (2 * step)
        values.append(slope)
        field = make_field(sensor)._replace(values=slope)
        at = jax.vmap(field_at, (None, 0, None))(field, xy, field.radii[0])
        among.append(at.T)
    return jnp.stack(values), jnp.stack(among)


def _diameter(sensor: Sensor) -> float:
    return float(sensor.electrode_diameter)


def _effective(even: Sensor) -> float:
    """Computes the sheet's resistance as metal discs lower it, Ω per square (Maxwell)."""
    covered = even.electrode_count * np.pi * _diameter(even) ** 2 / 4
    covered = covered / float(np.prod(even.size)) * float(np.asarray(even.electrode_shunt))
    return float(even.sheet_resistance) * (1 - covered) / (1 + covered)


def make_waves(
    sensor: Sensor, most: int
) -> tuple[Float[Array, "q nx ny M"], Float[Array, "q M M"]]:
    """Computes what a unit of each wave of the sheet adds to the table and to R_ee', Ω.

    The results are of first order, for the waves of `Calibration` with up to `most` half
    periods. Electrodes that even the sheet out, as metal discs, lower its resistance, and
    so the addition by a wave.
    """
    sensor, even, cells, every = parts_of(sensor)
    size = np.asarray(sensor.size, float)
    x, y = (np.linspace(0, s, n // every + 1) for s, n in zip(size, cells))
    if not sensor.flat:
        of_waves = sensor, cut_of(sensor, even), x, y, smooth_orders(most)
        ee, rows = (jnp.asarray(a, sensor.dtype) for a in wave_fields(*of_waves))
        return jnp.moveaxis(rows, 1, -1), ee
    followed = int(np.ceil(_FOLLOWED * size.max() / sensor.mean_pitch))
    orders, places = smooth_orders(most), np.asarray(sensor.electrode_xy, float)
    radius = averaged_radii(sensor)[_RADIUS]
    given = places, x, y, _diameter(even) / 2, size, orders, followed, radius
    ee, rows = rectangle_wave_fields(*given)
    scale = _effective(even) * heights(orders)
    values = scale[:, None, None, None] * np.moveaxis(rows, 1, -1)
    ee = scale[:, None, None] * ee
    return jnp.asarray(values, sensor.dtype), jnp.asarray(ee, sensor.dtype)
