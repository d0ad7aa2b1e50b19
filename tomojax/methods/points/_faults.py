"""Explains frames by faults of the rig, where further contacts would explain them too.

One wire, switch or channel that is wrong makes voltages of a known pattern in each slot. A
fault that explains a frame as well as further contacts do is likelier: what a fault makes
up lies anywhere on the sheet.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tomojax.kernels import contacts as model
from tomojax.kernels.algebra import solve_positive
from tomojax.kernels.contacts import Look, look
from tomojax.kernels.sheet import Grounds, volts_per_ampere
from tomojax.methods._contract import rms, rms_by_electrode
from tomojax.methods._errors import highest_cost, with_faults, without_offset
from tomojax.methods.points._blocks import called, climbed, each_frame, Frames, put
from tomojax.methods.points._fit import best_fit, DISCS
from tomojax.methods.points._found import Ended, Fitting, Found, look_of
from tomojax.methods.points._ladder import extra, GAIN, seen_at_all, shaped

# Faults of one frame, at most.
_MOST = 6

# Patterns after those of electrodes and pairs: a film that leads to ground everywhere, and
# crosstalk from the channel before and from the next.
_COMMON = 3

# More faults at once are less likely than a large object.
_LIKELY = 2

# Slots that faults are looked for in: those that are explained least.
_SLOTS = 8

# Faults that explain a frame better by less are not told from contacts.
_SURE = GAIN / 2

# A pattern whose square the others leave less than this part of is one of them.
_OWN = 1e-3


class Suspect(NamedTuple):
    """The fault that promises most beside some contacts."""

    fault: Int[Array, ""]  # its pattern's number
    cost: Float[Array, ""]  # that slopes promise with it


class Blamed(NamedTuple):
    """A fit beside faults, and the next suspect."""

    found: Found
    suspect: Suspect


def searched(frames: Frames, rows: Int[np.ndarray, " n"]) -> Found:
    """Returns the best fits: of contacts alone, or of fewer contacts beside faults."""
    ladder: Any = climbed(frames, rows)
    best: Any = jax.tree.map(np.array, ladder.best)
    for size in range(1, min(frames.most, 2) + 1):
        base = ladder.one if size == 1 else ladder.discs
        larger = _extra_of(best) > extra(size)
        # A fault may also hide a contact.
        there = (base.count == size) | (base.count == 0) & (size == 1)
        asking = there & (best.high | larger | best.unsure)
        asking = asking & (best.faults == 0)
        _blame(frames, rows, base, best, np.flatnonzero(asking), size)
    return best


def _blame(
    frames: Frames, rows: np.ndarray, base: Any, best: Any, asking: np.ndarray, size: int
) -> None:
    """Adds fault after fault to fits of `size` discs, while they promise enough."""
    if not len(asking):
        return
    alone = best.cost + GAIN * _extra_of(best)
    unexplained = best.high.copy()
    given = jax.tree.map(lambda a: np.asarray(a)[asking], base)
    suspect: Any = called(frames, rows[asking], _suspect, given, size)
    which = np.full((len(asking), _MOST), -1, np.int32)
    for n in range(1, _MOST + 1):
        price = GAIN * (n + extra(size))
        # Of contacts that explain too little, any explanation is better.
        limit = np.where(unexplained[asking], np.inf, alone[asking] + _SURE)
        going = (suspect.cost + price < limit) & (suspect.cost < given.cost - GAIN)
        if not going.any():
            return
        asking, which = asking[going], which[going]
        suspect, given = _part((suspect, given), going)
        which[:, n - 1] = suspect.fault
        new: Blamed = called(frames, rows[asking], _fit, (given, which), size)
        given, suspect = new.found, new.suspect
        score = given.cost + price
        now = (best.cost + GAIN * _extra_of(best))[asking]
        better = ~given.high & (given.count > 0) & (score < now)
        put(best, asking[better], _part(given, better), 0)
        close = ~unexplained[asking] & (np.abs(score - alone[asking]) < _SURE)
        best.unsure[asking[close]] = True


def _part(tree: Any, which: np.ndarray) -> Any:
    return jax.tree.map(lambda a: a[which], tree)


def _extra_of(found: Any) -> Any:
    return np.where(shaped(found), 1, extra(found.count)) + found.faults


@each_frame
def _suspect(scene: Fitting, base: Found, size: int) -> Suspect:
    explained = DISCS.explain(scene.method.sheet, scene.frame, _of(base, size))
    normal = model.normal_of(explained, scene.prepared.tolerance)
    slopes = model.free_slopes(explained)
    ended = Ended(_of(base, size), normal.matrix, explained.rest, slopes)
    none = jnp.full(_MOST, -1, jnp.int32)
    return _next(scene, scene, ended, explained.column, base.cost, none)


@each_frame
def _fit(scene: Fitting, given: tuple[Found, Array], size: int) -> Blamed:
    """Fits contacts that faults `which` may stand beside; they begin at `base`."""
    base, which = given
    known = jax.vmap(lambda k: _volts_of(scene, k))(which).transpose(1, 0, 2)
    errors = with_faults(scene.errors, scene.voltages, known)
    beside = scene._replace(errors=errors)
    found, ended = best_fit(beside, DISCS, _of(base, size)[None])
    explained = DISCS.explain(scene.method.sheet, beside.frame, ended.parameters)
    m = scene.voltages.shape[1]
    amount = explained.rest[:, m : m + len(which)]
    made = jnp.einsum("sf,sfm->sm", amount, known, precision="highest")
    misfit = explained.fitted.voltages + made - scene.voltages
    misfit, used = without_offset(scene.prepared, misfit)
    if size == 1:
        found = seen_at_all(beside, found)
    found = found._replace(
        faults=(which >= 0).sum().astype(found.faults.dtype),
        residual=rms(misfit, used),
        by_electrode=rms_by_electrode(misfit, used),
        high=found.cost > highest_cost(scene.prepared.tolerance),
        unsure=found.unsure | ((which >= 0).sum() > _LIKELY),
    )
    column = explained.column
    return Blamed(found, _next(scene, beside, ended, column, found.cost, which))


def _of(found: Found, size: int) -> Float[Array, " P"]:
    return found.parameters[:size].reshape(-1)


def _volts_of(scene: Fitting, fault: Int[Array, ""]) -> Float[Array, "S M"]:
    """Returns the voltages of one pattern, as large as the slot's; 0 for none (−1)."""
    sheet, volts, grounds = scene.method.sheet, scene.voltages, scene.frame.grounds
    m, pairs, table = volts.shape[1], scene.method.neighbours, sheet.field.electrodes
    leak = volts_per_ampere(sheet.slots, table[(fault - m) % m], grounds)
    one, other = pairs[(fault - 2 * m) % len(pairs)]
    short = sheet.slots.relative(table[one] - table[other], grounds)
    common = _common(scene)[(fault - 2 * m - len(pairs)) % _COMMON]
    alone = jnp.broadcast_to(jnp.arange(m, dtype=fault.dtype) == fault, volts.shape)
    kinds = [fault < 0, fault < m, fault < 2 * m, fault < 2 * m + len(pairs)]
    each = [jnp.zeros_like(volts), alone.astype(volts.dtype), leak, short]
    made = jnp.select([jnp.broadcast_to(k, volts.shape) for k in kinds], each, common)
    highest = jnp.abs(made).max(1, keepdims=True)
    return made / jnp.where(highest > 0, highest, 1) * jnp.abs(volts).max(1, keepdims=True)


