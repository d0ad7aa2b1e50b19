"""Physics has no unit of its own: lengths, ohms, volts and time may all be scaled.

What is found is the same then, in pitches, squares of the sheet and parts of the drive;
counts and flags are equal. No constant of a method is a length, a voltage or a time.
"""

import numpy as np
import pytest

import tomojax as tx
from bench.rigs import make_rig, network_of, Touch

# Lengths, ohms, volts.
SCALES = [(0.1, 0.01, 0.2), (10.0, 100.0, 3.0), (0.1, 100.0, 3.0), (10.0, 0.01, 0.2)]
CORNERS = np.array([0, 15])
CONTACTS = [
    (0.031, 0.052, 0.004, 1.0),
    (0.055, 0.024, 0.007, 0.2),
    (0.012, 0.068, 0.005, 5),
]


def sensor(length=1.0, ohm=1.0, volt=1.0):
    return tx.Sensor.grid(
        4,
        4,
        pitch=0.02 * length,
        margin=0.01 * length,
        electrode_diameter=0.005 * length,
        sheet_resistance=1e4 * ohm,
        ground_resistance=4.0 * ohm,
        drive_voltage=4.5 * volt,
        divisions=(32, 32),
    )


@pytest.fixture(scope="module")
def volts():
    """Of the sensor as it is, with a rig's errors, by a network; the last is a pair."""
    rng = np.random.default_rng(3)
    rig = make_rig(sensor(), "usual", rng)
    exact = network_of(rig)
    touches = [Touch(np.array([x, y]), (r, r), 0.0, g / 1e4) for x, y, r, g in CONTACTS]
    lone = [exact.touched(touch, CORNERS) for touch in touches]
    return rig.chain.read(np.stack([*lone, sum(lone[:2]) / 2]), rng)


def found(name, v, length=1.0, ohm=1.0, volt=1.0):
    method = tx.method(sensor(length, ohm, volt), name, grid=16)
    batch = tx.Batch(method, method.choose_lambda([]), contacts=2)
    return batch(v * volt, np.tile(CORNERS, (len(v), 1)))


@pytest.mark.parametrize(
    "name",
    ["source", "linear"]
    + [pytest.param(name, marks=pytest.mark.long) for name in ("points", "auto")],
)
def test_methods_scale(volts, name):
    """The same places to 1e-4 of a pitch, the same counts and flags."""
    want = found(name, volts)
    for length, ohm, volt in SCALES[:1] if name == "auto" else SCALES:
        got = found(name, volts, length, ohm, volt)
        np.testing.assert_array_equal(got.contact_count, want.contact_count)
        np.testing.assert_array_equal(got.flags, want.flags)
        place = got.contact_xy / (0.02 * length)
        np.testing.assert_allclose(place, want.contact_xy / 0.02, atol=1e-4)
        unit = got.contact_conductance * ohm
        np.testing.assert_allclose(unit, want.contact_conductance, rtol=2e-3)
        np.testing.assert_allclose(got.residual / volt, want.residual, rtol=1e-3)
        variance = got.contact_covariance / length**2
        np.testing.assert_allclose(variance, want.contact_covariance, rtol=1e-2)


@pytest.mark.long
def test_a_step_scales(volts):
    """A step's places, counts and flags; its drift is one of time, not of slots."""

    def run(length=1.0, ohm=1.0, volt=1.0, rate=1.0):
        step = tx.make_step(
            sensor(length, ohm, volt), "follow", "boundary", f_switch=1e4 * rate
        )
        slots = np.concatenate([volts[0], volts[0], volts[1], volts[1]]) * volt
        return step.replay(step.state, slots, np.tile(CORNERS, 4))[1]

    want, got = run(), run(*SCALES[0])
    np.testing.assert_array_equal(got.contacts.count, want.contacts.count)
    np.testing.assert_array_equal(got.flags, want.flags)
    place = got.contacts.xy / (0.02 * SCALES[0][0])
    np.testing.assert_allclose(place, want.contacts.xy / 0.02, atol=1e-4)
    # With longer slots a contact may have moved further: less is known of it.
    slow = run(rate=0.1).contacts.covariance[3, 0]
    assert (slow[:2] > want.contacts.covariance[3, 0, :2]).all()
