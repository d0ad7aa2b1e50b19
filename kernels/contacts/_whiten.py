"""Voltages freed of what their errors have in common, and currents that fit them."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tomojax.kernels.algebra import solve_positive


class WhitenedFrame(NamedTuple):
    """What S slots measured, whitened: errors are independent and of size 1. W = M + q."""

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
    """Errors of each channel's own, of size `own` (V; 0 where not used), and common ones.

    Of each of these `common` is what one standard deviation makes, V. Together they have
    the covariance C = diag(own²) + BᵀB, and |whitened|² = VᵀC⁻¹V: the last q values are
    the common errors that are most likely, in standard deviations, and the first M what
    is left then. It costs 2q/M of what a matrix for each slot would.
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
    """Columns as the frame's voltages are."""
    scaled = columns * frame.scale
    found = jnp.einsum("sqm,...sm->...sq", frame.filter, scaled, precision="highest")
    shared = jnp.einsum("sqm,...sq->...sm", frame.common, found, precision="highest")
    return jnp.concatenate([scaled - shared, found], -1)


def whitened_rows(
    frame: WhitenedFrame, columns: Float[Array, "S K M"]
) -> Float[Array, "S K W"]:
    """The same of K columns slot by slot."""
    scaled = columns * frame.scale[:, None]
    found = jnp.einsum("skm,sqm->skq", scaled, frame.filter, precision="highest")
    shared = jnp.einsum("skq,sqm->skm", found, frame.common, precision="highest")
    return jnp.concatenate([scaled - shared, found], -1)


def whitened_slopes(
    frame: WhitenedFrame, slopes: Float[Array, "S M P"]
) -> Float[Array, "S W P"]:
    """The same of slopes by P parameters."""
    scaled = slopes * frame.scale[:, :, None]
    found = jnp.matmul(frame.filter, scaled, precision="highest")
    shared = jnp.matmul(jnp.swapaxes(frame.common, 1, 2), found, precision="highest")
    return jnp.concatenate([scaled - shared, found], 1)


def unwhitened(frame: WhitenedFrame, slope: Float[Array, "S P W"]) -> Float[Array, "S P M"]:
    """From slopes of something by whitened voltages to those by voltages: the transpose."""
    count = frame.scale.shape[1]
    rest, found = slope[..., :count], slope[..., count:]
    back = jnp.einsum("spm,sqm->spq", rest, frame.common, precision="highest")
    back = jnp.einsum("spq,sqm->spm", found - back, frame.filter, precision="highest")
    return (rest + back) * frame.scale[:, None]


def currents(
    frame: WhitenedFrame, columns: Float[Array, "C S N"], ridge: Array | float = 0.0
) -> tuple[Float[Array, "S C"], Float[Array, "S N"]]:
    """Each slot's currents, and what is left: least squares, all whitened."""
    normal = jnp.einsum("csm,dsm->scd", columns, columns, precision="highest")
    right = jnp.einsum("csm,sm->sc", columns, frame.whitened, precision="highest")
    trace = jnp.trace(normal, axis1=1, axis2=2)
    tiny = 16 * jnp.finfo(normal.dtype).eps * trace + jnp.finfo(normal.dtype).tiny
    diagonal = tiny[:, None] + jnp.broadcast_to(ridge, right.shape)
    normal = normal + diagonal[..., None] * jnp.eye(len(columns), dtype=normal.dtype)
    found = solve_positive(normal, right[..., None])[..., 0]
    rest = frame.whitened - jnp.einsum("csm,sc->sm", columns, found, precision="highest")
    return found, rest
