"""What a fit of compact contacts is told of the sheet."""

import jax.numpy as jnp

from tomojax.kernels.contacts import Sheet
from tomojax.sensor import make_field, Sensor

# Usual radius of a contact and unit of the fit's lengths, of the electrodes' pitch: what
# can be told of a contact grows with the pitch, whatever the electrodes' size.
USUAL, UNIT = 0.3, 0.05


def sheet_of(sensor: Sensor) -> Sheet:
    """Computes the electrodes' potentials and lengths that suit the sensor."""
    pitch = sensor.mean_pitch
    return Sheet(
        make_field(sensor),
        jnp.exp(jnp.mean(jnp.log(sensor.sheet_resistance))),
        sensor.ground_resistance,
        sensor.drive_voltage,
        jnp.asarray(UNIT * pitch, sensor.dtype),
        jnp.asarray(USUAL * pitch, sensor.dtype),
    )
