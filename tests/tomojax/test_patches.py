"""Metal on electrodes: its current goes where the sheet takes it."""

import jax
import numpy as np
import pytest

import tomojax as tx
from bench.rigs import draw_rig, network_of, Touch

TEN = np.array([0, 63, 5, 12, 20, 27, 34, 41, 50, 58])
# From an electrode to the contact's middle, m; radius, m; conductance, S.
METAL = (
    ((0.0081, 0.0007), 0.0110, 7.7e-4),
    ((0.0060, -0.0010), 0.0075, 1.1e-3),
    ((-0.0070, 0.0020), 0.0097, 1.0e-3),
    ((0.0010, 0.0063), 0.0078, 2.3e-3),
)
# Pairs 15 mm apart, in the same way: to the middle; angle; radii; conductances.
PAIRS = (
    (36, (-0.0055, -0.0058), 0.85, (0.0054, 0.0057), (1.3e-3, 1.7e-3)),
    (14, (0.0015, -0.0050), 0.71, (0.0055, 0.0054), (5.5e-4, 2.4e-3)),
    (9, (0.0044, 0.0046), 0.85, (0.0045, 0.0040), (3.1e-3, 6.5e-4)),
)


@pytest.fixture(scope="module")
def every():
    """Rows of metal discs on a network of resistors without errors, and the truth."""
    sensor = tx.Sensor.grid(dtype=np.float32)
    none = {"uneven": 0.0, "off": 0.0, "gain": 0.0, "noise": 1e-7, "bits": 24}
    rig = draw_rig(sensor, np.random.default_rng(3), **none)
    exact, electrodes = network_of(rig), np.asarray(sensor.electrode_xy, float)
    made = [
        Touch(electrodes[e] + away, (a, a), 0.0, g)
        for e, (away, a, g) in zip((27, 14, 41, 9), METAL)
    ]
    for e, away, turn, radii, strength in PAIRS:
        along = 0.0075 * np.array([np.cos(turn), np.sin(turn)])
        middle = electrodes[e] + away
        each = zip((middle + along, middle - along), radii, strength)
        made.append([Touch(place, (a, a), 0.0, g) for place, a, g in each])
    scenes = [[touch] if isinstance(touch, Touch) else touch for touch in made]
    parts = [[(exact.weights(t), t.conductance) for t in scene] for scene in scenes]
    volts = np.array([exact.network.under(TEN, *part) for part in parts], np.float32)
    # As errors are told of a calibrated rig.
    known = tx.Calibration(error=0.1, own=0.1)
    batch = tx.Batch(tx.method(sensor, "points", 32, known), 1.0, 2, images=False)
    return batch(volts, np.tile(TEN, (len(made), 1))), made


@pytest.fixture
def rows(every):
    found, made = every
    lone = slice(len(METAL))
    return jax.tree.map(lambda a: a[lone], found), made[lone]


@pytest.mark.long
def test_near_pairs_of_metal(every):
    """Two discs that lean are farther off there than one bar is."""
    found, made = every
    for k, pair in enumerate(made[len(METAL) :], len(METAL)):
        assert found.contact_count[k] == 2
        off = found.contact_xy[k][:, None] - [touch.centre for touch in pair]
        assert np.hypot(*off.T).min(0).max() < 2.5e-3  # a sixth of what is between


def test_places_beside_electrodes(rows):
    found, made = rows
    assert found.contact_count.tolist() == [1] * len(made)
    off = found.contact_xy[:, 0] - [touch.centre for touch in made]
    assert np.hypot(*off.T).max() < 1e-4  # even discs that lean: 0.12 to 0.53 mm


def test_conductance_of_metal(rows):
    """The level hardly tells it: the current's shape does."""
    found, made = rows
    ratio = found.contact_conductance[:, 0] / [touch.conductance for touch in made]
    assert np.abs(np.log(ratio)).max() < 0.25


def test_radius_of_metal(rows):
    found, made = rows
    ratio = found.contact_radius[:, 0] / [touch.half_axes[0] for touch in made]
    assert np.abs(ratio - 1).max() < 0.05
