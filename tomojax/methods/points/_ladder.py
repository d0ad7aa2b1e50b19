"""Climbs the steps of `points`: one disc; more discs, a bar or a ring, if these gain."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from tomojax.kernels import contacts as model
from tomojax.kernels.algebra import tree_where
from tomojax.kernels.sheet import volts_per_ampere
from tomojax.methods._contract import rms, rms_by_electrode
from tomojax.methods._errors import seen
from tomojax.methods.points._fit import best_fit, CURVE, DISCS, polished, starts_at
from tomojax.methods.points._found import (
    APART,
    apart_and_strong,
    as_a_bar,
    Ended,
    Fitting,
    Found,
    is_long,
    LEFT,
    long_enough,
    look_of,
    near_and_strong,
)

# Candidates that a fit of one disc begins from.
_STARTS = 3

# Candidates that pairs are looked for with, and pairs that a fit begins from.
_FIRST = 5
_PAIRS = 2

# By how much, per slot, a larger model must fit better to be believed, for each contact
# beyond the first.
GAIN = 8.0

# Part of that gain which slopes have to promise before a larger model is fitted.
_PROMISE = 0.65

# Two discs are believed where their cost per slot is lower than one long contact's by the
# first number; discs that gain enough need no such lead. From more slots than the second
# number, which the lead was set with, a lead is as sure where it is as large over all of
# them: noise differs from slot to slot. Below the third number the row is in doubt.
_LEAD = 0.5
_LEAD_SLOTS = 10
_CLEAR = 2.5

# First guess of half a bar's length, of half the way between two discs that fit best.
_BAR = 1.3

# First guess of a ring's radius beside that half way itself, in usual radii.
_RING = 3.5


class Ladder(NamedTuple):
    """The best fit so far, and the fit of most discs: three discs may beat any ring."""

    best: Found
    one: Found  # disc
    discs: Found
    promise: Float[Array, ""]  # of one more disc, per slot, as far as slopes tell
    rival: Float[Array, "2"]  # where that would be, m
    pair: Float[Array, "2 2"]  # two discs that fit best, believed or not, m
    asked: Bool[Array, ""]  # whether one disc does not do, more are believed or not
    two: Found  # discs that may be one long contact, where `rivals`
    rivals: Bool[Array, ""]
    near: Bool[Array, ""]  # whether two discs are believed that one bar may look like


def _due(ladder: Ladder, size: int) -> Any:
    """Tells whether `size` discs are worth a try: the next step, with enough to gain."""
    # A promise that is no number is no reason not to try.
    enough = _PROMISE * GAIN * (size - 1)
    worth = ~(ladder.promise <= enough) & (ladder.discs.count == size - 1)
    # As many discs that leave what is usual are no better than a curve that leaves this.
    best, more = ladder.best, GAIN * (extra(size) - 1)
    return worth & ~(shaped(best) & (best.cost < best.usual + more))


def wants_curve(ladder: Ladder) -> Any:
    """Tells whether a bar or a ring is worth a try: neither one disc nor two will do.

    Two long discs may stand for a bar, which is then tried. So may two discs near each
    other, as a soft bar of two pitches makes them.
    """
    # Where a larger model has less to gain than the cost beyond the usual.
    explained = ladder.discs.cost < ladder.discs.usual + GAIN
    two = (ladder.discs.count == 2) & explained
    square = (ladder.discs.parameters[..., :2, 3:5] ** 2).sum(-1)
    return (
        ladder.rivals
        | ladder.near
        | ladder.asked & ~(two & (square < model.NOT_ROUND**2).any(-1))
    )


def shaped(found: Found) -> Any:
    """Tells whether a bar or a ring was found, in NumPy as well."""
    return ((found.extent**2).sum((-2, -1)) > 0) | (found.ring.sum(-1) > 0)


def are_discs(found: Found, size: int) -> Any:
    """Tells whether `size` discs were found, no fault beside them; in NumPy as well."""
    return (found.count == size) & ~shaped(found) & (found.faults == 0)


def first(scene: Fitting) -> Ladder:
    """Fits one disc, from the best candidates."""
    at, candidates = look_of(scene), scene.method.candidates
    scores = model.explained(_alone(scene, at), at.own)
    best = model.best_places(scores, candidates, 1.5 * scene.method.spacing, _STARTS)
    found, ended = best_fit(scene, DISCS, starts_at(scene, candidates[best][:, None]))
    found, ended = polished(scene, found, ended, 1)
    assert ended is not None
    found = seen_at_all(scene, found)
    promise, rival = _promise(scene, found, ended, 1)
    pair = jnp.stack([found.place[0], rival])
    # A long disc may be two, whatever slopes promise.
    promise = jnp.where(is_long(found), jnp.inf, promise)
    return Ladder(
        best=found,
        one=found,
        discs=found,
        promise=promise,
        rival=rival,
        pair=pair,
        asked=jnp.array(False),
        two=found,
        rivals=jnp.array(False),
        near=jnp.array(False),
    )


def _alone(scene: Fitting, at: model.Look) -> Float[Array, "s K"]:
    """Multiplies each candidate's column by the voltages, in the drive's direction."""
    forward = jnp.sign(scene.method.sheet.drive_voltage)
    weighed = model.weighed_volts(at, scene.voltages[scene.prepared.compared])
    return forward * model.along(at, weighed)


def seen_at_all(scene: Fitting, found: Found) -> Found:
    """Removes the contact where noise and channels' zeros are the better explanation."""
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
    """Fits `size` discs, and keeps them where they gain enough.

    Where they leave far more than errors, one more may explain it all, and together gain
    enough: that one is then tried beside these, which are not believed.
    """
    best, discs, pair = ladder.best, ladder.discs, ladder.pair
    new, ended = polished(scene, *_more_discs(scene, discs, ladder.rival, size), size)
    assert ended is not None
    if size == 2:
        # Of a fit that was given up nothing is known.
        pair = jnp.where(jnp.isfinite(new.place[:2]).all(), new.place[:2], pair)
    # Nor does one disc explain what is neither: a ring, where two are no better.
    asked = ladder.asked | discs.high | _gains(scene, discs, new, size)
    two, rivals = ladder.two, ladder.rivals
    if size == 2:
        two, rivals = new, is_long(discs) & near_and_strong(scene, new)
    # Discs too near each other, or one too weak, are not believed.
    sound = apart_and_strong(scene, new, size)
    new = new._replace(cost=jnp.where(sound, new.cost, jnp.inf))
    gained = _gains(scene, discs, new, size)
    near = gained & as_a_bar(scene, new) if size == 2 else ladder.near
    promise, rival = _promise(scene, new, ended, size)
    onward = gained | (new.high & (new.cost < discs.cost))
    return ladder._replace(
        best=tree_where(gained & (_score(new) < _score(best)), new, best),
        discs=tree_where(onward, new, discs),
        promise=jnp.where(onward, promise, 0),
        rival=rival,
        pair=pair,
        asked=asked,
        two=two,
        rivals=rivals,
        near=near,
    )


