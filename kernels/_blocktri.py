"""Symmetric positive definite block-tridiagonal systems, as scans over the blocks.

On a structured mesh the nodes of one mesh line couple to the next line alone. With n
lines of b nodes a factor costs n·b³ operations and n·b² numbers, against (n·b)³ and
(n·b)² for a dense one, and a scan compiles once for any n.
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

    W_0 is zero and stands here so that scans run over arrays of one length.
    """

    diagonal: Float[Array, "n b b"]
    lower: Float[Array, "n b b"]


def matmul(a: Array, b: Array) -> Array:
    """a·b at full precision: recent GPUs would otherwise round float32 to TF32."""
    return jnp.matmul(a, b, precision="highest")


def _transposed(a: Array) -> Array:
    return jnp.swapaxes(a, -1, -2)


def factor(matrix: BlockTri, row_sums: Float[Array, " nodes"]) -> BlockTriFactor:
    """Cholesky factor: L_i L_iᵀ = S_i = D_i − W_i W_iᵀ, W_i = E_{i−1} L_{i−1}⁻ᵀ.

    `row_sums` is A·1, from where it is known without cancellation. An untouched sheet
    leaks no current, and every rounding of S_i that breaks that is a leak to ground:
    in float32 those cost three digits. So the diagonal of S_i is set from its row sums
    r_i = a_i − W_i L_{i−1}⁻¹ r_{i−1} (a_i of A; all terms are positive), as in the
    elimination of Grassmann, Taksar and Heyman (Oper. Res. 33, 1107, 1985).
    A matrix that is not positive definite gives NaN from the failing block on.
    """

    def step(previous: tuple, blocks: tuple) -> tuple[tuple, tuple]:
        left, left_sums = previous
        diagonal, lower, upper_sums, sums = blocks
        w = triangular_solve(left, lower, left_side=False, lower=True, transpose_a=True)
        passed = triangular_solve(left, left_sums[:, None], left_side=True, lower=True)
        sums = sums - matmul(w, passed)[:, 0]
        schur = diagonal - matmul(w, _transposed(w))
        wanted = sums - upper_sums  # the couplings to the next block stand outside S_i
        eye = jnp.eye(len(schur), dtype=schur.dtype)
        schur = schur + eye * (wanted - schur.sum(1))[:, None]
        new = jnp.linalg.cholesky(schur)
        return (new, sums), (new, w)

    d, e = matrix
    n, b, _ = d.shape
    zero = jnp.zeros_like(d[:1])
    lower = jnp.concatenate([zero, e])
    upper_sums = jnp.concatenate([e.sum(1), zero[:, 0]])
    first = (jnp.eye(b, dtype=d.dtype), jnp.zeros(b, d.dtype))
    _, (diagonal, w) = jax.lax.scan(
        step, first, (d, lower, upper_sums, row_sums.reshape(n, b))
    )
    return BlockTriFactor(diagonal, w)


def solve(chol: BlockTriFactor, rhs: Float[Array, "nodes m"]) -> Float[Array, "nodes m"]:
    """A⁻¹·rhs for m right-hand sides from the factor."""
    n, b, _ = chol.diagonal.shape

    def forward(y: Array, blocks: tuple) -> tuple[Array, Array]:
        diagonal, w, right = blocks
        y = triangular_solve(diagonal, right - matmul(w, y), left_side=True, lower=True)
        return y, y

    def backward(carry: Array, blocks: tuple) -> tuple[Array, Array]:
        diagonal, w, y = blocks
        x = triangular_solve(
            diagonal, y - carry, left_side=True, lower=True, transpose_a=True
        )
        return matmul(_transposed(w), x), x

    blocks = rhs.reshape(n, b, -1)
    zero = jnp.zeros_like(blocks[0])
    _, y = jax.lax.scan(forward, zero, (*chol, blocks))
    _, x = jax.lax.scan(backward, zero, (*chol, y), reverse=True)
    return x.reshape(rhs.shape)


def inverse_band(chol: BlockTriFactor) -> BlockTri:
    """The blocks of A⁻¹ at the places where A has its own (Takahashi's recursion).

    With G_i = W_{i+1} L_i⁻¹: Z_{i+1,i} = −Z_{i+1,i+1} G_i and
    Z_{ii} = (L_i L_iᵀ)⁻¹ + G_iᵀ Z_{i+1,i+1} G_i, from the last block back.
    """
    n, b, _ = chol.diagonal.shape
    eye = jnp.eye(b, dtype=chol.diagonal.dtype)

    def step(carry: tuple, blocks: tuple) -> tuple[tuple, tuple]:
        z_next, w_next = carry
        diagonal, w = blocks
        inverse = triangular_solve(diagonal, eye, left_side=True, lower=True)
        g = matmul(w_next, inverse)
        below = -matmul(z_next, g)
        z = matmul(_transposed(inverse), inverse) - matmul(_transposed(g), below)
        return (z, w), (z, below)

    zero = jnp.zeros_like(chol.diagonal[0])
    _, (z, below) = jax.lax.scan(step, (zero, zero), tuple(chol), reverse=True)
    return BlockTri(z, below[:-1])
