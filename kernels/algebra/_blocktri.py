"""Solves symmetric positive definite block-tridiagonal systems, as scans over the blocks.

On a structured mesh the nodes of one mesh line couple to the next line alone. A factor of n
lines of b nodes costs n·b³ operations and n·b² numbers. A dense factor costs (n·b)³ and
(n·b)². A scan compiles once for any n.

`solve_positive` solves small symmetric systems, many at once.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax.linalg import triangular_solve
from jaxtyping import Array, Float


class BlockTri(NamedTuple):
    """A symmetric block-tridiagonal matrix: D_i on the diagonal, E_i at (i + 1, i)."""

    diagonal: Float[Array, "n b b"]
    lower: Float[Array, "n-1 b b"]


class BlockTriFactor(NamedTuple):
    """Cholesky factor of a `BlockTri`: L_i on the diagonal, W_i at (i, i - 1).

    `inverse` holds L_i⁻¹: a substitution is then products alone, and only one product is in
    the scan. W_0 is zero and is stored so that scans run over arrays of one length.
    """

    inverse: Float[Array, "n b b"]
    lower: Float[Array, "n b b"]


def matmul(a: Array, b: Array) -> Array:
    """Multiplies a·b at full precision: recent GPUs would else round float32 to TF32."""
    return jnp.matmul(a, b, precision="highest")


def factor(matrix: BlockTri, row_sums: Float[Array, " nodes"]) -> BlockTriFactor:
    """Factors by Cholesky: L_i L_iᵀ = S_i = D_i − W_i W_iᵀ, W_i = E_{i−1} L_{i−1}⁻ᵀ.

    `row_sums` is A·1, from where A·1 is known without cancellation. An untouched sheet
    leaks no current, but a rounding error of S_i acts as a leak to ground. In float32 such
    leaks cost three digits. So the row sums of S_i set its diagonal: r_i = a_i − W_i
    L_{i−1}⁻¹ r_{i−1}, a_i those of A. All terms are positive, as in the elimination of
    Grassmann, Taksar and Heyman (Oper. Res. 33, 1107, 1985). A matrix that is not positive
    definite gives NaN from the failing block on.
    """
    d, e = matrix
    n, b, _ = d.shape
    eye = jnp.eye(b, dtype=d.dtype)

    def step(previous: tuple, blocks: tuple) -> tuple[tuple, tuple]:
        left, left_sums = previous
        diagonal, lower, upper_sums, sums = blocks
        w = matmul(lower, left.mT)
        sums = sums - matmul(w, matmul(left, left_sums))
        schur = diagonal - matmul(w, w.mT)
        wanted = sums - upper_sums  # the couplings to the next block stand outside S_i
        schur = schur + eye * (wanted - schur.sum(1))[:, None]
        inverse = triangular_solve(
            jnp.linalg.cholesky(schur), eye, left_side=True, lower=True
        )
        return (inverse, sums), (inverse, w)

    zero = jnp.zeros_like(d[:1])
    lower = jnp.concatenate([zero, e])
    upper_sums = jnp.concatenate([e.sum(1), zero[:, 0]])
    blocks = (d, lower, upper_sums, row_sums.reshape(n, b))
    _, (inverse, w) = jax.lax.scan(step, (eye, jnp.zeros_like(eye[0])), blocks)
    return BlockTriFactor(inverse, w)


def solve(chol: BlockTriFactor, rhs: Float[Array, "nodes m"]) -> Float[Array, "nodes m"]:
    """Computes A⁻¹·rhs for m right-hand sides from the factor.

    y_i = L_i⁻¹r_i − (L_i⁻¹W_i)y_{i−1}, then x_i = L_i⁻ᵀy_i − (W_{i+1}L_i⁻¹)ᵀx_{i+1}. Terms
    that do not depend on the neighbouring block are one batched product outside the scan.
    """
    n, b, _ = chol.inverse.shape
    below = jnp.concatenate([chol.lower[1:], jnp.zeros_like(chol.lower[:1])])

    def substitute(previous: Array, blocks: tuple) -> tuple[Array, Array]:
        own, coupling = blocks
        x = own - matmul(coupling, previous)
        return x, x

    blocks = rhs.reshape(n, b, -1)
    zero = jnp.zeros_like(blocks[0])
    down = (matmul(chol.inverse, blocks), matmul(chol.inverse, chol.lower))
    _, y = jax.lax.scan(substitute, zero, down)
    up = (
        matmul(chol.inverse.mT, y),
        matmul(below, chol.inverse).mT,
    )
    _, x = jax.lax.scan(substitute, zero, up, reverse=True)
    return x.reshape(rhs.shape)


def inverse_band(chol: BlockTriFactor) -> BlockTri:
    """Computes the blocks of A⁻¹ where A has blocks of its own (Takahashi's recursion).

    Let G_i = W_{i+1} L_i⁻¹. From the last block back, Z_{i+1,i} = −Z_{i+1,i+1} G_i and
    Z_{ii} = (L_i L_iᵀ)⁻¹ + G_iᵀ Z_{i+1,i+1} G_i.
    """

    def step(z_next: Array, blocks: tuple) -> tuple[Array, tuple]:
        own, g = blocks
        below = -matmul(z_next, g)
        z = own - matmul(g.mT, below)
        return z, (z, below)

    own = matmul(chol.inverse.mT, chol.inverse)
    next_lower = jnp.concatenate([chol.lower[1:], jnp.zeros_like(chol.lower[:1])])
    g = matmul(next_lower, chol.inverse)
    _, (z, below) = jax.lax.scan(step, jnp.zeros_like(own[0]), (own, g), reverse=True)
    return BlockTri(z, below[:-1])


def solve_positive(
    matrix: Float[Array, "*batch n n"], right: Float[Array, "*batch n k"]
) -> Float[Array, "*batch n k"]:
    """Solves A⁻¹B, A small, symmetric and positive: Gauss and Jordan's elimination.

    For small n this is faster than LAPACK, which is called once for each matrix of a batch.
    """

    def eliminate(k: Array, both: Array) -> Array:
        row = jax.lax.dynamic_index_in_dim(both, k, -2)
        pivot = jax.lax.dynamic_index_in_dim(row, k, -1)
        column = jax.lax.dynamic_index_in_dim(both, k, -1)
        row = row / pivot
        return jnp.where((jnp.arange(n) == k)[:, None], row, both - column * row)

    n = matrix.shape[-1]
    if n == 1:
        return right / matrix
    both = jnp.concatenate([matrix, right], -1)
    return jax.lax.fori_loop(0, n, eliminate, both)[..., n:]
