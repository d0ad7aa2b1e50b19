"""Prepares the sheet's potentials and lengths for fits of compact contacts."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Integer

from tomojax.kernels.contacts import Field, NARROW, Sheet, thin_of
from tomojax.sensor import make_field, Sensor

# Usual radius of a contact and unit of the fit's lengths, of the electrodes' pitch: what
# can be told of a contact grows with the pitch, whatever the electrodes' size.
USUAL, UNIT = 0.3, 0.05

# Electrodes nearer than so many pitches are neighbours.
_BESIDE = 1.6


def sheet_of(sensor: Sensor) -> Sheet:
    """Computes the electrodes' potentials, and lengths that suit the sensor."""
    pitch, field = sensor.mean_pitch, make_field(sensor)
    usual = jnp.asarray(USUAL * pitch, sensor.dtype)
    narrow = jnp.asarray(NARROW * USUAL * pitch, sensor.dtype)
    thin, resistance = _beside(field, narrow, sensor.sheet_resistance)
    return Sheet(
        field=field,
        thin=thin,
        sheet_resistance=resistance,
        slots=sensor.slots(field.electrodes),
        drive_voltage=sensor.drive_voltage,
        unit=jnp.asarray(UNIT * pitch, sensor.dtype),
        size=usual,
    )


def neighbours_of(sensor: Sensor) -> Integer[np.ndarray, "n 2"]:
    """Lists pairs of electrodes that lie beside each other, or across from a corner."""
    xy = np.asarray(sensor.electrode_xy, float)
    apart = np.sqrt(((xy[:, None] - xy) ** 2).sum(-1))
    near = np.argwhere(np.triu(apart < _BESIDE * sensor.mean_pitch, 1))
    return near if len(near) else np.zeros((1, 2), int)


@jax.jit  # as one program to compile
def _beside(field: Field, narrow: Array, resistance: Array) -> tuple[Array, Array]:
    """Computes the table for narrow contacts, and the sheet's mean resistance."""
    return thin_of(field, narrow), jnp.exp(jnp.mean(jnp.log(resistance)))
