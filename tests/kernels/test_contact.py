"""Exact voltages, T and J(ρ) against one dense solve of the whole network."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import references

import tomojax as tx
from tomojax.kernels.sheet import (
    Conditions,
    conditions_of,
    ContactReduction,
    fem_contact,
    fem_shared_resistances,
    ground_voltages,
    Grounds,
    reduce_sites,
    Resistances,
    site_conductance,
    slot_jacobian,
    voltage_drop,
    voltage_slopes,
    volts_per_ampere,
)
from tomojax.sensor import sheet_on_mesh

SHAPE = (16, 10)
NODES, ELECTRODES = 17 * 11, 8
TOLERANCE = 1e-10  # of the largest voltage or potential


def patchy(rng, decades: float = 3) -> np.ndarray:
    """Conductances on a random third of the sites, over several decades.

    As many each time: another number of sites is another program.
    """
    g = np.zeros(NODES + ELECTRODES)
    some = rng.choice(len(g), len(g) // 3, replace=False)
    g[some] = 10 ** rng.uniform(-3 - decades, -3, len(some))
    return g


@pytest.fixture(params=[None, 0.7])
def sensor(request, small_sensor, rng) -> tx.Sensor:
    """An uneven sheet, with floating electrodes neglected or not."""
    rho = 1e4 * np.exp(0.4 * rng.standard_normal(small_sensor.element_count))
    return dataclasses.replace(
        small_sensor, sheet_resistance=rho, electrode_shunt=request.param
    )


# Op by op the scans would compile anew for every case.
on_mesh = jax.jit(sheet_on_mesh)
reduce_mesh = jax.jit(fem_contact, static_argnums=2)
shared_resistances = jax.jit(fem_shared_resistances, static_argnums=2)
reduce_to_sites = jax.jit(reduce_sites, static_argnums=2)
conditions_of, ground_voltages, slot_jacobian, voltage_drop = map(
    jax.jit, (conditions_of, ground_voltages, slot_jacobian, voltage_drop)
)
jit_slopes = jax.jit(lambda *a: voltage_slopes(*a[:-2])(*a[-2:]))
slot_map = jax.jit(references.slot_map)


@jax.jit
def parts_of(law, table, rows, each, which) -> list[jax.Array]:
    """Each member of a law of grounds."""
    volts = volts_per_ampere(law, rows[0], which)
    return [
        law.path(which),
        law.offset(which),
        law.relative(rows, which),
        law.apart(each, which),
        law.level(rows, which),
        law.sunk(rows, which, volts),
        slot_jacobian(table, law, which, jnp.array(10.0)),
        law.relative(rows, which[0]),
    ]


def alone(sensor: tx.Sensor) -> Grounds:
    """The law for a contact's reduction, which has the resistances."""
    return Grounds(None, sensor.ground_resistance)


def mesh_reduction(sensor: tx.Sensor, g) -> ContactReduction:
    return reduce_mesh(on_mesh(sensor), jnp.asarray(g), SHAPE)


def table_of_sites(sensor: tx.Sensor, sites) -> Resistances:
    """The table of chosen sites, as one of elements."""
    shares = jnp.eye(NODES + ELECTRODES)[:, jnp.asarray(sites)]
    ec, cc = shared_resistances(on_mesh(sensor), shares, SHAPE)
    return Resistances(tx.sensor.resistances(sensor).electrodes, ec, jnp.diag(cc))


def sensitivity(contact: ContactReduction, *drive) -> jax.Array:
    """∂V/∂g of every site."""
    n = len(contact.gap)
    return jit_slopes(contact, *drive, jnp.eye(n), jnp.arange(n))


@pytest.mark.parametrize("z", [0.0, 4.0])
def test_all_grounds(sensor, z, rng) -> None:
    sensor = dataclasses.replace(sensor, ground_resistance=z)
    g = patchy(rng)
    grounds = jnp.arange(ELECTRODES)
    drive = (alone(sensor), grounds, sensor.drive_voltage)
    contact = mesh_reduction(sensor, g)
    volts = ground_voltages(contact, *drive)
    drop = voltage_drop(contact, *drive)
    current = references.ground_currents(contact, *drive)
    for ground in range(ELECTRODES):
        want, u = references.network_voltages(sensor, g, ground=ground)
        scale = TOLERANCE * np.abs(want).max()
        np.testing.assert_allclose(volts[ground], want, atol=scale, rtol=0)
        np.testing.assert_allclose(4.5 - drop[ground], u, atol=scale, rtol=0)
        total = (g * (4.5 - u)).sum()
        np.testing.assert_allclose(current[ground], total, rtol=TOLERANCE)


