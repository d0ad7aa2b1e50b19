"""The reduced form of the slot maps: T^l = A_l B with M rows in B instead of K columns.

All slot maps share one row space, spanned by the differences of the electrodes' fields
and by a constant (T^l_ik = R_ik − R_lk + const_il). In an orthonormal basis B of it the
sums A_lᵀA_l are M × M and add over slots: a ground set or a weight is then a small sum.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from tomojax.kernels._blocktri import matmul
from tomojax.kernels._table import Resistances


def slot_basis(table: Resistances) -> Float[Array, "M K"]:
    """Orthonormal rows B that span the rows of T^l for every ground l (rank M)."""
    ek = table.elements
    # The constant has the size of the fields: QR does not rank, but float32 rounds.
    constant = jnp.full_like(ek[:1], jnp.sqrt(jnp.mean(ek**2)))
    rows = jnp.concatenate([ek[1:] - ek[:1], constant])
    return jnp.linalg.qr(rows.T)[0].T


def slot_factors(
    maps: Float[Array, "L M K"], basis: Float[Array, "r K"]
) -> Float[Array, "L M r"]:
    """A_l = T^l Bᵀ, so that T^l = A_l B; for another J the best A_l in that basis."""
    return matmul(maps, basis.T)
