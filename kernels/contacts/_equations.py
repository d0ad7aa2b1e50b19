"""Builds normal equations of contacts: best currents, and slopes by the parameters.

In each slot the currents are the best fit; all slots share places and sizes.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from tomojax.kernels.algebra import Normal, solve_positive
from tomojax.kernels.contacts._points import Fitted


class Explained(NamedTuple):
    """A frame of S slots, explained by C columns; all whitened but `fitted`."""

    rest: Float[Array, "S W"]  # measured less what they make
    column: Float[Array, "S C W"]  # of each, per ampere
    tangent: Float[Array, "S P W"]  # of what they make by each of P parameters
    prior: Float[Array, " p"]
    slope: Float[Array, "p P"]  # of the priors
    fitted: Fitted


def normal_of(found: Explained, tolerance: Float[Array, ""]) -> Normal:
    """Computes the cost Σ_s δ²·ln(1 + |r_s|²/δ²) + |priors|² and its equations.

    `tolerance` is δ². Slots that do not fit at all count little (Cauchy's loss). The
    currents adapt when parameters move, so only the part of the slopes beyond the currents
    counts. The change of that part with the parameters is left out.
    """
    misfit = (found.rest**2).sum(1) / tolerance
    weight = 1 / (1 + misfit)
    cost = tolerance * jnp.log1p(misfit).sum() + (found.prior**2).sum()
    count, sizes = found.column.shape[1], found.tangent.shape[1]
    both = jnp.concatenate([found.column, found.tangent], 1)
    gram = jnp.einsum("siw,sjw->sij", both, both, precision="highest")
    across = gram[:, :count, count:]
    own = regular(gram[:, :count, :count])
    part = jnp.einsum(
        "sci,scj->sij", across, solve_positive(own, across), precision="highest"
    )
    matrix = jnp.einsum("s,sij->ij", weight, gram[:, count:, count:] - part)
    right = jnp.einsum("spw,sw->sp", found.tangent, found.rest, precision="highest")
    gradient = found.prior @ found.slope - weight @ right
    known = jnp.matmul(found.slope.T, found.slope, precision="highest")
    return Normal(cost, matrix + known, gradient.reshape(sizes))


def free_slopes(found: Explained) -> Float[Array, "S P W"]:
    """Computes the slopes of the rest by parameters, where currents stay the best fit."""
    gram = jnp.einsum("scw,sdw->scd", found.column, found.column, precision="highest")
    along = jnp.einsum("scw,spw->scp", found.column, found.tangent, precision="highest")
    share = solve_positive(regular(gram), along)
    kept = jnp.einsum("scp,scw->spw", share, found.column, precision="highest")
    return kept - found.tangent


def regular(gram: Float[Array, "S C C"]) -> Float[Array, "S C C"]:
    """Adds a little to the diagonal: the matrix of a slot without channels is zero."""
    info = jnp.finfo(gram.dtype)
    more = 16 * info.eps * jnp.trace(gram, axis1=1, axis2=2) + info.tiny
    return gram + more[:, None, None] * jnp.eye(gram.shape[1], dtype=gram.dtype)


def best_currents(
    column: Float[Array, "S C W"], measured: Float[Array, "S W"]
) -> tuple[Float[Array, "S C"], Float[Array, "S W"]]:
    """Fits each slot's currents by least squares, all whitened; returns the rest too.

    The fit is solved twice: what one solve leaves by rounding is as large as the errors, in
    float32.
    """
    current = currents_of(column, measured)
    current = current + currents_of(column, measured - made_by(current, column))
    return current, measured - made_by(current, column)


def currents_of(
    column: Float[Array, "S C W"], measured: Float[Array, "S W"]
) -> Float[Array, "S C"]:
    """Fits each slot's currents by one solve."""
    gram = jnp.einsum("scw,sdw->scd", column, column, precision="highest")
    right = jnp.einsum("scw,sw->sc", column, measured, precision="highest")
    return solve_positive(regular(gram), right[..., None])[..., 0]


def made_by(current: Float[Array, "S C"], column: Float[Array, "S C W"]) -> Array:
    return jnp.einsum("sc,scw->sw", current, column, precision="highest")