def _longer(scene: Fitting, ladder: Ladder) -> Ladder:
    """Fits a bar or a ring in the place of two discs, and keeps the better fit.

    The step also runs where two discs lay too near each other to be believed, and where one
    long contact may look like them. The likelier is then kept, with a doubt where data
    hardly tell: of discs far apart and a curve as well.
    """
    one, two, rivals = ladder.one, ladder.two, ladder.rivals
    believed = ladder.best.count == 2
    before = tree_where(rivals, one, ladder.best)

    def tried(best: Found, starts: Float[Array, "n P"]) -> tuple[Found, tuple]:
        # With less it is not chosen.
        less = GAIN + jnp.maximum(0, one.cost - _score(best))
        less = jnp.where(rivals, 0, less)
        alone, _ = best_fit(scene, CURVE, starts, _asked_of(scene, one, less))
        # What leaves more than errors is no shape: a curve fits a little of anything.
        gained = _gains(scene, one, alone, 2) & ~alone.high & long_enough(scene, alone)
        chosen = tree_where(gained & (_score(alone) < _score(best)), alone, best)
        return chosen, (alone.cost, jnp.where(gained, alone.cost, jnp.inf))

    starts = jnp.stack([_bars(scene, ladder), _rings(scene, ladder)])
    # One after the other: the model is compiled once.
    each: Any
    best, each = jax.lax.scan(tried, before, starts)
    costs, sound = each
    lead = jnp.fmin(one.cost, costs[0]) - two.cost
    least = _LEAD * jnp.minimum(1, _LEAD_SLOTS / scene.prepared.slot_count)
    likelier = rivals & (lead > jnp.where(believed, 0, least))
    best = tree_where(likelier, two, best)
    apart: Any = jnp.where(rivals, lead, sound.min() - ladder.best.cost)
    doubtful = (rivals | believed) & (jnp.abs(apart) < _CLEAR)
    return ladder._replace(best=best._replace(doubtful=doubtful))