def test_voltages_of_a_scene_are_those_of_its_sites(sensor) -> None:
    scene = tx.Scene(
        tx.Disc([0.03, 0.029], 0.006, 3.0), tx.Bar([0.05, 0.015], 0.02, 0.005, 1.0, 9.0)
    )
    g = tx.sensor.contact_conductance(sensor, scene)
    sites = site_conductance(on_mesh(sensor), g, SHAPE)
    np.testing.assert_allclose(sites.sum(), g.sum(), rtol=1e-12)
    assert float(sites.min()) >= 0 and float(sites[NODES:].max()) > 0
    got = tx.voltages(sensor, scene)
    for ground in range(ELECTRODES):
        want, _ = references.network_voltages(sensor, sites, ground=ground)
        np.testing.assert_allclose(got[ground], want, atol=TOLERANCE * want.max(), rtol=0)


def test_several_and_partial_grounds(sensor, rng) -> None:
    g = patchy(rng)
    gamma = np.zeros((4, ELECTRODES))
    gamma[0, [1, 5]] = 0.25  # two grounds at once
    gamma[1] = 10 ** rng.uniform(-7, -1, ELECTRODES)  # every electrode partly
    gamma[2, 3] = 0.25  # one: the same as a ground of 4 Ω
    gamma[3, [0, 2, 7]] = 1e-4, 1e-2, 10.0
    contact = mesh_reduction(sensor, g)
    drive = sensor.drive_voltage
    slots = conditions_of(contact.resistance, jnp.asarray(gamma))
    every = jnp.arange(4)
    got = ground_voltages(contact, slots, every, drive)
    drops = voltage_drop(contact, slots, every, drive)
    for row, want_of in zip(np.asarray(got), gamma):
        want, _ = references.network_voltages(sensor, g, to_ground=want_of)
        np.testing.assert_allclose(row, want, atol=TOLERANCE * want.max(), rtol=0)
    for drop, want_of in zip(drops, gamma):
        _, u = references.network_voltages(sensor, g, to_ground=want_of)
        np.testing.assert_allclose(4.5 - drop, u, atol=TOLERANCE * 4.5, rtol=0)
    one = ground_voltages(contact, alone(sensor), jnp.array([3]), drive)
    np.testing.assert_allclose(got[2], one[0], atol=1e-11)


def test_slopes_with_several_grounds(sensor, rng) -> None:
    g = jnp.asarray(patchy(rng))
    gamma = jnp.asarray(10 ** rng.uniform(-6, 0, (3, ELECTRODES)))
    drive = jnp.arange(3), sensor.drive_voltage

    def law(g):
        contact = mesh_reduction(sensor, g)
        return contact, conditions_of(contact.resistance, gamma), *drive

    want = jax.jit(jax.jacfwd(lambda g: ground_voltages(*law(g))))(g)
    got = sensitivity(*law(g))
    np.testing.assert_allclose(got, want, atol=1e-9 * float(jnp.abs(want).max()))


def test_conditions_are_grounds_where_one_electrode_is_grounded(sensor, rng) -> None:
    """Each member of both laws, for rows of all slots and of each."""
    table = tx.sensor.resistances(sensor)
    one = sensor.slots(table.electrodes)
    gamma = jnp.eye(ELECTRODES) / sensor.ground_resistance
    other = conditions_of(table.electrodes, gamma)
    assert isinstance(one, Grounds) and isinstance(other, Conditions)
    which = jnp.array([5, 0, 5])
    rows = 1e3 * jnp.asarray(rng.standard_normal((4, ELECTRODES)))
    each = jnp.stack([rows, 2 * rows, 3 * rows])
    pairs = [parts_of(law, table, rows, each, which) for law in (one, other)]
    for got, want in zip(*pairs, strict=True):
        np.testing.assert_allclose(got, want, atol=1e-6 * float(jnp.abs(want).max()))
    np.testing.assert_array_equal(one.grounded(which), other.grounded(which))


