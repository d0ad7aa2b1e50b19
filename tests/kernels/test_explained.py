"""What contacts read off an image leave unexplained of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tomojax.kernels.images import explained, explained_by, no_contacts, point_sources

SHAPE, CELL = (6, 8), np.array([0.01, 0.02])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_of_its_own_point_sources_nothing_is_left(dtype, rng):
    basis, through = rng.normal(size=(7, 48)), rng.normal(size=(9, 7))
    pixels = np.array([[1, 2], [4, 5]])
    columns = through @ basis.reshape(7, *SHAPE)[:, pixels[:, 0], pixels[:, 1]]
    # Two slots, with currents of their own.
    seen = np.array([[2.0, 0.7], [0.1, 3.0]]) @ columns.T

    def left(xy, count, seen=seen):
        none = no_contacts(len(xy), dtype)
        contacts = none._replace(
            xy=jnp.asarray(xy, dtype), count=jnp.asarray(count, jnp.uint8)
        )

        @jax.jit
        def run(basis, through, seen, cell):
            sources = point_sources(basis, contacts, SHAPE, cell) @ through.T
            return explained(jnp.stack([sources] * len(seen)), seen)[1]

        return float(run(*(jnp.asarray(a, dtype) for a in (basis, through, seen, CELL))))

    at = np.concatenate([(pixels + 0.5) * CELL, [[np.nan, np.nan]]])
    tight = 1e-3 if dtype == np.float32 else 1e-6
    assert left(at, 2) < tight
    # One alone: what least squares leaves of each.
    one = columns[:, 0]
    rest = seen - np.outer(seen @ one / (one @ one), one)
    expected = np.linalg.norm(rest) / np.linalg.norm(seen)
    assert left(at, 1) == pytest.approx(expected, rel=1e-3)
    assert left(at, 0) == 1.0
    # Half way between two pixels: the mean of their columns.
    half = basis.reshape(7, *SHAPE)[:, 1, 2:4].mean(1)
    assert left(at[:1] + np.array([[0, 0.01]]), 1, (through @ half)[None]) < tight
    # At the very edge: the nearest pixel's.
    last = basis.reshape(7, *SHAPE)[:, 5, 7]
    assert left(SHAPE * CELL[None], 1, (through @ last)[None]) < tight


def test_a_frame_of_zeros_is_no_error():
    assert float(explained(jnp.zeros((2, 3, 5)), jnp.zeros((2, 5)))[1]) == 0


@pytest.mark.parametrize("count", [1, 2])
def test_the_rest_shows_what_no_contact_explains(count, rng):
    """A source far from all contacts is in the rest; one at whole pixels beside is not."""
    columns = rng.normal(size=(48, 40))
    pixels = np.array([[1, 1], [4, 6]])[:count]
    xy = np.full((3, 2), np.nan)
    xy[:count] = (pixels + 0.5) * CELL
    contacts = no_contacts(3, np.float64)._replace(
        xy=jnp.asarray(xy), count=jnp.asarray(count, jnp.uint8)
    )
    at = columns.reshape(*SHAPE, -1)
    amount = np.array([2.0, 0.7])[:count]
    seen = amount @ at[tuple(pixels.T)]
    fit = jax.jit(explained_by(SHAPE, (1, 1)))

    def of(seen):
        needed, cell = jnp.asarray(count > 1), jnp.asarray(CELL)
        return fit(needed, contacts, jnp.asarray(seen), (jnp.asarray(columns), None), cell)

    currents, left, rest = of(seen)
    np.testing.assert_allclose(currents, np.r_[amount, np.zeros(3 - count)], atol=1e-5)
    assert float(left) < 1e-5 and np.abs(rest).max() < 1e-5
    beside, far = of(seen + 0.1 * at[0, 2])[2], of(seen + 0.1 * at[1, 4])[2]
    assert np.abs(beside).max() < 1e-5
    assert np.linalg.norm(far) > 0.05 * np.linalg.norm(at[1, 4])
