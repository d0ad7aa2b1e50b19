"""A basis of as many rows as there are electrodes holds all of every slot map."""

import jax.numpy as jnp
import numpy as np
import pytest
import references

import tomojax as tx
from tomojax.kernels.inverse import reduce_slots, row_basis


@pytest.mark.parametrize("route", ["fem", "series"])
@pytest.mark.parametrize("dtype, tolerance", [(np.float64, 1e-12), (np.float32, 2e-5)])
def test_slot_maps_are_their_factors(route, dtype, tolerance) -> None:
    sensor = tx.Sensor.grid(divisions=(40, 40), dtype=dtype)
    table = tx.sensor.resistances(sensor, route)
    t = references.slot_map(table, jnp.array([0, 27, 63]), sensor.ground_resistance)
    basis = row_basis(t, 64)
    assert basis.shape == (64, 3200) and basis.dtype == dtype
    np.testing.assert_allclose(basis @ basis.T, np.eye(64), atol=10 * tolerance)
    a = reduce_slots(t, basis).factors
    scale = float(jnp.abs(t).max())
    np.testing.assert_allclose(a @ basis, t, atol=tolerance * scale, rtol=0)
    # The Gram matrices that later work adds up are those of the maps themselves.
    gram = jnp.einsum("lir,lis->rs", a, a, precision="highest")
    exact = jnp.einsum("lik,lij->kj", t[:, :, ::100], t[:, :, ::100], precision="highest")
    reduced = basis[:, ::100].T @ gram @ basis[:, ::100]
    np.testing.assert_allclose(
        reduced, exact, atol=10 * tolerance * float(exact.max()), rtol=0
    )