def steps(count: int) -> list[tuple[Callable[[Ladder], Any], Callable]]:
    """Lists the steps after the first disc: whether a frame asks for one, and the step."""
    found: list[tuple[Callable, Callable]] = []
    for size in range(2, count + 1):
        found.append((partial(_due, size=size), partial(_larger, size=size)))
        if size == 2:
            found.append((wants_curve, _longer))
    return found


def _promise(
    scene: Fitting, discs: Found, ended: Ended, size: int
) -> tuple[Float[Array, ""], Float[Array, "2"]]:
    """Returns the best candidate for one more disc: gain per compared slot, and place.

    The present discs may move a little then: a candidate counts beside the slopes of their
    fit. This is much less work than a fit.
    """
    candidates = scene.method.candidates
    if size >= scene.most:
        return jnp.zeros_like(discs.cost), candidates[0]
    at, some, m = look_of(scene), scene.prepared.compared, scene.voltages.shape[1]
    scale = scene.frame.scale[some]
    rest, slope = ended.rest[some], ended.slope[some].transpose(1, 0, 2)
    sheet, each = scene.method.sheet, jax.vmap(model.field_at, (None, 0, 0))
    made = each(sheet.field, discs.place[:size], discs.radius[:size])  # by an ampere
    made = volts_per_ampere(sheet.slots, made, scene.frame.grounds[some])
    own = model.own_beside(at, made)
    normal = jnp.einsum("psw,qsw->pq", slope, slope, precision="highest")
    right = jnp.einsum("psw,sw->p", slope, rest, precision="highest")
    left = model.along(at, scale * rest[:, :m])
    slopes = model.along(at, scale * slope[..., :m])
    gains = model.gains_beside(left, slopes, own, normal, right)
    best = jnp.argmax(gains)
    return gains[best] / len(some), candidates[best]


def _score(found: Found) -> Array:
    """Returns the cost plus the gain that `_gains` asks of further contacts or a shape."""
    more = jnp.where(shaped(found), 1, jnp.asarray(extra(found.count)))
    return found.cost + GAIN * more.astype(found.cost.dtype)


def extra(count: Any) -> Any:
    """Returns how often `_gains` asks for a gain, from one disc to `count`."""
    return count * (count - 1) // 2


def _more_discs(
    scene: Fitting, discs: Found, rival: Float[Array, "2"], size: int
) -> tuple[Found, Ended]:
    """Fits one more disc; two discs also start from pairs of candidates.

    More also start where one of the present discs stood for two: each is wide then.
    """
    candidates = scene.method.candidates
    # As usual ones: what is missing has made those that there are long.
    beside = jnp.concatenate([discs.place[: size - 1], rival[None]])
    starts = starts_at(scene, beside[None])
    if size == 2:
        at, spacing = look_of(scene), 1.5 * scene.method.spacing
        alone = _alone(scene, at)
        scores = model.explained(alone, at.own)
        places = model.best_places(scores, candidates, spacing, _FIRST)
        pairs = model.best_pairs(at, alone, places, candidates, spacing, _PAIRS)
        pairs = jnp.concatenate([candidates[pairs], _halves(scene, discs)[None]])
        starts = jnp.concatenate([starts, starts_at(scene, pairs)])
    else:
        starts = jnp.concatenate([starts, starts_at(scene, _divided(scene, discs, size))])
    less = jnp.where((size == 2) & is_long(discs), 0.0, GAIN * (size - 1))
    return best_fit(scene, DISCS, starts, _asked_of(scene, discs, less))


