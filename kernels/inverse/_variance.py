"""Estimates how much of the voltages is image, white noise, common mode and gain error.

v ~ N(0, τ²AAᵀ + s²I + a²Σ_l 1_l1_lᵀ + g²Σ_i v_i v_iᵀ). The terms are an image of
independent elements, white noise, an offset of all of slot l, and a gain error of electrode
i. The electrode's voltages in all slots are v_i. The four variances are the likeliest,
found by the MM algorithm for variance components (Zhou et al., J. Comput. Graph. Stat. 28,
2019).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
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