def test_slot_map_is_exact_in_the_current(sensor, rng) -> None:
    """V^l = T^l s for any current image, one ground or several, whatever fed it."""
    s = 1e-6 * rng.standard_normal(sensor.element_count)
    table = tx.sensor.resistances(sensor)
    t = slot_map(table, jnp.arange(ELECTRODES), sensor.ground_resistance)
    for ground in range(ELECTRODES):
        want, _ = references.network_voltages(sensor, injected=s, ground=ground)
        got = t[ground] @ s
        np.testing.assert_allclose(got, want, atol=TOLERANCE * np.abs(want).max(), rtol=0)
    gamma = 10 ** rng.uniform(-7, -1, (3, ELECTRODES))
    several = conditions_of(table.electrodes, jnp.asarray(gamma))
    shared = several.maps(table.elements, jnp.arange(3))
    for row, t_row in zip(gamma, shared):
        want, _ = references.network_voltages(sensor, injected=s, to_ground=row)
        got = t_row @ s
        np.testing.assert_allclose(got, want, atol=TOLERANCE * np.abs(want).max(), rtol=0)


def test_slot_map_on_sites_carries_any_contact(sensor, rng) -> None:
    """The same with the currents g(V0 − u) that a real contact drives."""
    g = patchy(rng)
    sites = np.flatnonzero(g)
    table = table_of_sites(sensor, sites)
    t = slot_map(table, jnp.arange(ELECTRODES), sensor.ground_resistance)
    for ground in range(ELECTRODES):
        want, u = references.network_voltages(sensor, g, ground=ground)
        got = t[ground] @ (g * (4.5 - u))[sites]
        np.testing.assert_allclose(got, want, atol=TOLERANCE * want.max(), rtol=0)


@pytest.mark.parametrize("rho", [0.3, 2e5])
def test_jacobian_is_one_element_in_contact(sensor, rho, rng) -> None:
    j = 4.5 * tx.jacobian(sensor, contact_resistance=rho)
    gamma = 10 ** rng.uniform(-7, -1, (1, ELECTRODES))
    shared = 4.5 * tx.jacobian(sensor, gamma, rho)
    for k in rng.choice(sensor.element_count, 4, replace=False):
        for ground in (0, 4):
            want, _ = references.network_voltages(
                sensor, element=(k, 1 / rho), ground=ground
            )
            np.testing.assert_allclose(j[ground, :, k], want, atol=1e-10 * want.max())
        want, _ = references.network_voltages(
            sensor, element=(k, 1 / rho), to_ground=gamma[0]
        )
        np.testing.assert_allclose(shared[0, :, k], want, atol=1e-10 * want.max())


def test_imposed_potential_is_the_limit_of_small_resistance(small_sensor) -> None:
    zero = tx.jacobian(small_sensor)
    small = tx.jacobian(small_sensor, contact_resistance=1e-6)
    np.testing.assert_allclose(zero, small, atol=1e-8)


@pytest.mark.parametrize("total", [1e-12, 1e-6, 1e-3, 1e3])
@pytest.mark.parametrize("dtype, tolerance", [(np.float64, 1e-8), (np.float32, 2e-4)])
def test_weak_and_strong_contacts_lose_no_digits(
    small_sensor, total, dtype, tolerance, rng
) -> None:
    """Fifteen decades of conductance, relative to the largest voltage of each."""
    xy = np.asarray(small_sensor.electrode_xy, dtype)
    sensor = tx.Sensor(small_sensor.size, xy, divisions=SHAPE)
    exact = tx.Sensor(np.asarray(sensor.size, float), xy.astype(float), divisions=SHAPE)
    g = np.zeros(NODES + ELECTRODES)
    g[rng.choice(len(g), 30)] = total / 30
    drive = (alone(sensor), jnp.arange(ELECTRODES), sensor.drive_voltage)
    got = np.asarray(ground_voltages(mesh_reduction(sensor, g.astype(dtype)), *drive))
    assert got.dtype == dtype
    for ground in range(ELECTRODES):
        want, _ = references.network_voltages(exact, g, ground=ground)
        # The dense reference itself loses 1e-16/total against 1e-4 S of sheet.
        atol = max(tolerance, 1e-17 / total) * want.max()
        np.testing.assert_allclose(got[ground], want, atol=atol, rtol=0)


