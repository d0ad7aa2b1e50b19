"""`points` on a rig that is not ours, with noise, told nominal values alone."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rig import NOMINAL, Rig

import tomojax as tx
from tomojax import Flag
from tomojax.kernels.contacts import NOT_ROUND
from tomojax.methods.points import Found, Ladder, wants_curve

CORNERS = [0, 63]


@pytest.fixture(scope="module")
def rig():
    return Rig(np.random.default_rng(11))


@pytest.fixture(scope="module")
def scenes(rig):
    """Name: voltages of all 64 grounds, and of each contact place and conductance."""
    rng = np.random.default_rng(12)
    found = {}
    for k in range(10):
        radius, total = rng.uniform(0.003, 0.009), 10 ** rng.uniform(-5.5, -3)
        inside = rig.disc(rng.uniform(radius + 1e-3, 0.159 - radius, 2), radius)
        found[f"one_{k}"] = [(inside, total)]
    for k, apart in enumerate((0.03, 0.03, 0.02)):
        turn, middle = rng.uniform(0, np.pi), rng.uniform(0.03, 0.13, 2)
        half = apart / 2 * np.array([np.cos(turn), np.sin(turn)])
        total = 10 ** rng.uniform(-4.5, -3.5)
        found[f"two_{k}"] = [
            (rig.disc(middle + half, 0.005), total),
            (rig.disc(middle - half, 0.005), total / rng.uniform(1, 8)),
        ]
    found["bar"] = [(rig.bar([0.083, 0.071], 0.075, 0.01, 0.6), 8e-4)]
    found["metal_bar"] = [(rig.bar([0.09, 0.078], 0.07, 0.011, 2.1), 3.0)]
    found["ring"] = [(rig.ring([0.075, 0.084], 0.024, 0.03), 6e-4)]
    found["metal"] = [(rig.disc([0.091, 0.066], 0.012), 5.0)]
    found["three"] = [
        (rig.disc(xy, 0.006), 2e-4) for xy in ([0.04, 0.05], [0.12, 0.04], [0.07, 0.12])
    ]
    return {name: rig.scene(*contacts) for name, contacts in found.items()}


@pytest.fixture(scope="module")
def method():
    return tx.method(tx.Sensor.grid(dtype=np.float32), "points", 32)


@pytest.fixture(scope="module")
def rows(rig, scenes, method):
    """Rows of all scenes, in their order, from the two corner slots."""
    volts = np.stack([rig.measure(v)[CORNERS] for v, _ in scenes.values()])
    return tx.Batch(method, 1.0, contacts=3)(volts, np.tile(CORNERS, (len(volts), 1)))


def apart(row_xy, truth):
    """The farthest of the places from its truth, matched as fits best, m."""
    places = np.array([place for place, _ in truth])
    ways = np.hypot(*(row_xy[: len(places), None] - places).transpose(2, 0, 1))
    return ways.min(0).max()


def test_how_many_and_where(scenes, rows):
    errors = {}
    for k, (name, (_, truth)) in enumerate(scenes.items()):
        assert rows.contact_count[k] == len(truth), name
        errors[name] = apart(rows.contact_xy[k], truth)
    ones = [e for name, e in errors.items() if name.startswith("one")]
    assert np.median(ones) < 0.3e-3 and max(ones) < 1e-3
    assert max(errors.values()) < 3e-3
    high = (rows.flags & (Flag.HIGH_RESIDUAL | Flag.SOLVE_FAILED)) > 0
    assert not high.any()


@pytest.mark.long
def test_three_on_few_electrodes():
    """Also where two discs explain little, or one of them stands for two."""
    told = {"divisions": (40, 40), "electrode_shunt": 1.0, "dtype": np.float32}
    sensor = tx.Sensor.grid(5, 5, **told)
    grounds = np.array([0, 4, 20, 24, 12, 2, 10, 14, 22, 6])
    rng, pitch = np.random.default_rng(3), sensor.mean_pitch
    made, true = [], []
    while len(made) < 8:
        places = rng.uniform(0.1, 0.9, (3, 2)) * np.asarray(sensor.size)
        if np.linalg.norm(places - np.roll(places, 1, 0), axis=1).min() < 1.5 * pitch:
            continue
        siemens, radii = 10 ** rng.uniform(-4.8, -4.0, 3), rng.uniform(0.2, 0.4, 3) * pitch
        discs = map(tx.Disc.of_total, places, radii, siemens)
        made.append(np.asarray(tx.voltages(sensor, tx.Scene(*discs), grounds)))
        true.append(places)
    volts = np.stack(made) + 2e-4 * rng.normal(size=(8, 10, 25))
    batch = tx.Batch(tx.method(sensor, "points", 16), images=False)
    rows = batch(volts.astype(np.float32), np.tile(grounds, (8, 1)))
    assert rows.contact_count.tolist() == [3] * 8
    assert max(map(apart, rows.contact_xy, [[(p, 0) for p in t] for t in true])) < 1e-3


def test_frames_together_ask_for_a_curve_as_each_alone():
    """Two round discs that explain a frame ask for no bar; two long ones, or rivals, do."""
    parameters = np.zeros((4, 3, 6), np.float32)
    parameters[1:, :2, 3] = 2 * NOT_ROUND
    parameters[2, 1, 3] = 0  # one is round
    zero, last, none = np.zeros(4, np.float32), np.arange(4) == 3, np.zeros(4, bool)
    discs = Found(*[zero] * len(Found._fields))
    discs = discs._replace(parameters=parameters, count=np.full(4, 2))
    for why in ((last, none), (none, last)):
        ladder = Ladder(*[discs] * 3, *[zero] * 3, np.ones(4, bool), discs, *why)
        parts = [jax.tree.map(lambda a, k=k: a[k], ladder) for k in range(4)]
        each = [bool(wants_curve(part)) for part in parts]
        assert each == [False, True, False, True]
        assert np.asarray(wants_curve(ladder)).tolist() == each


def test_two_or_one_long_one(rig, method):
    """Near pairs and ellipses are counted right, or in doubt; small discs are sure."""
    rng, made, true = np.random.default_rng(15), [], []
    for k in range(18):
        turn, middle = rng.uniform(0, np.pi), rng.uniform(0.04, 0.12, 2)
        along = np.array([np.cos(turn), np.sin(turn)])
        if k % 3 == 0:
            discs = [rig.disc(middle + s * 0.0075 * along, 0.005) for s in (1, -1)]
            scene = [(inside, 10 ** rng.uniform(-4.5, -3.5)) for inside in discs]
        else:
            axes = np.array([0.018, 0.008]) if k % 3 == 1 else np.array([0.006, 0.006])
            away = (rig.cells - middle) @ np.stack([along, along[::-1] * [-1, 1]], 1) / axes
            scene = [((away**2).sum(1) < 1, 10 ** rng.uniform(-4.5, -3))]
        made.append(rig.measure(rig.scene(*scene)[0])[CORNERS])
        true.append(len(scene))
    found = tx.Batch(method, 1.0, contacts=3)(np.stack(made), np.tile(CORNERS, (18, 1)))
    doubt = found.flags & Flag.COUNT_UNCERTAIN > 0
    assert ((found.contact_count == true) | doubt).sum() >= 17
    assert (found.contact_count[::3] == 2).sum() >= 3
    assert not doubt[2::3].any()


def test_soft_bars_are_no_pairs(rig, method):
    """Bars of 26 to 50 mm: two discs explain their voltages, within what errors leave."""
    rng, made = np.random.default_rng(8), []
    for _ in range(16):
        turn, middle = rng.uniform(0, np.pi), rng.uniform(0.035, 0.125, 2)
        bar = rig.bar(middle, rng.uniform(0.026, 0.05), 0.006, turn)
        made.append(rig.measure(rig.scene((bar, 10 ** rng.uniform(-5.2, -4)))[0])[CORNERS])
    found = tx.Batch(method, 1.0, contacts=3)(np.stack(made), np.tile(CORNERS, (16, 1)))
    doubt = found.flags & Flag.COUNT_UNCERTAIN > 0
    assert ((found.contact_count == 1) | doubt).sum() >= 15


def test_shapes(scenes, rows):
    named = {name: k for k, name in enumerate(scenes)}
    bar, ring, metal = (named[name] for name in ("bar", "ring", "metal"))
    angle, radius = rows.contact_angle[:, 0], rows.contact_radius[:, 0]
    assert abs(np.degrees(angle[bar] - 0.6)) < 1.5
    assert abs(np.degrees(angle[named["metal_bar"]] - 2.1)) < 1.5
    # Discs with the same second moments.
    assert abs(radius[bar] / (0.075 / np.sqrt(6)) - 1) < 0.12
    assert abs(radius[ring] / (0.027 * np.sqrt(2)) - 1) < 0.1
    assert abs(radius[metal] / (0.012 * np.sqrt(2)) - 1) < 0.15
    assert np.isnan(angle[ring])
    assert rows.image[ring, 15, 16] < 0.1 * rows.image[ring].max()  # the hole


def test_conductance(scenes, rows):
    """Where the contact itself is not a short beside the sheet."""
    errors = []
    for k, (name, (_, truth)) in enumerate(scenes.items()):
        if name.startswith("one") and truth[0][1] < 2e-4:
            errors.append(rows.contact_conductance[k, 0] / truth[0][1] - 1)
    assert len(errors) >= 4
    assert np.median(np.abs(errors)) < 0.06 and np.abs(errors).max() < 0.2


@pytest.mark.long
def test_float32_beside_float64(scenes, method):
    wide = tx.method(tx.Sensor.grid(), "points", 32)
    names = list(scenes)[:13]  # single contacts and pairs
    volts = np.stack([scenes[name][0][CORNERS] for name in names])
    grounds = np.tile(CORNERS, (len(names), 1))
    # Three as elsewhere in this file, where that is compiled already.
    one = tx.Batch(method, 1.0, contacts=3)(volts, grounds)
    other = tx.Batch(wide, 1.0, contacts=2)(volts, grounds)
    np.testing.assert_array_equal(one.contact_count, other.contact_count)
    np.testing.assert_allclose(one.contact_xy[:, :2], other.contact_xy, atol=5e-5)


@pytest.mark.long
def test_one_frame_compiled_whole(scenes, method):
    """`estimate` under `jit`, as a step function has it: what `Batch` says in parts."""
    names = ["one_0", "two_0"]
    prepared = method.prepare(np.array(CORNERS), np.ones((2, 64), bool), 1.0)
    run = jax.jit(lambda p, v: method.estimate(p, v, 2))
    volts = np.stack([scenes[name][0][CORNERS] for name in names]).astype(np.float32)
    rows = tx.Batch(method, 1.0, contacts=3)(volts, np.tile(CORNERS, (2, 1)))
    for k in range(2):
        contacts, image, residual, *_ = run(prepared, volts[k])
        assert contacts.count == rows.contact_count[k]
        np.testing.assert_allclose(contacts.xy, rows.contact_xy[k, :2], atol=1e-5)
        np.testing.assert_allclose(image, rows.image[k], atol=0.01 * rows.image[k].max())
        np.testing.assert_allclose(residual, rows.residual[k], rtol=0.01)


@pytest.mark.long
def test_gradients_through_a_whole_estimate(scenes):
    """In reverse, through the voltages, against differences: Gauss and Newton's part."""
    method = tx.method(tx.Sensor.grid(), "points", 8)
    volts, _ = scenes["one_0"]
    prepared = method.prepare(np.array(CORNERS), np.ones((2, 64), bool), 1.0)

    def place(v: jax.Array) -> jax.Array:
        return method.estimate(prepared, v, 1).contacts.xy[0]

    v = jnp.asarray(volts[CORNERS], float)
    along = jnp.asarray(np.random.default_rng(0).normal(size=v.shape))
    slope = jnp.tensordot(jax.jit(jax.jacrev(place))(v), along, 2)
    run = jax.jit(place)
    difference = (run(v + 1e-4 * along) - run(v - 1e-4 * along)) / 2e-4
    np.testing.assert_allclose(slope, difference, atol=0.05 * float(abs(difference).max()))


