"""Models the errors of a frame's voltages: the converter's noise, and the model's own."""

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tomojax._programs import kept
from tomojax.kernels.contacts import Noise, whiten, WhitenedFrame
from tomojax.kernels.sheet import Slots, smooth_modes
from tomojax.methods._contract import centred
from tomojax.sensor import Calibration, nominal_noise, Sensor

# Nominal values leave these parts of measured voltages; they are from a resistor network
# that varies by 1.5 to 3 %.
_OWN = 0.0008  # each electrode's own error: gain, detail of the sheet
_BEND = 0.02  # of how a voltage differs from its neighbours'
_OFF = 0.03  # by which an electrode is off its place, of its diameter
_SMOOTH = 0.003  # the sheet's longest waves, common to all
# A slot's offset is as good as free: a ground path, or a face that touches in part, may
# lift it by its size.
_OFFSET = 1.0

# A step's contacts are round discs. What a shape does to its neighbours is error there, so
# that a channel's own, and by its bend, is so many times as large.
_ROUND = 2.0

# By its slope the error is less: the whole of it hides a second contact for five slots
# more.
_SLOPED = 0.5

# What a contact must explain in all: a fit to noise gains some too.
_SEEN = 25.0

# And what it must explain more for each slot.
_SEEN_MORE = 4.0

# χ² of a slot, of its tolerance, that errors do not leave.
_HIGH = 3.0

# Slots that stand for all.
_SLOTS = 4

# Waves of the sheet that one slot's voltages have in common: the longest. All fourteen are
# no better in a step, three lose a second contact on the way to it.
_LONGEST = 5


class PreparedErrors(NamedTuple):
    """Errors of S slots with their good channels."""

    grounds: Int[Array, " S"]
    used: Bool[Array, "S M"]
    grounded: Bool[Array, "L M"]  # of every ground: what tells of its path alone
    own: Float[Array, ""]  # a channel's own error, as a part of its voltage
    local: Float[Array, "3 M M"]  # and of its voltage's bend and slopes, from all voltages
    smooth: Float[Array, "q M"]  # relative errors that channels have in common, 1 σ each
    spread: Float[Array, ""]  # of the model's error, by λ
    offset: Float[Array, ""]  # of a slot, as a part of its mean voltage
    noise: Float[Array, ""]  # of the converter, V
    compared: Int[Array, " s"]  # slots that candidates are compared in
    tolerance: Float[Array, ""]  # a slot's misfit beyond which it counts little

    @property
    def slots(self) -> Bool[Array, " S"]:
        """Tells which slots have a channel that is used."""
        return self.used.any(1)

    @property
    def slot_count(self) -> Float[Array, ""]:
        """Returns the number of such slots, 1 at least."""
        return jnp.maximum(self.slots.sum(), 1).astype(self.tolerance.dtype)

    def mean(self, values: Float[Array, "S n"]) -> Float[Array, " n"]:
        """Computes the mean over such slots."""
        return jnp.where(self.slots[:, None], values, 0).sum(0) / self.slot_count


class Whitened(NamedTuple):
    """One whitened frame, and its errors."""

    frame: WhitenedFrame
    own: Float[Array, "S M"]  # σ of a channel's own error but for noise, V
    common: Float[Array, "S q M"]  # and of what they have in common, V, the offset last
    offset: Float[Array, " S"]  # σ of what all channels of a slot may be off, V


