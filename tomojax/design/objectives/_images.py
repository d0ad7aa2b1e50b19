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

# Contacts around each place.
_NEAR = 12

# How far off the contacts are, of the electrodes' pitch, to each side.
_AROUND = 1 / 6

# The contacts' radii: a factor, both ways.
_SIZES = np.sqrt(2)

# Rigs that take turns.
_RIGS = 16

# A width counts so much beside an error of place.
_WIDTH = 0.6


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
) -> SimulatedImage:
    """Simulates contacts within a sixth pitch of `places`, of radii about `radius`."""
    pitch = sensor.mean_pitch
    # The sequence's first is the corner.
    drawn = qmc.Halton(3, scramble=False).random(len(places) * _NEAR + 1)[1:]
    off = _AROUND * pitch * (2 * drawn[:, :2] - 1)
    at = np.repeat(np.asarray(places), _NEAR, 0) + off
    radii = radius * _SIZES ** (2 * drawn[:, 2] - 1)
    at = np.clip(at, radius, np.asarray(sensor.size) - radius)
    discs = {"radius": radii, "conductance": conductance}
    scenes = simulate_scenes(sensor, at, rigs=min(_RIGS, len(at)), **discs)
    images = ImageError.of(method, scenes, pitch)
    images = replace(images, log_lam=jnp.log(jnp.asarray(lam, sensor.dtype)))
    contacts = scenes.places.reshape(len(places), _NEAR, 2)
    return SimulatedImage(images, contacts, method.cell)
