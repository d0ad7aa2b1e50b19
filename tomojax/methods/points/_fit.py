"""One fit of `points` to one frame: what it is given, and what is known when it ends."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels import contacts as model
from tomojax.kernels.algebra import least_squares, LeastSquares, solve_positive
from tomojax.kernels.contacts import (
    slot_columns,
    unwhitened,
    whitened_columns,
    WhitenedFrame,
)
from tomojax.methods._contract import rms, rms_by_electrode
from tomojax.methods._errors import (
    highest_cost,
    misfit_cost,
    PreparedErrors,
    whitened,
    without_offset,
)

# What is left of whitened voltages for each that is free, usually: the errors that are told
# of are nearly the largest of what is usual. Beyond so many times that they are unusual.
LEFT, _UNUSUAL = 0.37, 4.0

# Fits from several starts: the best, after a few steps, is gone on with.
_FEW, _MOST = 6, 30


class Found(NamedTuple):
    """Contacts of one frame as they were fitted, `count` of at most C."""

    cost: Float[Array, ""]  # per slot
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
    residual: Float[Array, ""]  # V rms
    by_electrode: Float[Array, " M"]  # the same of each


class Fitting(NamedTuple):
    """One frame, and what it is fitted with."""

    method: Any
    prepared: PreparedErrors
    frame: WhitenedFrame
    own: Float[Array, "S M"]  # these three as in `Whitened`
    common: Float[Array, "S q M"]
    offset: Float[Array, " S"]
    voltages: Float[Array, "S M"]
    most: int  # contacts


def fitting_of(
    method, prepared: PreparedErrors, voltages: Float[Array, "S M"], most: int
) -> Fitting:
    """A frame, whitened."""
    return Fitting(method, prepared, *whitened(prepared, voltages), voltages, most)


def candidates_of(scene: Fitting) -> tuple[Array, Array]:
    """Of each candidate in some slots, and the frame in these; whitened."""
    some = scene.prepared.compared
    part: WhitenedFrame = jax.tree.map(lambda a: a[some], scene.frame)
    sheet, potentials = scene.method.sheet, scene.method.potentials
    z = sheet.ground_resistance
    columns = slot_columns(sheet.field, potentials, part.grounds, z)
    return whitened_columns(part, columns), part.whitened


def starts_at(scene: Fitting, places: Float[Array, "n C 2"]) -> Float[Array, "n CP"]:
    """Usual contacts there."""
    lengths = places / scene.method.sheet.unit
    usual = ((0, 0), (0, 0), (0, model.DISC - 2))
    return jnp.pad(lengths, usual).reshape(len(places), -1)


def fit_of(scene: Fitting, kind: Callable) -> Callable:
    """That model, of a flat vector of parameters."""
    width = (-1, model.DISC) if kind is model.discs else (-1,)
    return lambda p: kind(scene.method.sheet, scene.frame, p.reshape(width))


def best_fit(
    scene: Fitting, kind: Callable, starts: Float[Array, "n P"]
) -> tuple[Found, LeastSquares]:
    """The best of the fits from `starts`, and how it ended."""
    # The search itself is not differentiated (its loop cannot be, in reverse): what it
    # ends at is, as the place where the cost's slope is zero.
    still = jax.tree.map(
        lambda a: lax.stop_gradient(a) if eqx.is_inexact_array(a) else a, scene
    )
    fit, prepared = fit_of(still, kind), scene.prepared
    starts = lax.stop_gradient(starts)
    search = least_squares(fit, starts, prepared.tolerance, _MOST, _FEW)
    ended: LeastSquares = jax.tree.map(lax.stop_gradient, search)
    cost = jnp.where(jnp.isfinite(ended.cost), ended.cost, jnp.inf)
    parameters = _implicit(scene, kind, ended)
    rest, _, fitted = fit_of(scene, kind)(parameters)
    slots = prepared.used.any(1)
    n = jnp.maximum(slots.sum(), 1).astype(cost.dtype)
    volts: Array = fitted.voltages
    misfit, used = without_offset(prepared, volts - scene.voltages)
    currents: Array = fitted.current
    current = jnp.where(slots[:, None], currents, 0).sum(0) / n
    drop = _drop(scene, fitted, rest)
    count = len(fitted.radius)
    known, of_size, limited = _uncertainty(still, ended, count)
    vague = model.hardly_told(scene.method.sheet, current / drop, of_size)
    # What is long is not added to.
    of_discs = (
        parameters if kind is model.discs else jnp.zeros(model.DISC * count, cost.dtype)
    )
    values = (
        of_discs.reshape(count, -1),
        fitted.place,
        fitted.extent,
        fitted.ring,
        fitted.radius,
        current,
        current / drop,
        known,
        vague,
    )
    found = Found(
        cost / n,
        misfit_cost((rest**2).sum(1), prepared.tolerance),
        jnp.asarray(count),
        *(_padded(a, scene.most) for a in values),
        high=cost / n > highest_cost(prepared.tolerance),
        limited=limited,
        residual=rms(misfit, used),
        by_electrode=rms_by_electrode(misfit, used),
    )
    return found, ended


@eqx.filter_custom_jvp
def _implicit(scene: Fitting, kind: Callable, ended: LeastSquares) -> Array:
    """The parameters themselves, where the cost's slope is zero: p' = −H⁻¹·∂(∂C/∂p).

    C is `least_squares`' cost, H its second derivative. Only who differentiates pays.
    """
    return ended.parameters


@_implicit.def_jvp
def _(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    scene, kind, ended = primals
    at, tolerance = ended.parameters, scene.prepared.tolerance

    def cost(p: Array, scene: Fitting) -> Array:
        rest, priors, _ = fit_of(scene, kind)(p)
        lost = tolerance * jnp.log1p((rest**2).sum(1) / tolerance)
        return (lost.sum() + (priors**2).sum()) / 2

    moving, still = eqx.partition(scene, eqx.is_inexact_array)
    # What does not move has no tangent.
    along = jax.tree.map(
        lambda a, t: jnp.zeros_like(a) if t is None else t, moving, tangents[0]
    )
    downhill = lambda moving: jax.grad(cost)(at, eqx.combine(moving, still))  # noqa: E731
    _, moved = jax.jvp(downhill, (moving,), (along,))
    bent = jax.hessian(cost)(at, scene)
    # A fit that failed stays where it is.
    sound = jnp.isfinite(bent).all() & jnp.isfinite(at).all()
    found = jnp.linalg.inv(jnp.where(sound, bent, jnp.eye(len(at), dtype=at.dtype)))
    inverse = jnp.nan_to_num(found, posinf=0.0, neginf=0.0) * sound.astype(at.dtype)
    return at, -jnp.matmul(inverse, moved, precision="highest")


def _uncertainty(
    scene: Fitting, ended: LeastSquares, count: int
) -> tuple[Float[Array, "C 3"], Float[Array, " C"], Bool[Array, ""]]:
    """Covariance of the places, variance of the sizes, and whether errors are unusual.

    N⁻¹(ΣGᵀσ²G + κ²Σ_k(Σ_s G_sᵀe_sk)(…)ᵀ)N⁻¹, G the slopes of the fit by voltages: noise is
    another in each slot, the model's errors e_k are the same ones. So more slots average
    the one and not the other. κ² ≥ 1: how much more is left of the voltages than nominal
    values leave.
    """
    normal, parameters = ended.normal, ended.parameters
    frame = scene.frame
    used = frame.scale > 0
    slope = ended.slope.transpose(1, 2, 0)
    left = (ended.rest**2).sum(1)
    weight = 1 / (1 + left / scene.prepared.tolerance)
    by_voltage = unwhitened(frame, slope * weight[:, None, None])  # (S, M, P)
    noise = scene.prepared.noise**2 * jnp.einsum("smp,smq->pq", by_voltage, by_voltage)
    own = jnp.where(used, scene.own, 0)
    shared = jnp.concatenate(
        [
            jnp.einsum("smp,sm->mp", by_voltage, own),
            jnp.einsum("smp,sqm->qp", by_voltage, scene.common[:, :-1]),
            # Another in each slot: its ground's.
            jnp.einsum("smp,sm->sp", by_voltage, scene.common[:, -1]),
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
    """V0 − u at each contact in the mean over the slots, V, as its neighbours correct it.

    What the channels have in common is there too, as the fit has found it.
    """
    prepared, sheet = scene.prepared, scene.method.sheet
    # What is left ends with the common errors, in standard deviations, see `whiten`.
    found = rest[:, scene.voltages.shape[1] :]
    at = prepared.spread * scene.method.errors.smooth(fitted.place)
    relative = jnp.matmul(found[:, :-1], at, precision="highest")
    u = sheet.drive_voltage - fitted.drop
    drop = fitted.drop - jnp.abs(u) * relative - (found[:, -1] * scene.offset)[:, None]
    slots = prepared.used.any(1)
    n = jnp.maximum(slots.sum(), 1).astype(drop.dtype)
    mean = jnp.where(slots[:, None], drop, 0).sum(0) / n
    forward = jnp.sign(sheet.drive_voltage)
    least = model.LEAST_DROP * jnp.abs(sheet.drive_voltage)
    return forward * jnp.maximum(forward * mean, least)


def _padded(values: Array, count: int) -> Array:
    missing = count - len(values)
    return jnp.pad(values, ((0, missing),) + ((0, 0),) * (values.ndim - 1))