@pytest.mark.long
def test_stated_deviations(rig, method):
    """Feeble contacts, where noise is all that there is, and strong ones, which say so."""
    rng = np.random.default_rng(5)
    volts, places = [], []
    for _ in range(12):
        exact, truth = rig.scene((rig.disc(rng.uniform(0.02, 0.14, 2), 0.006), 3e-7))
        # Noise is what is tested: six readings of each, without the channels' zeros.
        volts += [rig.measure(exact)[CORNERS] - rig.zero for _ in range(6)]
        places += [truth[0][0]] * 6
    rows = tx.Batch(method, 1.0, contacts=2, images=False)(
        np.array(volts), np.tile(CORNERS, (len(volts), 1))
    )
    assert (rows.contact_count == 1).all()
    assert not (rows.flags & Flag.MODEL_LIMITED).any()
    z = (rows.contact_xy[:, 0] - places) / np.sqrt(rows.contact_covariance[:, 0, :2])
    # Zeros are part of the noise that is expected, a third of its square.
    inside = (np.abs(z) < np.sqrt(0.3**2 / 0.45**2)).mean()
    assert 0.58 < inside < 0.78


@pytest.mark.long
def test_unusual_errors_widen_what_is_stated(scenes, method, rows):
    """Gains that are 2 % off, where a thousandth is expected: said, and σ follows."""
    assert not (rows.flags[:10] & Flag.MODEL_LIMITED).any()
    gain = 1 + 0.02 * np.random.default_rng(2).normal(size=64)
    volts = np.stack([scenes[name][0][CORNERS] for name in list(scenes)[:10]])
    grounds = np.tile(CORNERS, (10, 1))
    off = tx.Batch(method, 1.0, contacts=3)(volts * gain, grounds)
    assert (off.flags & Flag.MODEL_LIMITED).all()
    c, usual = off.contact_covariance[:, 0], rows.contact_covariance[:10, 0]
    assert (c[:, 0] + c[:, 1] > 3 * (usual[:, 0] + usual[:, 1])).mean() >= 0.8
    assert (c[:, 0] * c[:, 1] > c[:, 2] ** 2).all()  # an ellipse


