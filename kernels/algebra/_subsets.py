"""Relaxes sets of n out of M to weights, and draws such sets at random.

The weights form the capped simplex, 0 ≤ w ≤ 1 and Σw = n: the convex hull of all sets of n.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float

# Halvings of the interval that the shift lies in.
_HALVINGS = 60


def project_weights(values: Float[Array, " M"], n: Float[Array, ""]) -> Float[Array, " M"]:
    """Finds the weights nearest to `values`: min(max(v − τ, 0), 1), τ so that Σw = `n`."""

    def halve(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = (low + high) / 2
        enough = jnp.clip(values - middle, 0, 1).sum() >= n
        return jnp.where(enough, middle, low), jnp.where(enough, high, middle)

    ends = values.min() - 1, values.max()
    low, high = lax.fori_loop(0, _HALVINGS, halve, ends)
    return jnp.clip(values - (low + high) / 2, 0, 1)


def least_weights(slope: Float[Array, " M"], n: int) -> Float[Array, " M"]:
    """Returns the set (weights 0 and 1) of the `n` smallest, least of a linear function."""
    chosen = jnp.argsort(slope)[:n]
    return jnp.zeros_like(slope).at[chosen].set(1)


def heaviest(weights: Float[Array, " M"], n: int) -> Float[Array, " M"]:
    """Returns the set (weights 0 and 1) of the `n` largest weights."""
    return least_weights(-weights, n)


@partial(jax.jit, static_argnums=1)
def subset_marginals(logits: Float[Array, " M"], n: int) -> Float[Array, " M"]:
    """Computes each member's probability to be in a set of `n`, p(S) ∝ exp Σ_{e in S} θ_e.

    The probabilities are ∂/∂θ of ln Σ_S exp Σ θ, an elementary symmetric polynomial. They
    are weights of the capped simplex, and every inner point of the simplex belongs to some
    θ.
    """
    return jax.grad(lambda t: _log_sums(t, n)[-1, n])(logits)


def draw_subset(key: Array, logits: Float[Array, " M"], n: int) -> Float[Array, " M"]:
    """Draws a set (weights 0 and 1) of `n` with p(S) of `subset_marginals`, exactly."""
    sums = _log_sums(lax.stop_gradient(logits), n)
    uniform = jax.random.uniform(key, logits.shape, logits.dtype)

    def step(left: Array, one: tuple) -> tuple[Array, Array]:
        theta, before, after, u = one
        with_it = jnp.where(left > 0, before[left - 1] + theta, -jnp.inf)
        taken = jnp.log(u) < with_it - after[left]
        return left - taken.astype(left.dtype), taken

    each = logits, sums[:-1], sums[1:], uniform
    start = jnp.asarray(n, int)
    _, taken = lax.scan(step, start, each, reverse=True)
    return taken.astype(logits.dtype)


def drawn_weights(key: Array, logits: Float[Array, " M"], n: int) -> Float[Array, " M"]:
    """Draws a set by `draw_subset`, with the derivatives of `subset_marginals`.

    This is SIMPLE (Ahmed, Zeng, Niepert, van den Broeck: ICLR 2023): later functions see a
    set, and their gradient passes to the probabilities. Linear functions get an unbiased
    gradient.
    """
    drawn, marginals = draw_subset(key, logits, n), subset_marginals(logits, n)
    return drawn + marginals - lax.stop_gradient(marginals)


def _log_sums(logits: Float[Array, " M"], n: int) -> Float[Array, "rows sums"]:
    """Sums exp Σθ over the sets of j of the first m, and takes ln: row m, column j."""
    least = -1e30  # ln 0, of which differences are numbers
    first = jnp.full(n + 1, least, logits.dtype).at[0].set(0)

    def step(row: Array, theta: Array) -> tuple[Array, Array]:
        with_it = jnp.concatenate([jnp.full_like(row[:1], least), row[:-1] + theta])
        # `jnp.logaddexp` has wrong second derivatives where both are the same.
        new = logsumexp(jnp.stack([row, with_it]), axis=0)
        return new, new

    _, rows = lax.scan(step, first, logits)
    return jnp.concatenate([first[None], rows])
