"""Sheets of any outline beside closed forms, and several grounds in every place."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx
from tomojax.kernels.sheet import coverage, rectangle_grid_fields, Skin

RADIUS = 0.05
RINGS = ((1, 0.0), (5, 0.016), (8, 0.032))


def rings() -> np.ndarray:
    """Places on rings about a disc's middle, at no angle of the mesh."""
    at = [
        r * np.stack([np.cos(a), np.sin(a)], 1)
        for n, r in RINGS
        for a in [2 * np.pi * np.arange(n) / n + 0.3]
    ]
    return RADIUS + np.concatenate(at)


def neumann(x: np.ndarray, y: np.ndarray, rim: float) -> np.ndarray:
    """G of an insulated disc at 1 Ω per square: a source and its image."""
    x, y = (x - RADIUS) / RADIUS, (y - RADIUS) / RADIUS
    squares = (x**2).sum(-1), (y**2).sum(-1)
    apart = np.maximum(np.hypot(*np.moveaxis(x - y, -1, 0)), rim / RADIUS)
    image = np.sqrt(1 - 2 * (x * y).sum(-1) + squares[0] * squares[1])
    return (-np.log(apart) - np.log(image) + sum(squares) / 2) / (2 * np.pi)


def pairs(ee: np.ndarray) -> np.ndarray:
    """Two-point resistances: free of any gauge."""
    own = np.diagonal(ee)
    both = own[:, None] + own - 2 * ee
    return both[np.triu_indices(len(ee), 1)]


@pytest.fixture(scope="module")
def disc() -> tx.Sensor:
    return tx.Sensor.disc(2 * RADIUS, rings(), sheet_resistance=1.0, electrode_shunt=1e-4)


def test_resistances_of_a_disc(disc) -> None:
    xy = rings()
    want = pairs(neumann(xy[:, None], xy, 0.0025))
    got = pairs(np.asarray(tx.sensor.resistances(disc).electrodes))
    np.testing.assert_allclose(got, want, rtol=2e-3)
    field = tx.sensor.make_field(disc)
    np.testing.assert_allclose(pairs(np.asarray(field.electrodes)), want, rtol=3e-4)
    alone = tx.sensor.make_among(disc)
    jax.tree.map(np.testing.assert_array_equal, alone, field.among)


def test_potentials_on_a_disc(disc) -> None:
    """The table of averages, apart from electrodes and the edge, and from any gauge."""
    field, xy = tx.sensor.make_field(disc), rings()
    nx, ny = field.values.shape[:2]
    axes = (np.linspace(0, 2 * RADIUS, n) for n in (nx, ny))
    at = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    want = neumann(at[:, :, None], xy, 0.0025)
    radius = float(field.radii[0])
    apart = np.hypot(*np.moveaxis(at[:, :, None] - xy, -1, 0)).min(2)
    clear = np.hypot(*np.moveaxis(at - RADIUS, -1, 0)) < RADIUS - radius
    clear &= apart > 0.0025 + radius
    off = (np.asarray(field.values[:, :, 0]) - want)[clear]
    off = off - off.mean(0) - (off - off.mean(0)).mean(1, keepdims=True)
    assert np.abs(off).max() < 1e-3 * np.ptp(want[clear])


def test_half_discs_on_a_slanting_edge() -> None:
    """A rectangle that stands askew in its box, beside one of twice the height."""
    wide, high = 0.08, 0.05
    cos, sin = np.cos(0.3), np.sin(0.3)
    put = lambda at: np.asarray(at) @ [[cos, sin], [-sin, cos]] + [high * sin, 0]  # noqa: E731
    xy = np.array([[0.015, 0], [0.04, 0], [0.068, 0]])
    corners = [[0, 0], [wide, 0], [wide, high], [0, high]]
    sensor = tx.Sensor.polygon(put(corners), put(xy), electrode_shunt=1.0)
    field = tx.sensor.make_field(sensor)
    axes = (np.linspace(0, s, n) for s, n in zip(field.size, field.values.shape))
    at = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    place = (at - [high * sin, 0]) @ [[cos, -sin], [sin, cos]]
    some = ((place > 0.003) & (place < np.array([wide, high]) - 0.003)).all(-1)
    some &= np.hypot(*np.moveaxis(place[:, :, None] - xy, -1, 0)).min(-1) > 0.005
    # An ampere through half a disc is two through a whole one.
    given = xy + [0, high], *np.zeros((2, 2)), 0.0025, np.array([wide, 2 * high]), 1.0
    ee, _, rows = rectangle_grid_fields(*given, place[some] + [0, high])
    rho = 2 * float(sensor.sheet_resistance)
    want = pairs(rho * ee)
    np.testing.assert_allclose(pairs(np.asarray(field.electrodes)), want, rtol=1e-3)
    off = np.asarray(field.values[:, :, 0])[some] - rho * rows.T
    off = off - off.mean(0) - (off - off.mean(0)).mean(1, keepdims=True)
    assert np.abs(off).max() < 1e-3 * np.ptp(rho * rows)


