"""The choice of λ: each rule against its definition, and under noise of three kinds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx
from tomojax.kernels.inverse import (
    choose_lambda,
    lambda_grid,
    lambda_scores,
    Spectrum,
    spectrum,
)
from tomojax.kernels.sheet import centroids

# Each is one compiled program here. JAX would else compile each of its operations alone.
choose_lambda, spectrum = jax.jit(choose_lambda), jax.jit(spectrum)
lambda_grid = jax.jit(lambda_grid, static_argnums=1)
lambda_scores = jax.jit(lambda_scores, static_argnums=3)


def dense_scores(rows, v, lam, rule, noise):
    """Every score from the hat matrix itself, by NumPy."""
    s, m, k = rows.shape
    a, y, n = rows.reshape(-1, k), v.ravel(), s * m
    hat = a @ np.linalg.solve(a.T @ a + lam * np.eye(k), a.T)
    rest = np.eye(n) - hat
    r = rest @ y
    if rule == "cross_validation":
        # Really left out, one electrode, then one slot at a time.
        number = np.arange(n).reshape(s, m)
        errors = []
        for groups in (number.T, number):
            total = 0.0
            for block in groups:
                kept = np.setdiff1d(np.arange(n), block)
                normal = a[kept].T @ a[kept] + lam * np.eye(k)
                phi = np.linalg.solve(normal, a[kept].T @ y[kept])
                total += ((a[block] @ phi - y[block]) ** 2).sum()
            errors.append(total)
        return np.array(errors)
    if rule == "discrepancy":
        return np.array([abs(np.log(r @ r / (n * noise**2)))])
    if rule == "marginal_likelihood":
        covariance = np.eye(n) + a @ a.T / lam
        fit = y @ np.linalg.solve(covariance, y)
        return np.array([n * np.log(fit) + np.linalg.slogdet(covariance)[1]])
    gcv = r @ r / np.trace(rest) ** 2
    if rule == "gcv":
        return np.array([gcv])
    return np.array([gcv * (0.1 + 0.9 * np.trace(hat @ hat) / n)])


@pytest.mark.parametrize("columns", [9, 40])
@pytest.mark.parametrize(
    "rule", ["cross_validation", "discrepancy", "gcv", "robust_gcv", "marginal_likelihood"]
)
def test_scores_are_their_definitions(rng, columns, rule) -> None:
    rows, v = rng.standard_normal((3, 5, columns)), rng.standard_normal((3, 5))
    grid = np.array([1e-2, 0.3, 20.0])
    s = spectrum(jnp.asarray(rows))
    scores = lambda_scores(s, jnp.asarray(v), jnp.asarray(grid), rule, jnp.asarray(0.7))
    exact = np.array([dense_scores(rows, v, lam, rule, 0.7) for lam in grid])
    np.testing.assert_allclose(scores, exact, rtol=1e-8)


def test_variances_are_found(rng) -> None:
    """Drawn from the model itself: each variance within a factor of 2 of its own."""
    from tomojax.kernels.inverse import variance_components

    rows = rng.standard_normal((12, 30, 40))
    image = 2.0 * rng.standard_normal(40)
    exact = rows @ image
    s = spectrum(jnp.asarray(rows))
    components = jax.jit(lambda v: variance_components(*s, v))
    for white, common, gain in ((0.1, 3.0, 0.03), (1.0, 0.5, 0.04), (0.1, 2.0, 0.02)):
        v = exact * (1 + gain * rng.standard_normal(30))
        v += common * rng.standard_normal((12, 1)) + white * rng.standard_normal(v.shape)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("tomojax.kernels.inverse._lambda._STEPS", 300)
            found = components(jnp.asarray(v))
        wanted = np.array([2.0, white, common, gain]) ** 2
        ratio = np.asarray(found) / wanted
        assert (ratio > 0.3).all() and (ratio < 3).all(), ratio


def test_likelihood_never_falls(rng) -> None:
    """MM's own promise, by NumPy's likelihood of the components' covariance."""
    from tomojax.kernels.inverse import variance_components

    rows = rng.standard_normal((3, 5, 40))
    v = rng.standard_normal((3, 5))
    s = spectrum(jnp.asarray(rows))
    a, y = rows.reshape(15, -1), v.ravel()
    slot = np.kron(np.eye(3), np.ones((5, 5)))
    gain = np.kron(np.ones((3, 3)), np.eye(5)) * np.outer(y, y)
    values = []
    for steps in (1, 2, 4, 8):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("tomojax.kernels.inverse._lambda._STEPS", steps)
            t = jax.jit(lambda v: variance_components(*s, v))(jnp.asarray(v))
        c = t.image * a @ a.T + t.white * np.eye(15) + t.common * slot + t.gain * gain
        values.append(-np.linalg.slogdet(c)[1] - y @ np.linalg.solve(c, y))
    assert (np.diff(values) >= -1e-9).all(), values


