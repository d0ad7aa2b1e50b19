"""Ranks the places of a coarse grid where contacts may be, for a fit to start from."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tomojax.kernels.algebra import solve_positive
from tomojax.kernels.contacts._equations import whitened_columns, WhitenedFrame


class Look(NamedTuple):
    """K candidates beside some slots of a frame; each candidate feeds one ampere.

    All frames share the products with one table.
    """

    potential: Float[Array, "K n"]  # Ω; in each slot its `offset` comes to it
    offset: Float[Array, "s M"]
    blocks: Float[Array, "s M n"] | None  # what each slot makes of it; None: it stays
    frame: WhitenedFrame  # these slots
    own: Float[Array, "s K"]  # |c|² of each column c, whitened


def look(
    potential: Float[Array, "K n"],
    offset: Float[Array, "s M"],
    frame: WhitenedFrame,
    blocks: Float[Array, "s M n"] | None = None,
) -> Look:
    """Weighs each candidate's column c: cᵀC⁻¹c, C the errors' covariance.

    `blocks` of a slot's D (see `Slots`) where more than its level depends on the ground.
    """
    weight, scale = frame.scale**2, frame.scale[:, None]
    # As free as a slot's offset is, its mean says nothing: without it less cancels.
    total = jnp.maximum(weight.sum(1, keepdims=True), jnp.finfo(weight.dtype).tiny)
    offset = offset - (weight * offset).sum(1, keepdims=True) / total
    at = Look(potential, offset, blocks, frame, weight)
    if blocks is None:
        square = _products(weight, potential**2)
        square = square + (weight * offset**2).sum(1, keepdims=True)
        square = square + 2 * _products(weight * offset, potential)
    else:
        columns = _columns(at, potential)
        square = jnp.einsum("sm,ksm->sk", weight, columns**2, precision="highest")
    both = (jnp.stack([frame.common, frame.filter]) * scale).transpose(0, 2, 1, 3)
    common, found = along(at, both)
    return at._replace(own=jnp.maximum(square - (common * found).sum(0), 0))


def _columns(at: Look, potential: Float[Array, "k n"]) -> Float[Array, "n s M"]:
    if at.blocks is None:
        return potential[:, None] + at.offset
    turned = jnp.einsum("sim,nm->nsi", at.blocks, potential, precision="highest")
    return turned + at.offset


def weighed_volts(at: Look, volts: Float[Array, "*n s M"]) -> Float[Array, "*n s M"]:
    """Computes C⁻¹v, C the errors' covariance."""
    count = volts.shape[-1]
    return whitened_columns(at.frame, volts)[..., :count] * at.frame.scale


def along(at: Look, weighed: Float[Array, "*n s M"]) -> Float[Array, "*n s K"]:
    """Multiplies each candidate's column by weighed volts."""
    constant = (at.offset * weighed).sum(-1, keepdims=True)
    if at.blocks is not None:
        weighed = jnp.einsum("...si,sim->...sm", weighed, at.blocks, precision="highest")
    return _products(weighed, at.potential) + constant


def explained(along: Float[Array, "s K"], own: Float[Array, "s K"]) -> Float[Array, " K"]:
    """Sums (c·v)²/|c|² over slots whose current has the drive's direction."""
    return _part(along, own).sum(0)


def own_beside(at: Look, known: Float[Array, "C s M"]) -> Float[Array, "s K"]:
    """Computes each candidate's |c|² beside known columns, V/A; 0 if hardly any is left."""
    heavy = weighed_volts(at, known)
    gram = jnp.einsum("csm,dsm->scd", heavy, known, precision="highest")
    trace = jnp.trace(gram, axis1=1, axis2=2)[:, None, None]
    gram = gram + (1e-6 * trace + 1e-30) * jnp.eye(len(known), dtype=gram.dtype)
    across = along(at, heavy).transpose(1, 0, 2)  # (s, C, K)
    left = at.own - (across * solve_positive(gram, across)).sum(1)
    return jnp.where(left > 1e-3 * at.own, left, 0)


