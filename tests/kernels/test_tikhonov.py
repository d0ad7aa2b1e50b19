"""Eq. 3 by every route, against NumPy in float64; derivatives; float32 where it is hard."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx
from tomojax.kernels.inverse import solve_reduced, tikhonov

ROUTES = ["cholesky", "double"]


def dense(rows, v, lam, w=None):
    """The paper's formula as it stands, by an LU solve in float64."""
    rows, v = np.asarray(rows, float), np.asarray(v, float)
    w = np.ones(len(v)) if w is None else np.asarray(w, float)
    normal = rows.T @ (w[:, None] * rows) + lam * np.eye(rows.shape[1])
    return np.linalg.solve(normal, rows.T @ (w * v))


def relative(a, b) -> float:
    return float(np.linalg.norm(np.asarray(a, float) - b) / np.linalg.norm(b))


@pytest.mark.parametrize("route", [*ROUTES, "auto"])
@pytest.mark.parametrize("shape", [(12, 40), (40, 12)])
@pytest.mark.parametrize("dtype, tolerance", [(np.float64, 1e-11), (np.float32, 2e-5)])
def test_is_the_formula(rng, route, shape, dtype, tolerance) -> None:
    rows = rng.standard_normal(shape).astype(dtype)
    v, w = rng.standard_normal(shape[0]).astype(dtype), rng.random(shape[0]).astype(dtype)
    w[0] = 0
    lam = dtype(0.03)
    phi = tikhonov(*map(jnp.asarray, (rows, v, lam, w)), route)
    assert phi.dtype == dtype
    assert relative(phi, dense(rows, v, float(lam), w)) <= tolerance
    plain = tikhonov(*map(jnp.asarray, (rows, v, lam)), route=route)
    assert relative(plain, dense(rows, v, float(lam))) <= tolerance


def a_jacobian(small_sensor, grounds):
    j = tx.jacobian(small_sensor, grounds)
    return np.asarray(j).reshape(-1, small_sensor.element_count)


@pytest.mark.parametrize("wide", [True, False])
@pytest.mark.parametrize("data", ["smooth", "random"])
@pytest.mark.parametrize("decade", [-2, -7, -10])
def test_float32_where_it_is_hard(small_sensor, rng, wide, data, decade) -> None:
    """The default is right to 1e-4 of the same system in float64 down to 1e-10·σ₁²."""
    rows = a_jacobian(small_sensor, np.arange(8))
    rows = (rows if wide else rows[:, ::10]).astype(np.float32)
    n, k = rows.shape
    assert (n < k) == wide
    image = np.exp(-((np.arange(k) / k - 0.4) ** 2) / 0.02)
    v = rows @ image if data == "smooth" else rng.standard_normal(n)
    v = v.astype(np.float32)
    lam = np.float32(np.linalg.norm(rows.astype(float), 2) ** 2 * 10.0**decade)
    rows, v = jnp.asarray(rows), jnp.asarray(v)
    # Of LU on the normal system: 1e-16/1e-10.
    exact = tikhonov_by_svd(rows, v, float(lam))
    default = tikhonov(rows, v, jnp.asarray(lam))
    assert default.dtype == np.float32
    assert relative(default, exact) <= 1e-4
    if decade == -10 and wide:
        cholesky = tikhonov(rows, v, jnp.asarray(lam), route="cholesky")
        assert not relative(cholesky, exact) <= 1e-2, (
            "else the default need not be in float64"
        )


def tikhonov_by_svd(rows, v, lam):
    u, s, vt = np.linalg.svd(np.asarray(rows, float), full_matrices=False)
    return vt.T @ (s / (s**2 + lam) * (u.T @ np.asarray(v, float)))


