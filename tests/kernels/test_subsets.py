"""Sets of n out of M against enumeration."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from tomojax.kernels import algebra as subsets


def marginals(logits, n):
    """By all sets."""
    total, sums = 0.0, np.zeros(len(logits))
    for chosen in itertools.combinations(range(len(logits)), n):
        p = np.exp(logits[list(chosen)].sum())
        total, sums[list(chosen)] = total + p, sums[list(chosen)] + p
    return sums / total


@pytest.mark.parametrize("n", [1, 3, 6, 7])
def test_marginals(rng, n):
    logits = rng.normal(0, 2, 7)
    found = subsets.subset_marginals(jnp.asarray(logits), n)
    np.testing.assert_allclose(found, marginals(logits, n), rtol=1e-12)


@pytest.mark.parametrize("spread", [0.0, 1.5])  # equal logits are the symmetric start
def test_slopes_of_marginals(rng, spread):
    logits, n, h = spread * rng.normal(size=8), 3, 1e-6
    found = jax.jacobian(lambda t: subsets.subset_marginals(t, n))(jnp.asarray(logits))
    for k in range(8):
        step = h * np.eye(8)[k]
        wanted = (marginals(logits + step, n) - marginals(logits - step, n)) / (2 * h)
        np.testing.assert_allclose(found[:, k], wanted, atol=1e-8)


def test_drawn_as_probable_as_they_should_be(rng):
    logits, n = rng.normal(size=9), 4
    keys = jax.random.split(jax.random.key(1), 40_000)
    drawn = jax.jit(jax.vmap(lambda k: subsets.draw_subset(k, jnp.asarray(logits), n)))(
        keys
    )
    assert set(np.unique(np.asarray(drawn))) == {0.0, 1.0}
    assert (np.asarray(drawn).sum(1) == n).all()
    off = np.asarray(drawn).mean(0) - marginals(logits, n)
    assert np.abs(off).max() < 4 * 0.5 / np.sqrt(len(keys))


def test_gradient_through_a_drawn_set_is_unbiased_where_linear(rng):
    logits, cost = jnp.asarray(rng.normal(size=6)), jnp.asarray(rng.normal(size=6))
    drawn = lambda t, key: (cost * subsets.drawn_weights(key, t, 2)).sum()  # noqa: E731
    found = jax.grad(drawn)(logits, jax.random.key(0))
    wanted = jax.grad(lambda t: (cost * subsets.subset_marginals(t, 2)).sum())(logits)
    np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_projection_is_the_nearest(rng):
    values, n = rng.normal(0, 1.5, 6), 2.5
    found = np.asarray(subsets.project_weights(jnp.asarray(values), jnp.asarray(n)))
    best = minimize(
        lambda w: ((w - values) ** 2).sum(),
        np.full(6, n / 6),
        bounds=[(0, 1)] * 6,
        constraints={"type": "eq", "fun": lambda w: w.sum() - n},
        options={"ftol": 1e-14},
    )
    assert abs(found.sum() - n) < 1e-12 and found.min() >= 0 and found.max() <= 1
    np.testing.assert_allclose(found, best.x, atol=1e-6)


def test_heaviest_and_least():
    values = jnp.asarray([3.0, 1.0, 2.0, 5.0])
    np.testing.assert_array_equal(subsets.heaviest(values, 2), [1, 0, 0, 1])
    np.testing.assert_array_equal(subsets.least_weights(values, 2), [0, 1, 1, 0])