def test_tables_in_float32_have_its_digits() -> None:
    """The sheet is solved in float64, whatever the sensor's type."""
    places = {"rim": 6, "points": [[0.025, 0.025]]}
    one, other = (
        np.asarray(tx.sensor.make_field(tx.Sensor.disc(0.05, places, dtype=d)).values)
        for d in (np.float32, np.float64)
    )
    np.testing.assert_allclose(one, other, rtol=0, atol=2e-6 * np.ptp(other))


def test_a_rectangle_as_an_outline_is_one() -> None:
    """The same sheet told by its corners has the rectangle's voltages."""
    corners = [[0, 0], [0.08, 0], [0.08, 0.08], [0, 0.08]]
    plain = tx.Sensor.grid(4, 4, divisions=(32, 32))
    cut = tx.Sensor.polygon(corners, np.asarray(plain.electrode_xy), divisions=(32, 32))
    touch = tx.Disc([0.031, 0.047], 0.006, 1.0)
    want = tx.voltages(plain, touch, [0, 9])
    np.testing.assert_allclose(tx.voltages(cut, touch, [0, 9]), want, atol=1e-4)
    assert abs(cut.area - 0.0064) < 1e-6


def test_a_bent_rectangle_is_one() -> None:
    """A sheet around a cylinder, without an outline, has the flat sheet's voltages."""

    def bend(p: jax.Array) -> jax.Array:
        turn = p[..., 0] / RADIUS
        return jnp.stack([jnp.cos(turn), jnp.sin(turn), p[..., 1] / RADIUS], -1) * RADIUS

    plain = tx.Sensor.grid(4, 4, divisions=(32, 32))
    bent = tx.Sensor(plain.size, plain.electrode_xy, surface=bend, divisions=(32, 32))
    touch = tx.Disc([0.031, 0.047], 0.006, 1.0)
    want = tx.voltages(plain, touch, [0, 9])
    np.testing.assert_allclose(tx.voltages(bent, touch, [0, 9]), want, atol=1e-3)


def test_parts_of_cut_triangles() -> None:
    """Areas of a half plane at any angle add up, and can be differentiated."""
    shape, size = (12, 10), jnp.array([0.12, 0.1])
    axes = (np.linspace(0, s, n + 1) for s, n in zip(size, shape))
    x, y = (v.ravel() for v in np.meshgrid(*axes, indexing="ij"))

    def area(off: jax.Array) -> jax.Array:
        level = 0.8 * x + 0.6 * y - off
        return coverage(Skin(jnp.asarray(level)), shape).sum() * 0.5 * 0.01**2

    # A corner's triangle, of legs off/0.8 and off/0.6.
    for off in (0.031, 0.047):
        np.testing.assert_allclose(area(jnp.array(off)), off**2 / 0.96, rtol=1e-6)
        slope = jax.grad(area)(jnp.array(off))
        np.testing.assert_allclose(slope, 2 * off / 0.96, rtol=1e-5)


@pytest.mark.long
def test_gradient_by_an_outline_and_by_places() -> None:
    """Of a loss on Eq. 3's image, beside differences."""
    xy = np.array(
        [[0.02, 0.02], [0.06, 0.021], [0.022, 0.06], [0.061, 0.062], [0.04, 0.041]]
    )
    volts = np.random.default_rng(0).uniform(0, 1, (2, 5))

    def loss(p: jax.Array) -> jax.Array:
        # Not in the middle of the mesh: which of two cells as near is cut, rounding says.
        edge = tx.sensor.RoundEdge([0.0403, 0.0398], 0.0392)
        edge = jax.tree.map(lambda a: a * (1 + p[0]), edge)
        moved = jnp.asarray(xy).at[2].add(p[1:])
        sensor = tx.Sensor([0.09, 0.09], moved, outline=edge, divisions=(24, 24))
        jacobian = tx.jacobian(sensor, [0, 3], 1e4)
        return (tx.reconstruct(jacobian, volts, lam=0.1).image ** 2).sum()

    # Without LLVM's passes, as tests compile, a slope was wrong by 2 % on an AMD processor.
    passes = {"xla_backend_optimization_level": 1}
    f = jax.jit(jax.value_and_grad(loss), compiler_options=passes)
    p = jnp.array([0.013, 1e-4, -2e-4])
    slope = f(p)[1]
    for k, step in enumerate(np.diag([1e-6, 1e-7, 1e-7])):
        want = (f(p + step)[0] - f(p - step)[0]) / (2 * step[k])
        np.testing.assert_allclose(slope[k], want, rtol=1e-5)


def test_electrodes_on_a_rim_answer_alike() -> None:
    """Four of the eight lie where the box ends: the mesh has no node beyond them."""
    metal = {"electrode_shunt": 1.0, "divisions": (60, 60)}
    sensor = tx.Sensor.disc(2 * RADIUS, {"rim": 8}, **metal)
    series = np.asarray(tx.sensor.sheet_on_mesh(sensor).dipole_series)
    towards_the_edge, along = series.reshape(2, 8)
    np.testing.assert_allclose(along, along.mean(), rtol=0.02)
    assert towards_the_edge.min() > 100 * along.max()
