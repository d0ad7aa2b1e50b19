"""The paper's Eq. 3: φ = (JᵀWJ + λI)⁻¹JᵀWv, by routes of different accuracy.

With A = √W·J the smaller of the two systems is solved, A Aᵀ + λI (n rows) or
AᵀA + λI (K columns). Their condition is σ₁²/λ: in float32, Cholesky loses the solution
at λ ≈ 1e-6·σ₁² and is NaN below 1e-7. The triangle of a QR of [Aᵀ; √λI] has the square
root of that condition, and a residual in two floats then corrects what is left.
"""

from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from tomojax.kernels import algebra as two
from tomojax.kernels.algebra import matmul

SolveRoute = Literal["auto", "cholesky", "qr", "refined"]

# Each correction gains the digits that the triangle has right, in float32 four or more
# while λ ≥ 1e-8·σ₁² and two at 1e-10. The wide system starts with as many; the tall one
# starts from AᵀWv, which has lost twice as many, and errors of 1000 were seen.
_WIDE_CORRECTIONS, _TALL_CORRECTIONS = 2, 5


def tikhonov(
    rows: Float[Array, "n K"],
    voltages: Float[Array, " n"],
    regularisation: Float[Array, ""],
    weights: Float[Array, " n"] | None = None,
    route: SolveRoute = "auto",
) -> Float[Array, " K"]:
    """φ = argmin Σ_i w_i (J_i φ − v_i)² + λ‖φ‖², for one frame.

    **Arguments:** `rows` J_s, the selected slots' rows; `voltages` V; `regularisation`
    λ > 0 in the unit of J²; `weights` w ≥ 0 of the rows, 1 by default; `route`:
    "cholesky" of the smaller normal system, "qr" of [Aᵀ; √λI] or [A; √λI],
    "refined" adds corrections with residuals in two floats (in float32 right to 1e-7
    down to λ = 1e-8·σ₁² and to 1e-5 at 1e-10); "auto" is "cholesky" in float64
    and "refined" in float32.

    Differentiable to any order in J, V, λ and w (also at w = 0) by the solve's own rule.
    λ ≤ 0 and NaN give NaN, never an image.
    """
    if weights is None:
        weights = jnp.ones_like(voltages)
    if route == "auto":
        route = "cholesky" if rows.dtype == jnp.float64 else "refined"
    return _tikhonov(route, rows, voltages, regularisation, weights)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _tikhonov(
    route: SolveRoute, rows: Array, voltages: Array, lam: Array, weights: Array
) -> Array:
    scale = jnp.sqrt(weights)
    a, b = scale[:, None] * rows, scale * voltages
    solve = _factor(a, lam, route)
    # √ of a negative number is NaN, of 0 it is not.
    lam = jnp.where(lam > 0, lam, jnp.nan)
    wide = len(a) <= a.shape[1]
    if route != "refined":
        y = solve(b if wide else matmul(a.T, b))
        phi = matmul(a.T, y) if wide else y
        return phi + 0 * lam
    # In two floats all through: φ = Aᵀy cancels as far as λ is small.
    if wide:
        y = two.widen(solve(b))
        for _ in range(_WIDE_CORRECTIONS):
            left = two.add(two.matvec(a, two.matvec(a.T, y)), two.multiply(lam[None], y))
            residual = two.add(two.widen(b), two.negative(left))
            y = two.add(y, two.widen(solve(residual[0])))
        return two.matvec(a.T, y)[0]
    phi = two.widen(solve(matmul(a.T, b)))
    for _ in range(_TALL_CORRECTIONS):
        residual = two.add(two.widen(b), two.negative(two.matvec(a, phi)))
        left = two.negative(two.multiply(lam[None], phi))
        normal = two.add(two.matvec(a.T, residual), left)
        phi = two.add(phi, two.widen(solve(normal[0])))
    return phi[0]


def _factor(a: Array, lam: Array, route: SolveRoute):
    """b ↦ (A Aᵀ + λI)⁻¹b or (AᵀA + λI)⁻¹b, whichever is smaller."""
    short = a if len(a) <= a.shape[1] else a.T
    identity = jnp.eye(len(short), dtype=a.dtype)
    if route == "cholesky":
        lower = jnp.linalg.cholesky(matmul(short, short.T) + lam * identity)
    else:
        stacked = jnp.concatenate([short.T, jnp.sqrt(lam) * identity])
        lower = jnp.linalg.qr(stacked, mode="r").T
    triangle = partial(lax.linalg.triangular_solve, lower, left_side=True, lower=True)

    def solve(b: Array) -> Array:
        return triangle(triangle(b[:, None]), transpose_a=True)[:, 0]

    return solve


@_tikhonov.defjvp
def _tikhonov_jvp(route, primals, tangents):
    """H dφ = Jᵀ(W(dv − dJφ) + dw∘r) + dJᵀWr − dλφ,  H = JᵀWJ + λI,  r = v − Jφ.

    From H φ = JᵀWv. With more columns than rows, H⁻¹t = (t − Aᵀ(AAᵀ + λI)⁻¹At)/λ. The
    linear solve carries its own rule, so that derivatives of derivatives exist too.
    """
    rows, voltages, lam, weights = primals
    d_rows, d_voltages, d_lam, d_weights = tangents
    phi = _tikhonov(route, rows, voltages, lam, weights)
    residual = voltages - matmul(rows, phi)
    per_row = weights * (d_voltages - matmul(d_rows, phi)) + d_weights * residual
    right = matmul(rows.T, per_row) + matmul(d_rows.T, weights * residual) - d_lam * phi
    return phi, _normal_solve(route, rows, lam, weights, right)


def _normal_solve(route, rows, lam, weights, right) -> Array:
    """(JᵀWJ + λI)⁻¹ right, by the factor of the smaller system."""

    def normal(x: Array) -> Array:
        return matmul(rows.T, weights * matmul(rows, x)) + lam * x

    a = lax.stop_gradient(jnp.sqrt(weights)[:, None] * rows)
    solve = _factor(a, lax.stop_gradient(lam), "qr" if route == "refined" else route)

    def by_factor(_, t: Array) -> Array:
        if len(a) > a.shape[1]:
            return solve(t)
        return (t - matmul(a.T, solve(matmul(a, t)))) / lax.stop_gradient(lam)

    return lax.custom_linear_solve(normal, right, by_factor, symmetric=True)
