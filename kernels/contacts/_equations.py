"""Builds normal equations of contacts: best currents, and slopes by the parameters.

In each slot the currents are the best fit; all slots share places and sizes.

Frames are freed of common errors first: whitened.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

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


class WhitenedFrame(NamedTuple):
    """The whitened voltages of S slots: errors are independent and of size 1. W = M + q."""

    grounds: Int[Array, " S"]
    whitened: Float[Array, "S W"]
    scale: Float[Array, "S M"]  # 1/V; 0 where not used
    common: Float[Array, "S q M"]  # what one σ of each common error makes, times scale
    filter: Float[Array, "S q M"]  # finds them


def whiten(
    voltages: Float[Array, "S M"],
    grounds: Int[Array, " S"],
    own: Float[Array, "S M"],
    common: Float[Array, "S q M"],
) -> WhitenedFrame:
    """Whitens voltages: errors of each channel, `own` (V; 0: not used), and common ones.

    `common` holds the voltages that one standard deviation of each common error makes, V.
    The errors' covariance is C = diag(own²) + BᵀB, and |whitened|² = VᵀC⁻¹V. The last q
    values are the likeliest common errors, in standard deviations; the first M values are
    the rest. This costs 2q/M of the work that a matrix for each slot takes.
    """
    scale = jnp.where(own > 0, 1 / jnp.where(own > 0, own, 1), 0)
    common = common * scale[:, None]
    normal = jnp.einsum("sqm,spm->sqp", common, common, precision="highest")
    normal = normal + jnp.eye(common.shape[1], dtype=common.dtype)
    # Fewer unknowns than channels: its inverse, and one product.
    unit = jnp.eye(common.shape[1], dtype=common.dtype)
    inverse = solve_positive(normal, jnp.broadcast_to(unit, normal.shape))
    found = jnp.matmul(inverse, common, precision="highest")
    frame = WhitenedFrame(grounds, voltages, scale, common, found)
    return frame._replace(whitened=whitened_columns(frame, voltages))


def whitened_columns(frame: WhitenedFrame, columns: Float[Array, "*C S M"]) -> Array:
    """Whitens columns in the way that the frame's voltages are whitened."""
    scaled = columns * frame.scale
    found = jnp.einsum("sqm,...sm->...sq", frame.filter, scaled, precision="highest")
    shared = jnp.einsum("sqm,...sq->...sm", frame.common, found, precision="highest")
    return jnp.concatenate([scaled - shared, found], -1)


def whitened_rows(
    frame: WhitenedFrame, columns: Float[Array, "S K M"]
) -> Float[Array, "S K W"]:
    """Whitens K columns slot by slot, as `whitened_columns` does."""
    scaled = columns * frame.scale[:, None]
    found = jnp.einsum("skm,sqm->skq", scaled, frame.filter, precision="highest")
    shared = jnp.einsum("skq,sqm->skm", found, frame.common, precision="highest")
    return jnp.concatenate([scaled - shared, found], -1)


def whitened_slopes(
    frame: WhitenedFrame, slopes: Float[Array, "S M P"]
) -> Float[Array, "S W P"]:
    """Whitens slopes by P parameters, as `whitened_columns` does."""
    scaled = slopes * frame.scale[:, :, None]
    found = jnp.matmul(frame.filter, scaled, precision="highest")
    shared = jnp.matmul(jnp.swapaxes(frame.common, 1, 2), found, precision="highest")
    return jnp.concatenate([scaled - shared, found], 1)


def unwhitened(frame: WhitenedFrame, slope: Float[Array, "S P W"]) -> Float[Array, "S P M"]:
    """Turns slopes by whitened voltages into slopes by voltages: the transpose."""
    count = frame.scale.shape[1]
    rest, found = slope[..., :count], slope[..., count:]
    back = jnp.einsum("spm,sqm->spq", rest, frame.common, precision="highest")
    back = jnp.einsum("spq,sqm->spm", found - back, frame.filter, precision="highest")
    return (rest + back) * frame.scale[:, None]
