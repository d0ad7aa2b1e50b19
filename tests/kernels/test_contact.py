"""Exact voltages, T and J(ρ) against one dense solve of the whole network."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import references

import tomojax as tx
from tomojax import kernels
from tomojax._forward import _fem

SHAPE = (16, 10)
TOLERANCE = 1e-10  # of the largest voltage or potential


def patchy(rng, k: int, decades: float = 3) -> np.ndarray:
    """Conductances on a random third of the elements, over several decades."""
    g = 10 ** rng.uniform(-3 - decades, -3, k)
    return np.where(rng.random(k) < 0.3, g, 0)


def uneven(sensor: tx.Sensor, rng) -> tx.Sensor:
    rho = 1e4 * np.exp(0.4 * rng.standard_normal(sensor.element_count))
    return dataclasses.replace(sensor, sheet_resistance=rho)


def dense_reduction(sensor: tx.Sensor, g) -> kernels.ContactReduction:
    everything = jnp.arange(sensor.element_count)
    _, kc = kernels.fem_element_columns(_fem(sensor), everything, sensor.divisions)
    table = tx.resistances(sensor)
    return kernels.reduce_contact(table.electrodes, table.elements, kc, jnp.asarray(g))


@pytest.mark.parametrize("z", [0.0, 4.0])
def test_all_grounds_by_both_routes(small_sensor, z, rng) -> None:
    sensor = dataclasses.replace(uneven(small_sensor, rng), ground_resistance=z)
    g = patchy(rng, sensor.element_count)
    got = tx.voltages(sensor, jnp.asarray(g))
    dense = dense_reduction(sensor, g)
    grounds = jnp.arange(sensor.electrode_count)
    by_table = kernels.ground_voltages(
        dense, grounds, sensor.ground_resistance, sensor.drive_voltage
    )
    drop = kernels.voltage_drop(
        dense, grounds, sensor.ground_resistance, sensor.drive_voltage
    )
    current = kernels.ground_currents(
        dense, grounds, sensor.ground_resistance, sensor.drive_voltage
    )
    for ground in range(sensor.electrode_count):
        want, u = references.network_voltages(sensor, g, ground=ground)
        scale = TOLERANCE * np.abs(want).max()
        np.testing.assert_allclose(got[ground], want, atol=scale, rtol=0)
        np.testing.assert_allclose(by_table[ground], want, atol=scale, rtol=0)
        np.testing.assert_allclose(4.5 - drop[ground], u, atol=scale, rtol=0)
        np.testing.assert_allclose(
            current[ground], (g * (4.5 - u)).sum(), rtol=TOLERANCE
        )


def test_several_and_partial_grounds(small_sensor, rng) -> None:
    sensor = uneven(small_sensor, rng)
    g = patchy(rng, sensor.element_count)
    m = sensor.electrode_count
    gamma = np.zeros((4, m))
    gamma[0, [1, 5]] = 0.25  # two grounds at once
    gamma[1] = 10 ** rng.uniform(-7, -1, m)  # every electrode partly
    gamma[2, 3] = 0.25  # one: the same as a ground of 4 Ω
    gamma[3, [0, 2, 7]] = 1e-4, 1e-2, 10.0
    got = tx.voltages(sensor, jnp.asarray(g), gamma)
    for row, want_of in zip(np.asarray(got), gamma):
        want, _ = references.network_voltages(sensor, g, to_ground=want_of)
        np.testing.assert_allclose(row, want, atol=TOLERANCE * want.max(), rtol=0)
    one = tx.voltages(sensor, jnp.asarray(g), [3])
    np.testing.assert_allclose(got[2], one[0], atol=1e-11)


def test_slot_map_is_exact_for_any_contact(small_sensor, rng) -> None:
    """V^l = T^l s^l with the currents that really flow, one ground or several."""
    sensor = uneven(small_sensor, rng)
    g = patchy(rng, sensor.element_count)
    table = tx.resistances(sensor)
    grounds = jnp.arange(sensor.electrode_count)
    t = kernels.slot_map(table, grounds, sensor.ground_resistance)
    for ground in range(sensor.electrode_count):
        want, u = references.network_voltages(sensor, g, ground=ground)
        got = t[ground] @ (g * (4.5 - u))
        np.testing.assert_allclose(got, want, atol=TOLERANCE * want.max(), rtol=0)
    gamma = 10 ** rng.uniform(-7, -1, (3, sensor.electrode_count))
    shared, _ = kernels.shared_slot_map(table, jnp.asarray(gamma))
    for row, t_row in zip(gamma, shared):
        want, u = references.network_voltages(sensor, g, to_ground=row)
        got = t_row @ (g * (4.5 - u))
        np.testing.assert_allclose(got, want, atol=TOLERANCE * want.max(), rtol=0)


@pytest.mark.parametrize("rho", [0.3, 2e5])
def test_jacobian_is_one_element_in_contact(small_sensor, rho, rng) -> None:
    sensor = uneven(small_sensor, rng)
    j = 4.5 * tx.jacobian(sensor, contact_resistance=rho)
    gamma = 10 ** rng.uniform(-7, -1, (1, sensor.electrode_count))
    shared = 4.5 * tx.jacobian(sensor, gamma, rho)
    for k in rng.choice(sensor.element_count, 4, replace=False):
        g = np.zeros(sensor.element_count)
        g[k] = 1 / rho
        for ground in (0, 4):
            want, _ = references.network_voltages(sensor, g, ground=ground)
            np.testing.assert_allclose(j[ground, :, k], want, atol=1e-10 * want.max())
        want, _ = references.network_voltages(sensor, g, to_ground=gamma[0])
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
    sensor = tx.Sensor(
        small_sensor.size,
        np.asarray(small_sensor.electrode_xy, dtype),
        divisions=SHAPE,
    )
    exact = tx.Sensor(
        np.asarray(sensor.size, float),
        np.asarray(sensor.electrode_xy, float),
        divisions=SHAPE,
    )
    g = np.zeros(sensor.element_count)
    g[rng.choice(sensor.element_count, 30)] = total / 30
    got = np.asarray(tx.voltages(sensor, jnp.asarray(g, dtype)))
    dense = dense_reduction(sensor, g.astype(dtype))
    grounds = jnp.arange(8)
    other = kernels.ground_voltages(
        dense, grounds, sensor.ground_resistance, sensor.drive_voltage
    )
    for ground in range(8):
        want, _ = references.network_voltages(exact, g, ground=ground)
        # The dense reference itself loses 1e-16/total against 1e-4 S of sheet.
        atol = max(tolerance, 1e-17 / total) * want.max()
        np.testing.assert_allclose(got[ground], want, atol=atol, rtol=0)
        np.testing.assert_allclose(other[ground], want, atol=atol, rtol=0)


def test_adjoint_sensitivity_is_the_derivative(small_sensor, rng) -> None:
    sensor = uneven(small_sensor, rng)
    g = jnp.asarray(patchy(rng, sensor.element_count))
    grounds = jnp.array([0, 3, 6])
    got = jax.jacfwd(lambda g: tx.voltages(sensor, g, grounds))(g)
    contact = kernels.fem_contact(_fem(sensor), g, SHAPE)
    want = kernels.voltage_sensitivity(
        contact, grounds, sensor.ground_resistance, sensor.drive_voltage
    )
    scale = float(jnp.abs(want).max())
    np.testing.assert_allclose(got, want, atol=1e-10 * scale)
    reverse = jax.jacrev(lambda g: tx.voltages(sensor, g, grounds))(g)
    np.testing.assert_allclose(reverse, want, atol=1e-10 * scale)
    nothing = kernels.fem_contact(_fem(sensor), 0 * g, SHAPE)
    at_rest = kernels.voltage_sensitivity(
        nothing, grounds, sensor.ground_resistance, sensor.drive_voltage
    )
    t = kernels.slot_map(tx.resistances(sensor), grounds, sensor.ground_resistance)
    np.testing.assert_allclose(at_rest, 4.5 * t, atol=1e-9 * float(t.max()))


def test_no_contact_reads_nothing(small_sensor) -> None:
    nothing = tx.voltages(small_sensor, tx.Scene())
    np.testing.assert_array_equal(nothing, 0)
    floating = kernels.shared_ground_voltages(
        kernels.fem_contact(_fem(small_sensor), jnp.zeros(320), SHAPE),
        jnp.zeros((1, 8)),
        small_sensor.drive_voltage,
    )
    np.testing.assert_array_equal(floating, 0)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_element_on_the_grounded_electrode_is_finite(dtype) -> None:
    """0/0 at ρ = z = 0: the ground wins, the element's column is 0, gradients too."""
    ee = jnp.asarray([[3.0, -1.0], [-1.0, 2.0]], dtype) * 1e3
    # Element 0 is electrode 0 itself; element 1 lies elsewhere.
    table = kernels.Resistances(
        ee, jnp.stack([ee[:, 0], jnp.asarray([500.0, 200.0], dtype)], 1), jnp.asarray([3e3, 4e3], dtype)
    )
    grounds = jnp.array([0, 1])

    def j(rho, z):
        loop = kernels.loop_resistance(table, grounds, z)
        return kernels.contact_jacobian(
            kernels.slot_map(table, grounds, z), loop, rho
        )

    zero = jnp.asarray(0.0, dtype)
    got = j(zero, zero)
    assert np.isfinite(got).all()
    np.testing.assert_array_equal(got[0, :, 0], 0)
    assert np.abs(np.asarray(got[1, :, 0])).max() > 0.1
    slope = jax.jacrev(j, (0, 1))(zero, zero)
    assert all(np.isfinite(s).all() for s in slope)
    assert np.isfinite(j(zero, jnp.asarray(4.0, dtype))).all()
