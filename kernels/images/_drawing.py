"""Turns fitted contacts into rows of results and into an image."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tomojax.kernels.images._contacts import Contacts, strongest_first
from tomojax.kernels.images._merit import pixel_places


class Spots(NamedTuple):
    """Places, sizes and currents of C fitted contacts, which an image shows."""

    place: Float[Array, "C 2"]  # m
    extent: Float[Array, "C 2"]  # m
    ring: Float[Array, " C"]  # m
    radius: Float[Array, " C"]  # m
    current: Float[Array, " C"]  # A


def points_as_contacts(
    count: Int[Array, ""],
    spots: Spots,
    conductance: Float[Array, " C"],
    covariance: Float[Array, "C 3"],
) -> Contacts:
    """Turns the first `count` fitted contacts into `Contacts`, strongest first.

    The radius is that of the disc with the contact's second moments: |e|²/3 along a bar and
    a²/4 across, R²/2 of a ring.
    """
    place, extent, ring, radius, current = spots
    there = jnp.arange(len(radius)) < count
    reach = (extent**2).sum(-1)
    long = reach > radius**2
    angle = jnp.arctan2(extent[:, 1], extent[:, 0]) % np.pi
    whole = jnp.sqrt(radius**2 + 2 / 3 * reach + 2 * ring**2)
    angle = jnp.where(long, angle, jnp.nan)
    none = jnp.zeros((), jnp.uint8)
    found = Contacts(none, place, whole, angle, current, conductance, covariance)
    return strongest_first(found, there)


def points_image(
    spots: Spots, cell: Float[Array, "2"], shape: tuple[int, int]
) -> Float[Array, "nx ny"]:
    """Draws current density, A/m²: a Gaussian with each contact's second moments.

    A ring is a rim with a Gaussian's profile. No Gaussian is narrower than a pixel. All of
    a contact's current is inside the image, wherever the contact lies.
    """
    x, y = pixel_places(shape, cell)
    across = jnp.maximum(spots.radius**2 / 4, jnp.max(cell) ** 2)[:, None, None]

    def one(spot: Spots, across: Array) -> Array:
        place, extent, ring, _, current = spot
        a, b = across + extent[0] ** 2 / 3, across + extent[1] ** 2 / 3
        c = extent[0] * extent[1] / 3
        u, v = (x - place[0])[:, None], (y - place[1])[None]
        form: Array = (b * u**2 - 2 * c * u * v + a * v**2) / (a * b - c**2)
        rim: Array = (jnp.sqrt(u**2 + v**2) - ring) ** 2 / across
        density = jnp.exp(-jnp.where(ring > 0, rim, form) / 2)
        return current * density / (density.sum() * cell.prod())

    return jax.vmap(one)(spots, across).sum(0)
