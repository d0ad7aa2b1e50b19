"""Fits one disc to each frame, and returns what channels leave: for drift and `info`."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Integer

from tomojax.calibration._frames import Near
from tomojax.kernels.contacts import DISC
from tomojax.methods import fitting_of, Points

# Frames of a compiled call.
_CALL = 16


class Left(NamedTuple):
    """The part of each frame's voltages that the best disc leaves."""

    relative: Float[np.ndarray, "n M"]  # of a channel's voltages, over the slots; 1
    variance: Float[np.ndarray, "n M"]  # of that, as noise and the model's errors make it
    misfit: Float[np.ndarray, " n"]  # χ² for each voltage that is free
    places: Float[np.ndarray, "n 2"]  # m; NaN where the fit failed


def left_of(
    points: Points,
    voltages: Float[np.ndarray, "n S M"],
    grounds: Integer[np.ndarray, "n S"],
    places: Float[np.ndarray, "n 2"],
) -> Left:
    """Fits one disc, begun at `places` (m), to each frame of corrected voltages.

    A channel that is NaN in some slot of some frame is not used. Calls have one size, so
    that one program serves any number of frames of as many slots.
    """
    n, slots, _ = voltages.shape
    used = np.isfinite(voltages).all((0, 1))
    prepared = points.prepare(np.zeros(slots, int), np.tile(used, (slots, 1)), 1.0)
    # The slots that stand for all are the same whatever the channels.
    volts, dtype = np.nan_to_num(voltages), points.errors.noise.dtype
    parts = []
    for k in range(0, n, _CALL):
        some = np.minimum(np.arange(k, k + _CALL), n - 1)
        # A call is filled up with starts that are none: those fits end at once.
        there = (np.arange(k, k + _CALL) < n)[:, None]
        starts = np.where(there, places[some], np.nan)
        given = (jnp.asarray(a, dtype) for a in (volts[some], starts))
        found = _left(points, prepared, jnp.asarray(grounds[some]), *given)
        parts.append([np.asarray(a, float)[: n - k] for a in found])
    found = Left(*(np.concatenate(a) for a in zip(*parts)))
    told = used & (found.variance > 0)
    return found._replace(
        relative=np.where(told, found.relative, 0),
        variance=np.where(told, found.variance, np.inf),
    )


@eqx.filter_jit
def _left(
    points: Points, prepared: Any, grounds: Array, volts: Array, places: Array
) -> tuple[Array, ...]:
    def one(g: Array, v: Array, place: Array) -> tuple[Array, ...]:
        return _one(points, prepared._replace(grounds=g), v, place)

    return jax.vmap(one)(grounds, volts, places)


def _one(
    points: Points, prepared: Any, volts: Float[Array, "S M"], place: Float[Array, "2"]
) -> tuple[Array, ...]:
    """Computes Σ_s f(v − f)/Σ_s f², f the fitted voltages, less the slot's common part."""
    scene = fitting_of(points, prepared, volts, 1)
    frame, anywhere = scene.frame, jnp.full((), jnp.inf, place.dtype)
    near = Near(points.sheet, frame, prepared.tolerance, place, anywhere)
    parameters = near.fitted()
    found = near.explained(parameters)
    used = (frame.scale > 0).astype(volts.dtype)
    fit = found.fitted.voltages * used
    misfit = (volts - fit) * used
    # Its ground's path lifts all channels of a slot.
    count = jnp.maximum(used.sum(1, keepdims=True), 1)
    misfit = (misfit - misfit.sum(1, keepdims=True) / count) * used
    power = jnp.maximum((fit**2).sum(0), 1e-30)
    relative = (fit * misfit).sum(0) / power
    # A channel's own errors are the same in all slots; the sheet's are in each place.
    own = (jnp.abs(fit) * scene.errors.own * used).sum(0) / power
    smooth = (prepared.smooth**2).sum(0)
    variance = jnp.asarray(prepared.noise) ** 2 / power + own**2 + jnp.asarray(smooth)
    # Free are the voltages but for a current in each slot, and the disc.
    free = jnp.maximum(used.sum() - used.max(1).sum() - DISC, 1)
    chi = (found.rest**2).sum() / free
    sound = jnp.isfinite(parameters).all() & jnp.isfinite(relative).all()
    return (
        jnp.where(sound, relative, 0),
        jnp.where(sound & (power > 1e-20), variance, 0),
        jnp.where(sound, chi, jnp.nan),
        jnp.where(sound, found.fitted.place[0], jnp.nan),
    )
