"""Computes what frames with one contact each say of the rig, the contact eliminated."""

from functools import partial
from typing import Any, cast, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Integer

from tomojax.calibration._unknowns import RigSlopes, slopes_by_rig
from tomojax.kernels import contacts as model
from tomojax.kernels.algebra import descend, Normal
from tomojax.kernels.contacts import Explained, normal_of, Sheet, WhitenedFrame
from tomojax.methods import fitting_of, method, Points
from tomojax.sensor import Calibration, Sensor

# Steps of a contact's own fit.
_STEPS = 15

# Frames of a compiled call, and those that its loop works on at once.
_FRAMES = 64
_TOGETHER = 16

# How fast a contact may move in a frame, 1 σ, m/s: a hand that rubs.
_SPEED = 0.3


class Known(NamedTuple):
    """Frames with one contact each: its rough place, and how well that is known.

    The arrays are NumPy's on the host, and JAX's in compiled calls.
    """

    voltages: Float[Any, "n S M"]
    grounds: Integer[Any, "n S"]
    places: Float[Any, "n 2"]  # m
    spread: Float[Any, " n"]  # 1 σ of them, m
    times: Float[Any, "n S"]  # of slots, s
    weight: Float[Any, " n"]  # of what a frame tells, beside its neighbours

    def on_device(self, dtype: Any) -> "Known":
        """Makes JAX's arrays, of which a compiled call takes each frame by itself."""
        wide = Known(*(jnp.asarray(a, dtype) for a in self))
        return wide._replace(grounds=jnp.asarray(self.grounds))


def points_of(sensor: Sensor, calibration: Calibration) -> Points:
    """Makes the method `points` that frames are fitted by."""
    return cast(Points, method(sensor, "points", 32, calibration))


class Sums(NamedTuple):
    """The normal equations of all frames, and what the frames leave."""

    each: Float[np.ndarray, " n"]  # what is left of a frame, of what errors leave
    normal: Float[np.ndarray, "P P"]
    right: Float[np.ndarray, " P"]
    scatter: Float[np.ndarray, "P P"]  # of the right side, frame by frame
    left: Float[np.ndarray, ""]  # Σ of squares, whitened
    free: Float[np.ndarray, ""]  # how many of them errors leave
    shared: Float[np.ndarray, ""]  # mean square of common errors, of nominal ones


class Near(NamedTuple):
    """A frame, and about where its one contact is."""

    sheet: Sheet
    frame: WhitenedFrame
    tolerance: Float[Array, ""]
    place: Float[Array, "2"]  # m
    spread: Float[Array, ""]  # 1 σ of it, m; ∞: the place is a start alone

    def explained(self, parameters: Float[Array, "6"]) -> Explained:
        """Explains the frame by a contact with these parameters."""
        found, unit = model.discs(self.sheet, self.frame, parameters), self.sheet.unit
        place, spread = self.place / unit, self.spread / unit
        slope = jnp.eye(2, model.DISC, dtype=spread.dtype) / spread
        return found._replace(
            prior=jnp.concatenate([found.prior, (parameters[:2] - place) / spread]),
            slope=jnp.concatenate([found.slope, slope]),
        )

    def fitted(self) -> Float[Array, "6"]:
        """Fits a contact: its parameters."""
        start = jnp.pad(self.place / self.sheet.unit, (0, model.DISC - 2))[None]
        limits, counts = model.limits_of(self.sheet), (_STEPS, _STEPS, _TOGETHER)
        return descend(_cost, start, limits, *counts, jnp.inf, 0.0, self)[0]


def _cost(parameters: Float[Array, "6"], near: Near) -> Normal:
    return normal_of(near.explained(parameters), near.tolerance)


def sums_of(
    points: Points, slopes: RigSlopes, volts: Float[np.ndarray, "n S M"], known: Known
) -> Sums:
    """Sums the normal equations of the rig's values over frames; `volts` are corrected."""
    used = np.isfinite(volts).all((0, 1))
    prepared = points.prepare(known.grounds[0], np.tile(used, (volts.shape[1], 1)), 1.0)
    dtype = points.errors.noise.dtype
    times = known.times - known.times.mean(1, keepdims=True)
    whole = known._replace(voltages=np.nan_to_num(volts), times=times)
    each, parts = [], []
    for k in range(0, len(volts), _FRAMES):
        part = np.arange(k, k + _FRAMES)
        there = part < len(volts)
        some = Known(*(a[np.minimum(part, len(volts) - 1)] for a in whole))
        some = some._replace(weight=there * some.weight).on_device(dtype)
        found = _frames(points, slopes, prepared, some)
        parts.append(Sums(*(np.asarray(a, float) for a in found)))
        each.append(parts[-1].each[there])
    total = Sums(*(np.sum(a, 0) for a in zip(*parts)))
    return total._replace(
        each=np.concatenate(each), shared=total.shared / known.weight.sum()
    )


