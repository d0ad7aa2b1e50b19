"""Tells a frame's contacts and their uncertainty when a fit ends.

Contacts that were found are sound if they are apart, strong, or long enough.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels import contacts as model
from tomojax.kernels.algebra import solve_positive
from tomojax.kernels.contacts import Look, look, unwhitened, WhitenedFrame
from tomojax.kernels.sheet import Grounds
from tomojax.methods._contract import rms, rms_by_electrode
from tomojax.methods._errors import (
    highest_cost,
    misfit_cost,
    PreparedErrors,
    Whitened,
    whitened,
    without_offset,
)

# What is left of whitened voltages for each that is free, usually: the errors that are told
# of are nearly the largest of what is usual.
LEFT = 0.37

# A current against the drive, which no contact makes, is no error beyond so many σ.
_AGAINST = 5.0

# Beyond so many times that, errors are unusual.
_UNUSUAL = 4.0


class Found(NamedTuple):
    """Fitted contacts of one frame, `count` of at most C."""

    cost: Float[Array, ""]  # per slot
    usual: Float[Array, ""]  # of it, with as many channels
    misfits: Float[Array, " S"]  # of each slot
    count: Int[Array, ""]  # pyright: ignore (tuples have a method of that name)
    parameters: Float[Array, "C P"]
    place: Float[Array, "C 2"]
    extent: Float[Array, "C 2"]
    ring: Float[Array, " C"]
    radius: Float[Array, " C"]
    current: Float[Array, " C"]  # A, the mean over the slots
    conductance: Float[Array, " C"]
    covariance: Float[Array, "C 3"]  # of the place: xx, yy, xy, m²
    vague: Bool[Array, " C"]  # whether a conductance is hardly told
    high: Bool[Array, ""]  # whether too much is left to be errors
    limited: Bool[Array, ""]  # the model's error is larger than nominal values leave
    faults: Int[Array, ""]  # of the rig, that explain a part of the frame
    unsure: Bool[Array, ""]  # whether faults or contacts explain the frame
    doubtful: Bool[Array, ""]  # whether two contacts or one long one do
    residual: Float[Array, ""]  # V rms
    by_electrode: Float[Array, " M"]  # the same of each


class Fitting(NamedTuple):
    """One frame, with the method and the errors for its fit."""

    method: Any
    prepared: PreparedErrors
    errors: Whitened  # of the frame
    voltages: Float[Array, "S M"]
    most: int  # contacts

    @property
    def frame(self) -> WhitenedFrame:
        """Returns the frame's whitened voltages."""
        return self.errors.frame


def fitting_of(
    method, prepared: PreparedErrors, voltages: Float[Array, "S M"], most: int
) -> Fitting:
    """Whitens a frame for its fit."""
    return Fitting(method, prepared, whitened(prepared, voltages), voltages, most)


def look_of(scene: Fitting, some: Int[Array, " s"] | None = None) -> Look:
    """Whitens the candidates' voltages, and the frame's, in the compared slots."""
    some, sheet = scene.prepared.compared if some is None else some, scene.method.sheet
    which, slots = scene.frame.grounds[some], sheet.slots
    part = jax.tree.map(lambda a: a[some], scene.frame)
    if not isinstance(slots, Grounds):
        offset, blocks = slots.offset(which), slots.block(which)
        return look(scene.method.potentials, offset, part, blocks)
    # As free as it is, z does not count.
    offset = slots._replace(resistance=0.0).offset(which)
    return look(scene.method.potentials, offset, part)


class Ended(NamedTuple):
    """The end of a fit: its parameters, and the whitened residuals there."""

    parameters: Float[Array, " P"]
    normal: Float[Array, "P P"]  # JᵀWJ
    rest: Float[Array, "S W"]
    slope: Float[Array, "S P W"]  # of that, currents being what fits best


def found_of(
    scene: Fitting,
    explained: model.Explained,
    ended: Ended,
    cost: Array,
    are_discs: bool,
) -> Found:
    """Tells the contacts of a fit that has ended, and what the fit leaves."""
    prepared, rest, fitted = scene.prepared, ended.rest, explained.fitted
    cost = jnp.where(jnp.isfinite(cost), cost, jnp.inf) / prepared.slot_count
    misfit, used = without_offset(prepared, fitted.voltages - scene.voltages)
    current = prepared.mean(fitted.current)
    conductance = current / _drop(scene, fitted, rest)
    count = len(fitted.radius)
    forward = jnp.sign(scene.method.sheet.drive_voltage)
    size = jnp.sqrt((explained.column**2).sum(-1))
    against = (forward * fitted.current * size).min() < -_AGAINST
    # What is long is not added to.
    of_discs = ended.parameters if are_discs else jnp.zeros(model.DISC, rest.dtype)
    # How sure a place is is not differentiated.
    known, of_size, limited = _uncertainty(_still(scene), _still(ended), count)
    each = {
        "parameters": of_discs.reshape(count, -1),
        "place": fitted.place,
        "extent": fitted.extent,
        "ring": fitted.ring,
        "radius": fitted.radius,
        "current": current,
        "conductance": conductance,
        "covariance": known,
        "vague": model.hardly_told(scene.method.sheet, conductance, of_size),
    }
    free = (scene.frame.scale > 0).sum().astype(cost.dtype)
    missing = (0, scene.most - count), (0, 0)
    return Found(
        cost=cost,
        usual=LEFT * free / prepared.slot_count,
        misfits=misfit_cost((explained.rest**2).sum(1), prepared.tolerance),
        count=jnp.asarray(count),
        **{name: jnp.pad(values, missing[: values.ndim]) for name, values in each.items()},
        high=cost > highest_cost(prepared.tolerance),
        limited=limited,
        faults=jnp.asarray(0),
        unsure=against,
        doubtful=jnp.array(False),
        residual=rms(misfit, used),
        by_electrode=rms_by_electrode(misfit, used),
    )