class Errors(eqx.Module):
    """Errors of a rig with nominal values, or errors that a calibration states."""

    electrode_xy: Float[Array, "M 2"]
    size: Float[Array, "2"]
    off: Float[Array, ""]  # of electrodes, pitches
    noise: Float[Array, ""]  # of the converter, V
    grounded: Bool[Array, "L M"]
    error: Float[Array, ""]  # of the model, as a part of that of nominal values
    part: Float[Array, ""]  # the same of what each channel has of its own

    @classmethod
    def of(cls, sensor: Sensor, slots: Slots | None = None) -> "Errors":
        """Makes the errors of a rig with nominal values.

        By default each electrode is grounded alone.
        """
        which = sensor.all_grounds()
        grounded: Any = np.eye(sensor.electrode_count, dtype=bool)
        if slots is not None:
            grounded = slots.grounded(which)
        noise = jnp.asarray(nominal_noise(sensor), sensor.dtype)
        off = _OFF * sensor.electrode_diameter / sensor.mean_pitch
        grounded, one = jnp.asarray(grounded), jnp.asarray(np.ones((), sensor.dtype))
        return cls(sensor.electrode_xy, sensor.size, off, noise, grounded, one, one)

    def calibrated(self, calibration: Calibration) -> "Errors":
        """Returns the errors that the calibration states."""
        parts = calibration.error, calibration.own
        error, part = (jnp.asarray(a, self.error.dtype) for a in parts)
        noise = noise_as(calibration, self.noise)
        return replace(self, noise=noise, error=error, part=part)

    def prepare(self, grounds: np.ndarray, good: np.ndarray, lam: float) -> PreparedErrors:
        """Prepares S slots' errors; `lam` multiplies the variance of the model's error."""
        used = _common(good)
        channels = np.asarray(used.any(0))
        slots = np.flatnonzero(used.any(1))
        compared = slots
        if len(slots) > _SLOTS:
            compared = slots[np.linspace(0, len(slots) - 1, _SLOTS).round().astype(int)]
        dtype, wide = self.noise.dtype, float(np.sqrt(lam))
        spread, own = wide * float(self.error), wide * float(self.part)
        xy = np.asarray(self.electrode_xy, float)
        parts = np.array([_BEND, float(self.off), float(self.off)])
        local = own * parts[:, None, None] * bends_and_slopes(xy, channels)
        # As many σ² as there are channels: twice what errors leave that are as told.
        tolerance = max(1, used.sum(1).max(initial=0))
        made: dict[str, Any] = dict(
            grounds=np.asarray(grounds, np.int32),
            used=used,
            grounded=self.grounded,
            own=np.asarray(own * _OWN, dtype),
            local=local.astype(dtype),
            smooth=np.asarray(spread, dtype) * np.asarray(self.smooth(self.electrode_xy)),
            spread=np.asarray(spread, dtype),
            offset=np.asarray(spread * _OFFSET, dtype),
            noise=self.noise,
            compared=compared,
            tolerance=np.asarray(tolerance, dtype),
        )
        return PreparedErrors(**jax.tree.map(jnp.asarray, made))

    def in_slot(self, good: Bool[np.ndarray, " M"]) -> Noise:
        """Returns one slot's errors for a `step`, with the sheet's longest waves alone."""
        ready = self.prepare(np.array([0]), good[None], 1.0)
        # In NumPy: each operation of JAX's would be a program to compile.
        ready = jax.tree.map(np.asarray, ready)
        strength = (ready.smooth**2).mean(1)
        longest = np.sort(np.argsort(-strength, kind="stable")[:_LONGEST])
        smooth = ready.smooth[longest]
        dtype = ready.local.dtype
        shaped = np.array([_ROUND, _SLOPED, _SLOPED], dtype)
        local = (shaped[:, None, None] * ready.local).transpose(2, 0, 1)
        own = jnp.asarray(_ROUND * ready.own, dtype)
        found = Noise(ready.noise, own, local.reshape(len(local), -1), smooth, ready.offset)
        return jax.tree.map(jnp.asarray, found)

    def smooth(self, places: Float[Array, "n 2"]) -> Float[Array, "q n"]:
        """Returns the relative errors that neighbours have in common, 1 σ of each wave."""
        return _smooth(places, self.size)


@kept
def _smooth(places: Float[Array, "n 2"], size: Float[Array, "2"]) -> Float[Array, "q n"]:
    modes, strength = smooth_modes(places, size)
    return modes * jnp.asarray(_SMOOTH * strength[:, None], modes.dtype)


def noise_as(calibration: Calibration, nominal: Float[Array, ""]) -> Float[Array, ""]:
    """Returns the calibration's noise, V, or the nominal noise where none is stated."""
    told = calibration.noise
    return nominal if told is None else jnp.asarray(told, nominal.dtype)


def noise_of(sensor: Sensor) -> Noise:
    """Returns one slot's errors of a rig with nominal values, every channel good."""
    return Errors.of(sensor).in_slot(np.ones(sensor.electrode_count, bool))


