"""What one contact makes of a slot, as `points` sees it: a disc that draws its current."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from tomojax.kernels._one_slot import in_slot, tangents
from tomojax.kernels._points import green_of, Sheet, SIZE_WIDTH


def contact_current(
    sheet: Sheet, place: Float[Array, "2"], size: Array, resistance: Array, ground: Array
) -> Float[Array, ""]:
    """V0/(1/g + R_kk + R_ll + z − 2R_l(x)), A: R_kk the disc's own."""
    raw = tangents(sheet, place, size)[0]
    radius = sheet.size * jnp.exp(SIZE_WIDTH * size)
    own = green_of(sheet, place[None], radius[None])(place)[0]
    z = jnp.broadcast_to(sheet.ground_resistance, raw.shape)[ground]
    loop = own + sheet.field.electrodes[ground, ground] + z - 2 * raw[ground]
    return sheet.drive_voltage / (resistance + loop)


def contact_columns(
    sheet: Sheet, place: Float[Array, "2"], size: Array, resistance: Array, ground: Array
) -> Float[Array, "4 M"]:
    """A disc's voltages, V, and how moves (per unit) and its size change them."""
    raw = tangents(sheet, place, size)
    current = contact_current(sheet, place, size, resistance, ground)
    return current * in_slot(sheet, raw[None], ground)[0]
