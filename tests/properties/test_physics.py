"""What holds for every sensor, scene and ground."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import references
from hypothesis import given, HealthCheck, settings, strategies as st

import tomojax as tx
from tomojax.kernels.sheet import (
    centroids,
    fem_contact,
    fem_shared_resistances,
    Grounds,
    site_conductance,
    triangles,
    voltage_drop,
)
from tomojax.sensor import sheet_on_mesh

# One mesh shape per electrode count: a new one compiles anew, a new value does not.
GRIDS = {(2, 3): (20, 28), (3, 2): (28, 20)}


@st.composite
def sensors(draw) -> tx.Sensor:
    rows, columns = draw(st.sampled_from(sorted(GRIDS)))
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    pitch = 0.02 * draw(st.floats(0.8, 1.5))
    divisions = GRIDS[rows, columns]
    sensor = tx.Sensor.grid(
        rows, columns, pitch, 0.01, electrode_diameter=0.005, divisions=divisions
    )
    moved = sensor.electrode_xy + rng.uniform(-2e-3, 2e-3, sensor.electrode_xy.shape)
    k = sensor.element_count
    return dataclasses.replace(
        sensor,
        electrode_xy=moved,
        sheet_resistance=1e4 * np.exp(draw(st.floats(0, 0.5)) * rng.standard_normal(k)),
        electrode_shunt=draw(st.sampled_from([None, 1.0])),
        ground_resistance=draw(st.sampled_from([0.0, 4.0, 1e3])),
    )


@st.composite
def scenes(draw, sensor: tx.Sensor) -> tx.sensor.AbstractShape:
    """Contacts of any size, place and strength: one value traces for all."""
    number = lambda low, high: draw(st.floats(low, high))  # noqa: E731
    w, h = np.asarray(sensor.size)
    # Half of them on or beside an electrode, where the model has most to get right.
    e = draw(st.integers(0, sensor.electrode_count - 1))
    near = np.asarray(sensor.electrode_xy[e]) + [number(-6e-3, 6e-3) for _ in "xy"]
    return tx.Scene(
        tx.Disc(near, 10 ** number(-3.3, -1.8), 10 ** number(-6, 5)),
        tx.Bar(
            [number(0, w), number(0, h)], 0.03, 0.006, number(0, 3), 10 ** number(-6, 5)
        ),
    )


# Op by op each would be a hundred programs for every shape.
on_mesh = jax.jit(sheet_on_mesh)
shared_resistances = jax.jit(fem_shared_resistances, static_argnums=2)
reduction = jax.jit(fem_contact, static_argnums=2)

property_test = settings(
    max_examples=25, deadline=None, suppress_health_check=list(HealthCheck)
)


@property_test
@given(st.data())
def test_reciprocity(data) -> None:
    """Feeding an electrode and reading an element is the converse."""
    sensor = data.draw(sensors())
    table = tx.sensor.resistances(sensor)
    vertices = triangles(sensor.divisions)[40]
    fem = on_mesh(sensor)
    shares = jnp.eye(sum(fem.feeds.shape))[:, vertices]
    at_vertices, among = shared_resistances(fem, shares, sensor.divisions)
    scale = float(table.own.max())
    # An element is a third of each vertex. The table has fed the electrodes and read the
    # element; here its vertices are fed and the electrodes read.
    np.testing.assert_allclose(
        at_vertices.mean(1), table.elements[:, 40], atol=1e-10 * scale
    )
    np.testing.assert_allclose(among.mean(), table.own[40], atol=1e-10 * scale)


def on_an_electrode(sensor: tx.Sensor, g) -> bool:
    """Whether a contact has an element on a disc or at its rim."""
    at = np.asarray(centroids(sensor.divisions, sensor.size))[np.asarray(g) > 0]
    side = float(np.max(np.asarray(sensor.size) / sensor.divisions))
    apart = np.linalg.norm(at[:, None] - np.asarray(sensor.electrode_xy), axis=-1)
    return bool((apart < float(sensor.electrode_diameter) / 2 + side).any())


@pytest.mark.long
@property_test
@given(st.data())
def test_currents_balance_and_voltages_are_bounded(data) -> None:
    sensor = data.draw(sensors())
    scene = data.draw(scenes(sensor))
    g = tx.sensor.contact_conductance(sensor, scene)
    volts = tx.voltages(sensor, scene)
    # A short within the grounded electrode's disc, whose current enters uniformly over it:
    # the disc's mean is held at 0, and parts of it are below.
    least = -0.1 * 4.5 if on_an_electrode(sensor, g) else -1e-6
    assert float(volts.min()) >= least and float(volts.max()) <= 4.5 + 1e-6
    fem = on_mesh(sensor)
    sites = site_conductance(fem, g, sensor.divisions)
    contact = reduction(fem, sites, sensor.divisions)
    grounds = jnp.arange(sensor.electrode_count)
    drive = (Grounds(None, sensor.ground_resistance), grounds, sensor.drive_voltage)
    into = (sites * voltage_drop(contact, *drive)).sum(1)
    out = references.ground_currents(contact, *drive)
    np.testing.assert_allclose(into, out, rtol=1e-6)
    grounded = volts[grounds, grounds]
    np.testing.assert_allclose(grounded, sensor.ground_resistance * out, atol=1e-8)


@property_test
@given(st.data())
def test_jacobian_tends_to_the_slot_map(data) -> None:
    sensor = data.draw(sensors())
    rho = 1e12
    table = tx.sensor.resistances(sensor)
    t = references.slot_map(table, jnp.arange(3), sensor.ground_resistance)
    j = rho * tx.jacobian(sensor, [0, 1, 2], rho)
    # What is left is loop/ρ, below 1e5/1e12.
    np.testing.assert_allclose(j, t, rtol=2e-7, atol=1e-7)
    # A potential imposed on one element: none exceeds it, but on an electrode's own feed.
    elements = centroids(sensor.divisions, sensor.size)
    apart = jnp.linalg.norm(elements[:, None] - sensor.electrode_xy[None], axis=-1)
    clear = np.asarray(apart.min(1) > 2 * sensor.electrode_diameter)
    imposed = np.asarray(tx.jacobian(sensor))[:, :, clear]
    assert imposed.max() <= 1 + 1e-9 and imposed.min() >= -1e-9


@property_test
@given(st.data())
def test_rank_of_the_slot_maps(data) -> None:
    """All grounds together have rank M; one slot M − 1, or M through a ground path."""
    sensor = data.draw(sensors())
    table = tx.sensor.resistances(sensor)
    m = sensor.electrode_count
    for z, one in ((0.0, m - 1), (4.0, m)):
        t = np.asarray(references.slot_map(table, jnp.arange(m), jnp.asarray(z)))
        tolerance = 1e-8 * np.linalg.norm(t[0], 2)
        assert np.linalg.matrix_rank(t.reshape(m * m, -1), tolerance) == m
        # z·Σs alone is the last direction: small beside 10 kΩ, but not rounding.
        assert np.linalg.matrix_rank(t[0], tolerance) == one


@pytest.mark.parametrize("route", ["fem", "series"])
def test_symmetries_of_the_square(route) -> None:
    """Quarter turns and mirrors permute the table and leave it the same."""
    sensor = tx.Sensor.grid(4, 4, 0.04, 0.02, divisions=(40, 40))
    table = tx.sensor.resistances(sensor, route)
    xy = np.asarray(sensor.electrode_xy)
    elements = np.asarray(centroids(sensor.divisions, sensor.size))

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
