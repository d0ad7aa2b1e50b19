"""Chooses how much to regularise: λ from the data, by criteria over a logarithmic grid.

All criteria are arithmetic on one thin singular value decomposition A = U diag(σ) Vᵀ of the
selected rows. The decomposition serves every λ and every frame. Let β = Uᵀv and f = λ/(σ² +
λ). The residual is r = (I − H)v with I − H = U f Uᵀ + (I − UUᵀ).

One criterion asks how much of the voltages is image, white noise, common mode and gain
error: v ~ N(0, τ²AAᵀ + s²I + a²Σ_l 1_l1_lᵀ + g²Σ_i v_i v_iᵀ). The terms are an image of
independent elements, white noise, an offset of all of slot l, and a gain error of electrode
i. The electrode's voltages in all slots are v_i. The four variances are the likeliest,
found by the MM algorithm for variance components (Zhou et al., J. Comput. Graph. Stat. 28,
2019).
"""

from typing import Literal, NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.custom_batching import sequential_vmap
from jax.scipy.linalg import cho_solve
from jaxtyping import Array, Float

from tomojax.kernels.algebra import matmul

_STEPS = 25  # in trials of the rule 20 did as well as 60

# g² v_i v_iᵀ with g = 1 would explain any voltages: gains are errors, 5 % at most.
_LARGEST_GAIN = 0.05


class Variances(NamedTuple):
    image: Float[Array, ""]  # τ²
    white: Float[Array, ""]  # s²
    common: Float[Array, ""]  # a²
    gain: Float[Array, ""]  # g²


def variance_components(
    left: Float[Array, "S M p"], singular: Float[Array, " p"], v: Float[Array, "S M"]
) -> Variances:
    """Estimates the four variances; A = U diag(σ) Vᵀ by `left` U and `singular` σ."""
    slots, electrodes, p = left.shape
    n = slots * electrodes
    in_slot = jnp.repeat(jnp.eye(slots, dtype=v.dtype), electrodes, axis=0)
    at_electrode = jnp.eye(electrodes, dtype=v.dtype) * v[..., None]
    image = left.reshape(n, p) * singular
    # One factor W of all components but the white one, and whose column is whose.
    w = jnp.concatenate([image, in_slot, at_electrode.reshape(n, electrodes)], 1)
    counts = (p, slots, electrodes)
    members = jnp.repeat(jnp.eye(3, dtype=v.dtype), jnp.array(counts), axis=0,
                         total_repeat_length=sum(counts))  # fmt: skip
    gram, onto, y = matmul(w.T, w), matmul(w.T, v.reshape(n)), v.reshape(n)
    share = jnp.sum(y**2) / 4
    tiny = jnp.finfo(v.dtype).tiny
    energy = matmul(jnp.diagonal(gram), members)
    most = jnp.array([jnp.inf, jnp.inf, _LARGEST_GAIN**2], v.dtype)
    start = jnp.minimum(share / jnp.maximum(energy, tiny), most), share / n

    def step(_, variances: tuple[Array, Array]) -> tuple[Array, Array]:
        # With W̃ = W√D/s and M = I + W̃ᵀW̃: W̃ᵀV⁻¹W̃ = (I − M⁻¹)/s² and W̃ᵀV⁻¹v = M⁻¹W̃ᵀv/s²,
        # free of the cancellations of Woodbury's formula.
        d, white = variances
        scale = jnp.sqrt(matmul(members, d) / white)
        m = jnp.eye(len(scale), dtype=v.dtype) + scale[:, None] * gram * scale
        lower = jnp.linalg.cholesky(m)
        inverse = cho_solve((lower, True), jnp.eye(len(scale), dtype=v.dtype))
        explained = matmul(inverse, scale * onto)
        rest = y - matmul(w, scale * explained)
        diagonal = jnp.diagonal(inverse)
        part = matmul(explained**2, members) / white
        freedom = matmul(1 - diagonal, members)
        left_over = n - jnp.sum(1 - diagonal)
        d = jnp.minimum(d * jnp.sqrt(part / jnp.maximum(freedom, tiny)), most)
        return d, white * jnp.sqrt(jnp.sum(rest**2) / white / jnp.maximum(left_over, tiny))

    d, white = lax.fori_loop(0, _STEPS, step, start)
    return Variances(d[0], white, d[1], d[2])


