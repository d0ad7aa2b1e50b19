"""Tells whether fitted contacts are sound: apart, strong enough, long enough."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from tomojax.kernels import contacts as model
from tomojax.methods.points._found import Fitting, Found

# Discs nearer than this many usual radii are what the model's error makes of fewer. Two
# discs at ± h have a moment of h²: a calibrated model that leaves a part of the error
# brings h down by its root, but not to where discs would lie on each other.
APART = 2.7
_ON_EACH_OTHER = 1.6

# So is a second disc below this part of the strongest, and a further one.
_WEAKEST_SECOND = 0.04
_WEAKEST = 0.1

# Two discs nearer than so many usual radii may be one long contact.
_REACH = 4.0

# A ring narrower than so many usual radii is a disc.
_NARROWEST = 1.2


def is_long(disc: Found) -> Bool[Array, ""]:
    """Tells whether one disc is longer than a round contact makes it."""
    return (disc.parameters[0, 3:5] ** 2).sum() > model.NOT_ROUND**2


def apart_and_strong(scene: Fitting, found: Found, size: int) -> Bool[Array, ""]:
    """Tells whether all discs lie apart, and all are strong enough."""
    left = jnp.sqrt(scene.method.errors.part)
    least = jnp.clip(APART * left, _ON_EACH_OTHER, APART)
    weakest = _WEAKEST if size > 2 else _WEAKEST_SECOND
    return (_nearest(scene, found, size) >= least) & _strong(scene, found, size, weakest)


def near_and_strong(scene: Fitting, found: Found) -> Bool[Array, ""]:
    """Tells whether two discs lie so near that one long contact may look like them."""
    apart = _nearest(scene, found, 2)
    near = (apart >= _ON_EACH_OTHER) & (apart < _REACH)
    return near & _strong(scene, found, 2, _WEAKEST_SECOND)


def _nearest(scene: Fitting, found: Found, size: int) -> Float[Array, ""]:
    """Returns the least distance of two discs, in usual radii."""
    place = found.place[:size]
    apart = ((place[:, None] - place) ** 2).sum(-1) + jnp.diag(jnp.full(size, jnp.inf))
    return jnp.sqrt(apart.min()) / scene.method.sheet.size


def _strong(scene: Fitting, found: Found, size: int, weakest: float) -> Bool[Array, ""]:
    current = jnp.sign(scene.method.sheet.drive_voltage) * found.current[:size]
    return current.min() >= weakest * current.max()


def long_enough(scene: Fitting, curve: Found) -> Bool[Array, ""]:
    """Tells whether a bar is longer than wide, or a ring wider than a disc looks.

    Otherwise a disc explains the frame with fewer parameters.
    """
    long = (curve.extent[0] ** 2).sum() >= curve.radius[0] ** 2
    wide = curve.ring[0] >= _NARROWEST * scene.method.sheet.size
    is_ring = curve.ring[0] > 0
    return (is_ring & wide) | (~is_ring & long)
