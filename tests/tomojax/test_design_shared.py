"""Several grounds at once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx
from tomojax import design as shared
from tomojax.design import contact_columns
from tomojax.kernels.contacts import in_slot, tangents


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid(4, 4, divisions=(32, 32), electrode_shunt=1.0)


PAIRS = np.array([[[0.03, 0.04], [0.047, 0.043]], [[0.05, 0.021], [0.061, 0.035]]])


@pytest.fixture(scope="module")
def pairs(sensor):
    return shared.pairs_of(sensor, PAIRS)


def test_one_closed_switch_is_a_ground(sensor, pairs):
    gamma = jnp.zeros(16).at[6].set(shared.closed(sensor))
    t, _ = shared.shared_map(pairs, pairs.places[0], gamma)
    raw = jnp.stack([tangents(pairs.sheet, p, jnp.zeros(())) for p in pairs.places[0]])
    wanted = in_slot(pairs.sheet, raw, jnp.asarray(6))
    np.testing.assert_allclose(t, wanted, rtol=1e-7, atol=1e-7 * abs(wanted).max())


def test_currents_of_one_contact(sensor, pairs):
    gamma = jnp.zeros(16).at[6].set(shared.closed(sensor))
    got = shared.shared_columns(pairs, pairs.places[0, :1], gamma)[0]
    wanted = contact_columns(
        pairs.sheet, pairs.places[0, 0], jnp.zeros(()), pairs.resistance, jnp.asarray(6)
    )
    np.testing.assert_allclose(got, wanted, rtol=1e-7, atol=1e-7 * abs(wanted).max())


def test_voltages_of_several_grounds_are_a_mesh_s(sensor, pairs):
    gamma = np.zeros((2, 16))
    gamma[0, [0, 5, 11]] = float(shared.closed(sensor))
    gamma[1, [3, 12]] = 1e-4, 3e-4
    radius = float(pairs.sheet.size)
    density = 1e-4 / (np.pi * radius**2)
    for two in PAIRS:
        scene = tx.Scene(*(tx.Disc(p, radius, density) for p in two))
        wanted = np.asarray(tx.voltages(sensor, scene, gamma))
        for g, volts in zip(gamma, wanted):
            got = shared.shared_columns(pairs, jnp.asarray(two), jnp.asarray(g))[:, 0].sum(
                0
            )
            np.testing.assert_allclose(got, volts, atol=0.06 * volts.max())


@pytest.mark.parametrize("start", ["symmetric", "random"])
def test_slopes_in_conductances(sensor, pairs, rng, start):
    free = (
        jnp.zeros((2, 16))
        if start == "symmetric"
        else jnp.asarray(rng.normal(size=(2, 16)))
    )
    most, ones = shared.closed(sensor), jnp.ones(2)

    @jax.jit
    def value(free):
        gamma = shared.gamma(jax.nn.sigmoid(free), most)
        return 1e3 * shared.pair_objective(pairs, gamma).value(ones)

    slope = np.asarray(jax.jit(jax.grad(value))(free))
    assert np.isfinite(slope).all()
    h = 1e-4
    for s, e in ((0, 0), (1, 7), (0, 13)):
        step = jnp.zeros_like(free).at[s, e].set(h)
        wanted = (value(free + step) - value(free - step)) / (2 * h)
        np.testing.assert_allclose(slope[s, e], wanted, 1e-5, 1e-6 * abs(slope).max())


def test_switches_come_out(sensor):
    found = tx.design.design_shared(sensor, PAIRS, 2, steps=10)
    most = float(shared.closed(sensor))
    assert set(np.unique(found.to_ground)) == {0.0, most}
    assert (found.to_ground > 0).any(1).all()
    assert 0 < found.value <= found.single


@pytest.mark.parametrize(
    "places", [np.zeros((0, 2, 2)), np.zeros((3, 2)), [[[np.nan] * 2] * 2]]
)
def test_bad_pairs(sensor, places):
    with pytest.raises(ValueError, match="places"):
        tx.design.design_shared(sensor, places)
