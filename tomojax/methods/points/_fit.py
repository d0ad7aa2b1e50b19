"""One fit of `points` to one frame: what it is given, and what is known when it ends."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels import contacts as model
from tomojax.kernels.algebra import (
    descend,
    Limits,
    Normal,
    solve_positive,
)
from tomojax.kernels.contacts import Look, look, unwhitened, WhitenedFrame
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
_FEW, _MOST = 3, 20

# A start of one disc that leaves less than this part of what is usual is the best of them;
# two discs that explain as much may still be two others.
_ENOUGH = 1.5

# Beyond so many times the cost that is asked for, and what is usual, a fit to a few slots
# is not gone on with.
_HOPELESS = 2.0

# A few of many slots are searched with; then this many steps with all slots follow. Slots
# share errors, and more steps would fit those. A few slots hardly tell a curve.
_LAST, _LAST_LONG = 3, 10

# Slots that a turn of the search works on at once: of fewer a call costs more than work,
# of more they do not stay in the processor's cache. And least and most frames of them.
_TOGETHER, _LEAST_MOST = 64, (4, 16)


class Found(NamedTuple):
    """Contacts of one frame as they were fitted, `count` of at most C."""

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


def look_of(scene: Fitting) -> Look:
    """The candidates beside some slots of the frame."""
    some, sheet = scene.prepared.compared, scene.method.sheet
    ee, grounds = sheet.field.electrodes, scene.frame.grounds[some]
    offset = jnp.diagonal(ee)[grounds][:, None] - ee[grounds]
    part = jax.tree.map(lambda a: a[some], scene.frame)
    return look(scene.method.potentials, offset, part)


def starts_at(scene: Fitting, places: Float[Array, "n C 2"]) -> Float[Array, "n CP"]:
    """Usual contacts there."""
    lengths = places / scene.method.sheet.unit
    usual = ((0, 0), (0, 0), (0, model.DISC - 2))
    return jnp.pad(lengths, usual).reshape(len(places), -1)


class Ended(NamedTuple):
    """The end of a fit: its parameters, and the whitened residuals there."""

    parameters: Float[Array, " P"]
    normal: Float[Array, "P P"]  # JᵀWJ
    rest: Float[Array, "S W"]
    slope: Float[Array, "S P W"]  # of that, currents being what fits best


class Kind(NamedTuple):
    """A model: what it explains of a frame, and the limits of its parameters."""

    explain: Callable[..., model.Explained]
    limits: Callable[..., Limits]
    parameters: int  # of one contact
    last: int  # steps with all slots


# Traced once for all that holds it.
DISCS = Kind(jax.jit(model.discs), model.limits_of, model.DISC, _LAST)
CURVE = Kind(jax.jit(model.curve), model.limits_of_curve, model.CURVE, _LAST_LONG)


def best_fit(
    scene: Fitting,
    kind: Kind,
    starts: Float[Array, "n P"],
    below: Float[Array, " S"] | None = None,
) -> tuple[Found, Ended]:
    """The best of the fits from `starts`, and how it ended.

    Slots' costs `below`, if any, are asked for: what does not reach them may end early.
    """
    if below is None:
        below = jnp.full(len(scene.voltages), jnp.inf, starts.dtype)
    parameters = _lowest(scene, kind, lax.stop_gradient(starts), lax.stop_gradient(below))
    explained = kind.explain(scene.method.sheet, scene.frame, parameters)
    normal = model.normal_of(explained, scene.prepared.tolerance)
    # What ends the residuals of a curve is what is known of it, in no voltage.
    width = scene.frame.whitened.shape[1]
    slopes = model.free_slopes(explained)[..., :width]
    ended = Ended(parameters, normal.matrix, explained.rest[:, :width], slopes)
    return _found(scene, kind, explained, ended, normal.cost), ended


@eqx.filter_custom_jvp
def _lowest(
    scene: Fitting, kind: Kind, starts: Float[Array, "n P"], below: Float[Array, " S"]
) -> Float[Array, " P"]:
    """Parameters of the lowest cost: of each start a few steps, and the best to its end.

    Of many slots a few stand for all, until what is lowest there is known.
    """
    frame, sheet, some = scene.frame, scene.method.sheet, scene.prepared.compared
    # No start is good for a frame without voltages, as fill a call up: it ends at once.
    starts = jnp.where(jnp.isfinite(frame.whitened).all(), starts, jnp.nan)
    limits = _limits(kind, sheet, starts.shape[1])

    def lowest(
        starts: Array, frame: WhitenedFrame, below: Array, most: int
    ) -> tuple[Array, Array]:
        together = int(np.clip(_TOGETHER // len(frame.grounds), *_LEAST_MOST))
        alone = kind is DISCS and starts.shape[1] == kind.parameters
        enough = (_ENOUGH if alone else 0.0) * _usual(frame)
        of = below.sum(), enough, sheet, frame, scene.prepared.tolerance
        return descend(_cost_of(kind), starts, limits, _FEW, most, together, *of)

    if len(some) < len(frame.grounds):
        part = jax.tree.map(lambda a: a[some], frame)
        found, cost = lowest(starts, part, below[some], _MOST)
        # What is far from explaining these explains no more of all.
        hopeless = cost > _HOPELESS * below[some].sum() + _usual(part)
        found = jnp.where(hopeless, jnp.nan, found)
        return lowest(found[None], frame, below, kind.last)[0]
    return lowest(starts, frame, below, _MOST)[0]


def _usual(frame: WhitenedFrame) -> Float[Array, ""]:
    """What errors leave of a frame, usually."""
    return LEFT * (frame.scale > 0).sum().astype(frame.scale.dtype)


def _limits(kind: Kind, sheet: model.Sheet, count: int) -> Limits:
    each = count // kind.parameters
    return jax.tree.map(lambda a: jnp.tile(a, each), kind.limits(sheet))


@functools.cache
def _cost_of(kind: Kind) -> Callable[..., Normal]:
    @jax.jit
    def cost(
        p: Float[Array, " P"], sheet: model.Sheet, frame: WhitenedFrame, tolerance: Array
    ) -> Normal:
        return model.normal_of(kind.explain(sheet, frame, p), tolerance)

    return cost


@_lowest.def_jvp
def _(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    """p' = −(∂g/∂p)⁻¹·∂g, g the slope of the cost that is 0 there.

    Only who differentiates pays: the search's loop cannot be, in reverse.
    """
    scene, kind, starts, below = primals
    at = _lowest(scene, kind, starts, below)
    sheet, cost = scene.method.sheet, _cost_of(kind)
    highest = _limits(kind, sheet, len(at)).highest

    def downhill(p: Array, scene: Fitting) -> Array:
        sheet, tolerance = scene.method.sheet, scene.prepared.tolerance
        slope = cost(p, sheet, scene.frame, tolerance).gradient
        return jnp.where(at >= highest, p, slope)

    moving, still = eqx.partition(scene, eqx.is_inexact_array)
    # What does not move has no tangent.
    along = jax.tree.map(
        lambda a, t: jnp.zeros_like(a) if t is None else t, moving, tangents[0]
    )
    of_scene = lambda moving: downhill(at, eqx.combine(moving, still))  # noqa: E731
    _, moved = jax.jvp(of_scene, (moving,), (along,))
    return at, -_solved(jax.jacfwd(downhill)(at, scene), moved, at)


def _solved(bent: Float[Array, "P P"], moved: Float[Array, " P"], at: Array) -> Array:
    # A fit that failed stays where it is.
    sound = jnp.isfinite(bent).all() & jnp.isfinite(at).all()
    found = jnp.linalg.inv(jnp.where(sound, bent, jnp.eye(len(at), dtype=at.dtype)))
    inverse = jnp.nan_to_num(found, posinf=0.0, neginf=0.0) * sound.astype(at.dtype)
    return jnp.matmul(inverse, moved, precision="highest")


def _found(
    scene: Fitting, kind: Kind, explained: model.Explained, ended: Ended, cost: Array
) -> Found:
    prepared, rest, fitted = scene.prepared, ended.rest, explained.fitted
    cost = jnp.where(jnp.isfinite(cost), cost, jnp.inf)
    slots = prepared.used.any(1)
    n = jnp.maximum(slots.sum(), 1).astype(cost.dtype)
    misfit, used = without_offset(prepared, fitted.voltages - scene.voltages)
    current = jnp.where(slots[:, None], fitted.current, 0).sum(0) / n
    drop = _drop(scene, fitted, rest)
    count = len(fitted.radius)
    # What is long is not added to.
    of_discs = ended.parameters if kind is DISCS else jnp.zeros(model.DISC, rest.dtype)
    # How sure a place is is not differentiated.
    known, of_size, limited = _uncertainty(_still(scene), _still(ended), count)
    vague = model.hardly_told(scene.method.sheet, current / drop, of_size)
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
    return Found(
        cost / n,
        LEFT * (scene.frame.scale > 0).sum().astype(cost.dtype) / n,
        misfit_cost((explained.rest**2).sum(1), prepared.tolerance),
        jnp.asarray(count),
        *(_padded(a, scene.most) for a in values),
        high=cost / n > highest_cost(prepared.tolerance),
        limited=limited,
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
    """Covariance of the places, variance of the sizes, and whether errors are unusual.

    N⁻¹(ΣGᵀσ²G + κ²Σ_k(Σ_s G_sᵀe_sk)(…)ᵀ)N⁻¹, G the slopes of the fit by voltages: noise is
    another in each slot, the model's errors e_k are the same ones. So more slots average
    the one and not the other. κ² ≥ 1: how much more is left of the voltages than nominal
    values leave.
    """
    normal, parameters = ended.normal, ended.parameters
    frame = scene.frame
    used = frame.scale > 0
    left = (ended.rest**2).sum(1)
    weight = 1 / (1 + left / scene.prepared.tolerance)
    by_voltage = unwhitened(frame, ended.slope * weight[:, None, None])  # (S, P, M)
    own = jnp.where(used, scene.own, 0)
    # The slots' channels side by side, so that sums over them are products.
    flat = by_voltage.transpose(1, 0, 2).reshape(len(parameters), -1)
    noise = scene.prepared.noise**2 * jnp.matmul(flat, flat.T, precision="highest")
    alike = scene.common[:, :-1].transpose(1, 0, 2).reshape(-1, flat.shape[1])
    shared = jnp.concatenate(
        [
            (by_voltage * own[:, None]).sum(0).T,
            jnp.matmul(alike, flat.T, precision="highest"),
            # Another in each slot: its ground's.
            jnp.einsum("spm,sm->sp", by_voltage, scene.common[:, -1]),
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
