"""`auto` on voltages of a rig that is not ours (tests/rig.py)."""

import jax
import numpy as np
import pytest
from rig import NOMINAL, Rig

import tomojax as tx
from tomojax.methods import Rung

TEN = np.array([0, 63, 7, 56, 18, 21, 42, 45, 27, 36])
# Ten fingertips or so, at least 25 mm apart.
MANY = np.array([[20, 20], [50, 30], [90, 25], [130, 30], [30, 60], [70, 65], [115, 70]])


@pytest.fixture(scope="module")
def rig():
    return Rig(np.random.default_rng(8))


@pytest.fixture(scope="module")
def scenes(rig):
    """Name: the volts of ten grounds."""
    made = {
        "faint": [(rig.disc([0.062, 0.051], 0.005), 3e-6)],
        "strong": [(rig.disc([0.105, 0.086], 0.007), 4e-4)],
        "many": [(rig.disc(place / 1e3, 0.005), 3e-5) for place in MANY],
        "short": [(rig.disc(NOMINAL[27], 0.018), 10.0)],
        "nothing": [],
    }
    return {
        name: rig.measure(rig.scene(*contacts)[0])[TEN] for name, contacts in made.items()
    }


def run(method, scenes, names, **options):
    volts = np.stack([scenes[name] for name in names])
    batch = tx.Batch(method, method.choose_lambda([]), **options)
    return batch(volts, np.tile(TEN, (len(names), 1)), flags=None)


@pytest.mark.long
def test_auto_takes_the_smallest_that_explains(scenes):
    """One disc at most: two and more are for larger models."""
    method = tx.method(tx.Sensor.grid(dtype=np.float32), "auto", 32)
    names = ["nothing", "faint", "strong", "many", "short"]
    found = run(method, scenes, names, contacts=1)
    rungs = dict(zip(names, found.rung))
    assert rungs["nothing"] == Rung.NOTHING
    assert rungs["faint"] == rungs["strong"] == Rung.POINTS
    assert rungs["many"] >= Rung.SOURCE
    # One small disc beside faults of the rig, with a doubt, is as near as one disc comes.
    k = names.index("short")
    told = found.flags[k] & int(tx.Flag.RIG_FAULT | tx.Flag.PLACE_UNCERTAIN)
    assert rungs["short"] == Rung.SHAPE or told.bit_count() == 2
    assert np.hypot(*(found.contact_xy[k, 0] - NOMINAL[27])) < 1.5e-3
    # Where more may be told, one wide disc explains it, without a fault.
    wide = run(method, scenes, ["short"], contacts=2)
    assert not wide.flags[0] & int(tx.Flag.RIG_FAULT) and wide.contact_count[0] == 1
    assert np.hypot(*(wide.contact_xy[0, 0] - NOMINAL[27])) < 5e-4
    # The same, frame by frame in one compiled function.
    k = names.index("many")
    prepared = method.prepare(TEN, np.ones((10, 64), bool), method.choose_lambda([]))
    one = jax.jit(lambda p, v: method.estimate(p, v, 1))
    estimate = one(prepared, scenes["many"].astype(np.float32))
    assert estimate.rung == found.rung[k]
    # Its iterations end where rounding lets them, within a hundredth of a pitch.
    np.testing.assert_allclose(estimate.contacts.xy, found.contact_xy[k], atol=2e-4)