def _still(tree: Any) -> Any:
    return jax.tree.map(
        lambda a: lax.stop_gradient(a) if eqx.is_inexact_array(a) else a, tree
    )


def _uncertainty(
    scene: Fitting, ended: Ended, count: int
) -> tuple[Float[Array, "C 3"], Float[Array, " C"], Bool[Array, ""]]:
    """Returns the places' covariance, the sizes' variance, and whether errors are unusual.

    The covariance is N⁻¹(ΣGᵀσ²G + κ²Σ_k(Σ_s G_sᵀe_sk)(…)ᵀ)N⁻¹, G the slopes of the fit by
    voltages. Noise differs in each slot; the model's errors e_k are the same in all slots.
    More slots average noise, not the model's errors. The factor κ² ≥ 1 tells how much more
    of the voltages is left than nominal values leave.
    """
    normal, parameters = ended.normal, ended.parameters
    frame = scene.frame
    used = frame.scale > 0
    left = (ended.rest**2).sum(1)
    weight = 1 / (1 + left / scene.prepared.tolerance)
    by_voltage = unwhitened(frame, ended.slope * weight[:, None, None])  # (S, P, M)
    own = jnp.where(used, scene.errors.own, 0)
    # The slots' channels side by side, so that sums over them are products.
    flat = by_voltage.transpose(1, 0, 2).reshape(len(parameters), -1)
    noise = scene.prepared.noise**2 * jnp.matmul(flat, flat.T, precision="highest")
    alike = scene.errors.common[:, :-1].transpose(1, 0, 2).reshape(-1, flat.shape[1])
    shared = jnp.concatenate(
        [
            (by_voltage * own[:, None]).sum(0).T,
            jnp.matmul(alike, flat.T, precision="highest"),
            # Another in each slot: its ground's.
            jnp.einsum("spm,sm->sp", by_voltage, scene.errors.common[:, -1]),
        ]
    )
    # Of each contact the first two parameters are its place, then comes its size.
    each = len(parameters) // count
    blocks = each * np.arange(count)
    unit = jnp.eye(len(parameters), dtype=normal.dtype)
    inverse = solve_positive(normal, unit)
    free = jnp.maximum(used.sum() - len(parameters), 1).astype(normal.dtype)
    unusual = left.sum() / (LEFT * free)
    more = jnp.matmul(shared.T, shared) * jnp.maximum(1, unusual)
    whole = jnp.matmul(inverse.T, jnp.matmul(noise + more, inverse))
    whole = whole * scene.method.sheet.unit**2
    places = jnp.stack(
        [whole[blocks + i, blocks + j] for i, j in ((0, 0), (1, 1), (0, 1))], 1
    )
    of_size = jnp.diagonal(inverse)[blocks + 2] if each == model.DISC else 1.0
    return places, jnp.broadcast_to(of_size, (count,)), unusual > _UNUSUAL


def _drop(scene: Fitting, fitted: model.Fitted, rest: Array) -> Float[Array, " C"]:
    """Returns V0 − u at each contact, V, the mean over the slots, corrected for errors.

    The fit has found the errors that channels have in common; the contact shares them.
    """
    prepared, sheet = scene.prepared, scene.method.sheet
    # What is left ends with the common errors, in standard deviations, see `whiten`.
    found = rest[:, scene.voltages.shape[1] :]
    at = prepared.spread * scene.method.errors.smooth(fitted.place)
    relative = jnp.matmul(found[:, -1 - len(at) : -1], at, precision="highest")
    u = sheet.drive_voltage - fitted.drop
    lifted = (found[:, -1] * scene.errors.offset)[:, None]
    mean = prepared.mean(fitted.drop - jnp.abs(u) * relative - lifted)
    forward = jnp.sign(sheet.drive_voltage)
    least = model.LEAST_DROP * jnp.abs(sheet.drive_voltage)
    return forward * jnp.maximum(forward * mean, least)


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

# Two discs nearer than that may be what a bar of twice the length looks like.
_AS_A_BAR = 6.0

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


def as_a_bar(scene: Fitting, found: Found) -> Bool[Array, ""]:
    """Tells whether two discs lie so near that a bar, twice as long, may look like them."""
    return _nearest(scene, found, 2) < _AS_A_BAR


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