def _common(scene: Fitting) -> Float[Array, "3 S M"]:
    """Computes what a film makes, in which γV leaves everywhere, and crosstalk."""
    volts, sheet, grounds = scene.voltages, scene.method.sheet, scene.frame.grounds
    slots, used = sheet.slots, scene.prepared.used
    volts = jnp.where(used, volts, 0)
    rows = jnp.matmul(volts, sheet.field.electrodes, precision="highest")
    total = volts.sum(1, keepdims=True)
    film = slots.apart(rows, grounds) + total * slots.offset(grounds)
    before, after = jnp.roll(volts, 1, 1) - volts, jnp.roll(volts, -1, 1) - volts
    return jnp.stack([film, before, after])


def _looks(scene: Fitting, some: Int[Array, " s"]) -> list[Look]:
    """Whitens all patterns in some slots: of channels, of leaks, of shorts, and others."""
    leaks = look_of(scene, some)
    sheet, pairs = scene.method.sheet, scene.method.neighbours
    table, m = sheet.field.electrodes, scene.voltages.shape[1]
    frame, blocks, dtype = leaks.frame, leaks.blocks, scene.voltages.dtype
    none = jnp.zeros_like(leaks.offset)
    slots, which = sheet.slots, frame.grounds
    offset = slots.offset(which)
    if isinstance(slots, Grounds):
        offset = slots._replace(resistance=0.0).offset(which)
    common = _common(scene)[:, some]
    common = common / jnp.maximum(jnp.abs(common).max((1, 2), keepdims=True), 1e-30)
    return [
        look(jnp.eye(m, dtype=dtype), none, frame),
        look(table, offset, frame, blocks),
        look(table[pairs[:, 0]] - table[pairs[:, 1]], none, frame, blocks),
        look(jnp.eye(_COMMON, dtype=dtype), none, frame, common.transpose(1, 2, 0)),
    ]