def test_adjoint_sensitivity_is_the_derivative(sensor, rng) -> None:
    g = jnp.asarray(patchy(rng))
    grounds = jnp.array([0, 3, 6])
    law = alone(sensor), grounds, sensor.drive_voltage
    volts = lambda g: ground_voltages(mesh_reduction(sensor, g), *law)  # noqa: E731
    want = sensitivity(mesh_reduction(sensor, g), *law)
    scale = float(jnp.abs(want).max())
    np.testing.assert_allclose(jax.jit(jax.jacfwd(volts))(g), want, atol=1e-10 * scale)
    np.testing.assert_allclose(jax.jit(jax.jacrev(volts))(g), want, atol=1e-10 * scale)
    nothing = mesh_reduction(sensor, 0 * g)
    at_rest = sensitivity(nothing, *law)
    sites = table_of_sites(sensor, np.arange(len(g)))
    t = slot_map(sites, grounds, sensor.ground_resistance)
    np.testing.assert_allclose(at_rest, 4.5 * t, atol=1e-9 * float(t.max()))


def test_no_contact_reads_nothing(small_sensor) -> None:
    nothing = tx.voltages(small_sensor, tx.Scene())
    np.testing.assert_array_equal(nothing, 0)
    contact = mesh_reduction(small_sensor, jnp.zeros(NODES + ELECTRODES))
    slots = conditions_of(contact.resistance, jnp.zeros((1, 8)))
    floating = ground_voltages(contact, slots, jnp.array([0]), small_sensor.drive_voltage)
    np.testing.assert_array_equal(floating, 0)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_element_on_the_grounded_electrode_is_finite(dtype) -> None:
    """0/0 at ρ = z = 0: the ground wins, the element's column is 0, gradients too."""
    ee = jnp.asarray([[3.0, -1.0], [-1.0, 2.0]], dtype) * 1e3
    # Element 0 is electrode 0 itself; element 1 lies elsewhere.
    table = Resistances(
        ee,
        jnp.stack([ee[:, 0], jnp.asarray([500.0, 200.0], dtype)], 1),
        jnp.asarray([3e3, 4e3], dtype),
    )
    grounds = jnp.array([0, 1])

    def j(rho, z):
        return slot_jacobian(table, Grounds(ee, z), grounds, rho)

    j = jax.jit(j)
    zero = jnp.asarray(0.0, dtype)
    got = j(zero, zero)
    assert np.isfinite(got).all()
    np.testing.assert_array_equal(got[0, :, 0], 0)
    assert np.abs(np.asarray(got[1, :, 0])).max() > 0.1
    slope = jax.jit(jax.jacrev(j, (0, 1)))(zero, zero)
    assert all(np.isfinite(s).all() for s in slope)
    assert np.isfinite(j(zero, jnp.asarray(4.0, dtype))).all()


def all_sites(sensor: tx.Sensor) -> jax.Array:
    """R between all nodes and electrodes."""
    return shared_resistances(on_mesh(sensor), jnp.eye(NODES + ELECTRODES), SHAPE)[1]


@pytest.mark.parametrize("weakest", [1e-30, 1e-9])
def test_few_strong_sites_of_many(sensor, weakest, rng) -> None:
    """Exact where the rest carry nothing; else off by the square of it, fields by it."""
    table = all_sites(sensor)
    g = np.full(NODES + ELECTRODES, weakest)
    g[rng.choice(len(g), 12, replace=False)] = 10 ** rng.uniform(-5, -1, 12)
    got = reduce_to_sites(table, jnp.asarray(g), ELECTRODES)
    want = mesh_reduction(sensor, g)
    drive = (alone(sensor), jnp.arange(ELECTRODES), sensor.drive_voltage)
    weak = (weakest * jnp.diagonal(table)).sum()
    for of, off in ((ground_voltages, weak**2), (voltage_drop, weak)):
        atol = 4.5 * max(float(off), 1e-9)
        np.testing.assert_allclose(of(got, *drive), of(want, *drive), atol=atol, rtol=0)
