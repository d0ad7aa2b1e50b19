"""Smooth maps of places, against direct sums."""

import jax.numpy as jnp
import numpy as np
import pytest

from tomojax.kernels.inverse import place_scores, shrunk_covariance, smooth_map


@pytest.fixture
def frames(rng):
    places = rng.uniform(0, 1, (30, 2))
    waves = rng.normal(size=(2, 4))
    return places, np.sin(3 * places @ waves) + 0.05 * rng.normal(size=(30, 4))


def matern(one, other, length):
    r = np.sqrt(5 * ((one[:, None] - other) ** 2).sum(-1)) / length
    return (1 + r + r**2 / 3) * np.exp(-r)


@pytest.mark.parametrize("dtype, near", [(np.float64, 1e-6), (np.float32, 2e-3)])
def test_a_map_is_the_direct_solution(frames, rng, dtype, near) -> None:
    places, readings = frames
    blur, at = 0.1 * rng.uniform(size=30), rng.uniform(0, 1, (7, 2))
    given = (a.astype(dtype) for a in (places, readings, blur, at))
    found = smooth_map(*(jnp.asarray(a) for a in given), jnp.asarray(0.5, dtype))
    middle, scale = readings.mean(0), readings.std(0)
    scaled = (readings - middle) / scale

    def solved(ratio, keep):
        noise = np.diag(ratio + (blur[keep] / 0.5) ** 2)
        kernel = matern(places[keep], places[keep], 0.5) + noise
        return kernel, np.linalg.solve(kernel, scaled[keep])

    def evidence(ratio):
        kernel, weights = solved(ratio, np.arange(30))
        variance = (scaled * weights).mean(0)
        return -15 * np.log(variance).sum() - 2 * np.linalg.slogdet(kernel)[1]

    ratio = max((0.03, 0.1, 0.3, 1.0, 3.0), key=evidence)
    kernel, weights = solved(ratio, np.arange(30))
    across = matern(at, places, 0.5)
    np.testing.assert_allclose(found.readings, middle + across @ weights * scale, atol=near)
    spread = 1 - np.sum(across @ np.linalg.inv(kernel) * across, 1)
    np.testing.assert_allclose(found.spread, spread / ratio, atol=10 * near)
    keep = np.arange(1, 30)  # a frame's residual is by the map of the others
    by_others = matern(places[:1], places[keep], 0.5) @ solved(ratio, keep)[1] * scale
    np.testing.assert_allclose(
        found.left[0], readings[0] - middle - by_others[0], atol=near * 5
    )


def test_a_covariance_shrinks_as_few_frames_demand(rng) -> None:
    mixed = rng.normal(size=(3, 3))
    many, few = rng.normal(size=(20000, 3)) @ mixed, rng.normal(size=(3, 3)) @ mixed
    true = mixed.T @ mixed
    np.testing.assert_allclose(shrunk_covariance(jnp.asarray(many)), true, atol=0.2)
    assert np.linalg.eigvalsh(shrunk_covariance(jnp.asarray(few[:2]))).min() > 0


def test_scores_are_of_the_normal_law(rng) -> None:
    readings, mapped = rng.normal(size=(3, 4)), rng.normal(size=(5, 4))
    spread, whitener = rng.uniform(size=5), rng.normal(size=(4, 4))
    scores, chi2 = place_scores(
        *(jnp.asarray(a) for a in (readings, mapped, spread, whitener))
    )
    away = readings[2] - mapped[1]
    wanted = away @ whitener.T @ whitener @ away / (1 + spread[1])
    np.testing.assert_allclose(chi2[2, 1], wanted, rtol=1e-10)
    np.testing.assert_allclose(
        scores[2, 1], -wanted / 2 - 2 * np.log1p(spread[1]), rtol=1e-10
    )