def test_l_curve_is_greatest_curvature() -> None:
    """Residual and size of three singular values; the corner by a fine difference."""
    sigma = np.array([10.0, 1.0, 1e-3])
    rows = jnp.asarray(np.diag(sigma)[None])
    v = jnp.array([[10.0, 1.0, 0.05]])
    s = spectrum(rows)
    grid = lambda_grid(s, 20)
    none = jnp.asarray(1.0)
    scores = lambda_scores(s, v, grid, "l_curve", none)
    chosen = float(choose_lambda(grid, scores))
    t = np.linspace(-9, 3, 200001)
    lam = 10.0 ** t[:, None]
    x = np.log(np.sum((lam / (sigma**2 + lam) * np.asarray(v)) ** 2, 1)) / 2
    y = np.log(np.sum((sigma / (sigma**2 + lam) * np.asarray(v)) ** 2, 1)) / 2
    d = lambda a: np.gradient(a, t)  # noqa: E731
    curvature = (d(x) * d(d(y)) - d(y) * d(d(x))) / (d(x) ** 2 + d(y) ** 2) ** 1.5
    corner = t[100 + curvature[100:-100].argmax()]
    assert abs(np.log10(chosen) - corner) <= 0.1


def test_one_lambda_for_a_recording(rng) -> None:
    rows = jnp.asarray(rng.standard_normal((2, 4, 20)))
    frames = jnp.asarray(rng.standard_normal((5, 2, 4)))
    s = spectrum(rows)
    grid = lambda_grid(s)
    one = jnp.asarray(1.0)
    scores = jnp.stack([lambda_scores(s, f, grid, "gcv", one) for f in frames])
    assert choose_lambda(grid, scores) == grid[jnp.argmin(scores.sum(0))]
    assert choose_lambda(grid, scores[0]) == grid[jnp.argmin(scores[0])]
    spoilt = scores.at[0, 3].set(jnp.nan)
    assert jnp.isfinite(choose_lambda(grid, spoilt))
    assert jnp.isnan(choose_lambda(grid, scores * jnp.nan))


def test_batched_choice_does_not_hang(rng) -> None:
    """Batched factorisations side by side did, in jaxlib 0.10.2 on two cores."""
    j = jnp.asarray(rng.standard_normal((4, 16, 60)))
    frames = jnp.asarray(rng.standard_normal((3, 4, 16)))
    s = spectrum(j)
    grid = lambda_grid(s)
    one = jnp.asarray(1.0)
    score = lambda f: lambda_scores(s, f, grid, "cautious", one)  # noqa: E731
    batched = jax.jit(jax.vmap(score))(frames)
    # At 1e-11·σ₁² the blocks' condition is 1e11.
    np.testing.assert_allclose(batched[1], score(frames[1]), rtol=1e-4)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["white", "gain", "common"])
def test_default_under_three_kinds_of_noise(rng, kind) -> None:
    """Image error over the best λ's, median of 8 scenes: the default's is below 1.5.

    Scenes on a finer mesh than the reconstruction's; 0.5 % of the largest voltage, or of
    each. The benchmark has 30 trials and every rule.
    """
    coarse, fine = tx.Sensor.grid(divisions=(34, 34)), tx.Sensor.grid(divisions=(48, 48))
    grounds = rng.choice(64, 8, replace=False)
    j, j_fine = (np.asarray(tx.jacobian(s, grounds)) for s in (coarse, fine))
    places = [np.asarray(centroids(s.divisions, s.size)) for s in (coarse, fine)]
    excess = []
    u, singular, vt = np.linalg.svd(j.reshape(512, -1), full_matrices=False)
    lams = singular[0] ** 2 * np.logspace(-11, 1, 49)
    spectrum = Spectrum(jnp.asarray(u.reshape(8, 64, -1)), jnp.asarray(singular))
    grid, one = lambda_grid(spectrum), jnp.asarray(1.0)

    @jax.jit
    def choose(s, v):
        return choose_lambda(grid, lambda_scores(s, v, grid, "cautious", one))

    for _ in range(8):
        discs = [(rng.uniform(0.02, 0.14, 2), rng.uniform(0.006, 0.015)) for _ in range(2)]
        truth, source = (
            sum((((p - c) ** 2).sum(1) < r * r).astype(float) for c, r in discs)
            for p in places
        )
        exact = j_fine @ source * (34 / 48) ** 2
        level = 5e-3
        v = (
            exact
            + level
            * {
                "white": lambda v=exact: np.abs(v).max() * rng.standard_normal(v.shape),
                "gain": lambda v=exact: v * rng.standard_normal(64),
                "common": lambda v=exact: np.abs(v).max() * rng.standard_normal((8, 1)),
            }[kind]()
        )
        lam = choose(spectrum, jnp.asarray(v))
        images = (singular / (singular**2 + lams[:, None]) * (u.T @ v.ravel())) @ vt
        errors = np.linalg.norm(images - truth, axis=1)
        mine = (singular / (singular**2 + float(lam)) * (u.T @ v.ravel())) @ vt
        excess.append(np.linalg.norm(mine - truth) / errors.min())
    assert np.median(excess) <= 1.5, excess