def estimated_risk(
    left: Float[Array, "S M p"],
    singular: Float[Array, " p"],
    v: Float[Array, "S M"],
    variances: Variances,
    grid: Float[Array, " G"],
) -> Float[Array, " G"]:
    """Computes E‖φ_λ − φ‖² in the rows' space for each λ, under these variances.

    The risk is Σ_j τ²(λ/(σ_j² + λ))² + σ_j²/(σ_j² + λ)²·u_jᵀCu_j, C the covariance of the
    noise.
    """
    common = jnp.sum(left.sum(1) ** 2, 0)
    gain = jnp.sum(jnp.einsum("smp,sm->mp", left, v, precision="highest") ** 2, 0)
    noise = variances.white + variances.common * common + variances.gain * gain
    lam = grid[:, None]
    bias = variances.image * (lam / (singular**2 + lam)) ** 2
    return jnp.sum(bias + (singular / (singular**2 + lam)) ** 2 * noise, 1)


LambdaRule = Literal[
    "cautious",
    "cross_validation",
    "estimated_risk",
    "discrepancy",
    "gcv",
    "robust_gcv",
    "l_curve",
    "marginal_likelihood",
]

# Robust GCV: weight of GCV itself beside the variance it leaves out (Lukas, Inverse
# Problems 22, 2006, suggests 0.1 to 0.3).
_ROBUST_GCV = 0.1

# Too small a λ costs decades of error, too large a one at most the image: of the λ whose
# estimated errors are this close, the largest (as the one-standard-error rule does).
_ALIKE = 1.1


class Spectrum(NamedTuple):
    """Thin SVD of S·M selected rows."""

    left: Float[Array, "S M p"]  # U
    singular: Float[Array, " p"]  # σ, largest first


def spectrum(rows: Float[Array, "S M K"]) -> Spectrum:
    """Computes U and σ of the selected slots' rows (of J_s, or of reduced factors)."""
    slots, electrodes, columns = rows.shape
    u, s, _ = jnp.linalg.svd(rows.reshape(-1, columns), full_matrices=False)
    return Spectrum(u.reshape(slots, electrodes, -1), s)


def lambda_grid(s: Spectrum, per_decade: int = 4) -> Float[Array, " G"]:
    """Lists λ from 10·σ₁² to where the dtype ends: 1e-11·σ₁², or 1e-7·σ₁² in float32."""
    lowest = -11 if s.singular.dtype == jnp.float64 else -7
    exponents = jnp.linspace(lowest, 1, per_decade * (1 - lowest) + 1)
    return s.singular[0] ** 2 * 10.0 ** exponents.astype(s.singular.dtype)


