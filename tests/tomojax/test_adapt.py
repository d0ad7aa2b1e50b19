"""Zeros and gains that drift: followed by contacts that move, not by one that is held."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

import tomojax as tx
from tomojax.calibration import Adapter
from tomojax.cli.app import app

GROUNDS = np.array([0, 15, 3, 12, 5, 10])
NOISE, HOURS = 3e-4, 4


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid(4, 4, divisions=(16, 16), dtype=np.float32)


@pytest.fixture(scope="module")
def touches(sensor):
    """Places of contacts all over the sheet, and their voltages under GROUNDS."""
    rng = np.random.default_rng(1)
    places = rng.uniform(0.008, 0.072, (60, 2))
    volts = [tx.voltages(sensor, tx.Disc(xy, 0.005, 1.0), GROUNDS) for xy in places]
    return places, np.array(volts, float)


class Day:
    """A frame of silence and, but for some minutes, one of a touch each minute; drift."""

    def __init__(self, touches, held=(), faint=0.0, seed=0):
        rng = np.random.default_rng(seed)
        places, volts = touches
        minutes = np.arange(60 * HOURS)
        # One channel's rate is another's not: 1 % and 1 mV an hour, rms.
        rates = rng.normal(size=(2, 16))
        rates /= rates.std(1, keepdims=True)
        rates[0] -= rates[0].mean()
        hours = (minutes / 60)[:, None]
        self.gain, self.zero = np.exp(0.01 * hours * rates[0]), 1e-3 * hours * rates[1]
        self.which = rng.integers(1, len(places), len(minutes))
        self.held = np.isin(minutes // 60, held)
        self.which[self.held] = 0
        exact = volts[self.which]
        silence = np.where(self.held[:, None, None], faint * volts[0], 0 * exact)
        if not faint:
            silence[self.held] = volts[0]
        frames = np.stack([silence, silence, silence, exact], 1)
        frames = np.where(self.held[:, None, None, None] & (faint > 0), silence[:, None], frames)
        read = frames * self.gain[:, None, None] + self.zero[:, None, None]
        self.read = read + NOISE * rng.normal(size=read.shape)
        self.t = 60.0 * minutes[:, None] + 6e-4 * np.arange(4)
        self.places = places[self.which]

    def recording(self, sensor):
        rig = tx.recordings.Rig.of(sensor)
        flat = self.read.reshape(-1, *self.read.shape[2:])
        return tx.recordings.ArrayRecording(rig, flat, GROUNDS, self.t.ravel())


def settings(**more):
    given = dict(method="points", images=False, contacts=2, films=False, tare=False)
    return tx.results.Settings(**(given | more))


def results(sensor, day, path, **more):
    tx.reconstruct_recording(day.recording(sensor), path, settings(**more), overwrite=True)
    with h5py.File(path) as file:
        found = {name: file[name][...] for name in file}
    found["touch"] = found["contact_xy"].reshape(-1, 4, 2, 2)[:, 3, 0]
    found["off"] = np.hypot(*(found["touch"] - day.places).T)
    return found


def hourly(values):
    return np.median(values.reshape(HOURS, 60), 1)


@pytest.fixture(scope="module")
def day(touches):
    return Day(touches, held=(2,))


@pytest.fixture(scope="module")
def found(sensor, day, tmp_path_factory):
    folder = tmp_path_factory.mktemp("day")
    return {a: results(sensor, day, folder / f"{a}.h5", adapt=a) for a in (False, True)}


def test_drift_is_followed(found, day):
    without, adapted = (hourly(found[a]["off"]) for a in (False, True))
    assert without[3] > 10 * without[0] / 2 and without[3] > 1e-3
    start = hourly(found[True]["off"])[0]
    assert adapted[1] < 1.5 * start and adapted[3] < 1.5 * start
    gain = np.log(found[True]["adapted_gain"][-1] / day.gain[-1])
    assert gain.std() < 1e-3 < 0.02 < np.log(day.gain[-1]).std()
    zero = found[True]["adapted_zero"][-1] - day.zero[-1]
    assert np.abs(zero).max() < NOISE < 2e-3 < np.abs(day.zero[-1]).max()


def test_results_log_what_was_used(found):
    log = found[True]
    chunks = len(log["adapted_t"])
    assert log["adapted_gain"].shape == log["adapted_zero"].shape == (chunks, 16)
    assert (np.diff(log["adapted_t"]) > 0).all() and "adapted_t" not in found[False]
