"""Frees voltages of common errors: whitens them."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tomojax.kernels.algebra import solve_positive


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