@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize("shape", [(6, 15), (15, 6)])
@pytest.mark.parametrize("argument", ["rows", "voltages", "lam", "weights"])
def test_derivatives(rng, route, shape, argument) -> None:
    """Reverse and forward against central differences, weights at 0 among them.

    Step 1e-5: the differences' own error is 1e-10 by curvature and by rounding.
    """
    values = {
        "rows": jnp.asarray(rng.standard_normal(shape)),
        "voltages": jnp.asarray(rng.standard_normal(shape[0])),
        "lam": jnp.asarray(0.3),
        "weights": jnp.asarray(rng.random(shape[0])).at[1].set(0.0),
    }
    probe = jnp.asarray(rng.standard_normal(shape[1]))

    def f(x):
        v = {**values, argument: x}
        phi = tikhonov(v["rows"], v["voltages"], v["lam"], v["weights"], route)
        return probe @ phi

    x, step = values[argument], 1e-5
    reverse, forward = jax.jit(lambda x: (jax.grad(f)(x), jax.jacfwd(f)(x)))(x)
    assert np.isfinite(reverse).all()
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-11)
    run = jax.jit(f)
    for i in range(min(x.size, 8)):
        at = np.zeros(x.size)
        at[i] = step
        e = jnp.asarray(at.reshape(x.shape))
        if argument == "weights" and x[i] == 0:  # no weight is negative
            slope = (-3 * run(x) + 4 * run(x + e) - run(x + 2 * e)) / (2 * step)
        else:
            slope = (run(x + e) - run(x - e)) / (2 * step)
        np.testing.assert_allclose(np.ravel(reverse)[i], slope, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("wide", [True, False])
@pytest.mark.parametrize("decade, tolerance", [(-2, 1e-5), (-6, 1e-4), (-8, 1e-3)])
def test_derivatives_in_float32(small_sensor, rng, wide, decade, tolerance) -> None:
    """The gradient in weights and λ of a loss of several images, float64 not enabled.

    A gradient is the normal system's solution of a float32 vector: 1e-7·σ₁/√λ is to be had.
    """
    rows = a_jacobian(small_sensor, np.arange(8))
    rows = (rows if wide else rows[:, ::10]).astype(np.float32)
    volts = rows @ rng.standard_normal((rows.shape[1], 3)).astype(np.float32)
    weights = rng.uniform(0.2, 1, len(rows)).astype(np.float32)
    log_lam = np.float32(np.log(np.linalg.norm(rows.astype(float), 2) ** 2 * 10.0**decade))

    def loss(weights, log_lam):
        solve = lambda v: tikhonov(jnp.asarray(rows), v, jnp.exp(log_lam), weights)  # noqa: E731
        return jnp.mean(jax.vmap(solve, 1)(jnp.asarray(volts)) ** 2)

    slope = jax.grad(loss, (0, 1))
    with jax.enable_x64(False):
        found = jax.jit(slope)(weights, log_lam)
        # One factor serves all frames and what is differentiated.
        text = str(jax.make_jaxpr(slope)(weights, log_lam))
    assert text.count("= cholesky") == 1 and found[0].dtype == np.float32
    rows, volts = rows.astype(float), volts.astype(float)
    exact = jax.jit(slope)(weights.astype(float), np.float64(log_lam))
    for one, other in zip(found, exact):
        assert relative(one, other) <= tolerance


def test_second_derivative(rng) -> None:
    rows = jnp.asarray(rng.standard_normal((5, 9)))
    v = jnp.asarray(rng.standard_normal(5))
    f = lambda lam: jnp.sum(tikhonov(rows, v, lam) ** 3)  # noqa: E731
    slope = jax.jit(jax.grad(f))
    second = jax.jit(jax.grad(jax.grad(f)))(0.3)
    np.testing.assert_allclose(
        second, (slope(0.3 + 1e-5) - slope(0.3 - 1e-5)) / 2e-5, rtol=1e-7
    )


@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize("lam", [0.0, -1.0, np.nan])
def test_no_image_for_a_bad_lambda(rng, route, lam) -> None:
    for shape in ((4, 9), (9, 4)):
        rows = jnp.asarray(rng.standard_normal(shape))
        phi = tikhonov(rows, jnp.ones(shape[0]), jnp.asarray(lam), route=route)
        assert np.isnan(phi).all()


def test_reduced_slots_are_the_full_solve(small_sensor, rng) -> None:
    """With as many rows in the basis as J has rank, blocks give the image itself."""
    j = tx.jacobian(small_sensor)  # 64 rows
    reduced = tx.paper.reduce_jacobian(j, 64)
    np.testing.assert_allclose(reduced.factors @ reduced.basis, j, atol=1e-11)
    grounds, v = jnp.array([1, 4, 6]), jnp.asarray(rng.standard_normal((3, 8)))
    w, lam = jnp.array([1.0, 0.0, 2.5]), jnp.asarray(2.0)
    c = jax.jit(solve_reduced)(reduced, grounds, v, lam, w)
    rows = np.asarray(j[grounds]).reshape(24, -1)
    exact = dense(rows, np.ravel(v), 2.0, np.repeat(w, 8))
    assert relative(c @ reduced.basis, exact) <= 1e-9

    def total(w, lam):
        return jnp.sum(solve_reduced(reduced, grounds, v, lam, w) ** 2)

    slope = jax.jit(jax.grad(total, (0, 1)))(w, lam)
    run = jax.jit(total)
    h = 1e-5
    np.testing.assert_allclose(
        slope[1], (run(w, lam + h) - run(w, lam - h)) / (2 * h), rtol=1e-6
    )
    e = jnp.array([h, 0.0, 0.0])
    np.testing.assert_allclose(
        slope[0][0], (run(w + e, lam) - run(w - e, lam)) / (2 * h), rtol=1e-6
    )
    assert np.isnan(solve_reduced(reduced, grounds, v, -lam, w)).all()


def test_a_smaller_basis_is_near_the_best(small_sensor) -> None:
    j = np.asarray(tx.jacobian(small_sensor))
    singular = np.linalg.svd(j.reshape(64, -1), compute_uv=False)
    for rank in (10, 30):
        reduced = tx.paper.reduce_jacobian(j, rank)
        left = np.linalg.norm(j - np.asarray(reduced.factors @ reduced.basis))
        best = np.sqrt((singular[rank:] ** 2).sum())
        assert best * (1 - 1e-9) <= left <= 1.1 * best
