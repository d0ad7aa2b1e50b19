"""Reduces a sheet in contact over many sites of which few matter to each other.

A site is a part of the sheet that current enters in fixed shares (a pixel, say), or an
electrode's metal. R between all sites is computed once for a sheet. A contact then needs
one factor of its strong sites. Weak sites also take from each other's current, to second
order in how weak they are. Voltages leave this effect out. Fields, which give the slopes,
are those of the strong sites alone.
"""

from functools import partial

import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.lax.linalg import triangular_solve
from jaxtyping import Array, Float

from tomojax.kernels.algebra import matmul
from tomojax.kernels.sheet._reduction import ContactReduction

# Numbers of sites that a factor is made of: whichever is the first to be enough, or all.
_SIZES = (32, 64, 128, 224, 352)

# Σ g·R of the sites left out of the factor, at most: the square of each is neglected. In
# fits of one to three contacts, bars and palms that made χ² of 0.04 in 640 voltages, and of
# 2 where they start.
_WEAK = 0.3


def reduce_sites(
    resistance: Float[Array, "n n"], conductance: Float[Array, " n"], electrodes: int
) -> ContactReduction:
    """Reduces a contact on n sites, the last of which are the electrodes, to electrodes.

    The factor is of the strong sites alone. Let s = √g there and
    y = (I + sRs)⁻¹s·[1 R_ce]. Then q = s·y are the currents of the strong sites, and
    z = [1 R_ce] − R_ca·q the potentials everywhere. The weak sites add zᵀg·z to what q
    draws.
    **Arguments:** `resistance` R in one gauge, Ω; `conductance` g, S per site;
    `electrodes`: M.
    **Returns:** the reduction, with the field at all n sites.
    """
    n = len(resistance)
    sizes = [size for size in _SIZES if size < n]
    reduced = partial(_reduced, resistance, conductance, electrodes)
    if not sizes:
        return reduced(jnp.arange(n))
    weight = conductance * jnp.diagonal(resistance)
    highest, order = lax.top_k(weight, sizes[-1])
    beyond = weight.at[order].set(0).sum()
    # From the smallest up: as differences of sums they would be lost in rounding.
    after = beyond + jnp.cumsum(jnp.append(highest, 0)[::-1])[::-1]
    branch = (after[np.array(sizes)] > _WEAK).sum()
    some = [lambda order, k=k: reduced(order[:k]) for k in sizes]
    return lax.switch(branch, [*some, lambda _: reduced(jnp.arange(n))], order)


def _reduced(
    resistance: Array, conductance: Array, electrodes: int, at: Array
) -> ContactReduction:
    """Factors the sites `at`, and treats all others as weak."""
    own = jnp.diagonal(resistance)
    ends = jnp.concatenate([jnp.ones_like(own)[:, None], resistance[:, -electrodes:]], 1)
    rows, g = resistance[at], conductance[at]
    root = jnp.sqrt(g)[:, None]
    system = jnp.eye(len(at), dtype=g.dtype) + root * rows[:, at] * root.T
    chol = jnp.linalg.cholesky(system, symmetrize_input=False)
    half = triangular_solve(chol, root * ends[at], left_side=True, lower=True)
    y = triangular_solve(chol, half, left_side=True, lower=True, transpose_a=True)
    flow = root * y
    z = ends - matmul(rows.T, flow)
    # What is under a strong contact is y/s: as the difference it would lose its digits.
    strong = (g * own[at] > 1)[:, None]
    z = z.at[at].set(jnp.where(strong, y / jnp.where(strong, root, 1), z[at]))
    weak = conductance.at[at].set(0)[:, None]
    drawn = matmul(half.T, half) + matmul(z.T, weak * z)
    lift = drawn[0, 1:]
    return ContactReduction(
        drawn[0, 0],
        lift,
        1 - lift,
        resistance[-electrodes:, -electrodes:] - drawn[1:, 1:],
        z[:, 1:],
        z[:, 0],
    )