def lambda_scores(
    s: Spectrum,
    voltages: Float[Array, "S M"],
    grid: Float[Array, " G"],
    rule: LambdaRule,
    noise: Float[Array, ""],
) -> Float[Array, "G c"]:
    """Computes the scores that a rule minimises, for a frame: c columns, 1 if not said.

    - "cautious", c = 3: the columns of the next two rules; `choose_lambda` takes the
      largest of their λ. Each column is blind to some noise and then undersmooths by
      decades; none oversmooths by much.
    - "cross_validation", c = 2: squared errors of predicting each electrode's voltages in
      all slots, and each slot's at all electrodes, from the rest. Gain errors repeat in an
      electrode and common-mode noise in a slot. Electrodes and slots are left out whole, or
      noise would predict itself.
    - "estimated_risk": the image's expected error under the variances of
      image, white noise, common mode and gain error that explain the voltages best. The
      largest λ within a tenth of the least error counts.
    - "discrepancy": |log ‖r‖²/(n·noise²)|, the residual beside known noise (V rms).
    - "gcv": ‖r‖²/tr(I − H)² (Golub, Heath, Wahba, Technometrics 21, 1979).
    - "robust_gcv": the score of "gcv" times γ + (1 − γ)·tr(H²)/n.
    - "l_curve": −curvature of (log ‖r‖, log ‖φ‖) (Hansen, SIAM Review 34, 1992).
    - "marginal_likelihood": −log p(v|λ) with v ~ N(0, s²(I + AAᵀ/λ)), s² profiled out.
    """
    u = s.left.reshape(-1, s.left.shape[-1])
    v = voltages.reshape(-1)
    beta = matmul(u.T, v)
    n, p = u.shape
    # What no image explains; nothing where the rows are independent and p = n.
    beyond = v - matmul(u, beta) if p < n else jnp.zeros_like(v)
    outside = jnp.sum(beyond**2)

    def score(lam: Array) -> Array:
        f = lam / (s.singular**2 + lam)
        residual = jnp.sum((f * beta) ** 2) + outside
        if rule in ("cautious", "cross_validation"):
            left_over = (matmul(u, f * beta) + beyond).reshape(voltages.shape)
            return _left_out_errors(s.left, f, left_over)
        if rule == "discrepancy":
            return jnp.abs(jnp.log(residual / (n * noise**2)))[None]
        if rule == "marginal_likelihood":
            fit = jnp.sum(f * beta**2) + outside
            return (n * jnp.log(fit) - jnp.sum(jnp.log(f)))[None]
        gcv = residual / (jnp.sum(f) + (n - p)) ** 2
        robust = _ROBUST_GCV + (1 - _ROBUST_GCV) * jnp.sum((1 - f) ** 2) / n
        return (gcv if rule == "gcv" else gcv * robust)[None]

    if rule == "l_curve":
        return _l_curve(s.singular, beta, outside, grid)[:, None]
    if rule in ("cautious", "estimated_risk"):
        variances = variance_components(*s, voltages)
        risk = estimated_risk(*s, voltages, variances, grid)[:, None]
        risk = jnp.maximum(risk, _ALIKE * risk.min())
        if rule == "estimated_risk":
            return risk
        return jnp.concatenate([lax.map(score, grid), risk], 1)
    return lax.map(score, grid)


def choose_lambda(
    grid: Float[Array, " G"], scores: Float[Array, "*frames G c"]
) -> Float[Array, ""]:
    """Picks the λ of lowest score, summed over frames; the largest λ of several columns.

    A score that is not finite does not count (a factorisation fails at the smallest λ, or
    in float32 for one column). The result is NaN if no score is finite.
    """
    total = scores.reshape(-1, *scores.shape[-2:]).sum(0)
    usable = jnp.isfinite(total)
    # From the largest λ down: of equal scores the smoother image.
    falling = jnp.where(usable, total, jnp.inf)[::-1]
    best = grid[::-1][jnp.argmin(falling, axis=0)]
    largest = jnp.where(usable.any(0), best, -jnp.inf).max()
    return jnp.where(usable.any(), largest, jnp.nan)


# Block by block, also when a caller batches frames: batched calls are no faster here.
@sequential_vmap
def _left_out_errors(
    left: Float[Array, "S M p"], f: Float[Array, " p"], residual: Float[Array, "S M"]
) -> Float[Array, "2"]:
    """Computes Σ‖e_b‖² over electrodes b, and over slots b, with e_b = (I − H)_bb⁻¹ r_b.

    e_b is the error of predicting block b from the fit to all other blocks, exactly.
    """

    def squared_error(block_and_residual: tuple[Array, Array]) -> Array:
        block, r = block_and_residual
        # (I − H)_bb = I − U_b (1 − f) U_bᵀ
        rest = jnp.eye(len(r), dtype=f.dtype) - matmul(block * (1 - f), block.T)
        return jnp.sum(cho_solve((jnp.linalg.cholesky(rest), True), r) ** 2)

    by_electrode = lax.map(squared_error, (jnp.swapaxes(left, 0, 1), residual.T))
    by_slot = lax.map(squared_error, (left, residual))
    return jnp.stack([by_electrode.sum(), by_slot.sum()])


def _l_curve(singular, beta, outside, grid) -> Float[Array, " G"]:
    lam = grid[:, None]
    residual = jnp.sum((lam / (singular**2 + lam) * beta) ** 2, 1) + outside
    size = jnp.sum((singular / (singular**2 + lam) * beta) ** 2, 1)
    x, y = jnp.log(residual) / 2, jnp.log(size) / 2

    def slope(a: Array) -> Array:
        return jnp.asarray(jnp.gradient(a))

    dx, dy = slope(x), slope(y)
    curvature = dx * slope(dy) - dy * slope(dx)
    tiny = jnp.finfo(x.dtype).tiny
    return -curvature / jnp.maximum(dx**2 + dy**2, tiny) ** 1.5
