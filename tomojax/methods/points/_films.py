"""Fits films: frames in close succession, whose fits begin where the first frame's ends."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels import contacts as model
from tomojax.kernels.algebra import solve_positive, tree_where
from tomojax.methods.points._blocks import begun, called, each_frame, Frames, put
from tomojax.methods.points._faults import searched
from tomojax.methods.points._fit import best_fit, CURVE, DISCS, polished
from tomojax.methods.points._found import (
    apart_and_strong,
    Ended,
    Fitting,
    Found,
    long_enough,
)
from tomojax.methods.points._ladder import (
    are_discs,
    bar_at,
    GAIN,
    ring_at,
    seen_at_all,
    shaped,
)

# A contact is needed that gains so many times what the ladder asks of one more: the gain
# here is an upper bound, as the others stay where they are.
_NEEDED = 2.0

# A frame is searched whose cost is higher than that of its film's first by this part of
# what the ladder asks of one more contact. The first was tried for one, and a contact gains
# a part of the cost at most.
_MORE = 0.5


class Again(NamedTuple):
    """A fit that began at the fit of its film's first frame."""

    found: Found
    sound: Bool[Array, ""]  # whether each contact is needed, and enough is explained


def filmed(frames: Frames, films: Int[np.ndarray, " n"]) -> Found:
    """Fits each film's first frame by `searched`; the film's other frames begin there.

    A frame that the first frame's model explains less well is searched too.
    """
    n = len(films)
    _, firsts, film = np.unique(films, return_index=True, return_inverse=True)
    whole = searched(frames, firsts)
    found: Any = put(None, firsts, whole, n)
    done = np.zeros(n, bool)
    done[firsts] = True
    for size in range(frames.most + 1):
        if _is_of(whole, size).any():
            begun(frames, _again, whole, size)
    for size in range(frames.most + 1):
        rows = np.flatnonzero(_is_of(whole, size)[film] & ~done)
        if not len(rows):
            continue
        before = jax.tree.map(lambda a, rows=rows: a[film[rows]], whole)
        again: Again = called(frames, rows, _again, before, size)
        good = again.sound & (again.found.cost < before.cost + _MORE * GAIN)
        put(found, rows[good], jax.tree.map(lambda a, good=good: a[good], again.found), n)
        done[rows[good]] = True
    left = np.flatnonzero(~done)
    if len(left):
        put(found, left, searched(frames, left), n)
    return found


def _is_of(found: Found, size: int) -> Bool[np.ndarray, " n"]:
    """Tells whether `size` discs were found; a `size` of 0 stands for a bar or a ring."""
    fits = are_discs(found, size) if size else shaped(found) & (found.faults == 0)
    return fits & (found.count > 0) & ~found.high


@each_frame
def _again(scene: Fitting, before: Found, size: int) -> Again:
    return _discs(scene, before, size) if size else _curve(scene, before)


def _discs(scene: Fitting, before: Found, size: int) -> Again:
    found, ended = best_fit(scene, DISCS, before.parameters[:size].reshape(1, -1))
    if size == 1:
        found = seen_at_all(scene, found)
        found = tree_where(found.count > 0, polished(scene, found, None, size)[0], found)
        return Again(found, _explained(found) & (found.count > 0))
    needed = _needed(scene, ended).min() > _NEEDED * GAIN * (size - 1)
    apart = apart_and_strong(scene, found, size)
    found = polished(scene, found, None, size)[0]
    return Again(found, _explained(found) & needed & apart)


def _curve(scene: Fitting, before: Found) -> Again:
    sheet = scene.method.sheet
    place, reach, wide = before.place[0], before.extent[0], before.ring[:1]
    size = jnp.log(before.radius[:1] / sheet.size) / model.SIZE_WIDTH
    bar = bar_at(jnp.concatenate([place / sheet.unit, reach / sheet.unit, size]))
    ring = ring_at(jnp.concatenate([place, wide]) / sheet.unit)
    found, _ = best_fit(scene, CURVE, jnp.where(wide > 0, ring, bar)[None])
    return Again(found, _explained(found) & long_enough(scene, found))


def _explained(found: Found) -> Bool[Array, ""]:
    return ~found.high & jnp.isfinite(found.cost)


def _needed(scene: Fitting, ended: Ended) -> Float[Array, " C"]:
    """Computes χ² per slot that each disc explains; refits the other discs' currents."""
    # Once more what the fit ended with: in one program it is computed once.
    explained = DISCS.explain(scene.method.sheet, scene.frame, ended.parameters)
    gram = jnp.einsum(
        "scw,sdw->scd", explained.column, explained.column, precision="highest"
    )
    unit = jnp.broadcast_to(jnp.eye(gram.shape[1], dtype=gram.dtype), gram.shape)
    spread = solve_positive(jax.vmap(model.regular)(gram), unit)
    current = explained.fitted.current
    gain = (current**2 / jnp.diagonal(spread, axis1=1, axis2=2)).sum(0)
    return gain / scene.prepared.slot_count
