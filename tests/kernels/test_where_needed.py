"""The dearer way is taken where it is needed, and the result is the same either way."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tomojax.kernels.algebra import where_needed


def whole(x, factor):
    return {"sum": factor * x.sum(), "way": jnp.array(2)}


def simple(x, factor):
    """Right where all but the first are 0."""
    return {"sum": factor * x[0], "way": jnp.array(1)}


@pytest.mark.parametrize("count", [1, 5, 40])
def test_a_batch_is_its_frames(count, rng):
    x = rng.normal(size=(count, 3)).astype(np.float32)
    x[::3, 1:] = 0
    needed = (x[:, 1:] != 0).any(1)
    run = where_needed(whole, simple, together=4)
    batch = jax.jit(jax.vmap(run, (0, 0, None)))(needed, x, jnp.float32(2))
    np.testing.assert_allclose(batch["sum"], 2 * x.sum(1), rtol=1e-5, atol=1e-6)
    # Those in need went the whole way, and no more others than fill up a group.
    ways = np.asarray(batch["way"])
    assert (ways[needed] == 2).all()
    assert ((ways == 2) & ~needed).sum() < 4
    alone = [run(n, v, jnp.float32(2)) for n, v in zip(needed, x)]
    np.testing.assert_allclose(batch["sum"], [a["sum"] for a in alone], rtol=1e-6)
    assert [int(a["way"]) for a in alone] == [2 if n else 1 for n in needed]


def test_within_another_batch(rng):
    x = jnp.asarray(rng.normal(size=(2, 7, 3)).astype(np.float32))
    run = where_needed(whole, simple, together=4)
    found = jax.vmap(jax.vmap(run, (0, 0, None)), (0, 0, 0))(
        jnp.ones((2, 7), bool), x, jnp.array([1.0, 2.0], jnp.float32)
    )
    want = np.asarray(x.sum(2)) * [[1.0], [2.0]]
    np.testing.assert_allclose(found["sum"], want, rtol=1e-5, atol=1e-5)
