"""Interpolates electrodes' potentials at points beside electrodes' own discs.

A table alone does not follow the bends at a disc's rim. So the table has what is left when
two known fields are taken off: the logarithm about the electrode that feeds, and the dipole
of each other metal disc.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax.kernels.contacts._field import thin_rows_at

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


def rows_near(
    near: Near,
    size: Float[Array, "2"],
    at: Float[Array, "n 2"],
    each: Float[Array, "p 2"],
) -> Float[Array, "n 3 M"]:
    """Computes R_e (Ω) of n small patches, and slopes by x and y, row by row.

    `each` has a patch's points about its middle: what is rough is averaged over these. At
    most one electrode is within reach of a point.
    """
    square = ((at[:, None] - near.electrodes) ** 2).sum(-1)
    own = jnp.argmin(square, 1).astype(jnp.int32)
    away = (at - near.electrodes[own])[:, None] + each

    def rough(shift: Float[Array, "2"]) -> tuple[Array, Array]:
        log, dipole = fields_about(near.radius, near.reach, away + shift)
        return log.mean(1), dipole.mean(1)

    none, unit = jnp.zeros_like(size), jnp.eye(2, dtype=size.dtype)
    turned = jax.vmap(lambda by: jax.jvp(rough, (none,), (by,)), out_axes=(None, 0))
    now, slopes = turned(unit)
    log, dipole = (jnp.concatenate([a[None], b]) for a, b in zip(now, slopes))
    rows = jax.vmap(thin_rows_at, (None, None, 0))(near.smooth, size, at)
    feeds = jnp.arange(len(near.electrodes), dtype=own.dtype) == own[:, None]
    rows = rows + jnp.where(feeds[:, None], near.feed * log.T[..., None], 0)
    polarised = near.answer * near.radius**2 * dipole
    return rows + jnp.einsum("nmk,jnk->njm", near.pull[own], polarised, precision="highest")
