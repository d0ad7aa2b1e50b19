"""Rigs that are nearly as they say: what designs by simulation take for the truth."""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array

from tomojax._sensor import Sensor
from tomojax.kernels._mesh import centroids

# Rigs of scenes: sheets that vary by 1 σ, electrodes off by 1 σ (m), gains by 1 σ; and
# the waves of a sheet, at most so many half periods along a side.
_SHEET, _OFF, GAIN, _WAVES = 0.02, 75e-6, 5e-4, 4


def varied(sensor: Sensor, key: Array) -> Sensor:
    """A rig that is nearly so: its sheet in long waves, its electrodes' places."""
    sheet, places = jax.random.split(key)
    middles = centroids(sensor.divisions, sensor.size).astype(sensor.dtype)
    order = jnp.arange(_WAVES, dtype=sensor.dtype)
    along, across = (
        jnp.cos(jnp.pi * order * middles[:, k : k + 1] / sensor.size[k]) for k in (0, 1)
    )
    length = jnp.hypot(order[:, None], order).at[0, 0].set(jnp.inf)
    strength = jax.random.normal(sheet, length.shape, sensor.dtype) / length
    waves = ((along @ strength) * across).sum(1)
    part = 1 + _SHEET * waves / waves.std()
    off = _OFF * jax.random.normal(places, sensor.electrode_xy.shape, sensor.dtype)
    return replace(
        sensor,
        sheet_resistance=sensor.sheet_resistance * part,
        electrode_xy=sensor.electrode_xy + off,
    )
