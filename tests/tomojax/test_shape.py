"""`shape` on voltages of rigs that are not ours (`bench.rigs`)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx
from bench.rigs import draw_rig, draw_strokes, network_of, Strokes
from tomojax import Flag
from tomojax.methods import Rung

TEN = np.array([0, 7, 56, 63, 3, 24, 31, 60, 27, 36])
ALL = np.arange(64)
MIDDLE = np.array([0.08, 0.08])
BARS = (np.array([[0.045, 0.05], [0.045, 0.11]]), np.array([[0.115, 0.05], [0.115, 0.11]]))
MADE = {
    "H": draw_strokes("H", MIDDLE, 0.1, 0.2, 0.3, 0.014),
    "S": draw_strokes("S", MIDDLE, 0.1, -0.3, 0.05, 0.014),
    "frame": draw_strokes("frame", MIDDLE, 0.1, 0.4, 1.0),
    "unlike": Strokes(BARS, (0.02, 0.02), 0.5, presses=(0.2, 1.0)),
    "disc": Strokes((MIDDLE[None],), (0.028,), 0.3),
    "sheet": Strokes((np.array([[0.0, 0.08], [0.16, 0.08]]),), (0.2,), 0.05),
}


@pytest.fixture(scope="module")
def volts():
    rng = np.random.default_rng(77)
    rig = draw_rig(tx.Sensor.grid(dtype=np.float32), rng)
    exact = network_of(rig)
    zero = rig.chain.zero
    return {
        name: rig.chain.read(exact.touched(strokes, ALL), rng) - zero
        for name, strokes in MADE.items()
    }


@pytest.fixture(scope="module")
def method():
    return tx.method(tx.Sensor.grid(dtype=np.float32), "shape", 32)


def batch_of(method, volts, names, grounds, good=None, **options):
    v = np.stack([volts[name][grounds] for name in names]).astype(np.float32)
    run = tx.Batch(method, 1.0, **options)
    return run(v, np.tile(grounds, (len(v), 1)), good)


def inside(name):
    """Which pixels are touched by half or more."""
    part = (np.arange(320) + 0.5) / 320 * 0.16
    points = np.stack(np.meshgrid(part, part, indexing="ij"), -1).reshape(-1, 2)
    each = MADE[name].inside(points).reshape(32, 10, 32, 10).mean((1, 3))
    return each > 0.5


def overlap(found, name):
    truth = inside(name)
    return (found & truth).sum() / (found | truth).sum()


@pytest.fixture(scope="module")
def rows(method, volts):
    return batch_of(method, volts, list(MADE), ALL)


@pytest.mark.long
def test_letters_and_frames_can_be_read(rows, method, volts):
    names = list(MADE)
    for name in ("H", "S", "frame"):
        k = names.index(name)
        assert overlap(rows.touch[k] > 0.5, name) > 0.7, name
        # The image's own half level says the same.
        assert overlap(rows.image[k] > rows.image[k].max() / 2, name) > 0.65, name
        assert rows.contact_count[k] == 1
        assert not rows.flags[k] & Flag.HIGH_RESIDUAL.value
    ten = batch_of(method, volts, ["H", "S", "frame"], TEN)
    two = batch_of(method, volts, ["H", "S", "frame"], np.array([0, 63]))
    for k, name in enumerate(("H", "S", "frame")):
        assert overlap(ten.touch[k] > 0.5, name) > 0.65, name
        assert overlap(two.touch[k] > 0.5, name) > 0.5, name


def test_objects_of_unlike_pressure_have_each_their_level(rows):
    k = list(MADE).index("unlike")
    assert rows.contact_count[k] == 2
    order = np.argsort(-rows.contact_xy[k, :2, 0])  # the stronger is on the right
    g = rows.contact_conductance[k, :2][order]
    area = 0.02 * 0.06 + np.pi * 0.01**2
    np.testing.assert_allclose(g, [0.5 * area, 0.1 * area], rtol=0.15)
    places = 1e3 * rows.contact_xy[k, :2][order]
    np.testing.assert_allclose(places, [[115, 80], [45, 80]], atol=4)
    assert overlap(rows.touch[k] > 0.5, "unlike") > 0.75


def test_deviations_and_probabilities(rows):
    assert rows.touch is not None and rows.image_deviation is not None
    assert ((0 <= rows.touch) & (rows.touch <= 1)).all()
    assert (rows.image_deviation >= 0).all()
    k = list(MADE).index("H")
    sure = (rows.touch[k] < 0.05) | (rows.touch[k] > 0.95)
    assert sure.mean() > 0.8
    truth = inside("H")
    assert (truth[sure] == (rows.touch[k] > 0.5)[sure]).mean() > 0.97


@pytest.mark.long
def test_hard_cases_are_defined_and_flagged(method, volts, rows):
    """The whole sheet, one slot, dead channels, noise alone."""
    k = list(MADE).index("sheet")
    assert np.isfinite(rows.image[k]).all()
    # All of its conductance is on the sheet, beyond which it reaches.
    total = rows.image[k].mean() * 0.16**2
    assert total == pytest.approx(MADE["sheet"].conductance, rel=0.2)
    metal = {"metal": np.full((64, 64), 4.4) * (1 - np.eye(64))}
    plate = batch_of(method, metal, ["metal"], TEN)
    assert np.isfinite(plate.image).all() and plate.flags[0] & Flag.HIGH_RESIDUAL.value
    one = batch_of(method, volts, list(MADE), np.array([9]))
    assert np.isfinite(one.image).all() and np.isfinite(one.residual).all()
    good = np.ones((1, 10, 64), bool)
    good[:, :, [5, 33, 50]] = False
    dead = batch_of(method, volts, ["H"], TEN, good)
    assert overlap(dead.touch[0] > 0.5, "H") > 0.5
    noise = {"none": 3e-4 * np.random.default_rng(1).normal(size=(64, 64))}
    none = batch_of(method, noise, ["none"], TEN, threshold=0.0)
    assert none.contact_count[0] == 0 and none.flags[0] & Flag.NO_CONTACT.value
    assert np.isfinite(none.image).all()


def test_a_lone_contact(rows):
    k = list(MADE).index("disc")
    assert rows.contact_count[k] == 1
    assert np.hypot(*(rows.contact_xy[k, 0] - MIDDLE)) < 1e-3
    assert rows.contact_conductance[k, 0] == pytest.approx(
        MADE["disc"].conductance, rel=0.1
    )


@pytest.mark.long
def test_both_precisions(volts, rows):
    wide = tx.method(tx.Sensor.grid(), "shape", 32)
    v = volts["H"][TEN]
    run = tx.Batch(wide, 1.0)
    double = run(v[None], TEN[None])
    narrow = tx.Batch(tx.method(tx.Sensor.grid(dtype=np.float32), "shape", 32), 1.0)
    single = narrow(v[None].astype(np.float32), TEN[None])
    np.testing.assert_allclose(single.touch, double.touch, atol=0.05)
    np.testing.assert_allclose(single.image, double.image, atol=0.02 * double.image.max())


def test_a_film_goes_on_from_its_frames(method, volts):
    """A frame that begins at the one before ends where it would anew."""
    v = np.stack([volts["H"][TEN], 1.002 * volts["H"][TEN], volts["S"][TEN]])
    v = v.astype(np.float32)
    grounds = np.tile(TEN, (3, 1))
    anew = tx.Batch(method, 1.0)(v, grounds)
    film = tx.Batch(method, 1.0, film=3)(v, grounds)
    for k, name in enumerate(("H", "H", "S")):
        assert overlap(film.touch[k] > 0.5, name) > 0.65
        both = (film.touch[k] > 0.5) & (anew.touch[k] > 0.5)
        assert both.sum() > 0.8 * (anew.touch[k] > 0.5).sum()


@pytest.mark.long
def test_the_image_is_differentiable_by_voltages(volts):
    """By finite differences of whole fits, each with its level: of the sum of an image."""
    method = tx.method(tx.Sensor.grid(), "shape", 16)
    prepared = method.prepare(TEN, np.ones((10, 64), bool), 1.0)
    v = jnp.asarray(volts["H"][TEN])

    def total(v):
        return method.estimate(prepared, v, 1).image.sum()

    value, slope = jax.jit(jax.value_and_grad(total))(v)
    assert np.isfinite(value) and np.isfinite(slope).all()
    # All voltages rise by one in a thousand: more touches, or touches better.
    raised = float(jnp.vdot(slope, v)) / float(value)
    further = float(total(1.001 * v) - total(0.999 * v)) / 0.002 / float(value)
    assert 0 < raised < 3 * further and further < 5


@pytest.mark.long
def test_auto_takes_it_where_smaller_models_do_not_explain(volts):
    method = tx.method(tx.Sensor.grid(dtype=np.float32), "auto", 32)
    lam = method.choose_lambda([])
    v = np.stack([volts[n][TEN] for n in ("disc", "H")]).astype(np.float32)
    rows = tx.Batch(method, lam)(v, np.tile(TEN, (2, 1)))
    assert rows.rung[0] == Rung.POINTS and rows.rung[1] == Rung.SHAPE
    assert rows.touch is None
    assert rows.image[1].max() > 0 and rows.contact_current[1, 0] > 0
