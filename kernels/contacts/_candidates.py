"""Where contacts may be: the best places of a coarse grid, for a fit to start from."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tomojax.kernels.algebra import solve_positive


def best_places(
    columns: Float[Array, "K S M"],
    rest: Float[Array, "S M"],
    places: Float[Array, "K 2"],
    apart: Array | float,
    count: int,
) -> Float[Array, "count 2"]:
    """The candidates whose current explains most of `rest`, `apart` from each other.

    `columns` and `rest` whitened; Σ_s (c_s·r_s)²/|c_s|², currents in the drive's direction
    alone being what an object feeds.
    """
    along = jnp.einsum("ksm,sm->ks", columns, rest, precision="highest")
    own = jnp.sum(columns**2, -1)
    explained = jnp.where(along > 0, along**2 / jnp.where(own > 0, own, 1), 0).sum(1)
    chosen = []
    for _ in range(count):
        k = jnp.argmax(explained)
        chosen.append(places[k])
        explained = jnp.where(_near(places, places[k], apart), -jnp.inf, explained)
    return jnp.stack(chosen)


def best_pairs(
    columns: Float[Array, "K S M"],
    whitened: Float[Array, "S M"],
    places: Float[Array, "K 2"],
    apart: Float[Array, ""],
    count: int,
) -> Float[Array, "count 2 2"]:
    """The pairs of candidates that explain most, one after another.

    Both currents positive in each slot; pairs whose places are both nearer than `apart` to
    one that is chosen are passed over.
    """
    gram = jnp.einsum("ksm,jsm->skj", columns, columns, precision="highest")
    along = jnp.einsum("ksm,sm->sk", columns, whitened, precision="highest")
    own = jnp.maximum(jnp.diagonal(gram, axis1=1, axis2=2), 1e-30)
    one, other = along[:, :, None], along[:, None, :]
    own_one, own_other = own[:, :, None], own[:, None, :]
    det = own_one * own_other - gram**2
    apart_enough = det > 1e-5 * own_one * own_other
    det = jnp.where(apart_enough, det, 1)
    first = (own_other * one - gram * other) / det
    second = (own_one * other - gram * one) / det
    both = apart_enough & (first > 0) & (second > 0)
    alone = jnp.maximum(jnp.where(one > 0, one**2 / own_one, 0), other**2 / own_other)
    explained = jnp.where(both, first * one + second * other, alone).sum(0)
    explained = jnp.where(jnp.tri(len(places), dtype=bool).T, -jnp.inf, explained)
    chosen = []
    for _ in range(count):
        k = jnp.argmax(explained)
        i, j = k // len(places), k % len(places)
        chosen.append(jnp.stack([places[i], places[j]]))
        near_i, near_j = (_near(places, places[p], apart) for p in (i, j))
        taken = near_i[:, None] & near_j[None] | near_j[:, None] & near_i[None]
        explained = jnp.where(taken, -jnp.inf, explained)
    return jnp.stack(chosen)


def _near(places: Array, place: Array, apart: Array | float) -> Array:
    return ((places - place) ** 2).sum(1) <= apart**2


def apart_from(
    columns: Float[Array, "K S M"], known: Float[Array, "C S M"]
) -> Float[Array, "K S M"]:
    """Columns without what `known` ones make of them; 0 where nearly nothing is left."""

    def slot(known: Float[Array, "C M"], columns: Float[Array, "K M"]) -> Array:
        own = jnp.matmul(known, known.T, precision="highest")
        own = own + 1e-6 * jnp.trace(own) * jnp.eye(len(known), dtype=own.dtype)
        both = jnp.matmul(known, columns.T, precision="highest")
        part = solve_positive(own, both)
        return columns - jnp.matmul(part.T, known, precision="highest")

    new = jax.vmap(slot, (1, 1), 1)(known, columns)
    kept = jnp.sum(new**2, -1) > 1e-3 * jnp.sum(columns**2, -1)
    return jnp.where(kept[..., None], new, 0)


def gains_beside(
    columns: Float[Array, "K S M"],
    rest: Float[Array, "S M"],
    slope: Float[Array, "S M P"],
) -> Float[Array, " K"]:
    """By how much each candidate lowers |rest|² while P parameters may move as well.

    Each has a current of its own in each slot; the parameters are shared by the slots.
    """
    own = jnp.sum(columns**2, -1)
    scaled = columns * jax.lax.rsqrt(jnp.where(own > 0, own, 1))[..., None]
    along = jnp.einsum("ksm,sm->ks", scaled, rest, precision="highest")
    with_slope = jnp.einsum("ksm,smp->ksp", scaled, slope, precision="highest")
    normal = jnp.einsum("smp,smq->pq", slope, slope, precision="highest")
    right = jnp.einsum("smp,sm->p", slope, rest, precision="highest")
    # Parameters are known to their unit, about, before anything is measured.
    known = jnp.diag(1 + 1e-3 * jnp.diagonal(normal))
    before = solve_positive(normal + known, right[:, None])[:, 0] @ right
    normal = normal + known - jnp.einsum("ksp,ksq->kpq", with_slope, with_slope)
    right = right - jnp.einsum("ksp,ks->kp", with_slope, along)
    moved = solve_positive(normal, right[..., None])[..., 0]
    return (along**2).sum(1) + (moved * right).sum(1) - before