def _asked_of(scene: Fitting, old: Found, less: Array | float) -> Float[Array, " S"]:
    """Returns slots' costs of a fit that gains `less`; the prior's cost is in each."""
    known = old.cost - old.misfits.sum() / scene.prepared.slot_count
    slots = scene.prepared.slots.astype(old.cost.dtype)
    return (old.misfits + known - less) * slots


def _divided(scene: Fitting, discs: Found, size: int) -> Float[Array, "n size 2"]:
    """Puts two places in the place of one of the discs, along it or across, each in turn.

    They are a radius from its middle at least.
    """
    starts = []
    for k in range(size - 1):
        others = jnp.delete(discs.place[: size - 1], k, axis=0)
        for turn in (0.0, jnp.pi / 2):
            halves = _halves(scene, discs, k, discs.radius[k], turn)
            starts.append(jnp.concatenate([others, halves]))
    return jnp.stack(starts)


def _halves(
    scene: Fitting,
    discs: Found,
    k: int = 0,
    least: Float[Array, ""] | float = 0.0,
    turn: float = 0.0,
) -> Float[Array, "2 2"]:
    """Puts two places on one long disc, ± h, of the same moment: h² = 2·(a² − b²)/8.

    h is at least half the least distance of two discs: two discs look like a long disc.
    """
    sheet = scene.method.sheet
    long = discs.parameters[k, 3:5]
    h = jnp.sqrt(2 * model.LONG * jnp.sqrt((long**2).sum() + 1e-12)) * sheet.size
    h = jnp.maximum(h, jnp.maximum(APART / 2 * sheet.size, least))
    angle = jnp.arctan2(long[1], long[0]) / 2 + turn
    along = h * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    return discs.place[k] + jnp.stack([along, -along])


def _gains(scene: Fitting, old: Found, new: Found, size: int) -> Array:
    """Tells whether the slots fit better by enough, in the mean.

    No slot may make up much more than its part of the gain: a contact shows in every slot.
    A contact that only one slot asks for is near that slot's ground, where the sheet is not
    known well enough.
    """
    # Where the model's error is larger than thought, so is what a ghost would gain; what is
    # left beyond the tolerance is no error but a contact that is missing.
    enough = GAIN * (size - 1) * jnp.clip(new.cost / new.usual, 1, 1 / LEFT)
    each = old.misfits - new.misfits
    over = jnp.maximum(each - 2 * enough, 0).sum() / scene.prepared.slot_count
    return old.cost - new.cost - over > enough


def _bars(scene: Fitting, ladder: Ladder) -> Float[Array, "2 P"]:
    """Returns the start of a bar's fit; the second row is NaN, no start."""
    pair = ladder.pair
    middle, half = pair.mean(0), (pair[1] - pair[0]) / 2
    start = bar_at(jnp.concatenate([middle, _BAR * half]) / scene.method.sheet.unit)
    return jnp.stack([start, jnp.full_like(start, jnp.nan)])


def _rings(scene: Fitting, ladder: Ladder) -> Float[Array, "2 P"]:
    """Returns the starts of a ring's fits."""
    sheet, pair = scene.method.sheet, ladder.pair
    half = jnp.sqrt(((pair[1] - pair[0]) ** 2).sum() + 1e-12) / 2
    around = jnp.stack([ladder.one.place[0], pair.mean(0)])
    wide = jnp.stack([_RING * sheet.size, half])
    lengths = jnp.concatenate([around, wide[:, None]], 1) / sheet.unit
    return jax.vmap(ring_at)(lengths)


def bar_at(known: Float[Array, " n"]) -> Float[Array, " P"]:
    """Returns a bar's parameters: the `known` numbers, then zeros."""
    return jnp.pad(known, (0, CURVE.parameters - len(known)))


def ring_at(known: Float[Array, " n"]) -> Float[Array, " P"]:
    """Returns a ring's parameters, the first of which are `known`."""
    return bar_at(known).at[-1].set(1)
