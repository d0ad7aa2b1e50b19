"""Rates images of contacts near a place, on rigs that are not nominal: error and width."""

from dataclasses import replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.stats import qmc

from tomojax.design.objectives._image_error import ImageError
from tomojax.design.objectives._information import AbstractObjective
from tomojax.design.objectives._rigs import simulate_scenes
from tomojax.kernels.images import half_width, image_place
from tomojax.methods import Linear
from tomojax.sensor import Sensor

# Contacts around each place, how far off (of the electrodes' pitch, to each side), their
# radii (factor, both ways), rigs that take turns, and what a width counts.
_NEAR, _AROUND, _SIZES, _RIGS, _WIDTH = 12, 1 / 6, np.sqrt(2), 16, 0.6


class SimulatedImage(AbstractObjective):
    """√(mean of squared errors of place) + 0.6·(mean half-value width) of images, m.

    The images are `linear`'s, of contacts that hold the sheet at V0, several around each
    place. Noise seldom spoils such images: J(0) knows nothing of the current that each slot
    draws. Sets differ most in how far these currents move the image. The figure is not
    convex in the weights: no bound exists.
    """

    images: ImageError  # of P·n scenes
    contacts: Float[Array, "P n 2"]  # m
    cell: Float[Array, "2"]  # m
    worst: ClassVar[bool] = False  # pyright: ignore
    convex: ClassVar[bool] = False
    swaps: ClassVar[int | None] = 32
    unit: ClassVar[str] = "m"  # pyright: ignore

    @property
    def slots(self) -> int:
        return self.images.slots

    @property
    def lam(self) -> float:
        return self.images.lam

    def alone(self, k: Array) -> "SimulatedImage":
        count = self.contacts.shape[1]
        scenes = self.images.alone(k * count + jnp.arange(count))
        return replace(self, images=scenes, contacts=self.contacts[k][None])

    def __call__(self, weights: Float[Array, " L"]) -> Float[Array, " P"]:
        images = self.images.images(weights).reshape(-1, *self.images.shape)
        found = jax.vmap(image_place, (0, None))(images, self.cell)
        width = jax.vmap(half_width, (0, None))(images, self.cell)
        off = found.reshape(self.contacts.shape) - self.contacts
        tiny = jnp.finfo(off.dtype).tiny
        each = jnp.sqrt((off**2).sum(-1).mean(-1) + tiny)
        return each + _WIDTH * width.reshape(off.shape[:2]).mean(1)


def simulated_image(
    sensor: Sensor,
    method: Linear,
    places: Float[Array, "P 2"],
    lam: float,
    radius: float,
    conductance: float,
    pitch: float,
) -> SimulatedImage:
    """Simulates contacts within a sixth `pitch` of `places`, of radii about `radius`."""
    # The sequence's first is the corner.
    drawn = qmc.Halton(3, scramble=False).random(len(places) * _NEAR + 1)[1:]
    off = _AROUND * pitch * (2 * drawn[:, :2] - 1)
    at = np.repeat(np.asarray(places), _NEAR, 0) + off
    radii = radius * _SIZES ** (2 * drawn[:, 2] - 1)
    at = np.clip(at, radius, np.asarray(sensor.size) - radius)
    scenes = simulate_scenes(
        sensor,
        at,
        radius=radii,
        conductance=conductance,
        rigs=min(_RIGS, len(at)),
    )
    images = ImageError.of(method, scenes, pitch)
    images = replace(images, log_lam=jnp.log(jnp.asarray(lam, sensor.dtype)))
    contacts = scenes.places.reshape(len(places), _NEAR, 2)
    return SimulatedImage(images, contacts, method.cell)