def _next(
    scene: Fitting,
    beside: Fitting,
    ended: Ended,
    column: Float[Array, "S C W"],
    cost: Float[Array, ""],
    which: Int[Array, " F"],
) -> Suspect:
    """Finds the fault that lowers the cost most, beside contacts and faults `which`."""
    m, squares = scene.voltages.shape[1], (ended.rest**2).sum(1)
    some = jax.lax.top_k(squares, min(_SLOTS, len(squares)))[1]
    scale = beside.frame.scale[some]
    rest, slope = ended.rest[some], ended.slope[some].transpose(1, 0, 2)
    normal = jnp.einsum("psw,qsw->pq", slope, slope, precision="highest")
    right = jnp.einsum("psw,sw->p", slope, rest, precision="highest")
    column = column[some]
    heavy = (scale[:, None] * column[..., :m]).transpose(1, 0, 2)
    gram = jnp.einsum("scw,sdw->scd", column, column, precision="highest")
    gram = jax.vmap(model.regular)(gram)
    alone = _looks(scene, some)
    own, left, slopes = [], [], []
    for at, before in zip(alone if beside is scene else _looks(beside, some), alone):
        across = model.along(at, heavy).transpose(1, 0, 2)  # (s, C, K)
        free = at.own - (across * solve_positive(gram, across)).sum(1)
        own.append(jnp.where(free > _OWN * before.own, free, 0))
        left.append(model.along(at, scale * rest[:, :m]))
        slopes.append(model.along(at, scale * slope[..., :m]))
    lefts = jnp.concatenate(left, 1)
    gains = model.gains_beside(
        lefts, jnp.concatenate(slopes, 2), jnp.concatenate(own, 1), normal, right
    )
    # A leak and a film take current out of the sheet, which no contact does.
    forward = jnp.sign(scene.method.sheet.drive_voltage)
    number = jnp.arange(len(gains), dtype=jnp.int32)
    takes = (number >= m) & (number < 2 * m) | (number == len(gains) - _COMMON)
    feeds = (lefts.sum(0) * forward > 0) & takes
    known = (number[:, None] == which).any(1)
    gains = jnp.where(feeds | known, 0, gains) / scene.prepared.slot_count
    best = jnp.argmax(gains).astype(jnp.int32)
    # Cauchy's loss of what is left, as if all slots were alike.
    tolerance = scene.prepared.tolerance
    misfit = tolerance * jnp.expm1(cost / tolerance)
    promised = tolerance * jnp.log1p(jnp.maximum(misfit - gains[best], 0) / tolerance)
    return Suspect(best, promised)
