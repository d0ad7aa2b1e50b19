"""Two fingers by `follow` on a rig of another model: at once, near, and beside a fault."""

import numpy as np
import pytest
from faulty import grid
from rig import Rig

import tomojax as tx
from bench import attacked

CORNERS = np.array([0, 63])


@pytest.fixture(scope="module")
def step():
    return tx.make_step(tx.Sensor.grid(dtype=np.float32), contacts=3, native=False)


def told(step, volts, grounds):
    lost = np.zeros(len(volts), np.int32)
    return step.replay(
        step.state, volts.astype(np.float32), grounds.astype(np.int32), lost
    )[1]


@pytest.mark.parametrize("apart", [0.025, 0.06])
@pytest.mark.parametrize("first", [0, 20])
def test_two_are_two_within_twenty_slots(step, apart, first):
    """The one before the other by so many slots, or both at once."""
    rig = Rig(np.random.default_rng(3))
    xy = np.array([[0.062, 0.085], [0.062 + apart, 0.085 + 0.3 * apart]])
    touch = [(rig.disc(p, 0.005).astype(float), g) for p, g in zip(xy, (5e-5, 8e-5))]
    stages = [np.zeros((2, 64)), rig.under(CORNERS, touch[0]), rig.under(CORNERS, *touch)]
    which = np.repeat([0, 1, 2], [6, first, 50])
    turn = np.arange(len(which)) % 2
    out = told(step, rig.measure(np.array(stages)[which, turn]), CORNERS[turn])
    assert (out.contacts.count[:6] == 0).all() and (out.contacts.count[-30:] == 2).all()
    places = np.asarray(out.contacts.xy[-1, :2], float)
    off = np.hypot(*(places[:, None] - xy).transpose(2, 0, 1)).min(0)
    assert off.max() < 1.5e-3


@pytest.mark.long
def test_a_short_of_the_grounded_corner_is_no_finger():
    """The second contact that it looks like is there under one ground alone."""
    sensor = grid(6, 6)
    step = tx.make_step(sensor, contacts=3, native=False)
    corners = np.array([0, 35])
    lone = attacked.lone(sensor, 21, rigs=1, each=4)
    short = attacked.short_of(0, 6)
    for k, scene in enumerate(lone):
        grounds = corners[np.arange(60) % 2]
        out = told(step, short(scene, grounds, np.random.default_rng(k)), grounds)
        assert (out.contacts.count[10:] == 1).mean() > 0.9
        assert np.hypot(*(np.asarray(out.contacts.xy[-1, 0]) - scene.xy[0])) < 2e-3
