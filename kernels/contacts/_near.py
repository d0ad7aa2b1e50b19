"""Interpolates electrodes' potentials at points beside electrodes' own discs.

A table alone does not follow the bends at a disc's rim. So the table has what is left when
two known fields are taken off: the logarithm about the electrode that feeds, and the dipole
of each other metal disc.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tomojax.kernels.contacts._field import cubic, nearby_of

# Terms of the smooth parts: more are less smooth, fewer end less smoothly.
_TERMS = 3


class Near(NamedTuple):
    """R_e at points, in parts: a smooth table, and fields about each of M electrodes."""

    smooth: Float[Array, "nx ny M"]  # Ω
    electrodes: Float[Array, "M 2"]  # m
    pull: Float[Array, "M M 2"]  # −∇R_e at electrode e' without its disc, Ω/m
    feed: Float[Array, ""]  # ρ/2π, Ω
    radius: Float[Array, ""]  # of an electrode's disc, m
    reach: Float[Array, ""]  # where the fields about it have faded, m
    answer: Float[Array, ""]  # of a disc's dipole, beside metal's: 0 to 1


def fields_about(
    radius: Float[Array, ""], reach: Float[Array, ""], away: Float[Array, "*n 2"]
) -> tuple[Float[Array, "*n"], Float[Array, "*n 2"]]:
    """Computes the rough parts of −ln r and of r/r² (1/m) away from a disc's centre.

    Within the disc r counts as its radius. The smooth parts, which a table has, are the
    series of both in 1 − r²/R², R the reach, cut off; so the rough parts end at R. They
    take arrays of NumPy and of JAX.
    """
    xp = np if isinstance(away, np.ndarray) else jnp
    square = (away**2).sum(-1) / reach**2
    far, less = xp.maximum(square, (radius / reach) ** 2), xp.maximum(1 - square, 0)
    log, inverse, power = -xp.log(far), 1 / far - 1, less
    for k in range(1, _TERMS + 1):
        log, inverse, power = log - power / k, inverse - power, power * less
    log, inverse = (xp.where(square < 1, a, 0) for a in (log / 2, inverse))
    return log, away * inverse[..., None] / reach**2


def nearest(near: Near, at: Float[Array, "n 2"]) -> Int[Array, " n"]:
    """Finds the electrode nearest to each place: at most one is within reach of a place."""
    square = ((at[:, None] - near.electrodes) ** 2).sum(-1)
    return jnp.argmin(square, 1).astype(jnp.int32)


def rows_near(
    near: Near,
    size: Float[Array, "2"],
    at: Float[Array, "n 2"],
    own: Int[Array, " n"],
    log: Float[Array, " n"],
    dipole: Float[Array, "n 2"],
) -> Float[Array, "n M"]:
    """Computes R_e at points, Ω, from the fields about each point's electrode `own`."""

    def smooth(at: Array) -> Array:
        part, nearby = nearby_of(near.smooth[:, :, None], size, at, 0, 1)
        along = cubic(part)
        flat = (along[0][:, None] * along[1]).ravel()
        return jnp.matmul(flat, nearby[:, 0], precision="highest")

    rows = jax.vmap(smooth)(at)
    feeds = jnp.arange(len(near.electrodes), dtype=own.dtype) == own[:, None]
    rows = rows + jnp.where(feeds, near.feed * log[:, None], 0)
    polarised = near.answer * near.radius**2 * dipole
    return rows + jnp.einsum("nmk,nk->nm", near.pull[own], polarised, precision="highest")
