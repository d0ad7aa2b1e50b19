"""Bring-up of a round skin: a dead channel, swapped wires, gains; tables are refused."""

from dataclasses import replace

import numpy as np
import pytest

import tomojax as tx
from tomojax.bringup.sheet import Plane

RADIUS, NOISE = 0.05, 2e-4


@pytest.fixture(scope="module")
def skin():
    return tx.Sensor.disc(2 * RADIUS, {"rim": 12, "grid": 0.02}, dtype=np.float32)


@pytest.fixture(scope="module")
def rig(skin):
    return tx.recordings.Rig.of(skin)


@pytest.fixture(scope="module")
def volts(skin):
    """Nothing, then a rub; under each ground."""
    rng = np.random.default_rng(0)
    xy = rng.uniform(-1, 1, (200, 2))
    xy = RADIUS * (1 + xy[np.hypot(*xy.T) < 0.85][:40])
    rub = [np.asarray(tx.voltages(skin, tx.Disc(at, 0.004, 1.0))) for at in xy]
    volts = np.concatenate([np.zeros((30, *rub[0].shape)), np.stack(rub)])
    return volts + NOISE * rng.normal(size=volts.shape)


def found(rig, volts):
    recording = tx.recordings.ArrayRecording(rig, volts, np.arange(volts.shape[1]))
    return tx.bringup.check(recording, corners=None)


def test_potentials_are_a_discs(rig):
    """Green's function of a disc without flux through its edge, and its slope."""

    def exact(one, other):
        a, b = ((p[..., 0] + 1j * p[..., 1]) / RADIUS - 1 - 1j for p in (one, other))
        logs = np.log(abs(a - b)) + np.log(abs(1 - a * b.conj()))
        return -(logs - (abs(a) ** 2 + abs(b) ** 2) / 2) / (2 * np.pi)

    plane = Plane(rig)
    assert plane.pitch == pytest.approx(np.sqrt(np.pi * RADIUS**2 / plane.count), rel=0.01)
    assert np.hypot(*(plane.places - RADIUS).T).max() < RADIUS
    turn = np.linspace(0, 6, 12)
    one = RADIUS * (1 + 0.7 * np.stack([np.cos(turn), np.sin(turn)], 1))
    other = RADIUS * (1 + 0.3 * np.stack([np.cos(2 * turn), np.sin(3 * turn)], 1))
    one, other = one[:, None], other[None]
    off = plane.green(one, other) - exact(one, other)
    assert np.ptp(off) < 0.04 * np.ptp(exact(one, other))
    step = np.diag([1e-6, 1e-6])
    slope = [(exact(one + s, other) - exact(one - s, other)) / 2e-6 for s in step]
    error = np.abs(plane.slope(one, other) - np.stack(slope))
    assert error.max() < 0.25 * np.abs(slope).max()


def kinds(checked):
    return [(fault.kind, fault.channels) for fault in checked.faults]


@pytest.mark.long
def test_a_sound_round_skin_has_no_fault(rig, volts):
    checked = found(rig, volts)
    assert not checked.faults and list(checked.unjudged) == ["mirrored or turned array"]
    assert checked.figures["residual_percent"] < 0.5


def test_a_dead_channel_and_swapped_wires(rig, volts):
    dead = volts.copy()
    dead[:, :, 6] = NOISE * np.random.default_rng(1).normal(size=dead.shape[:2])
    assert kinds(found(rig, dead)) == [("dead", (6,))]
    swapped = volts.copy()
    swapped[:, :, [5, 16]] = swapped[:, :, [16, 5]]
    assert kinds(found(rig, swapped)) == [("swapped", (5, 16))]


def test_a_table_is_refused_in_a_line(rig, volts):
    table = 0.25 * np.eye(volts.shape[1])
    with pytest.raises(ValueError, match="a table of conditions, expected one ground"):
        found(replace(rig, conditions=table), volts)
