"""Solves small symmetric systems, many at once."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


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
