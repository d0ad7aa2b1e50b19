"""The steps of `points`: one disc; then more discs, a bar or a ring, while that gains."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from tomojax.kernels import contacts as model
from tomojax.kernels.algebra import LeastSquares
from tomojax.kernels.contacts import (
    apart_from,
    bar,
    best_pairs,
    best_places,
    field_at,
    gains_beside,
    ring,
    slot_columns,
    whitened_columns,
)
from tomojax.methods._contract import rms, rms_by_electrode
from tomojax.methods._errors import seen
from tomojax.methods.points._fit import (
    best_fit,
    candidates_of,
    fit_of,
    Fitting,
    Found,
    LEFT,
    starts_at,
)

# Candidates that fits begin from. Pairs are looked through of no more than so many, as
# memory and time grow with their square; what is far apart is found one by one.
_STARTS, _PAIRED = 3, 400

# By how much, per slot, a larger model must fit better to be believed, for each contact
# beyond the first.
_GAIN = 8.0

# Part of that gain which slopes have to promise before a larger model is fitted.
_PROMISE = 0.6

# Discs nearer than this many usual radii, and a second or further one below this part of
# the strongest, are what the model's error makes of fewer.
_APART, _WEAKEST = 2.7, (0.04, 0.1)

# Of the first guesses, in usual radii: half a bar's length, with its directions; radii of
# rings. A ring narrower than the least is a disc.
_BAR, _DIRECTIONS, _RINGS, _NARROWEST = 4.0, 4, (2.0, 5.0), 1.2


class Ladder(NamedTuple):
    """The best so far, and the most discs so far: three may do what no ring does."""

    best: Found
    one: Found  # disc
    discs: Found
    promise: Float[Array, ""]  # of one more disc, per slot, as far as slopes tell
    asked: Bool[Array, ""]  # whether one disc does not do, more are believed or not


def _due(ladder: Ladder, size: int) -> Any:
    """Whether `size` discs are worth a try: the next step, with that much to gain."""
    enough = _PROMISE * _GAIN * (size - 1)
    # A promise that is no number is no reason not to try.
    return ~(ladder.promise <= enough) & (ladder.discs.count == size - 1)


def first(scene: Fitting) -> Ladder:
    """One disc, from the best candidate."""
    columns, compared = candidates_of(scene)
    places = best_places(columns, compared, scene.method.candidates, 0.0, _STARTS)
    found, ended = best_fit(scene, model.discs, starts_at(scene, places[:, None]))
    found = _seen(scene, found)
    promise = _promise(scene, found, ended, 1)
    return Ladder(found, found, found, promise, jnp.array(False))


def _seen(scene: Fitting, found: Found) -> Found:
    """No contact where none is the better explanation: noise and channels' zeros."""
    used = scene.prepared.used
    towards = found.current[0] * jnp.sign(scene.method.sheet.drive_voltage)
    there = seen(scene.prepared, scene.frame, found.misfits) & (towards > 0)
    volts = jnp.where(used, scene.voltages, 0)
    return found._replace(
        count=jnp.where(there, found.count, 0),
        current=jnp.where(there, found.current, 0),
        limited=found.limited & there,
        residual=jnp.where(there, found.residual, rms(volts, used)),
        by_electrode=jnp.where(there, found.by_electrode, rms_by_electrode(volts, used)),
    )


def _larger(scene: Fitting, ladder: Ladder, size: int) -> Ladder:
    """`size` discs, where they gain enough."""
    best, one, discs, _, asked = ladder
    new, ended = _more_discs(scene, discs, size)
    # Nor does one disc explain what is neither: a ring, where two are no better.
    asked = asked | discs.high | _gains(scene, discs, new, size)
    new = _believed(scene, new, size)
    gained = _gains(scene, discs, new, size)
    best = _choose(gained & (_score(new) < _score(best)), new, best)
    promise = jnp.where(gained, _promise(scene, new, ended, size), 0)
    return Ladder(best, one, _choose(gained, new, discs), promise, asked)


def _longer(scene: Fitting, ladder: Ladder) -> Ladder:
    """A bar or a ring in the place of two discs, where it fits better yet.

    Tried as well where two were too near each other to be believed.
    """
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
            found.append((lambda ladder: ladder.asked, _longer))
    return found


def _promise(scene: Fitting, discs: Found, ended: LeastSquares, size: int) -> Array:
    """What the best candidate for one more would gain, per slot compared.

    The discs that there are may move a little then: each candidate is told apart from
    the slopes of their fit. Much less work than to fit it.
    """
    if size >= scene.most:
        return jnp.zeros_like(discs.cost)
    some = scene.prepared.compared
    rest, slope = ended.rest[some], ended.slope.transpose(1, 2, 0)[some]
    columns, _ = candidates_of(scene)
    known = whitened_columns(scene.frame, _own_columns(scene, discs, size))[:, some]
    new = apart_from(columns, known)
    return gains_beside(new, rest, slope).max() / len(some)