@pytest.mark.long
def test_scenes_that_no_disc_explains(rig, method):
    """Each has a result that is defined, or a flag that says that there is none."""
    inside = [
        rig.disc(NOMINAL[27], 0.006),  # on the grounded electrode
        rig.disc([0.08, 0.08], 0.07),  # a whole hand
    ]
    scenes = [rig.scene((inside[0], 3e-4))[0][[27, 0]]]
    scenes.append(rig.scene((inside[1], 2e-3))[0][[27, 0]])
    ten = rng_places(10)
    scenes.append(rig.scene(*((rig.disc(p, 0.004), 5e-5) for p in ten))[0][[27, 0]])
    scenes.append(np.zeros((2, 64)))
    volts = rig.measure(np.array(scenes))
    good = np.ones(volts.shape, bool)
    rows = tx.Batch(method, 1.0, contacts=3)(volts, np.tile([27, 0], (4, 1)), good)
    assert rows.contact_count[0] == 1
    assert np.hypot(*(rows.contact_xy[0, 0] - NOMINAL[27])) < 3e-3
    # A hand or ten contacts are not what three discs explain: that is said.
    assert (rows.contact_count[1:3] >= 1).all()
    assert rows.flags[2] & Flag.HIGH_RESIDUAL
    assert rows.flags[3] == Flag.NO_CONTACT and rows.contact_count[3] == 0
    inside = np.isfinite(rows.contact_xy)
    assert ((rows.contact_xy >= 0) & (rows.contact_xy <= 0.16))[inside].all()


def rng_places(count):
    """Places at least 25 mm from each other."""
    rng, places = np.random.default_rng(3), np.zeros((0, 2))
    while len(places) < count:
        new = rng.uniform(0.015, 0.145, 2)
        if (np.hypot(*(places - new).T) > 0.025).all():
            places = np.vstack([places, new])
    return places


def test_dead_electrodes_are_left_out(rig, scenes, method):
    volts, truth = scenes["one_0"]
    volts = rig.measure(volts)[CORNERS][None].repeat(2, 0)
    near = np.argsort(np.hypot(*(NOMINAL - truth[0][0]).T))[:2]
    good = np.ones(volts.shape, bool)
    good[1, :, near] = False
    volts[1, :, near] = 5.0
    rows = tx.Batch(method, 1.0, contacts=3)(volts, np.tile(CORNERS, (2, 1)), good)
    assert (rows.contact_count == 1).all()
    assert np.hypot(*(rows.contact_xy[1, 0] - truth[0][0])) < 2e-3
