"""Films: rows that follow each other closely. The others begin where their first ends."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tomojax._programs import kept
from tomojax.kernels import contacts as model
from tomojax.kernels.algebra import solve_positive
from tomojax.methods.points._blocks import called, Frames, put, searched
from tomojax.methods.points._fit import (
    BAR,
    best_fit,
    DISCS,
    Ended,
    Fitting,
    fitting_of,
    Found,
    RING,
)
from tomojax.methods.points._ladder import (
    apart_and_strong,
    GAIN,
    long_enough,
    seen_at_all,
    wide_enough,
)

# A contact is needed that gains so many times what the ladder asks of one more: the gain
# here is an upper bound, as the others stay where they are.
_NEEDED = 2.0

# A frame is searched whose cost is higher than that of its film's first by this part of
# what the ladder asks of one more contact. The first was tried for one, and a contact gains
# a part of the cost at most.
_MORE = 0.5


class Again(NamedTuple):
    """A fit that began at the first of its film."""

    found: Found
    sound: Bool[Array, ""]  # whether each contact is needed, and enough is explained


def filmed(frames: Frames, films: Int[np.ndarray, " n"]) -> Found:
    """Fits each film's first frame as `searched` does, and the others from there.

    What the first frame's model does not explain as well is searched as well.
    """
    n = len(films)
    _, firsts, film = np.unique(films, return_index=True, return_inverse=True)
    whole = searched(frames, firsts).best
    found: Any = put(None, firsts, whole, n)
    done = np.zeros(n, bool)
    done[firsts] = True
    for kind, size in _kinds(frames.most):
        rows = np.flatnonzero(_is_of(whole, kind, size)[film] & ~done)
        if not len(rows):
            continue
        before = jax.tree.map(lambda a, rows=rows: a[film[rows]], whole)
        again: Again = called(frames, rows, _again, before, kind, size)
        good = again.sound & (again.found.cost < before.cost + _MORE * GAIN)
        put(found, rows[good], jax.tree.map(lambda a, good=good: a[good], again.found), n)
        done[rows[good]] = True
    left = np.flatnonzero(~done)
    if len(left):
        put(found, left, searched(frames, left).best, n)
    return found


def _kinds(most: int) -> list[tuple[int, int]]:
    return [(0, size) for size in range(1, most + 1)] + [(1, 1), (2, 1)]


def _is_of(found: Found, kind: int, size: int) -> Bool[np.ndarray, " n"]:
    bar, ring = (found.extent**2).sum((1, 2)) > 0, found.ring.sum(1) > 0
    shape = np.where(bar, 1, np.where(ring, 2, 0))
    return (shape == kind) & (found.count == size) & ~found.high


@kept
def _again(
    method, prepared, voltages, grounds, before: Found, most: int, kind: int, size: int
) -> Again:
    def one(v: Array, grounds: Array, before: Found) -> Again:
        scene = fitting_of(method, prepared._replace(grounds=grounds), v, most)
        return (partial(_discs, size=size), _bar, _ring)[kind](scene, before)

    return jax.vmap(one)(voltages, grounds, before)


def _discs(scene: Fitting, before: Found, size: int) -> Again:
    found, ended = best_fit(scene, DISCS, before.parameters[:size].reshape(1, -1))
    if size == 1:
        found = seen_at_all(scene, found)
        return Again(found, _explained(found) & (found.count > 0))
    needed = _needed(scene, ended).min() > _NEEDED * GAIN * (size - 1)
    apart = apart_and_strong(scene, found, size)
    return Again(found, _explained(found) & needed & apart)


def _bar(scene: Fitting, before: Found) -> Again:
    sheet = scene.method.sheet
    lengths = jnp.concatenate([before.place[0], before.extent[0]]) / sheet.unit
    size = jnp.log(before.radius[0] / sheet.size) / model.SIZE_WIDTH
    start = jnp.concatenate([lengths, jnp.stack([size, 0 * size])])
    found, _ = best_fit(scene, BAR, start[None])
    return Again(found, _explained(found) & long_enough(found))


def _ring(scene: Fitting, before: Found) -> Again:
    lengths = jnp.concatenate([before.place[0], before.ring[:1]]) / scene.method.sheet.unit
    found, _ = best_fit(scene, RING, jnp.pad(lengths, (0, 1))[None])
    return Again(found, _explained(found) & wide_enough(scene, found))


def _explained(found: Found) -> Bool[Array, ""]:
    return ~found.high & jnp.isfinite(found.cost)


def _needed(scene: Fitting, ended: Ended) -> Float[Array, " C"]:
    """χ² per slot that each disc explains, the others' currents being what fits best."""
    # Once more what the fit ended with: in one program it is computed once.
    explained = DISCS.explain(scene.method.sheet, scene.frame, ended.parameters)
    gram = jnp.einsum(
        "scw,sdw->scd", explained.column, explained.column, precision="highest"
    )
    unit = jnp.broadcast_to(jnp.eye(gram.shape[1], dtype=gram.dtype), gram.shape)
    spread = solve_positive(jax.vmap(model.regular)(gram), unit)
    slots = jnp.maximum(scene.prepared.used.any(1).sum(), 1).astype(gram.dtype)
    current = explained.fitted.current
    return (current**2 / jnp.diagonal(spread, axis1=1, axis2=2)).sum(0) / slots