def _score(found: Found) -> Array:
    """Cost, with what `_gains` asks of each contact beyond the first, and of a shape."""
    shaped = ((found.extent**2).sum((-2, -1)) > 0) | (found.ring.sum(-1) > 0)
    extra = jnp.where(shaped, 1, found.count * (found.count - 1) // 2)
    return found.cost + _GAIN * extra.astype(found.cost.dtype)


def _more_discs(scene: Fitting, discs: Found, size: int) -> tuple[Found, LeastSquares]:
    """One more than there are; two also from pairs of candidates."""
    candidates = scene.method.candidates
    columns, compared = candidates_of(scene)
    spacing = 1.5 * (candidates[1, 1] - candidates[0, 1])
    known = discs.parameters[: size - 1]
    rest, _, _ = fit_of(scene, model.discs)(known.ravel())
    some = scene.prepared.compared
    own = whitened_columns(scene.frame, _own_columns(scene, discs, size - 1))[:, some]
    columns_left = apart_from(columns, own)
    more = best_places(columns_left, rest[some], candidates, spacing, _STARTS)
    kept = jnp.broadcast_to(known.ravel(), (_STARTS, known.size))
    starts = jnp.concatenate([kept, starts_at(scene, more[:, None])], 1)
    if size == 2:
        if len(candidates) > _PAIRED:  # those beside what one disc takes for one
            away = ((candidates - discs.place[0]) ** 2).sum(1)
            beside = jax.lax.top_k(-away, _PAIRED)[1]
            columns, candidates = columns[beside], candidates[beside]
        pairs = best_pairs(columns, compared, candidates, spacing, _STARTS)
        pairs = jnp.concatenate([pairs, _halves(scene, discs)[None]])
        starts = jnp.concatenate([starts, starts_at(scene, pairs)])
    return best_fit(scene, model.discs, starts)


def _halves(scene: Fitting, discs: Found) -> Float[Array, "2 2"]:
    """Two places for one long disc, ± h along it: as much of a moment, h² = 2·(a² − b²)/8.

    At least half of a usual pair's distance apart, as a long disc is what two look like.
    """
    sheet = scene.method.sheet
    long = discs.parameters[0, 3:5]
    h = jnp.sqrt(2 * model.LONG * jnp.sqrt((long**2).sum() + 1e-12)) * sheet.size
    h = jnp.maximum(h, _APART / 2 * sheet.size)
    angle = jnp.arctan2(long[1], long[0]) / 2
    along = h * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    return discs.place[0] + jnp.stack([along, -along])


def _own_columns(scene: Fitting, discs: Found, size: int) -> Float[Array, "C S M"]:
    """What the discs make per ampere."""
    sheet = scene.method.sheet
    each = jax.vmap(field_at, (None, 0, 0))
    own = each(sheet.field, discs.place[:size], discs.radius[:size])
    grounds, z = scene.frame.grounds, sheet.ground_resistance
    return slot_columns(sheet.field, own, grounds, z)


def _gains(scene: Fitting, old: Found, new: Found, size: int) -> Array:
    """Whether each slot fits better by enough, in the mean.

    Of which no slot may make out much more than its part: a contact shows in every slot,
    and what only one asks for is near that slot's ground, where the sheet is not known
    well enough.
    """
    # Where the model's error is larger than thought, so is what a ghost would gain; what is
    # left beyond the tolerance is no error but a contact that is missing.
    slots = jnp.maximum(scene.prepared.used.any(1).sum(), 1)
    channels = (scene.frame.scale > 0).sum() / slots
    usual = LEFT * channels.astype(new.cost.dtype)
    enough = _GAIN * (size - 1) * jnp.clip(new.cost / usual, 1, 1 / LEFT)
    each = old.misfits - new.misfits
    over = jnp.maximum(each - 2 * enough, 0).sum() / slots.astype(each.dtype)
    return old.cost - new.cost - over > enough


def _believed(scene: Fitting, found: Found, size: int) -> Found:
    """At infinite cost where two discs are one, or one is a ghost."""
    place, current = found.place[:size], found.current[:size]
    apart = ((place[:, None] - place) ** 2).sum(-1) + jnp.diag(jnp.full(size, jnp.inf))
    near = apart.min() < (_APART * scene.method.sheet.size) ** 2
    weak = current.min() < _WEAKEST[size > 2] * current.max()
    return found._replace(cost=jnp.where(near | weak, jnp.inf, found.cost))


def _bar(scene: Fitting, middle: Float[Array, "2"]) -> Found:
    turn = np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
    ends = jnp.asarray(np.stack([np.cos(turn), np.sin(turn)], 1), middle.dtype)
    ends = _BAR * scene.method.sheet.size / scene.method.sheet.unit * ends
    middles = jnp.broadcast_to(middle, ends.shape)
    starts = jnp.concatenate([middles, ends, jnp.zeros_like(ends)], 1)
    found, _ = best_fit(scene, bar, starts)
    # No longer than wide: a disc, which says so with less.
    short = (found.extent[0] ** 2).sum() < found.radius[0] ** 2
    return found._replace(cost=jnp.where(short, jnp.inf, found.cost))


def _ring(scene: Fitting, middle: Float[Array, "2"]) -> Found:
    sheet = scene.method.sheet
    wide = jnp.array(_RINGS, middle.dtype) * sheet.size / sheet.unit
    starts = [jnp.array([*middle, w, 0]) for w in wide]
    found, _ = best_fit(scene, ring, jnp.stack(starts))
    narrow = found.ring[0] < _NARROWEST * sheet.size
    return found._replace(cost=jnp.where(narrow, jnp.inf, found.cost))


def _choose(first: Array, one: Found, other: Found) -> Found:
    return jax.tree.map(lambda a, b: jnp.where(first, a, b), one, other)
