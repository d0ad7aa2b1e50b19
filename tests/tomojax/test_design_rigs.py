"""Designs by simulated rigs: their scenes, errors of place, images of contacts."""

import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx
from tomojax.design import designs_by_place, score
from tomojax.design.objectives import Contact, exact_on_rig
from tomojax.methods import Points

sys.path.append(str(Path(__file__).parents[1]))
from rig import Rig  # noqa: E402


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid(4, 4, divisions=(32, 32), electrode_shunt=1.0)


@pytest.fixture(scope="module")
def images(sensor):
    places = tx.design.design_places(sensor, count=4)
    return tx.design.design_objective(sensor, places, "linear", "rigs", grid=16)


@pytest.mark.parametrize("count", [1, 2])
def test_scenes_of_soft_contacts_are_a_mesh_s(sensor, count):
    places, conductance = np.array([[0.031, 0.042], [0.052, 0.022]])[:count], 1e-4
    none = jnp.zeros((1, count, 16)), jnp.zeros((1, 16), bool), jnp.zeros((16, 16))
    sheet = Points.of(sensor, (8, 8)).sheet
    at = jnp.asarray(places)[None], jnp.asarray([0.006])
    got = exact_on_rig(sheet, *at, *none, conductance)[0]
    density = conductance / (np.pi * 0.006**2)
    wanted = tx.voltages(sensor, tx.Scene(*(tx.Disc(p, 0.006, density) for p in places)))
    assert np.abs(got - wanted).max() < 0.025 * np.abs(wanted).max()


@pytest.mark.long
def test_scenes_of_metal_are_a_network_s():
    """A contact at V0 is no larger than it is: on a mesh it was, by an element."""
    sensor = tx.Sensor.grid(divisions=(32, 32))
    rig = Rig(np.random.default_rng(0), 0, 0, 0, 0)
    places = np.array([[0.0602, 0.0798], [0.0398, 0.1202]])  # between electrodes
    found = np.asarray(
        tx.design.simulate_scenes(sensor, places, radius=0.003, rigs=1).voltages
    )
    for volts, place in zip(found, places):
        inside = rig.disc(place, 0.003)
        exact = rig.scene((inside, 1.0))[0]
        assert np.sqrt(((volts - exact) ** 2).mean()) < 0.03 * np.abs(exact).max()


@pytest.mark.long
def test_metal_on_the_grounded_electrode():
    """No current is left for the sheet, as in a network."""
    rig = Rig(np.random.default_rng(0), 0, 0, 0, 0)
    place = np.array([0.0502, 0.0498])
    ground, other = 18, 27
    exact = rig.scene((rig.disc(place, 0.002), 1.0))[0]
    wide = tx.Sensor.grid(divisions=(32, 32))
    # Two scenes as above: one program.
    got = np.asarray(tx.design.simulate_scenes(wide, [place] * 2, rigs=1).voltages[0])
    assert np.abs(got[ground] - exact[ground]).max() < 0.05
    assert np.ptp(got[ground]) < 0.01 and np.ptp(got[other]) > 1


@pytest.mark.long
def test_a_radius_for_each_scene(sensor):
    places = np.array([[0.03, 0.04]] * 2)
    small, large = tx.design.simulate_scenes(
        sensor, places, radius=[0.001, 0.003], rigs=1
    ).voltages
    same, _ = tx.design.simulate_scenes(sensor, places, radius=0.001, rigs=1).voltages
    assert np.abs(small - large).max() > 0.1
    assert np.abs(small - same).max() < 0.01  # noise


@pytest.mark.parametrize(
    "words, message",
    [
        ({"places": np.zeros((3, 4))}, r"places: got shape \(3, 4\)"),
        ({"places": [[0.03, 0.09]] * 2}, "places: got 2 off the sheet"),
        ({"places": [[0.03, np.nan]] * 2}, "places: "),
        ({"radius": 0.0}, "radius: got"),
        ({"radius": [0.001] * 3}, r"radius: got shape \(3,\)"),
        ({"conductance": -1.0}, "conductance: got"),
        ({"rigs": 3}, "rigs: got 3, expected 1 to 2"),
    ],
)
def test_bad_scenes(sensor, words, message):
    with pytest.raises(ValueError, match=message):
        tx.design.simulate_scenes(
            sensor, **{"places": [[0.03, 0.04]] * 2, "rigs": 1, **words}
        )


