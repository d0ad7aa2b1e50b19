"""The steps of `points`: one disc; then more discs, a bar or a ring, while that gains."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tomojax import kernels
from tomojax.kernels import _points as model
from tomojax.kernels._candidates import (
    apart_from,
    best_pairs,
    best_places,
    gains_beside,
)
from tomojax.kernels._curves import bar, ring
from tomojax.kernels._least_squares import least_squares, LeastSquares, solve_positive
from tomojax.kernels._whiten import Frame, unwhitened, whiten, whitened_columns

# Fits begun from as many candidates; the best of them, after a few steps, are gone on with.
_STARTS, _KEPT, _FEW, _MOST = 3, 1, 6, 30

# A slot's misfit (64 channels) beyond which it counts little; and by how much, per slot, a
# larger model must fit better to be believed, for each contact beyond the first.
TOLERANCE, _GAIN = 64.0, 8.0

# What a contact must explain in all, and more for each slot: a fit to noise gains some too.
_SEEN = (25.0, 4.0)

# Part of that gain which slopes have to promise before a larger model is fitted.
_PROMISE = 0.6

# Discs nearer than this many usual radii, and a second or further one below this part of
# the strongest, are what the model's error makes of fewer.
_APART, _WEAKEST = 2.0, (0.04, 0.1)

# Of the first guesses, in usual radii: half a bar's length, with its directions; radii of
# rings. A ring narrower than the least is a disc.
_BAR, _DIRECTIONS, _RINGS, _NARROWEST = 4.0, 4, (2.0, 5.0), 1.2


class Prepared(NamedTuple):
    """For S slots with their good channels."""

    grounds: Int[Array, " S"]
    used: Bool[Array, "S M"]
    own: Float[Array, ""]  # a channel's own error, as a part of its voltage
    bend: Float[Array, "M M"]  # and of what its voltage is beside its neighbours'
    smooth: Float[Array, "q M"]  # relative errors that channels have in common, 1 σ each
    spread: Float[Array, ""]  # of the model's error, by λ
    offset: Float[Array, ""]  # of a slot, as a part of its mean voltage
    noise: Float[Array, ""]  # of the converter, V
    compared: Int[Array, " s"]  # slots that candidates are compared in


class Found(NamedTuple):
    """Contacts of one frame as they were fitted, `count` of at most C."""

    cost: Float[Array, ""]  # per slot
    misfits: Float[Array, " S"]  # of each slot
    count: Int[Array, ""]  # pyright: ignore (tuples have a method of that name)
    parameters: Float[Array, "C 3"]
    place: Float[Array, "C 2"]
    extent: Float[Array, "C 2"]
    ring: Float[Array, " C"]
    radius: Float[Array, " C"]
    current: Float[Array, " C"]  # A, the mean over the slots
    conductance: Float[Array, " C"]
    covariance: Float[Array, "C 3"]  # of the place: xx, yy, xy, m²
    limited: Bool[Array, ""]  # by the model's error rather than noise
    residual: Float[Array, ""]  # V rms


class Ladder(NamedTuple):
    """The best so far, and the most discs so far: three may do what no ring does."""

    best: Found
    one: Found  # disc
    discs: Found
    promise: Float[Array, ""]  # of one more disc, per slot, as far as slopes tell


class Scene(NamedTuple):
    """One frame, and what it is fitted with."""

    method: Any
    prepared: Prepared
    frame: Frame
    own: Float[Array, "S M"]  # σ of a channel's own error but for noise, V
    common: Float[Array, "S q M"]  # and of what they have in common, V, the offset last
    offset: Float[Array, " S"]  # σ of what all channels of a slot may be off, V
    voltages: Float[Array, "S M"]
    most: int  # contacts


def scene_of(method, prepared: Prepared, voltages: Float[Array, "S M"], most: int) -> Scene:
    """A frame, whitened."""
    used = prepared.used
    bent = jnp.matmul(voltages, prepared.bend.T, precision="highest")
    own = jnp.sqrt((prepared.own * voltages) ** 2 + bent**2)
    each = jnp.sqrt(own**2 + prepared.noise**2)
    high = jnp.where(used, jnp.abs(voltages), 0)
    channels = jnp.maximum(used.sum(1), 1).astype(voltages.dtype)
    offset = prepared.offset * high.sum(1) / channels
    flat = jnp.broadcast_to(offset[:, None], voltages.shape)
    common = jnp.concatenate([high[:, None] * prepared.smooth, flat[:, None]], 1)
    frame = whiten(voltages, prepared.grounds, jnp.where(used, each, 0), common)
    return Scene(method, prepared, frame, own, common, offset, voltages, most)


def _due(ladder: Ladder, size: int) -> Any:
    """Whether `size` discs are worth a try: the next step, with that much to gain."""
    enough = _PROMISE * _GAIN * (size - 1)
    # A promise that is no number is no reason not to try.
    return ~(ladder.promise <= enough) & (ladder.discs.count == size - 1)


def first(scene: Scene) -> Ladder:
    """One disc, from the best candidate."""
    columns, compared = _candidates(scene)
    places = best_places(columns, compared, scene.method.candidates, 0.0, _STARTS)
    found = _best(scene, model.discs, _starts(scene, places[:, None]))
    found = _seen(scene, found)
    return Ladder(found, found, found, _promise(scene, found, 1))


def _seen(scene: Scene, found: Found) -> Found:
    """No contact where none is the better explanation: noise and channels' zeros."""
    used = scene.prepared.used
    slots = jnp.maximum(used.any(1).sum(), 1).astype(found.cost.dtype)
    alone = TOLERANCE * jnp.log1p((scene.frame.whitened**2).sum(1) / TOLERANCE)
    least = _SEEN[0] + _SEEN[1] * slots
    towards = found.current[0] * jnp.sign(scene.method.sheet.drive_voltage)
    there = ((alone - found.misfits).sum() > least) & (towards > 0)
    channels = jnp.maximum(used.sum(), 1).astype(found.cost.dtype)
    volts = jnp.where(used, scene.voltages, 0)
    return found._replace(
        count=jnp.where(there, found.count, 0),
        current=jnp.where(there, found.current, 0),
        limited=found.limited & there,
        residual=jnp.where(there, found.residual, jnp.sqrt((volts**2).sum() / channels)),
    )