def best_places(
    scores: Float[Array, " K"],
    places: Float[Array, "K 2"],
    apart: Array | float,
    count: int,
) -> Int[Array, " count"]:
    """Picks the candidates of the highest scores, more than `apart` from each other."""
    chosen = []
    for _ in range(count):
        k = jnp.argmax(scores)
        chosen.append(k)
        scores = jnp.where(_near(places, places[k], apart), -jnp.inf, scores)
    return jnp.stack(chosen)


def best_pairs(
    at: Look,
    alone: Float[Array, "s K"],
    first: Int[Array, " n"],
    places: Float[Array, "K 2"],
    apart: Float[Array, ""],
    count: int,
) -> Int[Array, "count 2"]:
    """Picks the pairs that explain most, with one member among `first`, pair after pair.

    In a slot without two positive currents, the better member counts alone. A pair is
    passed over if both its places are within `apart` of a chosen pair's places. `alone` is
    each candidate `along` the measured voltages.
    """
    columns = _columns(at, at.potential[first])
    gram = along(at, weighed_volts(at, columns))  # (n, s, K)
    one, other = alone[:, first].T[..., None], alone[None]
    own_one, own_other = at.own[:, first].T[..., None], at.own[None]
    det = own_one * own_other - gram**2
    apart_enough = det > 1e-5 * own_one * own_other
    det = jnp.where(apart_enough, det, 1)
    current = (own_other * one - gram * other) / det
    further = (own_one * other - gram * one) / det
    both = apart_enough & (current > 0) & (further > 0)
    single = jnp.maximum(_part(one, own_one), _part(other, own_other))
    explains = jnp.where(both, current * one + further * other, single).sum(1)
    chosen = []
    for _ in range(count):
        k = jnp.argmax(explains)
        i, j = k // len(places), k % len(places)
        chosen.append(jnp.stack([first[i], j]))
        near_i, near_j = (_near(places, places[p], apart) for p in chosen[-1])
        taken = near_i[first][:, None] & near_j | near_j[first][:, None] & near_i
        explains = jnp.where(taken, -jnp.inf, explains)
    return jnp.stack(chosen)


def _part(along: Array, own: Array) -> Array:
    fits = (along > 0) & (own > 0)
    return jnp.where(fits, along**2 / jnp.where(own > 0, own, 1), 0)


def _products(rows: Float[Array, "*n s M"], columns: Float[Array, "K M"]) -> Array:
    return jnp.einsum("...sm,km->...sk", rows, columns, precision="highest")


def _near(places: Array, place: Array, apart: Array | float) -> Array:
    return ((places - place) ** 2).sum(1) <= apart**2


def gains_beside(
    left: Float[Array, "s K"],
    slopes: Float[Array, "P s K"],
    own: Float[Array, "s K"],
    normal: Float[Array, "P P"],
    right: Float[Array, " P"],
) -> Float[Array, " K"]:
    """Computes how much each candidate lowers |rest|² while P parameters may move as well.

    `left`, `slopes`: each candidate `along` the rest, and along its slopes; `own`: from
    `own_beside`; `normal`, `right`: products of the slopes with each other and with the
    rest. Each candidate has a current of its own in each slot; all slots share the
    parameters. The gain is eᵀ(1 − BN⁻¹Bᵀ)⁻¹e. Here e is the candidate's part of the rest in
    each slot, less the part that the parameters explain.
    """
    scale = jnp.where(own > 0, jax.lax.rsqrt(jnp.where(own > 0, own, 1)), 0)
    slopes = (slopes * scale).transpose(2, 1, 0)  # (K, s, P)
    # Parameters are known to their unit, about, before anything is measured.
    known = normal + jnp.diag(1 + 1e-3 * jnp.diagonal(normal))
    both = jnp.concatenate([right[:, None], jnp.eye(len(right), dtype=right.dtype)], 1)
    both = solve_positive(known, both)
    moved = jnp.matmul(slopes, both, precision="highest")
    e = (left * scale).T - moved[..., 0]
    share = jnp.einsum("ksp,ktp->kst", moved[..., 1:], slopes, precision="highest")
    # Own columns are longer than all errors in common leave them: never quite singular.
    matrix = 1.001 * jnp.eye(len(left), dtype=e.dtype) - share
    return (e * solve_positive(matrix, e[..., None])[..., 0]).sum(1)
