"""Reduces the slots' rows: J^l ≈ A_l B with r rows in B instead of K columns.

All slot maps T share one row space, which the differences of the electrodes' fields and a
constant span (T^l_ik = R_ik − R_lk + const_il). There r = M is exact. In an orthonormal B
the sums A_lᵀA_l are r × r and add over slots. A ground set, a weight or λ then costs a sum
of r × r blocks and one small factorisation.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tomojax.kernels.algebra import matmul


class ReducedSlots(NamedTuple):
    """The reduced rows J^l ≈ A_l B, with the blocks that add over slots."""

    basis: Float[Array, "r K"]  # B, orthonormal rows
    factors: Float[Array, "L M r"]  # A_l = J^l Bᵀ
    grams: Float[Array, "L r r"]  # A_lᵀA_l


def row_basis(maps: Float[Array, "L M K"], rank: int) -> Float[Array, "r K"]:
    """Finds orthonormal rows B that hold the `rank` largest singular vectors of all of J.

    The method is a randomised range finder with two power iterations (Halko, Martinsson,
    Tropp, SIAM Review 53, 2011). B leaves at most a tenth more than the best basis of that
    rank.
    """
    rows = maps.reshape(-1, maps.shape[-1])
    sketch = jax.random.normal(jax.random.key(0), (len(rows), rank), rows.dtype)
    q = jnp.linalg.qr(matmul(rows.T, sketch))[0]
    for _ in range(2):
        q = jnp.linalg.qr(matmul(rows, q))[0]
        q = jnp.linalg.qr(matmul(rows.T, q))[0]
    return q.T


def reduce_slots(maps: Float[Array, "L M K"], basis: Float[Array, "r K"]) -> ReducedSlots:
    """Computes the factors and blocks of J^l in `basis`."""
    factors = matmul(maps, basis.T)
    grams = matmul(jnp.swapaxes(factors, 1, 2), factors)
    return ReducedSlots(basis, factors, grams)


def solve_reduced(
    reduced: ReducedSlots,
    grounds: Int[Array, " S"],
    voltages: Float[Array, "S M"],
    regularisation: Float[Array, ""],
    weights: Float[Array, " S"] | None = None,
) -> Float[Array, " r"]:
    """Solves for c with φ ≈ Bᵀc: (Σ_s w_s A_sᵀA_s + λI) c = Σ_s w_s A_sᵀv_s.

    A sum of blocks has the square of J's condition. The solve serves float64, and λ above
    about 1e-5·σ₁² in float32. Below that λ Cholesky fails in float32 and gives NaN.
    `tikhonov` of the selected factors is the accurate way. λ ≤ 0 gives NaN.
    """
    if weights is None:
        weights = jnp.ones_like(voltages[:, 0])
    gram = jnp.einsum("s,srt->rt", weights, reduced.grams[grounds], precision="highest")
    right = jnp.einsum(
        "s,smr,sm->r", weights, reduced.factors[grounds], voltages, precision="highest"
    )
    lam = jnp.where(regularisation > 0, regularisation, jnp.nan)
    return solve_damped(gram, right, lam)


def solve_damped(
    gram: Float[Array, "r r"], right: Float[Array, "r ..."], lam: Float[Array, ""]
) -> Float[Array, "r ..."]:
    """Solves (G + λI) c = b for one b or several, G = JᵀWJ added up over slots.

    The solve's own rule makes c differentiable.
    """
    system = gram + lam * jnp.eye(len(gram), dtype=gram.dtype)
    return jax.scipy.linalg.solve(system, right, assume_a="pos")
