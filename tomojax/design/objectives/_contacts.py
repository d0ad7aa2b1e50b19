"""Computes a contact's voltages in a slot, in the model of `points`, and ideal images."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from tomojax.kernels.contacts import green_of, in_slot, Sheet, SIZE_WIDTH, tangents


class Contact(NamedTuple):
    """A disc in good or bad contact, as `points` knows discs, anywhere on a sheet."""

    sheet: Sheet
    size: Float[Array, ""]  # as `points` counts sizes
    resistance: Float[Array, ""]  # Ω

    @classmethod
    def of(cls, sheet: Sheet, radius: float | None, conductance: float) -> "Contact":
        """Makes a contact of a radius, m (None: usual for `points`), and conductance, S."""
        dtype = sheet.size.dtype
        given = sheet.size if radius is None else jnp.asarray(radius, dtype)
        size = jnp.log(given / sheet.size) / SIZE_WIDTH
        return cls(sheet, size, jnp.asarray(1 / conductance, dtype))

    def current(self, place: Float[Array, "2"], ground: Array) -> Float[Array, ""]:
        """Computes V0/(1/g + R_kk + R_ll + z − 2R_l(x)), A; R_kk is the disc's own."""
        sheet = self.sheet
        raw = tangents(sheet, place, self.size)[0]
        radius = sheet.size * jnp.exp(SIZE_WIDTH * self.size)
        own = green_of(sheet, place[None], radius[None])(place)[0]
        slots = sheet.slots
        volts = slots.relative(raw, ground) + slots.offset(ground)
        back = slots.level(raw, ground) + slots.sunk(raw, ground, volts)
        loop = own + slots.path(ground) - back
        return sheet.drive_voltage / (self.resistance + loop)

    def columns(self, place: Float[Array, "2"], ground: Array) -> Float[Array, "4 M"]:
        """Computes a disc's voltages, V, and their change by moves (per unit), by size."""
        raw = tangents(self.sheet, place, self.size)
        return self.current(place, ground) * in_slot(self.sheet, raw[None], ground)[0]


def without_current(gram: Float[Array, "k k"]) -> Float[Array, "k-1 k-1"]:
    """Eliminates the first unknown of JᵀN⁻¹J, the current: it is whatever fits."""
    return gram[1:, 1:] - gram[1:, :1] * gram[:1, 1:] / gram[0, 0]


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