def _larger(scene: Scene, ladder: Ladder, size: int) -> Ladder:
    """`size` discs, where they gain enough."""
    best, one, discs, _ = ladder
    new = _believed(scene, _more_discs(scene, discs, size), size)
    gained = _gains(scene, discs, new, size)
    best = _choose(gained & (_score(new) < _score(best)), new, best)
    promise = jnp.where(gained, _promise(scene, new, size), 0)
    return Ladder(best, one, _choose(gained, new, discs), promise)


def _longer(scene: Scene, ladder: Ladder) -> Ladder:
    """A bar or a ring in the place of two discs, where it fits better yet."""
    best, one = ladder.best, ladder.one
    middle = one.parameters[0, :2]
    for alone in (_bar(scene, middle), _ring(scene, middle)):
        gained = _gains(scene, one, alone, 2)
        best = _choose(gained & (_score(alone) < _score(best)), alone, best)
    return ladder._replace(best=best)


def steps(count: int) -> list[tuple[Callable[[Ladder], Any], Callable]]:
    """What follows the first disc: whether a frame asks for it, and the step."""
    found: list[tuple[Callable, Callable]] = []
    for size in range(2, count + 1):
        found.append((partial(_due, size=size), partial(_larger, size=size)))
        if size == 2:
            found.append((lambda ladder: ladder.discs.count == 2, _longer))
    return found


def _promise(scene: Scene, discs: Found, size: int) -> Array:
    """What the best candidate for one more would gain, per slot compared.

    The discs that there are may move a little then: each candidate is told apart from
    the slopes of their fit. Much less work than to fit it.
    """
    if size >= scene.most:
        return jnp.zeros_like(discs.cost)
    parameters = discs.parameters[:size].ravel()
    fit = lambda p: _of(scene, model.discs)(p)[0]  # noqa: E731
    some = scene.prepared.compared
    rest, slope = fit(parameters)[some], jax.jacfwd(fit)(parameters)[some]
    columns, _ = _candidates(scene)
    known = whitened_columns(scene.frame, _own_columns(scene, discs, size))[:, some]
    new = apart_from(columns, known)
    return gains_beside(new, rest, slope).max() / len(some)


