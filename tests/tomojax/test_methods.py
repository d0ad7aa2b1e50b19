"""Methods on frames: `source` and `linear`, and what any of them must do."""

import numpy as np
import pytest
from rig import Rig

import tomojax as tx
from tomojax import Flag
from tomojax.methods import Frame

GROUNDS = np.array([0, 63, 27])


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid(dtype=np.float32)


@pytest.fixture(scope="module", params=["source", "linear"])
def method(request, sensor):
    return tx.method(sensor, request.param, 32)


@pytest.fixture(scope="module")
def volts():
    """Exact voltages with noise, of the finite-element route on a finer mesh."""
    fine = tx.Sensor.grid(divisions=(80, 80))
    v = tx.voltages(fine, tx.Disc([0.094, 0.067], 0.006, 0.05), GROUNDS)
    rng = np.random.default_rng(0)
    return (np.asarray(v) + rng.normal(0, 3e-4, (20, *v.shape))).astype(np.float32)


def batch(method, **options):
    return tx.Batch(method, method.choose_lambda([]), **options)


def test_finds_the_contact(method, volts):
    rows = batch(method)(volts, np.tile(GROUNDS, (20, 1)))
    assert (rows.contact_count == 1).all() and (rows.flags == 0).all()
    apart = np.hypot(*(rows.contact_xy[:, 0] - [0.094, 0.067]).T)
    assert apart.max() < 2e-3
    assert np.isfinite(rows.image).all() and rows.image.shape == (20, 32, 32)
    assert np.isnan(rows.contact_conductance).all()  # neither method tells


def test_it_has_the_current(sensor, method, volts):
    """A contact's current is that from the object, within the model's error."""
    rows = batch(method)(volts, np.tile(GROUNDS, (20, 1)))
    fine = tx.Sensor.grid(divisions=(80, 80))
    g = tx.sensor.contact_conductance(fine, tx.Disc([0.094, 0.067], 0.006, 0.05))
    # One contact: its current is V0 − u through g, from the ground path's own drop.
    into_ground = np.asarray(tx.voltages(fine, g, GROUNDS))[np.arange(3), GROUNDS] / 4.0
    near = 0.05 if method.image_unit == "A/m^2" else 0.2  # as if electrodes were no metal
    np.testing.assert_allclose(rows.contact_current[:, 0], into_ground.mean(), rtol=near)
    if method.image_unit != "A/m^2":
        return
    # Of the image the most: how much it is in all is in the slots' offsets, not used.
    total = rows.image.sum((1, 2)) * float(method.cell.prod())
    assert (0.6 * into_ground.mean() < total).all() and (total < into_ground.mean()).all()


def test_the_image_is_about_the_contact_and_not_the_nearest_electrode(sensor):
    """Between electrodes, where an image of λI leans; voltages that are not our own."""
    rig, place = Rig(np.random.default_rng(5)), np.array([0.060, 0.100])
    volts, _ = rig.scene((rig.disc(place, 0.004), 1e-4))
    frame, grounds = rig.measure(volts)[None, GROUNDS].astype(np.float32), GROUNDS[None]
    method = tx.method(sensor, "source", 32)
    lam = method.choose_lambda([Frame(frame[0], GROUNDS, np.ones((3, 64), bool))])
    image = tx.Batch(method, lam)(frame, grounds).image[0]
    highest = (np.array(np.unravel_index(image.argmax(), image.shape)) + 0.5) * 0.005
    assert np.hypot(*(highest - place)) < 5e-3  # λI: 10.6 mm


def test_bad_channels_are_left_out(method, volts):
    """Whatever they read: the same bytes as with any other value there."""
    good = np.ones(volts.shape, bool)
    good[:, 1, [5, 30]] = False
    good[3:, 2] = False
    run = batch(method)
    spoiled = np.where(good, volts, np.nan).astype(np.float32)
    for_rails = np.where(good, volts, 5.0).astype(np.float32)
    grounds = np.tile(GROUNDS, (20, 1))
    a, b = run(spoiled, grounds, good), run(for_rails, grounds, good)
    for one, other in zip(a, b):
        np.testing.assert_array_equal(one, other)
    whole = run(volts, grounds)
    apart = np.hypot(*(a.contact_xy[:, 0] - whole.contact_xy[:, 0]).T)
    assert apart.max() < (2e-3 if "Source" in type(method).__name__ else 0.03)


