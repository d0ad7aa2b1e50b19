"""Computes a contact's voltages in a slot, in the model of `points`, and ideal images."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from tomojax.kernels.contacts import green_of, in_slot, Sheet, SIZE_WIDTH, tangents
from tomojax.kernels.sheet import ground_path


def contact_current(
    sheet: Sheet, place: Float[Array, "2"], size: Array, resistance: Array, ground: Array
) -> Float[Array, ""]:
    """Computes V0/(1/g + R_kk + R_ll + z − 2R_l(x)), A; R_kk is the disc's own."""
    raw = tangents(sheet, place, size)[0]
    radius = sheet.size * jnp.exp(SIZE_WIDTH * size)
    own = green_of(sheet, place[None], radius[None])(place)[0]
    path = ground_path(sheet.field.electrodes, ground, sheet.ground_resistance)
    loop = own + path - 2 * raw[ground]
    return sheet.drive_voltage / (resistance + loop)


def contact_columns(
    sheet: Sheet, place: Float[Array, "2"], size: Array, resistance: Array, ground: Array
) -> Float[Array, "4 M"]:
    """Computes a disc's voltages, V, and their change by moves (per unit) and by size."""
    raw = tangents(sheet, place, size)
    current = contact_current(sheet, place, size, resistance, ground)
    return current * in_slot(sheet, raw[None], ground)[0]


def blobs(
    shape: tuple[int, int], cell: Float[Array, "2"], places: Float[Array, "P 2"], width: Any
) -> Float[Array, "P pixels"]:
    """Makes images of Gaussians at `places`, of σ = `width`, m, and of length 1."""
    sides = [
        jnp.exp(
            -((((jnp.arange(n, dtype=d.dtype) + 0.5) * d - at[:, None]) / width) ** 2) / 2
        )
        for n, d, at in zip(shape, cell, places.T)
    ]
    images = (sides[0][:, :, None] * sides[1][:, None]).reshape(len(places), -1)
    return images / jnp.linalg.norm(images, axis=1, keepdims=True)
