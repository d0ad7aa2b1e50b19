"""Solves the paper's Eq. 3: φ = (JᵀWJ + λI)⁻¹JᵀWv, in float64 whatever the dtype.

Let A = √W·J. The smaller of two systems is solved: A Aᵀ + λI (n rows) or AᵀA + λI (K
columns). Their condition is σ₁²/λ. In float32, Cholesky loses the solution at λ ≈ 1e-6·σ₁²
and is NaN below 1e-7. Float64 keeps the solution, and processors have float64 whatever
dtype the process works in. A device without float64 has to emulate it or to refuse; none
was tried. There the route "cholesky" serves λ from 1e-5·σ₁² up.
"""

from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

SolveRoute = Literal["auto", "cholesky", "double"]

# Unlike `jnp.matmul` it names no dtype, which a `vmap` outside of `jax.enable_x64` would
# cut to float32.
matmul = partial(lax.dot, precision="highest")


def tikhonov(
    rows: Float[Array, "n K"],
    voltages: Float[Array, " n"],
    regularisation: Float[Array, ""],
    weights: Float[Array, " n"] | None = None,
    route: SolveRoute = "auto",
) -> Float[Array, " K"]:
    """Computes φ = argmin Σ_i w_i (J_i φ − v_i)² + λ‖φ‖², for one frame.

    **Arguments:** `rows` J_s, the selected slots' rows; `voltages` V; `regularisation` λ >
    0 in the unit of J²; `weights` w ≥ 0 of the rows, 1 by default; `route`:

    - "cholesky" factors the smaller normal system in the dtype of `rows`.
    - "double" does the same in float64, which the device must have.
    - "auto" is "cholesky" in float64 and "double" in float32 (right to 1e-7 down to λ =
      1e-10·σ₁²).

    The solve's own rule makes φ differentiable to any order in J, V, λ and w (also at w =
    0). One factor serves all frames of a `vmap`, and their derivatives. λ ≤ 0 and NaN give
    NaN, never an image.
    """
    if weights is None:
        weights = jnp.ones_like(voltages)
    if route == "auto":
        route = "cholesky" if rows.dtype == jnp.float64 else "double"
    factor = _factor(route, *map(lax.stop_gradient, (rows, regularisation, weights)))
    return _image(route, factor, rows, voltages, regularisation, weights)[0]


def _factor(route: SolveRoute, rows: Array, lam: Array, weights: Array) -> Array:
    """Factors the smaller of A Aᵀ + λI and AᵀA + λI into LLᵀ; "double" gives two floats."""
    if route == "double":
        with jax.enable_x64(True):
            lower = _factor("cholesky", *map(_doubled, (rows, lam, weights)))
            high = lower.astype(rows.dtype)
            return jnp.stack([high, (lower - _doubled(high)).astype(rows.dtype)])
    short = jnp.sqrt(weights)[:, None] * rows
    short = short if _is_wide(rows) else short.T
    identity = jnp.eye(len(short), dtype=rows.dtype)
    return jnp.linalg.cholesky(matmul(short, short.T) + lam * identity)


def _is_wide(rows: Array) -> bool:
    return rows.shape[0] <= rows.shape[1]


def _doubled(a: Array) -> Array:
    return lax.convert_element_type(a, jnp.float64)


def _whole(factor: Array) -> Array:
    """Adds the two floats of L from "double" in float64, where that is enabled."""
    return _doubled(factor[0]) + _doubled(factor[1])


def _by_triangle(lower: Array, b: Array) -> Array:
    """Computes (LLᵀ)⁻¹b."""
    triangle = partial(lax.linalg.triangular_solve, lower, left_side=True, lower=True)
    return triangle(triangle(b[:, None]), transpose_a=True)[:, 0]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _image(
    route: SolveRoute,
    factor: Array,
    rows: Array,
    voltages: Array,
    lam: Array,
    weights: Array,
) -> tuple[Array, Array]:
    """Computes φ, and v − Jφ."""
    if route == "double":
        with jax.enable_x64(True):
            given = map(_doubled, (rows, voltages, lam, weights))
            found = _image("cholesky", _whole(factor), *given)
            return tuple(x.astype(rows.dtype) for x in found)  # pyright: ignore
    scale = jnp.sqrt(weights)
    a, b = scale[:, None] * rows, scale * voltages
    # A small negative λ may leave a factor that is no NaN.
    lam = jnp.where(lam > 0, lam, jnp.nan)
    if _is_wide(rows):
        phi = matmul(a.T, _by_triangle(factor, b))
    else:
        phi = _by_triangle(factor, matmul(a.T, b))
    phi = phi + 0 * lam
    return phi, voltages - matmul(rows, phi)


@_image.defjvp
def _image_jvp(route, primals, tangents):
    """Differentiates H φ = JᵀWv: H dφ = Jᵀ(W(dv − dJφ) + dw∘r) + dJᵀWr − dλφ.

    H = JᵀWJ + λI and r = v − Jφ. If J has more columns than rows, H⁻¹t = (t − Aᵀ(AAᵀ +
    λI)⁻¹At)/λ. The linear solve carries its own rule, so that derivatives of derivatives
    exist too. That rule does not differentiate the factor, only uses it.
    """
    factor, rows, voltages, lam, weights = primals
    _, d_rows, d_voltages, d_lam, d_weights = tangents
    phi, residual = _image(route, factor, rows, voltages, lam, weights)
    moved = d_voltages - matmul(d_rows, phi)
    per_row = weights * moved + d_weights * residual
    right = matmul(rows.T, per_row) + matmul(d_rows.T, weights * residual) - d_lam * phi
    d_phi = _normal_solve(route, factor, rows, lam, weights, right)
    return (phi, residual), (d_phi, moved - matmul(rows, d_phi))


def _normal_solve(route, factor, rows, lam, weights, right) -> Array:
    """Computes (JᵀWJ + λI)⁻¹ right, by the factor of the smaller system."""

    def normal(x: Array) -> Array:
        return matmul(rows.T, weights * matmul(rows, x)) + lam * x

    fixed = map(lax.stop_gradient, (factor, rows, lam, weights))
    solve = partial(_by_factor, route, *fixed)
    return lax.custom_linear_solve(normal, right, lambda _, t: solve(t), symmetric=True)


def _by_factor(route, factor, rows, lam, weights, t) -> Array:
    if route == "double":
        with jax.enable_x64(True):
            given = map(_doubled, (rows, lam, weights, t))
            return _by_factor("cholesky", _whole(factor), *given).astype(t.dtype)
    if not _is_wide(rows):
        return _by_triangle(factor, t)
    a = jnp.sqrt(weights)[:, None] * rows
    return (t - matmul(a.T, _by_triangle(factor, matmul(a, t)))) / lam
