"""What holds for every sensor, scene and ground."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, HealthCheck, settings, strategies as st

import tomojax as tx
from tomojax import kernels
from tomojax._forward import _fem
from tomojax.kernels import _mesh

# One mesh shape per electrode count: a new one compiles anew, a new value does not.
GRIDS = {(2, 3): (12, 18), (4, 4): (20, 20), (3, 2): (18, 12)}


@st.composite
def sensors(draw) -> tx.Sensor:
    rows, columns = draw(st.sampled_from(sorted(GRIDS)))
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    pitch = 0.02 * draw(st.floats(0.8, 2.0))
    divisions = GRIDS[rows, columns]
    sensor = tx.Sensor.grid(
        rows, columns, pitch, 0.01, electrode_diameter=0.0095, divisions=divisions
    )
    moved = sensor.electrode_xy + rng.uniform(-2e-3, 2e-3, sensor.electrode_xy.shape)
    k = sensor.element_count
    return dataclasses.replace(
        sensor,
        electrode_xy=moved,
        sheet_resistance=1e4 * np.exp(draw(st.floats(0, 0.5)) * rng.standard_normal(k)),
        ground_resistance=draw(st.sampled_from([0.0, 4.0, 1e3])),
    )


@st.composite
def contacts(draw, sensor: tx.Sensor) -> np.ndarray:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(1, 30))
    g = np.zeros(sensor.element_count)
    decade = draw(st.floats(-8, 1))
    g[rng.choice(len(g), count)] = 10 ** (decade + rng.uniform(-1, 1, count))
    return g


property_test = settings(
    max_examples=25, deadline=None, suppress_health_check=list(HealthCheck)
)


@property_test
@given(st.data())
def test_reciprocity(data) -> None:
    """Feeding an electrode and reading an element is the converse."""
    sensor = data.draw(sensors())
    table = tx.resistances(sensor)
    np.testing.assert_allclose(table.electrodes, table.electrodes.T, rtol=1e-12)
    ec, kc = kernels.fem_element_columns(
        _fem(sensor), jnp.array([0, 5, 77]), sensor.divisions
    )
    scale = float(table.own.max())
    np.testing.assert_allclose(ec, table.elements[:, [0, 5, 77]], atol=1e-10 * scale)
    chosen = kc[jnp.array([0, 5, 77])]
    np.testing.assert_allclose(chosen, chosen.T, atol=1e-10 * scale)


@property_test
@given(st.data())
def test_currents_balance_and_voltages_are_bounded(data) -> None:
    sensor = data.draw(sensors())
    g = jnp.asarray(data.draw(contacts(sensor)))
    grounds = jnp.arange(sensor.electrode_count)
    contact = kernels.fem_contact(_fem(sensor), g, sensor.divisions)
    z, v0 = sensor.ground_resistance, sensor.drive_voltage
    volts = kernels.ground_voltages(contact, grounds, z, v0)
    assert float(volts.min()) >= -1e-9 and float(volts.max()) <= 4.5 + 1e-9
    into = (g * kernels.voltage_drop(contact, grounds, z, v0)).sum(1)
    out = kernels.ground_currents(contact, grounds, z, v0)
    np.testing.assert_allclose(into, out, rtol=1e-9)
    grounded = volts[grounds, grounds]
    np.testing.assert_allclose(grounded, z * out, atol=1e-9)


@property_test
@given(st.data())
def test_jacobian_tends_to_the_slot_map(data) -> None:
    sensor = data.draw(sensors())
    rho = 1e12
    t = kernels.slot_map(
        tx.resistances(sensor), jnp.arange(3), sensor.ground_resistance
    )
    j = rho * tx.jacobian(sensor, [0, 1, 2], rho)
    # What is left is loop/ρ, below 1e5/1e12.
    np.testing.assert_allclose(j, t, rtol=2e-7, atol=1e-7)
    assert float(tx.jacobian(sensor).max()) <= 1 + 1e-9


@property_test
@given(st.data())
def test_rank_of_the_slot_maps(data) -> None:
    """All grounds together have rank M; one slot M − 1, or M through a ground path."""
    sensor = data.draw(sensors())
    table = tx.resistances(sensor)
    m = sensor.electrode_count
    for z, one in ((0.0, m - 1), (4.0, m)):
        t = np.asarray(kernels.slot_map(table, jnp.arange(m), jnp.asarray(z)))
        tolerance = 1e-8 * np.linalg.norm(t[0], 2)
        assert np.linalg.matrix_rank(t.reshape(m * m, -1), tolerance) == m
        # z·Σs alone is the last direction: small beside 10 kΩ, but not rounding.
        assert np.linalg.matrix_rank(t[0], tolerance) == one


@pytest.mark.parametrize("route", ["fem", "series"])
def test_symmetries_of_the_square(route) -> None:
    """Quarter turns and mirrors permute the table and leave it the same."""
    sensor = tx.Sensor.grid(4, 4, 0.04, 0.02, divisions=(40, 40))
    table = tx.resistances(sensor, route)
    xy = np.asarray(sensor.electrode_xy)
    elements = np.asarray(_mesh.centroids(sensor.divisions, sensor.size))

    def permutation(places: np.ndarray, image: np.ndarray) -> np.ndarray:
        order = np.lexsort(np.round(places * 1e6).T)
        return order[np.argsort(np.lexsort(np.round(image * 1e6).T))]

    side = 0.16
    for image in (
        lambda p: np.stack([side - p[:, 0], p[:, 1]], 1),
        lambda p: p[:, ::-1],
        lambda p: np.stack([side - p[:, 1], p[:, 0]], 1),
    ):
        e, k = permutation(xy, image(xy)), permutation(elements, image(elements))
        np.testing.assert_allclose(xy[e], image(xy), atol=1e-12)
        np.testing.assert_allclose(elements[k], image(elements), atol=1e-12)
        scale = float(table.own.max())
        for part, turned in (
            (table.electrodes, table.electrodes[np.ix_(e, e)]),
            (table.elements, table.elements[np.ix_(e, k)]),
            (table.own, table.own[k]),
        ):
            np.testing.assert_allclose(part, turned, atol=1e-11 * scale)