def test_frames_without_data_or_contact(method, volts):
    good = np.ones(volts.shape, bool)
    good[4] = False
    v = volts.copy()
    v[7] = 1e-4
    rows = batch(method)(v, np.tile(GROUNDS, (20, 1)), good)
    assert rows.flags[4] == Flag.NO_DATA and rows.flags[7] == Flag.NO_CONTACT
    assert np.isnan(rows.image[4]).all() and np.isnan(rows.residual[4])
    np.testing.assert_allclose(rows.residual[7], 1e-4, rtol=1e-5)
    assert (rows.image[7] == 0).all() and rows.contact_count[[4, 7]].tolist() == [0, 0]


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_a_range_that_ends_too_low_is_flagged(method, volts, kind):
    volts = volts[:4].astype(kind)
    cut = np.minimum(volts, np.sort(volts, -1)[..., -10:-9])
    under = np.tile(GROUNDS, (4, 1))
    assert (batch(method)(cut, under).flags & tx.Flag.SATURATED).all()
    # A few at the end of the range may be.
    top = np.sort(volts, -1)[..., -8:-7]
    for whole in (volts, np.minimum(volts, top)):
        assert not (batch(method)(whole, under).flags & tx.Flag.SATURATED).any()


def test_wrong_model_is_flagged(method, rng):
    v = rng.uniform(0, 4, (3, 3, 64)).astype(np.float32)
    rows = batch(method)(v, np.tile(GROUNDS, (3, 1)))
    assert (rows.flags & Flag.HIGH_RESIDUAL.value).all()


def test_grounds_that_change_from_frame_to_frame(sensor, volts, rng):
    """As one by one."""
    run = batch(tx.method(sensor, "source", 24))
    order = np.array([rng.permutation(3) for _ in range(20)])
    mixed = np.take_along_axis(volts, order[..., None], 1)
    rows = run(mixed, GROUNDS[order])
    for k in range(0, 20, 5):
        alone = run(mixed[k : k + 1], GROUNDS[order[k : k + 1]])
        np.testing.assert_allclose(alone.contact_xy[0], rows.contact_xy[k], atol=1e-6)


def test_more_ground_sets_than_are_kept(sensor, monkeypatch):
    """Each frame its own grounds: prepared, forgotten, prepared again."""

    monkeypatch.setattr("tomojax.methods._batch._KEPT", 2)
    method = tx.method(sensor, "source", 16)
    run, again = tx.Batch(method, 1e8), tx.Batch(method, 1e8)
    v = np.random.default_rng(0).uniform(1, 2, (9, 1, 64)).astype(np.float32)
    rows = run(v, np.arange(9)[:, None])
    assert len(run._prepared) == 2
    for k in range(9):
        one = again(v[k : k + 1], np.array([[k]]))
        np.testing.assert_allclose(one.residual[0], rows.residual[k], rtol=1e-5)


def test_lambda_of_a_recording(sensor, volts):
    """The residual is what nominal values leave: within a factor of two."""
    method = tx.method(sensor, "source", 24)
    good = np.ones(volts.shape[1:], bool)
    frames = [tx.methods.Frame(v, GROUNDS, good) for v in volts[:4]]
    rows = tx.Batch(method, method.choose_lambda(frames))(volts, np.tile(GROUNDS, (20, 1)))
    part = rows.residual / np.sqrt((volts**2).mean((1, 2)))
    assert ((part > 0.007) & (part < 0.03)).all()


def test_bad_arguments(sensor):
    with pytest.raises(ValueError, match="method: got 'magic', expected one of"):
        tx.method(sensor, "magic")
    with pytest.raises(ValueError, match="got 'positive', expected 'source', which took"):
        tx.method(sensor, "positive")
    with pytest.raises(ValueError, match="'conductance', expected 'shape', which took"):
        tx.make_step(sensor, "conductance")
    with pytest.raises(ValueError, match="grid: got 3"):
        tx.method(sensor, "source", 3)
    method = tx.method(sensor, "source", 24)
    with pytest.raises(ValueError, match="lam: got nan"):
        tx.Batch(method, float("nan"))
    with pytest.raises(ValueError, match="contacts: got 0"):
        tx.Batch(method, 1.0, contacts=0)
    run, v, g = (
        tx.Batch(method, 1e8),
        np.ones((2, 3, 64), np.float32),
        np.zeros((2, 3), int),
    )
    with pytest.raises(ValueError, match="voltages: got shape"):
        run(v[..., :60], g)
    with pytest.raises(ValueError, match="grounds: got an electrode that is none"):
        run(v, g + 64)
    with pytest.raises(ValueError, match="voltages: got NaN where good"):
        run(v * np.nan, g, np.ones(v.shape, bool))