@eqx.filter_jit
def _frames(
    points: Points, slopes: RigSlopes, prepared: Any, frames: Known
) -> tuple[Array, ...]:
    one = partial(_frame, points, slopes, prepared)
    rows, shared, rest, *sums = jax.vmap(one)(frames)
    weight = frames.weight
    # One product for all frames.
    count = rows.shape[-1]
    root = jnp.sqrt(weight)[:, None, None]
    flat = (root * rows).reshape(-1, count)
    less = (root * shared).reshape(-1, count)
    normal = jnp.matmul(flat.T, flat, precision="highest")
    normal = normal - jnp.matmul(less.T, less, precision="highest")
    # A frame's errors have much in common: what each adds to the right side tells how much.
    each = jnp.einsum("nr,nrp->np", rest, rows, precision="highest") * weight[:, None]
    scatter = jnp.matmul(each.T, each, precision="highest")
    left = sums[0] / jnp.maximum(sums[1], 1)
    return left, normal, each.sum(0), scatter, *(weight @ s for s in sums)


def _frame(
    points: Points, slopes: RigSlopes, prepared: Any, one: Known
) -> tuple[Array, ...]:
    """Computes rows A of slopes by the rig, B, the contact's part of AᵀA, and the rest.

    The contact's currents are eliminated slot by slot. Place, size, shape and speed, which
    the slots share, are eliminated by BᵀB = AᵀT(TᵀT + Λ)⁻¹TᵀA. The contact's own fit leaves
    nothing along T but the priors' part, and so the right side is Aᵀr.
    """
    near, whole = near_of(points, prepared, one)
    found, sheet, frame = near.explained(near.fitted()), near.sheet, near.frame
    # Slots that do not fit at all count little, as in the fit.
    robust = jax.lax.rsqrt(1 + (found.rest**2).sum(1) / near.tolerance)[:, None]
    column = found.column[:, 0] * robust
    length = jnp.maximum((column**2).sum(1, keepdims=True), 1e-30)

    def free(rows: Float[Array, "S M k"]) -> Float[Array, "S M k"]:
        along = jnp.einsum("sm,smk->sk", column / length, rows, precision="highest")
        return rows - column[..., None] * along[:, None]

    scale = (frame.scale * robust)[..., None]
    rows = free(slopes_by_rig(sheet, slopes, frame.grounds, found.fitted) * scale)
    by_contact = found.tangent.transpose(0, 2, 1) * robust[..., None]
    moving = by_contact[..., :2] * (one.times * _SPEED / sheet.unit)[:, None, None]
    by_contact = free(jnp.concatenate([by_contact, moving], -1))
    rest = found.rest * robust
    shape = rows.shape[0] * rows.shape[1], -1
    a, t = rows.reshape(shape), by_contact.reshape(shape)
    known = jnp.matmul(found.slope.T, found.slope, precision="highest")
    still = jnp.diag(jnp.array([0.0] * model.DISC + [1.0] * 2, t.dtype))
    own = jnp.matmul(t.T, t, precision="highest") + (jnp.pad(known, (0, 2)) + still)
    both = jnp.matmul(t.T, a, precision="highest")
    shared = jax.scipy.linalg.solve_triangular(jnp.linalg.cholesky(own), both, lower=True)
    left = model.whitened_columns(whole, one.voltages - found.fitted.voltages)
    left = left[:, one.voltages.shape[1] :]
    count = (frame.scale > 0).sum() - rows.shape[0] - t.shape[1]
    sums = (rest**2).sum(), count.astype(rest.dtype), jnp.square(left * robust).mean()
    sound = jnp.isfinite(found.fitted.place).all() & jnp.isfinite(shared).all()
    return tuple(jnp.where(sound, x, 0) for x in (a, shared, rest.ravel(), *sums))


def near_of(points: Points, prepared: Any, one: Known) -> tuple[Near, WhitenedFrame]:
    """Whitens a frame by each channel's own errors alone, and by all errors.

    A calibration looks for the errors in common: its contacts are fitted without these.
    """
    volts, here = one.voltages, prepared._replace(grounds=one.grounds)
    frame = fitting_of(points, here, volts, 1).frame
    own = frame._replace(
        whitened=volts * frame.scale, common=frame.common[:, :0], filter=frame.filter[:, :0]
    )
    return Near(points.sheet, own, prepared.tolerance, one.places, one.spread), frame
