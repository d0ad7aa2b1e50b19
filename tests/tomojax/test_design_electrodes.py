"""Places for electrodes, by gradient."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx
from tomojax.design import image_scale


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid(3, 3, pitch=0.04, margin=0.02, divisions=(24, 24))


@pytest.mark.long
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


CORNERS = [[0, 0], [0.12, 0], [0.12, 0.12], [0, 0.12]]
LETTER = [[0, 0], [0.08, 0], [0.08, 0.04], [0.04, 0.04], [0.04, 0.08], [0, 0.08]]


@pytest.mark.long
def test_a_mesh_has_the_closed_forms_spread(sensor):
    """A rectangle told by its corners, and one told by a value per element."""
    plain = replace(sensor, divisions=(48, 48))
    cut = tx.Sensor.polygon(CORNERS, np.asarray(plain.electrode_xy), divisions=(48, 48))
    valued = plain.on_mesh((48, 48), np.full(2 * 48**2, 1e4))
    places = jnp.asarray([[0.05, 0.06], [0.08, 0.03], [0.03, 0.031], [0.1, 0.1]])
    lam = 1e-5 * image_scale(plain, 12)

    def spread(of):
        xy = of.electrode_xy
        return tx.design.image_spread(of, places, xy, lam=lam, grid=12)

    for other in (cut, valued):
        np.testing.assert_allclose(spread(other), spread(plain), rtol=0.02)


@pytest.mark.long
@pytest.mark.parametrize("grounds", ["one", "several"])
def test_slopes_on_a_disc_from_any_places(grounds):
    middle = [[0.03, 0.031], [0.05, 0.04], [0.045, 0.02], [0.022, 0.05], [0.06, 0.061]]
    table = None if grounds == "one" else np.eye(5)[:2] + 1e-4 * np.eye(5)[2:4]
    round_one = tx.Sensor.disc(0.08, middle, divisions=(20, 20), conditions=table)
    places, lam = jnp.asarray([[0.04, 0.03]]), 1e-4 * image_scale(round_one, 10)

    @jax.jit
    @jax.value_and_grad
    def value(xy):
        return tx.design.image_spread(round_one, places, xy, lam=lam, grid=10).sum()

    xy, h = round_one.electrode_xy, 1e-6
    slope = value(xy)[1]
    for e, k in ((0, 0), (4, 1)):
        step = jnp.zeros_like(xy).at[e, k].set(h)
        wanted = (value(xy + step)[0] - value(xy - step)[0]) / (2 * h)
        np.testing.assert_allclose(slope[e, k], wanted, 1e-5, 1e-7 * abs(slope).max())


@pytest.mark.long
@pytest.mark.parametrize("grounds", ["one", "several"])
def test_electrodes_of_a_letter_stay_on_it(grounds):
    """From places of no order, two of them on the rim."""
    places = [[0.01, 0.012], [0.0, 0.03], [0.03, 0.0], [0.031, 0.033], [0.07, 0.012]]
    xy = [*places, [0.055, 0.03], [0.012, 0.071], [0.028, 0.05]]
    table = np.eye(8) + np.roll(np.eye(8), 3, 1) if grounds == "several" else None
    letter = tx.Sensor.polygon(LETTER, xy, divisions=(24, 24), conditions=table)
    found = tx.design.design_electrodes(letter, grid=12, starts=1)
    assert found.spread.max() < 0.95 * found.spread_before.max()
    assert letter.on_sheet(found.electrode_xy).all()
    moved = replace(letter, electrode_xy=jnp.asarray(found.electrode_xy))
    inside = -np.asarray(moved.outline.distance(moved.electrode_xy))
    assert inside.min() > 0.55 * 0.005
    apart = np.linalg.norm(found.electrode_xy[:, None] - found.electrode_xy, axis=-1)
    assert (apart + np.eye(8)).min() > 1.3 * 0.005


def test_places_off_the_sheet():
    letter = tx.Sensor.polygon(LETTER, {"grid": 0.02}, divisions=(24, 24))
    with pytest.raises(ValueError, match="places: got 1 off the sheet"):
        tx.design.design_electrodes(letter, [[0.07, 0.07], [0.01, 0.01]], grid=12)
