"""Rates designs by simulation: the error of contacts' images on rigs that are not nominal.

The reconstruction knows nominal values. The voltages come from sheets that vary, electrodes
off their places, and channels with gains and noise. The error is not convex in the weights:
no bound exists. The design finds λ and the length over which an image is smooth together
with the grounds.

`simulated_image` rates images of contacts near each place: their error and their width.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.stats import qmc

from tomojax._checks import require_shape
from tomojax.design.objectives._contacts import blobs
from tomojax.design.objectives._information import AbstractObjective
from tomojax.design.objectives._rigs import simulate_scenes, SimulatedScenes
from tomojax.kernels.algebra import gaussian, matmul
from tomojax.kernels.images import half_width, image_place
from tomojax.kernels.inverse import solve_damped
from tomojax.methods import Linear, Source
from tomojax.sensor import Sensor

# Directions of an image that are looked at.
_RANK = 128

# Of λ/σ₁², where the search for λ begins.
_FIRST = 1e-5

# The least λ of a search, of what is rounded off the slots' sum.
_LEAST = 1e-3


class ImageError(AbstractObjective):
    """1 − cos² of the angle between each scene's image and a Gaussian at its contact.

    φ = GGᵀBᵀc is Tikhonov's image of the weighted slots, under a prior that is smooth over
    ℓ (G a Gaussian). The image is differentiable in the weights, ln λ and ln ℓ, by the rule
    of the linear solve. An error of 0 is an image like the contact; an image without the
    contact has 1.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = tx.design.design_places(sensor, count=4)
    >>> scenes = tx.design.simulate_scenes(sensor, places, rigs=1)
    >>> method = tx.method(sensor, "linear", grid=16)
    >>> objective = tx.design.ImageError.of(method, scenes, width=0.008)
    >>> errors = objective(jnp.ones(16))
    >>> errors.shape, bool(((errors > 0) & (errors < 1)).all())
    ((4,), True)
    """

    grams: Float[Array, "L r r"]
    rights: Float[Array, "P L r"]  # A_lᵀv_l of each scene
    basis: Float[Array, "r pixels"]
    targets: Float[Array, "P pixels"]
    log_lam: Float[Array, ""]
    log_length: Float[Array, ""] | None  # in pixels; None: no smoothing
    shape: tuple[int, int] = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        method: Linear | Source,
        scenes: SimulatedScenes,
        width: float,
        smooth: bool = False,
    ) -> "ImageError":
        """Makes the error of `method`'s images; contacts are Gaussians of σ `width`, m."""
        factors, basis = method.all_factors()[..., :_RANK], method.basis[:_RANK]
        grams = jnp.einsum("lmr,lms->lrs", factors, factors, precision="highest")
        count, m = len(factors), method.electrode_count
        require_shape("voltages", scenes.voltages, (None, count, m))
        rights = jnp.einsum("lmr,plm->plr", factors, scenes.voltages, precision="highest")
        places = scenes.places.reshape(-1, 2)
        targets = blobs(method.shape, method.cell, places, width)
        targets = targets.reshape(len(scenes.places), -1, targets.shape[1]).sum(1)
        targets = targets / jnp.linalg.norm(targets, axis=1, keepdims=True)
        lam = jnp.log(jnp.asarray(_FIRST * method.scale(), basis.dtype))
        length = jnp.zeros((), basis.dtype) if smooth else None
        return cls(grams, rights, basis, targets, lam, length, method.shape)

    @property
    def slots(self) -> int:
        return len(self.grams)

    @property
    def lam(self) -> float:
        return float(jnp.exp(self.log_lam))

    def alone(self, k: Array) -> "ImageError":
        k = jnp.atleast_1d(k)
        return replace(self, rights=self.rights[k], targets=self.targets[k])

    def in_reach(self) -> "ImageError":
        """Clips λ into reach of a descent: images beyond are rounding, or 0."""
        total = jnp.trace(self.grams.sum(0))
        low = _LEAST * jnp.finfo(self.dtype).eps * total
        return replace(self, log_lam=jnp.clip(self.log_lam, jnp.log(low), jnp.log(total)))

    def images(self, weights: Float[Array, " L"]) -> Float[Array, "P pixels"]:
        """Computes φ of every scene, from one set of slots."""
        total = jnp.einsum("l,lrs->rs", weights, self.grams, precision="highest")
        right = jnp.einsum("l,plr->rp", weights, self.rights, precision="highest")
        if self.log_length is None:
            return matmul(self._solved(total, right).T, self.basis)
        sides = [gaussian(n, jnp.exp(self.log_length)) for n in self.shape]
        sides = [side / jnp.linalg.norm(side, axis=1, keepdims=True) for side in sides]
        smooth = self._smoothed(self.basis, sides)
        inner = matmul(smooth, smooth.T)
        eps = 64 * jnp.finfo(inner.dtype).eps * jnp.trace(inner)
        lower = jnp.linalg.cholesky(inner + eps * jnp.eye(len(inner), dtype=inner.dtype))
        turned = matmul(lower.T, matmul(total, lower))
        solution = self._solved(turned, matmul(lower.T, right))
        back = jax.scipy.linalg.solve_triangular(lower, solution, lower=True, trans="T")
        return self._smoothed(matmul(back.T, smooth), [side.T for side in sides])

    def _smoothed(self, images: Array, sides: Sequence[Array]) -> Array:
        grid = images.reshape(-1, *self.shape)
        smooth = jnp.einsum("pxy,xi,yj->pij", grid, *sides, precision="highest")
        return smooth.reshape(images.shape)

    def _solved(self, total: Array, right: Array) -> Array:
        return solve_damped(total, right, jnp.exp(self.log_lam))

    def __call__(self, weights: Float[Array, " L"]) -> Float[Array, " P"]:
        images = self.images(weights)
        alike = (images * self.targets).sum(1) ** 2
        return 1 - alike / ((images**2).sum(1) + jnp.finfo(images.dtype).tiny)


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