def whitened(prepared: PreparedErrors, voltages: Float[Array, "S M"]) -> Whitened:
    """Whitens a frame: its errors become independent and of size 1."""
    used = _not_grounded(prepared)
    near = jnp.einsum("knm,sm->ksn", prepared.local, voltages, precision="highest")
    own = jnp.sqrt((prepared.own * voltages) ** 2 + (near**2).sum(0))
    each = jnp.sqrt(own**2 + prepared.noise**2)
    high = jnp.where(used, jnp.abs(voltages), 0)
    count = jnp.maximum(used.sum(1), 1).astype(voltages.dtype)
    offset = prepared.offset * high.sum(1) / count
    flat = jnp.broadcast_to(offset[:, None], voltages.shape)
    common = jnp.concatenate([high[:, None] * prepared.smooth, flat[:, None]], 1)
    frame = whiten(voltages, prepared.grounds, jnp.where(used, each, 0), common)
    return Whitened(frame, own, common, offset)


def with_faults(
    errors: Whitened, voltages: Float[Array, "S M"], known: Float[Array, "S F M"]
) -> Whitened:
    """Frees a frame of what faults of the rig may make, V; common errors come after."""
    frame, common = errors.frame, jnp.concatenate([known, errors.common], 1)
    own = jnp.where(frame.scale > 0, 1 / jnp.where(frame.scale > 0, frame.scale, 1), 0)
    return errors._replace(
        frame=whiten(voltages, frame.grounds, own, common), common=common
    )


def _not_grounded(prepared: PreparedErrors) -> Bool[Array, "S M"]:
    return prepared.used & ~prepared.grounded[prepared.grounds]


def without_offset(
    prepared: PreparedErrors, misfit: Float[Array, "S M"]
) -> tuple[Float[Array, "S M"], Bool[Array, "S M"]]:
    """Takes off the mean misfit of each slot, its ground's; tells the channels used."""
    used = _not_grounded(prepared)
    return centred(misfit, used), used


def misfit_cost(
    misfits: Float[Array, " S"], tolerance: Float[Array, ""]
) -> Float[Array, " S"]:
    """Returns Cauchy's loss of each slot's |r|²: a slot that fits badly counts little."""
    return tolerance * jnp.log1p(misfits / tolerance)


def highest_cost(tolerance: Float[Array, ""]) -> Float[Array, ""]:
    """Returns the cost beyond which a slot's rest is more than an error."""
    return tolerance * float(np.log1p(_HIGH))


def seen(
    prepared: PreparedErrors, frame: WhitenedFrame, costs: Float[Array, " S"]
) -> Bool[Array, ""]:
    """Tells whether a fit of these costs explains more than noise and channels' zeros."""
    alone = misfit_cost((frame.whitened**2).sum(1), prepared.tolerance)
    return (alone - costs).sum() > _SEEN + _SEEN_MORE * prepared.slot_count


def _common(good: Bool[np.ndarray, "S M"]) -> Bool[np.ndarray, "S M"]:
    """Marks the channels that are good in every slot that is kept.

    One set of channels serves all slots. Slots with no more than half of the best slot's
    channels are left out.
    """
    each = good.sum(1)
    slots = each * 2 > each.max()
    channels = good[slots].all(0) if slots.any() else good.any(0)
    return slots[:, None] & channels


def bends_and_slopes(
    xy: Float[np.ndarray, "M 2"], channels: Bool[np.ndarray, " M"]
) -> Float[np.ndarray, "3 M M"]:
    """Makes matrices from voltages to each one's distance from its neighbours' plane, and
    to the plane's slopes along x and y, per pitch."""
    apart = np.sqrt(((xy[:, None] - xy) ** 2).sum(-1)) + np.diag(np.full(len(xy), np.inf))
    pitch = np.median(apart.min(1))
    matrices = np.zeros((3, *apart.shape))
    for k in np.flatnonzero(channels):
        near = np.flatnonzero(channels & (apart[k] < 1.6 * pitch))
        if len(near) < 3:  # what is left of few: those that are nearest
            near = np.flatnonzero(channels)[np.argsort(apart[k, channels])[:4]]
            near = near[near != k]
        plane = np.column_stack([np.ones(len(near)), (xy[near] - xy[k]) / pitch])
        matrices[:, k, near] = np.array([[-1], [1], [1]]) * np.linalg.pinv(plane)
        matrices[0, k, k] = 1
    return matrices
