"""Fits `points` to one frame: from the fit's starts to the lowest cost."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from tomojax.kernels import contacts as model
from tomojax.kernels.algebra import descend, Limits, Normal, tree_where
from tomojax.kernels.contacts import WhitenedFrame
from tomojax.methods.points._found import Ended, Fitting, Found, found_of, LEFT

# Fits from several starts: the best, after a few steps, is gone on with.
_FEW = 3
_MOST = 20

# A start of one disc that leaves less than this part of what is usual is the best of them;
# two discs that explain as much may still be two others.
_ENOUGH = 1.5

# Beyond so many times the cost that is asked for, and what is usual, a fit to a few slots
# is not gone on with.
_HOPELESS = 2.0

# A few of many slots are searched with; then this many steps with all slots follow. Slots
# share errors, and more steps would fit those.
_LAST = 3

# Steps of patches, which begin where discs end.
_LAST_PATCHES = 12

# One disc's patches also begin round and as wide as this, in σ of what is known of a size.
_WIDE = 1.2

# Newton's steps that take an end to the lowest cost, where it is to be `exact`.
_NEWTON = 6

# More of such steps for a curve, which a few slots hardly tell.
_LAST_LONG = 10

# Slots that a turn of the search works on at once: of fewer a call costs more than work,
# of more they do not stay in the processor's cache.
_TOGETHER = 64

# Least and most frames of a turn.
_LEAST_TOGETHER = 4
_MOST_TOGETHER = 16


def starts_at(scene: Fitting, places: Float[Array, "n C 2"]) -> Float[Array, "n CP"]:
    """Returns starts with usual contacts at `places`."""
    lengths = places / scene.method.sheet.unit
    usual = ((0, 0), (0, 0), (0, model.DISC - 2))
    return jnp.pad(lengths, usual).reshape(len(places), -1)


class Kind(NamedTuple):
    """A model: the part of a frame that the model explains, and its parameters' limits."""

    explain: Callable[..., model.Explained]
    limits: Callable[..., Limits]
    parameters: int  # of one contact
    last: int  # steps with all slots
    searches: bool = True  # in a few slots first, which stand for all


# Traced once for all that holds it.
DISCS = Kind(jax.jit(model.discs), model.limits_of, model.DISC, _LAST)
CURVE = Kind(jax.jit(model.curve), model.limits_of_curve, model.CURVE, _LAST_LONG)
PATCHES = Kind(jax.jit(model.patches), model.limits_of, model.DISC, _LAST_PATCHES, False)


