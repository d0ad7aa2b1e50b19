"""What a fit of compact contacts is told of the sheet."""

import jax.numpy as jnp

from tomojax.kernels.contacts import Sheet
from tomojax.sensor import make_field, Sensor

# Usual radius of a contact and unit of the fit's lengths, of the electrodes' diameter.
USUAL, UNIT = 1.2, 0.2


def sheet_of(sensor: Sensor) -> Sheet:
    """Computes the electrodes' potentials and lengths that suit the sensor."""
    diameter = sensor.electrode_diameter
    return Sheet(
        make_field(sensor),
        jnp.exp(jnp.mean(jnp.log(sensor.sheet_resistance))),
        sensor.ground_resistance,
        sensor.drive_voltage,
        UNIT * diameter,
        USUAL * diameter,
    )