def _score(found: Found) -> Array:
    """Cost, with what `_gains` asks of each contact beyond the first, and of a shape."""
    shaped = ((found.extent**2).sum((-2, -1)) > 0) | (found.ring.sum(-1) > 0)
    extra = jnp.where(shaped, 1, found.count * (found.count - 1) // 2)
    return found.cost + _GAIN * extra.astype(found.cost.dtype)


def _more_discs(scene: Scene, discs: Found, size: int) -> Found:
    """One more than there are; two also from pairs of candidates."""
    candidates = scene.method.candidates
    columns, compared = _candidates(scene)
    spacing = 1.5 * (candidates[1, 1] - candidates[0, 1])
    known = discs.parameters[: size - 1]
    rest, _, _ = _of(scene, model.discs)(known.ravel())
    some = scene.prepared.compared
    own = whitened_columns(scene.frame, _own_columns(scene, discs, size - 1))[:, some]
    columns_left = apart_from(columns, own)
    more = best_places(columns_left, rest[some], candidates, spacing, _STARTS)
    kept = jnp.broadcast_to(known.ravel(), (_STARTS, known.size))
    starts = jnp.concatenate([kept, _starts(scene, more[:, None])], 1)
    if size == 2:
        pairs = best_pairs(columns, compared, candidates, spacing, _STARTS)
        starts = jnp.concatenate([starts, _starts(scene, pairs)])
    return _best(scene, model.discs, starts)


def _own_columns(scene: Scene, discs: Found, size: int) -> Float[Array, "C S M"]:
    """What the discs make per ampere."""
    sheet = scene.method.sheet
    each = jax.vmap(kernels.field_at, (None, 0, 0))
    own = each(sheet.field, discs.place[:size], discs.radius[:size])
    grounds, z = scene.frame.grounds, sheet.ground_resistance
    return kernels.slot_columns(sheet.field, own, grounds, z)


def _gains(scene: Scene, old: Found, new: Found, size: int) -> Array:
    """Whether each slot fits better by enough, in the mean.

    Of which no slot may make out much more than its part: a contact shows in every slot,
    and what only one asks for is near that slot's ground, where the sheet is not known
    well enough.
    """
    # Where the model's error is larger than thought, so is what a ghost would gain.
    enough = _GAIN * (size - 1) * jnp.maximum(1, new.cost / TOLERANCE)
    slots = jnp.maximum(scene.prepared.used.any(1).sum(), 1)
    each = jnp.minimum(old.misfits - new.misfits, 2 * enough)
    gain = jnp.minimum(each.sum() / slots.astype(each.dtype), old.cost - new.cost)
    return gain > enough


def _believed(scene: Scene, found: Found, size: int) -> Found:
    """At infinite cost where two discs are one, or one is a ghost."""
    place, current = found.place[:size], found.current[:size]
    apart = ((place[:, None] - place) ** 2).sum(-1) + jnp.diag(jnp.full(size, jnp.inf))
    near = apart.min() < (_APART * scene.method.sheet.size) ** 2
    weak = current.min() < _WEAKEST[size > 2] * current.max()
    return found._replace(cost=jnp.where(near | weak, jnp.inf, found.cost))


def _bar(scene: Scene, middle: Float[Array, "2"]) -> Found:
    turn = np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
    ends = jnp.asarray(np.stack([np.cos(turn), np.sin(turn)], 1), middle.dtype)
    ends = _BAR * scene.method.sheet.size / scene.method.sheet.unit * ends
    middles = jnp.broadcast_to(middle, ends.shape)
    starts = jnp.concatenate([middles, ends, jnp.zeros_like(ends[:, :1])], 1)
    found = _best(scene, bar, starts)
    # No longer than wide: a disc, which says so with less.
    short = (found.extent[0] ** 2).sum() < found.radius[0] ** 2
    return found._replace(cost=jnp.where(short, jnp.inf, found.cost))


def _ring(scene: Scene, middle: Float[Array, "2"]) -> Found:
    sheet = scene.method.sheet
    wide = jnp.array(_RINGS, middle.dtype) * sheet.size / sheet.unit
    starts = [jnp.append(middle, w) for w in wide]
    found = _best(scene, ring, jnp.stack(starts))
    narrow = found.ring[0] < _NARROWEST * sheet.size
    return found._replace(cost=jnp.where(narrow, jnp.inf, found.cost))


def _choose(first: Array, one: Found, other: Found) -> Found:
    return jax.tree.map(lambda a, b: jnp.where(first, a, b), one, other)


def _candidates(scene: Scene) -> tuple[Array, Array]:
    """Of each candidate in some slots, and the frame in these; whitened."""
    some = scene.prepared.compared
    part: Frame = jax.tree.map(lambda a: a[some], scene.frame)
    sheet, potentials = scene.method.sheet, scene.method.potentials
    z = sheet.ground_resistance
    columns = kernels.slot_columns(sheet.field, potentials, part.grounds, z)
    return whitened_columns(part, columns), part.whitened


def _starts(scene: Scene, places: Float[Array, "n C 2"]) -> Float[Array, "n C3"]:
    lengths = places / scene.method.sheet.unit
    usual = jnp.zeros_like(lengths[..., :1])
    return jnp.concatenate([lengths, usual], -1).reshape(len(places), -1)


def _of(scene: Scene, kind: Callable) -> Callable:
    """That model, of a flat vector of parameters."""
    width = (-1, 3) if kind is model.discs else (-1,)
    return lambda p: kind(scene.method.sheet, scene.frame, p.reshape(width))


def _best(scene: Scene, kind: Callable, starts: Float[Array, "n P"]) -> Found:
    """The best of the fits from `starts`."""
    fit, prepared = _of(scene, kind), scene.prepared

    def ended_from(starts: Array, most: int) -> tuple[LeastSquares, Array]:
        ended = jax.vmap(lambda p: least_squares(fit, p, TOLERANCE, most))(starts)
        return ended, jnp.where(jnp.isfinite(ended.cost), ended.cost, jnp.inf)

    if len(starts) > _KEPT:
        begun, cost = ended_from(starts, _FEW)
        starts = begun.parameters[jnp.argsort(cost)[:_KEPT]]
    ended, cost = ended_from(starts, _MOST)
    k = jnp.argmin(cost)
    parameters, cost = ended.parameters[k], ended.cost[k]
    rest, _, fitted = fit(parameters)
    slots = prepared.used.any(1)
    n = jnp.maximum(slots.sum(), 1).astype(cost.dtype)
    misfit = jnp.where(prepared.used, fitted.voltages - scene.voltages, 0)
    channels = jnp.maximum(prepared.used.sum(), 1).astype(cost.dtype)
    current = jnp.where(slots[:, None], fitted.current, 0).sum(0) / n
    drop = _drop(scene, fitted, rest)
    count = len(fitted.radius)
    # What is long is not added to.
    of_discs = parameters if kind is model.discs else jnp.zeros(3 * count, cost.dtype)
    spread, limited = _uncertainty(scene, kind, ended.normal[k], parameters, count)
    values = (
        of_discs.reshape(count, 3),
        fitted.place,
        fitted.extent,
        fitted.ring,
        fitted.radius,
        current,
        current / drop,
        spread,
    )
    return Found(
        cost / n,
        TOLERANCE * jnp.log1p((rest**2).sum(1) / TOLERANCE),
        jnp.asarray(count),
        *(_padded(a, scene.most) for a in values),
        limited=limited,
        residual=jnp.sqrt((misfit**2).sum() / channels),
    )


def _uncertainty(
    scene: Scene, kind: Callable, normal: Array, parameters: Array, count: int
) -> tuple[Float[Array, "C 3"], Bool[Array, ""]]:
    """Covariance of the places, and whether noise has the lesser part in it.

    N⁻¹(ΣGᵀσ²G + Σ_k(Σ_s G_sᵀe_sk)(…)ᵀ)N⁻¹, G the slopes of the fit by voltages: noise is
    another in each slot, the model's errors e_k are the same ones. So more slots average
    the one and not the other.
    """
    fit, used, frame = _of(scene, kind), scene.prepared.used, scene.frame
    rest, slope = fit(parameters)[0], jax.jacfwd(lambda p: fit(p)[0])(parameters)
    weight = 1 / (1 + (rest**2).sum(1) / TOLERANCE)
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
    # Of each contact the first two parameters are its place.
    blocks = len(parameters) // count * np.arange(count)
    unit = jnp.eye(len(parameters), dtype=normal.dtype)
    inverse = solve_positive(normal, unit) * scene.method.sheet.unit

    def of_places(middle: Array) -> Float[Array, "C 3"]:
        whole = jnp.matmul(inverse.T, jnp.matmul(middle, inverse))
        return jnp.stack(
            [whole[blocks + i, blocks + j] for i, j in ((0, 0), (1, 1), (0, 1))], 1
        )

    by_noise, by_model = of_places(noise), of_places(jnp.matmul(shared.T, shared))
    return by_noise + by_model, by_model[:, :2].sum() > by_noise[:, :2].sum()


def _drop(scene: Scene, fitted: model.Fitted, rest: Array) -> Float[Array, " C"]:
    """V0 − u at each contact in the mean over the slots, V, as its neighbours correct it.

    What the channels have in common is there too, as the fit has found it.
    """
    prepared, sheet = scene.prepared, scene.method.sheet
    # What is left ends with the common errors, in standard deviations, see `whiten`.
    found = rest[:, scene.voltages.shape[1] :]
    at = prepared.spread * scene.method.smooth(fitted.place)
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