@pytest.mark.long
def test_a_move_of_the_contact_is_its_score(sensor):
    """What the voltages of a contact a little further on pull by is that move."""
    points = Points.of(sensor, (8, 8))
    contact, ground = Contact.of(points.sheet, None, 1e-4), jnp.asarray(5)
    place, move = jnp.asarray([0.033, 0.041]), 1e-6
    there = place + jnp.asarray([move, 0])
    columns = contact.columns(place, ground)
    off = 1.3 * contact.columns(there, ground)[0] - columns[0]
    told, pull = score(columns, columns, off[None])
    known = told + jnp.diag(jnp.asarray([0.0, 0.0, 1e-9]))
    moved = jnp.linalg.solve(known, pull[0]) * points.sheet.unit
    # Of voltages 1.3 times as high the move counts 1.3 times.
    np.testing.assert_allclose(moved[:2], [1.3 * move, 0], atol=0.01 * move)


@pytest.mark.long
def test_errors_on_rigs(sensor):
    places = tx.design.design_places(sensor, count=6)
    objective = tx.design.design_objective(sensor, places, criterion="rigs")
    ones = jnp.ones(16)
    figures = np.asarray(objective(ones))
    assert (figures > 1e-6).all() and (figures < 2e-3).all()
    found = tx.design.design(objective, 3)
    assert np.isnan(found.bound) and found.value <= found.greedy * (1 + 1e-9)
    quiet = replace(objective, scores=objective.scores / 2)  # pyright: ignore
    np.testing.assert_allclose(quiet(ones), figures / 2, rtol=1e-9)
    slope = jax.jit(jax.grad(objective.value))(0.25 * ones)
    assert np.isfinite(np.asarray(slope)).all()


@pytest.mark.long
def test_images_on_rigs(sensor, images):
    """Figures are of places and widths; alone they are the same; slopes are right."""
    w = jnp.asarray(np.random.default_rng(3).uniform(0.2, 1, 16))
    value = jax.jit(lambda w: images.value(w))
    slope_at = jax.jit(jax.grad(lambda w: images.value(w)))
    figures = np.asarray(jax.jit(lambda w: images(w))(w))
    assert images.lam > 0
    assert figures.shape == (4,) and (figures > 0.002).all() and (figures < 0.05).all()
    one = jax.jit(lambda k: images.alone(k).value(w))
    alone = [float(one(jnp.asarray(k))) for k in range(4)]
    np.testing.assert_allclose(alone, figures, rtol=1e-9)
    slope, h = slope_at(w), 1e-6
    for k in (0, 7, 15):
        step = h * jnp.zeros(16).at[k].set(1.0)
        wanted = (value(w + step) - value(w - step)) / (2 * h)
        np.testing.assert_allclose(slope[k], wanted, rtol=1e-5, atol=1e-9)
    even = slope_at(jnp.full(16, 0.5))
    assert np.isfinite(np.asarray(even)).all()


@pytest.mark.long
def test_images_by_place(sensor, images):
    """Designs are better than sets that are drawn."""
    sets, bound = designs_by_place(images, 3)
    assert np.isnan(np.asarray(bound)).all()
    value = jax.jit(lambda k, w: images.alone(k).value(w))
    rng, kinds = np.random.default_rng(0), np.eye(16)
    for k, chosen in enumerate(sets):
        assert chosen.sum() == 3
        drawn = [kinds[rng.permutation(16)[:3]].sum(0) for _ in range(30)]
        others = [float(value(k, jnp.asarray(w))) for w in drawn]
        assert float(value(k, chosen)) <= np.quantile(others, 0.05)


def test_what_rigs_are_not_for(sensor):
    places = tx.design.design_places(sensor, count=2)
    with pytest.raises(ValueError, match="criterion: got 'rigs' of 'source'"):
        tx.design.design_objective(sensor, places, "source", "rigs")
    with pytest.raises(ValueError, match="noise: got a value for criterion 'rigs'"):
        tx.design.design_objective(sensor, places, criterion="rigs", noise=1e-3)
