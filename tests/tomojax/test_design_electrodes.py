"""Places for electrodes, by gradient."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx
from tomojax.design import image_scale


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid(3, 3, pitch=0.04, margin=0.02, divisions=(24, 24))


@pytest.mark.parametrize("start", ["symmetric", "random"])
def test_slopes_in_electrodes_places(sensor, rng, start):
    places = jnp.asarray(rng.uniform(0.02, 0.1, (5, 2)))
    lam = 1e-4 * image_scale(sensor, 8)

    def value(xy):
        return tx.design.image_spread(sensor, places, xy, lam=lam, grid=8).sum()

    xy = sensor.electrode_xy
    if start == "random":
        xy = xy + 0.003 * rng.normal(size=xy.shape)
    slope = np.asarray(jax.jit(jax.grad(value))(xy))
    assert np.isfinite(slope).all()
    value, h = jax.jit(value), 1e-6
    for e, k in ((0, 0), (4, 1), (7, 0)):
        step = jnp.zeros_like(xy).at[e, k].set(h)
        wanted = (value(xy + step) - value(xy - step)) / (2 * h)
        np.testing.assert_allclose(slope[e, k], wanted, 1e-5, 1e-7 * abs(slope).max())


@pytest.mark.long
def test_spread_is_backus_and_gilberts(sensor):
    """Less regularised an image is sharper, though not below what electrodes can tell."""
    places = jnp.asarray([[0.05, 0.06], [0.08, 0.03]])
    scale = image_scale(sensor, 12)
    each = [
        tx.design.image_spread(
            sensor, places, sensor.electrode_xy, lam=lam * scale, grid=12
        )
        for lam in (1e-2, 1e-4, 1e-6)
    ]
    assert (each[1] < 0.8 * each[0]).all() and (each[2] < 1.05 * each[1]).all()
    assert (each[2] > 0.004).all()


@pytest.mark.long
def test_the_worst_gets_better(sensor):
    found = tx.design.design_electrodes(sensor, grid=10, starts=1)
    assert found.spread.max() < 0.97 * found.spread_before.max()
    size, diameter = np.asarray(sensor.size), float(sensor.electrode_diameter)
    xy = found.electrode_xy
    assert (xy > diameter / 2).all() and (xy < size - diameter / 2).all()
    apart = np.linalg.norm(xy[:, None] - xy, axis=-1) + np.eye(len(xy))
    assert apart.min() > 1.2 * diameter
    # What it says is what these places have.
    parts = [np.linspace(s / 16, s * 15 / 16, 24) for s in size]
    places = jnp.asarray(np.stack(np.meshgrid(*parts, indexing="ij"), -1).reshape(-1, 2))
    lam = 1e-5 * image_scale(sensor, 10)
    again = tx.design.image_spread(sensor, places, jnp.asarray(xy), lam=lam, grid=10)
    np.testing.assert_allclose(found.spread, again, rtol=1e-6)


@pytest.mark.parametrize(
    "words, message",
    [
        (dict(places=np.zeros((0, 2))), "places: got none"),
        (dict(places=np.zeros((3, 3))), "places"),
        (dict(lam=-1.0), "lam"),
        (dict(starts=0), "starts: got 0"),
    ],
)
def test_bad_input(sensor, words, message):
    with pytest.raises(ValueError, match=message):
        tx.design.design_electrodes(sensor, grid=6, **words)


def test_an_uneven_sheet():
    sensor = tx.Sensor.grid(3, 3, divisions=(16, 16), sheet_resistance=np.full(512, 1e4))
    with pytest.raises(ValueError, match="a sheet with a value per element"):
        tx.design.design_electrodes(sensor, grid=6)