def best_fit(
    scene: Fitting,
    kind: Kind,
    starts: Float[Array, "n P"],
    below: Float[Array, " S"] | None = None,
) -> tuple[Found, Ended]:
    """Returns the best of the fits from `starts`, and that fit's end.

    `below` holds slots' costs: a fit that stays above these costs may end early.
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
    found = found_of(scene, explained, ended, normal.cost, kind is not CURVE)
    return found, ended


@eqx.filter_custom_jvp
def _lowest(
    scene: Fitting, kind: Kind, starts: Float[Array, "n P"], below: Float[Array, " S"]
) -> Float[Array, " P"]:
    """Finds the parameters of the lowest cost, see `_nearly`; to the end for `exact`."""
    found = _nearly(scene, kind, starts, below)
    if not scene.method.exact:
        return found

    def step(_: Array, at: Array) -> Array:
        downhill = _downhill(scene, kind, at)
        return at - _solved(jax.jacfwd(downhill)(at, scene), downhill(at, scene), at)

    return lax.fori_loop(0, _NEWTON, step, found)


def _nearly(
    scene: Fitting, kind: Kind, starts: Float[Array, "n P"], below: Float[Array, " S"]
) -> Float[Array, " P"]:
    """Tries each start, then ends the best fit where more steps gain next to nothing.

    A few of many slots stand for all, until the lowest cost of these few is known.
    """
    frame, sheet, some = scene.frame, scene.method.sheet, scene.prepared.compared
    # No start is good for a frame without voltages, as fill a call up: it ends at once.
    starts = jnp.where(jnp.isfinite(frame.whitened).all(), starts, jnp.nan)
    limits = _limits(kind, sheet, starts.shape[1])

    def lowest(
        starts: Array, frame: WhitenedFrame, below: Array, most: int
    ) -> tuple[Array, Array]:
        together = _TOGETHER // len(frame.grounds)
        together = int(np.clip(together, _LEAST_TOGETHER, _MOST_TOGETHER))
        alone = kind is DISCS and starts.shape[1] == kind.parameters
        enough = (_ENOUGH if alone else 0.0) * _usual(frame)
        of = below.sum(), enough, sheet, frame, scene.prepared.tolerance
        return descend(_cost_of(kind), starts, limits, _FEW, most, together, *of)

    if not kind.searches:
        return lowest(starts, frame, below, kind.last)[0]
    if len(some) < len(frame.grounds):
        part = jax.tree.map(lambda a: a[some], frame)
        found, cost = lowest(starts, part, below[some], _MOST)
        # What is far from explaining these explains no more of all.
        hopeless = cost > _HOPELESS * below[some].sum() + _usual(part)
        found = jnp.where(hopeless, jnp.nan, found)
        return lowest(found[None], frame, below, kind.last)[0]
    return lowest(starts, frame, below, _MOST)[0]


def polished(
    scene: Fitting, found: Found, ended: Ended | None, size: int
) -> tuple[Found, Ended | None]:
    """Lets `size` discs end as patches, where these explain the frame no worse.

    One disc also begins round and wide: a narrow, long one may look alike. Nominal values
    are too far off for patches to tell more than discs.
    """
    if not scene.method.patches:
        return found, ended
    start = found.parameters[:size].reshape(-1)
    starts = start[None]
    if size == 1:
        round_ = jnp.array([_WIDE, 0, 0, 0], start.dtype)
        starts = jnp.stack([start, start.at[2:].set(round_)])
    new, end = best_fit(scene, PATCHES, starts)
    told = {"doubtful": found.doubtful, "unsure": found.unsure | new.unsure}
    better, new = new.cost <= found.cost, new._replace(**told)
    if ended is not None:
        ended = tree_where(better, end, ended)
    return tree_where(better, new, found), ended


def _usual(frame: WhitenedFrame) -> Float[Array, ""]:
    """Returns the misfit that errors usually leave of a frame."""
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
    """Differentiates the fit: p' = −(∂g/∂p)⁻¹·∂g; g, the cost's slope, is 0 there.

    Only callers who differentiate pay for this solve. The search's loop cannot be
    differentiated in reverse.
    """
    scene, kind, starts, below = primals
    at = _lowest(scene, kind, starts, below)
    downhill = _downhill(scene, kind, at)
    moving, still = eqx.partition(scene, eqx.is_inexact_array)
    # What does not move has no tangent.
    along = jax.tree.map(
        lambda a, t: jnp.zeros_like(a) if t is None else t, moving, tangents[0]
    )
    of_scene = lambda moving: downhill(at, eqx.combine(moving, still))  # noqa: E731
    _, moved = jax.jvp(of_scene, (moving,), (along,))
    return at, -_solved(jax.jacfwd(downhill)(at, scene), moved, at)


def _downhill(scene: Fitting, kind: Kind, at: Float[Array, " P"]) -> Callable:
    """Returns the cost's slope as a function of parameters and scene; 0 at the lowest.

    What ends at its highest value near `at` stays there.
    """
    highest, cost = _limits(kind, scene.method.sheet, len(at)).highest, _cost_of(kind)

    def downhill(p: Array, scene: Fitting) -> Array:
        sheet, tolerance = scene.method.sheet, scene.prepared.tolerance
        slope = cost(p, sheet, scene.frame, tolerance).gradient
        return jnp.where(at >= highest, p - at, slope)

    return downhill


def _solved(bent: Float[Array, "P P"], moved: Float[Array, " P"], at: Array) -> Array:
    # A fit that failed stays where it is.
    sound = jnp.isfinite(bent).all() & jnp.isfinite(at).all()
    found = jnp.linalg.inv(jnp.where(sound, bent, jnp.eye(len(at), dtype=at.dtype)))
    inverse = jnp.nan_to_num(found, posinf=0.0, neginf=0.0) * sound.astype(at.dtype)
    return jnp.matmul(inverse, moved, precision="highest")
