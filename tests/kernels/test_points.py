"""What `points` is made of, each part beside an independent answer."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

import tomojax as tx
from tomojax.kernels.algebra import descend, Limits, Normal, solve_positive
from tomojax.kernels.contacts import (
    field_at,
    Noise,
    rows_at,
    slot_weights,
    unwhitened,
    whiten,
    whitened,
    whitened_columns,
)
from tomojax.kernels.images import points_image, Spots
from tomojax.kernels.sheet import (
    rectangle_fields,
    rectangle_green,
    rectangle_grid_fields,
    rectangle_slope,
)
from tomojax.sensor import make_field


@pytest.fixture(scope="module")
def field(paper_sensor):
    return make_field(paper_sensor)


# Each is one compiled program here. JAX would else compile each of its operations alone.
jit_green_slope = jax.jit(jax.vmap(jax.jacfwd(rectangle_green), (0, 0, None, None)))
jit_image = jax.jit(points_image, static_argnums=2)
jit_solve, jit_whiten = jax.jit(solve_positive), jax.jit(whiten)

PLACES = [(0.0621, 0.1043), (0.07, 0.09), (0.012, 0.011), (0.08, 0.0743)]


@pytest.mark.long
def test_table_is_the_mean_over_a_disc(paper_sensor, field):
    """Beside the closed form at 4000 places spread over the disc."""
    diameter, xy = paper_sensor.electrode_diameter, paper_sensor.electrode_xy
    metal = jnp.asarray(1.0)
    exact = jax.jit(
        lambda at: rectangle_fields(xy, at, diameter / 2, paper_sensor.size, metal)
    )
    k = np.arange(4000) + 0.5
    spiral = np.stack([np.cos(k * 2.399963), np.sin(k * 2.399963)], 1)
    for place in PLACES:
        for radius in (0.0024, 0.003, 0.0063, 0.0105):
            at = np.array(place) + radius * np.sqrt(k / 4000)[:, None] * spiral
            # What is beyond an edge is mirrored.
            want = 1e4 * np.asarray(exact(jnp.asarray(np.abs(at)))[1]).mean(1)
            got = field_at(field, jnp.array(place), jnp.asarray(radius))
            np.testing.assert_allclose(got, want, atol=0.005 * np.abs(want).max())
            away = np.hypot(*(np.asarray(xy) - place).T) > radius + diameter
            close = 5e-4 * np.abs(want).max()
            np.testing.assert_allclose(got[away], want[away], atol=close)


def test_slopes_of_the_table(field, rng):
    """Beside differences of its first row, and of its slopes by radius."""
    at = jax.jit(lambda p: rows_at(field, p[:2], p[2], p[3:]))
    steps = [1e-6, 1e-6, 1e-6, 1e-8, 1e-8]
    for place in rng.uniform(0.01, 0.15, (5, 2)):
        p = np.array([*place, 0.0063, 4e-6, -3e-6])
        rows = np.asarray(at(p))
        for k, step in enumerate(steps):
            move = step * np.eye(5)[k]
            change = np.asarray(at(p + move) - at(p - move)) / (2 * step)
            scale = np.abs(change[0]).max()
            np.testing.assert_allclose(rows[1 + k], change[0], rtol=1e-4, atol=1e-4 * scale)
            if k == 2:
                scale = np.abs(change[1:3]).max()
                np.testing.assert_allclose(rows[6:], change[1:3], atol=1e-4 * scale)
    round_one = at(np.array([0.06, 0.05, 0.006, 0, 0]))[0]
    want = field_at(field, jnp.array([0.06, 0.05]), jnp.asarray(0.006))
    np.testing.assert_allclose(round_one, want, rtol=1e-6)


def test_slope_of_the_closed_form_where_places_meet(paper_sensor):
    """An element's centre on an electrode's, or off it by less than rounding."""
    at = paper_sensor.electrode_xy[10].astype(np.float32)
    size, radius = paper_sensor.size.astype(np.float32), jnp.float32(0.0025)
    for off in (0.0, 1e-9, 1e-7):
        near = (at + np.float32(off))[None]
        slope = jit_green_slope(near, at[None], radius, size)
        assert np.isfinite(slope).all() and np.abs(slope).max() < 1e3


@pytest.mark.parametrize(("dtype", "close"), [(np.float32, 1e-4), (np.float64, 1e-11)])
def test_elimination(rng, dtype, close):
    """Also of numbers as large and small as squares of resistances and currents."""
    a = rng.normal(size=(7, 5, 12))
    a, b = a @ a.transpose(0, 2, 1), rng.normal(size=(7, 5, 3))
    for scale in (1.0, 1e10, 1e-10):
        got = jit_solve(jnp.asarray(scale * a, dtype), jnp.asarray(b, dtype)) * scale
        want = np.linalg.solve(a, b)
        np.testing.assert_allclose(got, want, atol=close * np.abs(want).max())


def test_whitening_is_the_inverse_covariance(rng):
    volts, own = rng.normal(size=(3, 9)), rng.uniform(0.1, 1, (3, 9))
    common, grounds = rng.normal(size=(3, 4, 9)), jnp.arange(3)
    frame = jit_whiten(*map(jnp.asarray, (volts, grounds, own, common)))
    for k in range(3):
        c = np.diag(own[k] ** 2) + common[k].T @ common[k]
        want = volts[k] @ np.linalg.solve(c, volts[k])
        np.testing.assert_allclose((frame.whitened[k] ** 2).sum(), want)
    # A channel that is not used counts for nothing, whatever it reads.
    unused = jnp.asarray(own).at[:, 2].set(0)
    one = jit_whiten(jnp.asarray(volts), grounds, unused, jnp.asarray(common))
    other = jit_whiten(
        jnp.asarray(volts).at[:, 2].set(9), grounds, unused, jnp.asarray(common)
    )
    np.testing.assert_array_equal(one.whitened, other.whitened)
    # <F v, r> = <v, Fᵀ r>.
    v, r = rng.normal(size=(3, 9)), rng.normal(size=(3, 1, 13))
    forward = whitened_columns(frame, jnp.asarray(v))
    back = unwhitened(frame, jnp.asarray(r))
    np.testing.assert_allclose((forward * r[:, 0]).sum(), (v * back[:, 0]).sum())


@pytest.mark.parametrize("dtype, close", [(np.float64, 1e-9), (np.float32, 2e-5)])
def test_a_slots_rows_are_whitened_by_its_covariance(rng, dtype, close):
    """Also of what channels have in common, a hundred times their own errors."""
    volts, x = rng.uniform(0.5, 1.5, 9), rng.normal(size=(3, 9))
    local, smooth = 1e-3 * rng.normal(size=(9, 27)), 0.1 * rng.normal(size=(4, 9))
    x[0], smooth[0] = volts, 0.1  # a row that is nothing but a common error
    given = 1e-3, 1e-3, local, smooth, 0.3
    noise = Noise(*(jnp.asarray(a, dtype) for a in given))
    used = np.arange(9) != 4
    weights = slot_weights(noise, jnp.asarray(volts, dtype), jnp.asarray(used))
    seen = np.asarray(whitened(weights, jnp.asarray(x, dtype)), float)
    own = 1e-6 + (1e-3 * volts) ** 2 + ((volts @ local).reshape(3, 9) ** 2).sum(0)
    common = np.concatenate([np.full((1, 9), 0.3 * volts.mean()), smooth * volts])
    c = (np.diag(own) + common.T @ common)[np.ix_(used, used)]
    want = x[:, used] @ np.linalg.solve(c, x[:, used].T)
    scale = np.sqrt(np.outer(np.diag(want), np.diag(want)))
    assert np.abs((seen @ seen.T - want) / scale).max() < close


def test_image_holds_the_current():
    cell, current = jnp.array([0.005, 0.0025]), jnp.array([1e-4, 2e-5, 3e-5])
    place = jnp.array([[0.08, 0.04], [0.001, 0.079], [0.1, 0.05]])
    extent = jnp.array([[0.03, 0.02], [0.0, 0.0], [0.0, 0.0]])
    ring = jnp.array([0.0, 0.0, 0.02])
    radius = jnp.array([0.005, 0.0001, 0.004])
    spots = Spots(place, extent, ring, radius, current)
    image = jit_image(spots, cell, (32, 32))
    np.testing.assert_allclose(image.sum() * cell.prod(), current.sum())
    last = spots._replace(current=current.at[:2].set(0))
    only = jit_image(last, cell, (32, 32))
    assert only[20, 20] < 0.01 * only.max()  # the hole


def test_field_needs_a_sheet_of_one_value(paper_sensor):
    with pytest.raises(ValueError, match="sheet_resistance"):
        make_field(tx.Sensor.grid(sheet_resistance=np.full(3200, 1e4)))


def test_descent_ends_where_scipy_does():
    """A valley that bends; one by one and in a batch; and at a bound."""

    def residuals(p, target):
        return jnp.stack([10 * (p[1] - p[0] ** 2), 1 - p[0], 0.1 * (p[0] - target)])

    def model(p, target):
        r, j = residuals(p, target), jax.jacfwd(residuals)(p, target)
        return Normal(r @ r, j.T @ j, j.T @ r)

    starts, targets = jnp.array([[-1.2, 1.0], [0.5, 3.0]]), jnp.array([3.0, -4.0, 0.5])

    def ends(highest):
        limits = Limits(jnp.array([highest, jnp.inf]), jnp.ones(2))
        one = lambda target: descend(model, starts, limits, 4, 60, 2, jnp.inf, 0.0, target)  # noqa: E731
        alone = jax.jit(one)
        return jax.jit(jax.vmap(one))(targets)[0], jnp.stack([alone(t)[0] for t in targets])

    for highest in (jnp.inf, 0.7):
        together, alone = ends(highest)
        np.testing.assert_allclose(together, alone, atol=1e-9)
        for target, found in zip(targets, together):
            bounds = (-np.inf, [highest, np.inf])
            want = optimize.least_squares(
                lambda p, t=target: np.asarray(residuals(p, t)), [0.5, 0.2], bounds=bounds
            )
            np.testing.assert_allclose(found, want.x, atol=2e-2)


def test_a_start_that_is_good_enough_is_the_last():
    """The first of two valleys is taken where it is low enough; without a start none."""

    def model(p):
        # Valleys at -1, of cost 1, and at 2, of cost 0.
        r = jnp.stack([(p[0] + 1) * (p[0] - 2), (2 - p[0]) / 3])
        j = jnp.stack([2 * p[:1] - 1, -jnp.ones(1) / 3])
        return Normal(r @ r, j.T @ j, j.T @ r)

    starts, limits = jnp.array([[-1.3], [2.2]]), Limits(jnp.full(1, jnp.inf), jnp.ones(1))
    for enough, valley, height in ((0.0, 2.0, 0.0), (1.5, -1.0, 1.0)):
        found, cost = descend(model, starts, limits, 3, 40, 2, jnp.inf, enough)
        np.testing.assert_allclose(found[0], valley, atol=0.06)
        np.testing.assert_allclose(cost, height, atol=0.05)
    none = jnp.array([[2.2], [jnp.nan]])
    np.testing.assert_allclose(
        descend(model, none, limits, 3, 40, 2, jnp.inf, 0.0)[0], 2, atol=1e-3
    )
    lost, cost = descend(model, none[::-1], limits, 3, 40, 2, jnp.inf, 0.0)
    assert np.isnan(lost).all() and cost == jnp.inf


def test_the_grid_is_the_same_along_both_sides(paper_sensor):
    """A square turned by a quarter is itself, also where places nearly meet the grid's."""
    xy = np.asarray(paper_sensor.electrode_xy, float)
    near = rectangle_grid_fields(
        xy.astype(np.float32).astype(float),
        *[np.linspace(0, 0.16, 33)] * 2,
        0.0025,
        np.array([0.16, 0.16]),
        1.0,
    )[1]
    size, radius = np.asarray(paper_sensor.size, float), 0.0025
    axis = np.linspace(0, size[0], 33)
    ee, ep, _ = rectangle_grid_fields(xy, axis, axis, radius, size, 1.0)
    turned = np.argsort(np.lexsort((xy[:, 0], xy[:, 1])))
    np.testing.assert_allclose(ee[turned][:, turned], ee, atol=1e-8)
    np.testing.assert_allclose(ep[turned].transpose(0, 2, 1), ep, atol=1e-8)
    np.testing.assert_allclose(near, ep, atol=1e-6)
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    args = (jnp.asarray(a) for a in (xy, points, radius, size))
    bare = rectangle_fields(*args, None)[1]
    expected = rectangle_grid_fields(xy, axis, axis, radius, size)[1]
    np.testing.assert_allclose(np.reshape(bare, expected.shape), expected, atol=1e-12)


@pytest.mark.parametrize(("dtype", "atol"), [(np.float64, 1e-11), (np.float32, 1e-3)])
@pytest.mark.parametrize("size", [(0.16, 0.16), (0.16, 0.1), (0.1, 0.3)])
def test_slope_of_green_is_its_derivative(rng, size, dtype, atol):
    """Far from each other, within the rim, at one place, and on either longer side."""
    size = jnp.asarray(size, dtype)
    at = jnp.asarray(rng.random((40, 2)), dtype) * size
    beside = at[:20] + jnp.asarray(rng.normal(0, 4e-3, (20, 2)), dtype)
    other = jnp.concatenate([beside, at[20:21], at[:19]])
    rim = jnp.asarray(5e-3, dtype)
    got, want = (f(at, other, rim, size) for f in (rectangle_slope, jit_green_slope))
    np.testing.assert_allclose(got, want, atol=atol)
