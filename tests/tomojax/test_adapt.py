"""Zeros and gains that drift: followed by contacts that move, not by one that is held."""

import json

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

import tomojax as tx
from tomojax.calibration import Adapter
from tomojax.cli.app import app

GROUNDS = np.array([0, 15, 3, 12, 5, 10])
NOISE, HOURS = 3e-4, 3


@pytest.fixture(scope="module")
def sensor():
    # A mesh that discs are small errors of.
    return tx.Sensor.grid(4, 4, divisions=(64, 64), dtype=np.float32)


@pytest.fixture(scope="module")
def touches(sensor):
    """Places of contacts all over the sheet, and their voltages under GROUNDS."""
    rng = np.random.default_rng(1)
    places = rng.uniform(0.008, 0.072, (60, 2))
    volts = [tx.voltages(sensor, tx.Disc(xy, 0.005, 1.0), GROUNDS) for xy in places]
    return places, np.array(volts, float)


class Day:
    """Three scans of silence and one of a touch, every two minutes; drift of 1 % and 1 mV
    an hour.

    In the hours `held` the first touch lasts throughout.
    """

    def __init__(self, touches, held=(), drift=1.0, hours=HOURS):
        rng = np.random.default_rng(2)
        places, volts = touches
        minutes = np.arange(0, 60 * hours, 2)
        # One channel's rate is not another's. What gains have in common is not followed.
        rates = rng.normal(size=(2, 16))
        rates[0] -= rates[0].mean()
        rates *= drift / rates.std(1, keepdims=True)
        at = (minutes / 60)[:, None]
        self.gain, self.zero = np.exp(0.01 * at * rates[0]), 1e-3 * at * rates[1]
        which = rng.integers(1, len(places), len(minutes))
        self.held = np.isin(minutes // 60, held)
        which[self.held] = 0
        scans = np.where(self.held[:, None], 0, [[-1, -1, -1, 0]]) + 0 * which[:, None]
        scans[:, 3] = which
        exact = np.where((scans >= 0)[..., None, None], volts[scans], 0)
        read = exact * self.gain[:, None, None] + self.zero[:, None, None]
        self.read = read + NOISE * rng.normal(size=read.shape)
        self.t = 60.0 * minutes[:, None] + 6e-4 * np.arange(4)
        self.places, self.touched = places[which], scans >= 0

    def recording(self, sensor):
        rig = tx.recordings.Rig.of(sensor)
        flat = self.read.reshape(-1, *self.read.shape[2:])
        return tx.recordings.ArrayRecording(rig, flat, GROUNDS, self.t.ravel())


def settings(contacts=1, **more):
    given = dict(method="points", images=False, contacts=contacts, films=False, tare=False)
    return tx.results.Settings(**(given | dict(chunk=60) | more))


def results(sensor, day, path, **more):
    tx.reconstruct_recording(day.recording(sensor), path, settings(**more), overwrite=True)
    with h5py.File(path) as file:
        found = {name: file[name][...] for name in file}
    found["bytes"] = path.read_bytes()
    xy = found["contact_xy"].reshape(-1, 4, *found["contact_xy"].shape[1:])[:, 3, 0]
    found["hours"] = np.hypot(*(xy - day.places).T).reshape(-1, 30)
    found["mm"] = 1e3 * np.median(found["hours"], 1)
    return found


@pytest.fixture(scope="module")
def day(touches):
    return Day(touches, held=(1,))


# A gain that is off may look like a second contact, where there may be one.
@pytest.fixture(scope="module", params=[1, pytest.param(2, marks=pytest.mark.long)])
def found(sensor, touches, day, tmp_path_factory, request):
    most = request.param
    folder = tmp_path_factory.mktemp("day")
    still = results(
        sensor, Day(touches, held=(1,), drift=0.0), folder / "still.h5", contacts=most
    )
    runs = {
        a: results(sensor, day, folder / f"{a}.h5", adapt=a, contacts=most)
        for a in (False, True)
    }
    return runs | {"start": still, "most": most}


@pytest.mark.long
def test_drift_is_followed(found, day):
    start, without, adapted = (found[a]["mm"] for a in ("start", False, True))
    assert without[-1] > 3 * start[-1]
    # A median of 30 places moves with the rounding of their fits.
    assert adapted[-1] < 1.25 * start[-1]
    gain = np.log(found[True]["adapted_gain"][-1] / day.gain[-1])
    assert gain.std() < 1e-3 and np.log(day.gain[-1]).std() > 0.025
    zero = found[True]["adapted_zero"][-1] - day.zero[-1]
    assert np.abs(zero).max() < NOISE < 2e-3 < np.abs(day.zero[-1]).max()


@pytest.mark.long
def test_a_contact_held_for_an_hour_stays(found, day):
    """And where it is: no farther than what the gains' own drift makes of it."""
    held = found[True]["contact_count"].reshape(-1, 4)[day.held]
    assert (held == 1).all()
    assert found[True]["mm"][1] < found[False]["mm"][1]
    assert 1e3 * found[True]["hours"][1].max() < 1.5  # gains that drift by 1 %


@pytest.mark.long
def test_results_log_what_was_used(found):
    log = found[True]
    assert log["adapted_gain"].shape == log["adapted_zero"].shape == (6, 16)
    assert (np.diff(log["adapted_t"]) > 0).all() and "adapted_t" not in found[False]


def test_zeros_that_wander_in_seconds_are_followed(sensor) -> None:
    """At a low rate, and by much more than a day's drift: 3 mV a minute."""
    rng = np.random.default_rng(5)
    adapter, t = Adapter(sensor), np.arange(3000) / 50
    walk = 3e-3 / np.sqrt(3000) * rng.normal(size=(3000, 1, 16)).cumsum(0)
    read = walk + NOISE * rng.normal(size=(3000, 2, 16))
    grounds, nobody = np.tile([0, 15], (3000, 1)), np.full((3000, 2), np.nan)
    off = []
    for some in tx.calibration.stretches(t):
        off.append(adapter.voltages(read[some]).mean((0, 1)))
        adapter.observe(t[some], read[some], grounds[some], nobody[some])
    assert len(off) == 30 and np.std(off[5:]) < 1e-3 < 2e-3 < walk[-1].std()


@pytest.mark.long
@pytest.mark.parametrize("found", [1], indirect=True)
def test_interrupted_it_goes_on_to_the_same_bytes(sensor, day, tmp_path, found):
    recording, other = day.recording(sensor), tmp_path / "b.h5"
    given = settings(found["most"], adapt=True)

    def stop(done, total):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tx.reconstruct_recording(recording, other, given, progress=stop)
    assert not other.exists()
    tx.reconstruct_recording(recording, other, given, resume=True)
    assert other.read_bytes() == found[True]["bytes"]


def adapter_after(sensor, volts, place, minutes=60, grounds=GROUNDS, seed=0):
    """An adapter after so many minutes of the same frame, with noise."""
    rng, adapter = np.random.default_rng(seed), Adapter(sensor)
    under, n = np.tile(grounds, (8, 1)), len(grounds)
    for minute in range(minutes):
        read = volts[:n] + NOISE * rng.normal(size=(8, n, 16))
        t = 60.0 * minute + 6e-4 * np.arange(8)
        adapter.observe(t, read, under, np.tile(place, (8, 1)))
    return adapter


def test_the_error_of_one_place_is_not_taken_for_gains(sensor, touches):
    """A held contact leaves the same of each channel over and over: it counts once."""
    places, volts = touches
    wrong = 1 + 3e-3 * np.random.default_rng(5).normal(size=16)
    once = adapter_after(sensor, volts[0] * wrong, places[0], minutes=1)
    long = adapter_after(sensor, volts[0] * wrong, places[0])
    assert once.counts[1] == long.counts[1] == 1
    np.testing.assert_allclose(long.gain, once.gain, atol=5e-4)
    # Nor do two squares that a contact goes to and fro between.
    adapter = Adapter(sensor)
    for k in range(40):
        xy = np.array([[0.03 + 0.02 * (k % 2), 0.03]])
        adapter.observe(np.array([1.0 * k]), volts[:1] * wrong, GROUNDS[None], xy)
    assert adapter.counts[[1, 3]].sum() == 2


@pytest.mark.parametrize("highest", [1e-3, 3e-3])
def test_a_light_touch_that_is_held_is_no_zero(sensor, touches, highest):
    """Whether above the threshold or below; silence as long is followed."""
    places, volts = touches
    faint = volts[0] * highest / volts[0].max()
    nobody = np.full(2, np.nan)
    adapter = adapter_after(sensor, faint, nobody)
    assert np.abs(adapter.offset).max() < 0.1 * highest
    silence = np.broadcast_to(faint.max(0), faint.shape)
    adapter = adapter_after(sensor, silence, nobody)
    np.testing.assert_allclose(adapter.offset, faint.max(0), atol=0.2 * NOISE)
    # Under one ground nobody can tell one from the other: nothing is followed.
    adapter = adapter_after(sensor, silence, nobody, grounds=GROUNDS[:1])
    assert not adapter.offset.any()


@pytest.mark.long
def test_what_is_followed_is_bounded(sensor, touches):
    """A gain that jumps by half is followed at 5 % an hour at most, and to 30 % at most."""
    places, volts = touches
    rng, adapter = np.random.default_rng(7), Adapter(sensor)
    broken = np.where(np.arange(16) == 6, 1.5, 1.0)
    hours = []
    for hour in range(16):
        for turn, k in enumerate(rng.permutation(60)[:15]):
            t = np.array([3600.0 * hour + 200.0 * turn])
            adapter.observe(t, volts[k][None] * broken, GROUNDS[None], places[k][None])
        hours.append(np.log(adapter.gain))
    moved = np.diff(hours, axis=0, prepend=0)
    assert np.abs(moved).max() < 0.12 and np.abs(hours).max() < 0.31
    # What all have in common: a channel that is stopped leaves the others a part of it.
    assert np.abs(np.mean(hours, 1)).max() < 0.3 / 6


def test_a_gap_or_nonsense_does_no_harm(sensor, touches):
    places, volts = touches
    adapter = Adapter(sensor)
    nothing = np.full((3, 6, 16), np.nan)
    under = np.tile(GROUNDS, (3, 1))
    adapter.observe(np.arange(3.0), nothing, under, np.tile(places[0], (3, 1)))
    adapter.observe(1e6 + np.arange(3.0), nothing + 9.0, under, np.full((3, 2), np.nan))
    read = volts[[0, 1, 2]].copy()
    read[:, :, 4] = np.nan  # a channel that gives nothing stays as it is
    adapter.observe(2e6 + np.arange(3.0), read, under, places[:3])
    noise = np.random.default_rng(0).uniform(0, 4, (3, 6, 16))
    adapter.observe(2e6 + 10 + np.arange(3.0), noise, under, places[3:6])
    assert np.isfinite(adapter.gain).all() and np.isfinite(adapter.offset).all()
    assert adapter.gain[4] == 1.0 and adapter.counts[3] >= 3


def saved(sensor, day, path):
    """A recording's file of a day."""
    from tomojax.recordings import attributes

    told = attributes(tx.recordings.Rig.of(sensor), 1.5e-4, 0.0)
    xy = told.pop("electrode_xy")
    with h5py.File(path, "w") as file:
        file["electrode_xy"] = np.asarray(xy)
        file.attrs.update(told)
        flat = day.read.reshape(-1, *day.read.shape[2:])
        file["v"] = np.round(flat / 1.5e-4).astype("i2")
        file["ground"] = np.tile(GROUNDS, (len(flat), 1)).astype("u1")
        file["t0"], file["gaps"] = day.t.ravel(), np.zeros((0, 2), int)


@pytest.mark.long
def test_info_tells_whether_a_calibration_fits(sensor, touches, tmp_path):
    known = tmp_path / "rig.json"
    tx.Calibration(offset=(0.0,) * 16, made="2026-01-02").save(known)
    told = {}
    for name, drift in (("fits", 0.0), ("drifted", 3.0)):
        rec = tmp_path / f"{name}.h5"
        saved(sensor, Day(touches, drift=drift, hours=2), rec)
        words = ["info", str(rec), "--calibration", str(known)]
        done = CliRunner().invoke(app, [*words, "--json", str(tmp_path / "i.json")])
        assert done.exit_code == 0, done.output
        summary = json.loads((tmp_path / "i.json").read_text())["summary"]
        told[name] = summary["calibration"], done.output
    fits, text = told["fits"]
    assert fits["fits"] and fits["contacts_chi2"] < 2 and fits["zeros_chi2"] < 2
    assert "made on 2026-01-02" in text and "still fits" in text
    drifted, text = told["drifted"]
    assert drifted["fits"] is False and drifted["contacts_chi2"] > 4
    assert 1 < drifted["gains_off_percent"] < 6 and "calibrate again" in text
    tx.Calibration(gain=(1.0,) * 64).save(known)
    with pytest.raises(ValueError, match="rig.json: gain: got .64,. values, expected 16"):
        CliRunner().invoke(app, words, catch_exceptions=False)


def test_command_with_adapt(sensor, touches, tmp_path):
    rec = tmp_path / "rec.h5"
    saved(sensor, Day(touches, hours=1), rec)
    words = ["reconstruct", str(rec), "--adapt", "--method", "points", "--no-images"]
    done = CliRunner().invoke(app, [*words, "--contacts", "1"])
    assert done.exit_code == 0, done.output
    with h5py.File(tmp_path / "rec.results.h5") as file:
        assert np.std(file["adapted_gain"][-1]) > 5e-3
        assert json.loads(file.attrs["configuration"])["adapt"] is True
