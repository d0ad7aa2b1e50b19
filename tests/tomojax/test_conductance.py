"""`conductance` and `auto` on voltages of a rig that is not ours (tests/rig.py)."""

import jax
import numpy as np
import pytest
from rig import NOMINAL, Rig

import tomojax as tx
from tomojax import Flag
from tomojax.methods import Rung

TEN = np.array([0, 63, 7, 56, 18, 21, 42, 45, 27, 36])
# Ten fingertips or so, at least 25 mm apart.
MANY = np.array([[20, 20], [50, 30], [90, 25], [130, 30], [30, 60], [70, 65], [115, 70]])


@pytest.fixture(scope="module")
def rig():
    return Rig(np.random.default_rng(8))


@pytest.fixture(scope="module")
def scenes(rig):
    """Name: the volts of ten grounds, and the total conductance."""
    made = {
        "faint": [(rig.disc([0.062, 0.051], 0.005), 3e-6)],
        "strong": [(rig.disc([0.105, 0.086], 0.007), 4e-4)],
        "rim": [(rig.ring([0.078, 0.082], 0.026, 0.031), 6e-4)],
        "many": [(rig.disc(place / 1e3, 0.005), 3e-5) for place in MANY],
        "hand": [(rig.disc([0.08, 0.08], 0.06), 2e-3)],
        "short": [(rig.disc(NOMINAL[27], 0.018), 10.0)],
        "nothing": [],
    }
    return {
        name: (rig.measure(rig.scene(*contacts)[0])[TEN], sum(g for _, g in contacts))
        for name, contacts in made.items()
    }


def run(method, scenes, names, **options):
    volts = np.stack([scenes[name][0] for name in names])
    batch = tx.Batch(method, method.choose_lambda([]), **options)
    return batch(volts, np.tile(TEN, (len(names), 1)), flags=None)


@pytest.fixture(scope="module")
def rows(scenes):
    method = tx.method(tx.Sensor.grid(dtype=np.float32), "conductance", 32)
    return run(method, scenes, list(scenes), threshold=0.0)


def test_total_conductance(scenes, rows):
    """Over decades, from faint to many contacts; of metal a lower bound."""
    for k, (name, (_, total)) in enumerate(scenes.items()):
        found = rows.image[k].sum() * 0.005**2
        if name in ("faint", "strong", "rim", "many", "hand"):
            assert abs(found / total - 1) < (0.15 if name == "hand" else 0.1), name
        if name == "short":
            assert 1e-3 < found < 10.0


def test_places_and_regions(scenes, rows):
    names = list(scenes)
    for name, place in (("faint", [62, 51]), ("strong", [105, 86]), ("rim", [78, 82])):
        k = names.index(name)
        assert rows.contact_count[k] == 1, name
        assert np.hypot(*(1e3 * rows.contact_xy[k, 0] - place)) < 2.5, name
        current, g = rows.contact_current[k, 0], rows.contact_conductance[k, 0]
        assert 0 < current / g < 4.5  # V0 − u
    assert rows.contact_count[names.index("many")] == 4  # as many as were asked for
    k = names.index("nothing")
    assert rows.contact_count[k] == 0 and rows.flags[k] == Flag.NO_CONTACT


def test_what_is_wide_is_seen_by_its_rim_alone(scenes, rows):
    vague = (rows.flags & tx.Flag.PLACE_UNCERTAIN) > 0
    assert [name for name, on in zip(scenes, vague) if on] == ["hand", "short"]


def test_a_rim_has_a_hole(scenes, rows):
    image = rows.image[list(scenes).index("rim")]
    x = (np.arange(32) + 0.5) * 0.005
    away = np.hypot(x[:, None] - 0.078, x - 0.082)
    hole, rim = image[away < 0.016].mean(), image[abs(away - 0.0285) < 0.004].mean()
    assert hole < 0.02 * rim


def test_both_precisions(scenes, rows):
    wide = tx.method(tx.Sensor.grid(), "conductance", 32)
    names = ["faint", "strong", "rim"]
    other = run(wide, scenes, names, threshold=0.0)
    for k, name in enumerate(names):
        i = list(scenes).index(name)
        apart = rows.contact_xy[i, 0] - other.contact_xy[k, 0]
        # A rim's middle is less certain than any one contact's place.
        assert np.hypot(*apart) < (3e-4 if name == "rim" else 5e-5), name
        np.testing.assert_allclose(other.image[k].sum(), rows.image[i].sum(), rtol=0.01)


def test_every_row_is_defined(rows):
    assert np.isfinite(rows.residual).all() and np.isfinite(rows.image).all()
    assert not (rows.flags & Flag.SOLVE_FAILED).any()
    assert (rows.image >= 0).all()


def test_auto_takes_the_smallest_that_explains(scenes):
    """One disc at most: two and more are for larger models."""
    method = tx.method(tx.Sensor.grid(dtype=np.float32), "auto", 32)
    names = ["nothing", "faint", "strong", "many", "short"]
    found = run(method, scenes, names, contacts=1)
    rungs = dict(zip(names, found.rung))
    assert rungs["nothing"] == Rung.NOTHING
    assert rungs["faint"] == rungs["strong"] == Rung.POINTS
    assert rungs["many"] >= Rung.SOURCE and rungs["short"] == Rung.SHAPE
    # The same, frame by frame in one compiled function.
    k = names.index("many")
    prepared = method.prepare(TEN, np.ones((10, 64), bool), method.choose_lambda([]))
    one = jax.jit(lambda p, v: method.estimate(p, v, 1))
    estimate = one(prepared, scenes["many"][0].astype(np.float32))
    assert estimate.rung == found.rung[k]
    # Its iterations end where rounding lets them, within a hundredth of a pitch.
    np.testing.assert_allclose(estimate.contacts.xy, found.contact_xy[k], atol=2e-4)
