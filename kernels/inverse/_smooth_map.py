"""Learns a smooth map from places to readings, and finds places by it.

Readings of frame i are y_i = f(x_i) + e_i. Each reading's map f is a Gaussian process with
the Matérn 5/2 kernel k of one length, and all readings share k up to their own scale:
f(x) = m + k(x, X)(K + qI + diag(b))⁻¹(Y − m). q is the noise over the map's variance. b_i
is the same of a place that is uncertain, by the kernel's slope: (s_i/l)² for a deviation
s_i. The errors e of different readings go together: their covariance comes from residuals.
Source: Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, 2.2, 5.4.2
(each frame's residual without the frame); McHutchon and Rasmussen, Gaussian process
training with input noise, 2011.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.scipy.linalg import cho_solve, solve_triangular
from jaxtyping import Array, Float

from tomojax.kernels.algebra import matmul

# Noise over the map's variance: from readings that follow places to a tenth, to those that
# hardly follow places at all.
_RATIOS = (0.03, 0.1, 0.3, 1.0, 3.0)


class SmoothMap(NamedTuple):
    """A map at G places."""

    readings: Float[Array, "G K"]
    spread: Float[Array, " G"]  # variance of the map, over that of a reading's noise
    left: Float[Array, "N K"]  # each frame's residual by the map of the other frames
    evidence: Float[Array, ""]  # log of the readings' probability, less a constant
    weights: Float[Array, "N K"]  # the map is the readings' mean + k(x, X)·weights


def smooth_map(
    places: Float[Array, "N D"],
    readings: Float[Array, "N K"],
    deviation: Float[Array, " N"],
    at: Float[Array, "G D"],
    length: Float[Array, ""] | float,
) -> SmoothMap:
    """Fits maps to N frames, and evaluates them; q by the evidence."""
    mean = readings.mean(0)
    scale = readings.std(0) + jnp.finfo(readings.dtype).tiny
    scaled = (readings - mean) / scale
    kernel = matern(places, places, length)
    blur = (deviation / length) ** 2

    def factor(ratio: Float[Array, ""]) -> Float[Array, "N N"]:
        return jnp.linalg.cholesky(kernel + jnp.diag(ratio + blur))

    def evidence(ratio: Float[Array, ""]) -> Float[Array, ""]:
        low = factor(ratio)
        white = solve_triangular(low, scaled, lower=True)
        variances = jnp.log(jnp.mean(white**2, 0))
        each = jnp.log(jnp.diagonal(low)).sum()
        total = -0.5 * len(places) * variances.sum() - each * readings.shape[1]
        return jnp.where(jnp.isfinite(total), total, -jnp.inf)

    ratios = jnp.asarray(_RATIOS, readings.dtype)
    scores = lax.map(evidence, ratios)
    ratio = ratios[jnp.argmax(scores)]
    low = factor(ratio)
    inverse = cho_solve((low, True), jnp.eye(len(places), dtype=readings.dtype))
    weights = matmul(inverse, scaled)
    across = matern(at, places, length)
    known = jnp.sum(matmul(across, inverse) * across, 1)
    return SmoothMap(
        readings=mean + matmul(across, weights) * scale,
        spread=jnp.maximum(1 - known, 0) / ratio,
        left=weights / jnp.diagonal(inverse)[:, None] * scale,
        evidence=scores.max(),
        weights=weights * scale,
    )


def matern(
    one: Float[Array, "A D"], other: Float[Array, "B D"], length: Float[Array, ""] | float
) -> Float[Array, "A B"]:
    """Returns the kernel (1 + r + r²/3)·exp(−r) with r = √5·distance/length."""
    squared = jnp.sum((one[:, None] - other) ** 2, -1)
    r = jnp.sqrt(5 * squared / length**2 + jnp.finfo(one.dtype).eps)
    return (1 + r + r**2 / 3) * jnp.exp(-r)


@jax.jit  # as one program to compile
def shrunk_covariance(errors: Float[Array, "N K"]) -> Float[Array, "K K"]:
    """Estimates E[eeᵀ], shrunk towards its diagonal as few frames demand.

    Source: Schäfer and Strimmer, A shrinkage approach to large-scale covariance matrix
    estimation, 2005, target D. Frames are taken as they are: their mean counts as an error.
    """
    n = len(errors)
    moment = matmul(errors.T, errors) / n
    own = jnp.diagonal(moment)
    fourth = matmul((errors**2).T, errors**2) / n
    doubt = (jnp.sum(fourth - moment**2) - jnp.sum(jnp.diagonal(fourth) - own**2)) / n
    size = jnp.sum(moment**2) - jnp.sum(own**2)
    share = jnp.clip(doubt / jnp.maximum(size, jnp.finfo(errors.dtype).tiny), 0, 1)
    return (1 - share) * moment + share * jnp.diag(own)


def place_scores(
    readings: Float[Array, "n K"],
    mapped: Float[Array, "G K"],
    spread: Float[Array, " G"],
    whitener: Float[Array, "K K"],
) -> tuple[Float[Array, "n G"], Float[Array, "n G"]]:
    """Returns log p(y | x) of n frames at G places, less a constant, and χ² of each.

    y ~ N(f(x), (1 + spread(x))·Σ), with Σ⁻¹ = WᵀW for the `whitener` W.
    """
    white, maps = matmul(readings, whitener.T), matmul(mapped, whitener.T)
    squares = jnp.sum(white**2, 1)[:, None] - 2 * matmul(white, maps.T)
    chi2 = jnp.maximum(squares + jnp.sum(maps**2, 1), 0) / (1 + spread)
    return -0.5 * (chi2 + readings.shape[1] * jnp.log1p(spread)), chi2
