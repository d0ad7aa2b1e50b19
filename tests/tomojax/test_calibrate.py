"""Calibrations, of a rig that is not ours and of recordings in memory."""

import json
from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rig import Rig

import tomojax as tx
from tomojax.calibration import read_places, rig_slopes, slopes_by_rig, unknowns_of
from tomojax.kernels.contacts import field_at, Fitted
from tomojax.kernels.sheet import volts_per_ampere

CORNERS = [0, 63]

# As many slots as `calibrate_recording` takes for a frame: one program for both.
SLOTS = 10


@pytest.fixture(scope="module")
def rig():
    return Rig(np.random.default_rng(21), variation=0.03)


@pytest.fixture(scope="module")
def presses(rig):
    """One contact in each of 40 places: all grounds, as they are read, and the places."""
    rng = np.random.default_rng(22)
    volts, places = [], []
    for _ in range(40):
        exact, truth = rig.scene((rig.disc(rng.uniform(0.01, 0.15, 2), 0.006), 1e-4))
        volts.append(rig.measure(exact))
        places.append(truth[0][0])
    return np.array(volts, np.float32), np.array(places)


@cache
def sensor():
    return tx.Sensor.grid(dtype=np.float32, divisions=(32, 32))


@pytest.fixture(scope="module")
def frames(presses):
    """30 of the contacts, each with ten grounds."""
    grounds = 6 * np.arange(SLOTS) + np.arange(30)[:, None] % 10
    return np.take_along_axis(presses[0][:30], grounds[..., None], 1), grounds


@pytest.fixture(scope="module")
def calibration(rig, presses, frames):
    """Zeros from silence; the rest from 30 of the contacts, whose places are told."""
    silence = np.stack([rig.measure(np.zeros((2, 64))) for _ in range(40)])
    before = tx.calibration.tare(
        tx.recordings.ArrayRecording(tx.recordings.Rig.of(sensor()), silence, CORNERS)
    )
    return tx.calibration.calibrate(sensor(), *frames, presses[1][:30], before)


def fits(known, volts, grounds):
    """Fits one contact to each frame, with a calibration."""
    method = tx.method(sensor(), "points", 32, known)
    batch = tx.Batch(method, 1.0, contacts=1, images=False)
    return batch(known.voltages(volts), grounds)


@pytest.mark.long
def test_what_is_left_is_at_most_half(presses, calibration):
    """At other places than it is made of; residuals of many grounds, places of two."""
    volts, places = presses
    left, many = {}, np.tile(np.arange(0, 64, 7), (10, 1))
    for name, known in (("nominal", tx.Calibration()), ("calibrated", calibration)):
        whole = fits(known, volts[30:, many[0]], many)
        two = fits(known, volts[30:, CORNERS], np.tile(CORNERS, (10, 1)))
        error = np.hypot(*(two.contact_xy[:, 0] - places[30:]).T)
        left[name] = whole.residual, error
    assert (left["calibrated"][0] < left["nominal"][0] / 2).all()
    assert np.median(left["calibrated"][1]) < np.median(left["nominal"][1])
    assert left["calibrated"][1].max() < 0.5e-3


@pytest.fixture(scope="module")
def found(frames):
    """A calibration from them without their places."""
    rig = sensor()
    return tx.calibration.calibrated(rig, tx.calibration.known_frames(rig, *frames))


@pytest.fixture(scope="module")
def blind(found):
    return found.calibration


@pytest.mark.long
def test_what_frames_do_not_tell_moves_freely(frames, found):
    """A move that is listed leaves the residuals as they are; others raise them."""
    # Moves of all electrodes are told hardly more than half: of which end is rounding's.
    assert tx.calibration.summary(sensor(), found)["not_told"][0] == "all gains together"
    assert "usual: all gains together" in tx.calibration.text(sensor(), found)
    volts, grounds = frames
    known, each = found.calibration, np.random.default_rng(0).normal(size=(64, 2))
    gain, places = np.asarray(known.gain), np.asarray(known.electrodes)
    shift = np.tile([np.sqrt(2), 0.0], (64, 1))
    moved = {
        "all gains": replace(known, gain=tuple(gain * 1.001)),
        "a shift": replace(known, electrodes=tuple(map(tuple, places + 1e-4 * shift))),
        "each gain": replace(known, gain=tuple(gain * (1 + 1e-3 * each[:, 0]))),
        "each place": replace(known, electrodes=tuple(map(tuple, places + 1e-4 * each))),
    }
    left = {}
    for name, calibration in {"none": known, **moved}.items():
        # Ten at a time, as many as in the other tests.
        each = [fits(calibration, volts[k::3], grounds[k::3]) for k in range(3)]
        left[name] = np.median([rows.residual for rows in each])
    assert left["all gains"] < 1.01 * left["none"]
    # The sheet's edges tell a little of a shift.
    assert left["a shift"] < 2 * left["none"] < 0.7 * left["each place"]
    assert left["each gain"] > 3 * left["none"]


@pytest.mark.long
def test_places_need_not_be_known(rig, presses, blind, calibration):
    """Places of ten other contacts: nearer than nominal, as near as with places."""
    volts, places = presses
    grounds = np.tile(np.arange(0, 64, 7), (10, 1))
    error, nominal = {}, tx.Calibration()
    for name, known in (("nominal", nominal), ("blind", blind), ("placed", calibration)):
        found = fits(known, volts[30:, grounds[0]], grounds)
        error[name] = np.median(np.hypot(*(found.contact_xy[:, 0] - places[30:]).T))
    assert error["blind"] < 0.7 * error["nominal"]
    assert error["blind"] < 1.3 * error["placed"]


@pytest.mark.long
def test_electrodes_are_found(rig, blind):
    """Beside the middles of the squares that an electrode covers."""
    true = np.array([rig.cells[rig.node == e].mean(0) for e in range(64)])
    nominal = np.asarray(sensor().electrode_xy)
    left = nominal + np.asarray(blind.electrodes) - true
    assert np.sqrt((left**2).mean()) < 0.7 * np.sqrt(((true - nominal) ** 2).mean())


@pytest.mark.long
def test_gains_and_zeros_are_the_rigs(rig, calibration):
    left = np.std(np.asarray(calibration.gain) - rig.gain)
    assert left < 0.4 * np.std(rig.gain)
    left = np.std(np.asarray(calibration.offset) - rig.zero)
    assert left < 0.2 * np.std(rig.zero)
    assert 0.1 <= calibration.error < 0.9


@pytest.mark.long
def test_the_sheet_is_found(rig, calibration):
    """As waves: beside the network's own, from its conductances along x."""
    assert np.abs(calibration.sheet).max() > 0.005
    at = rig.cells[::97]
    factor = calibration.sheet_factor(at, np.array([0.16, 0.16]))
    true = rig.sheet[::97] / rig.sheet.mean()
    assert np.corrcoef(factor, true)[0, 1] > 0.8


@pytest.fixture
def told() -> tx.Calibration:
    """Some of 64 channels, whatever rig it is of."""
    rng = np.random.default_rng(5)
    gain, offset = 1 + 1e-3 * rng.normal(size=64), 1e-4 * rng.normal(size=64)
    told = {"gain": tuple(gain.tolist()), "offset": tuple(offset.tolist())}
    return tx.Calibration(**told, sheet=(0.01,) * 27)


def test_file(told, tmp_path):
    path, calibration = tmp_path / "c.json", told
    calibration.save(path)
    assert tx.Calibration.load(path) == calibration
    path.write_text(path.read_text().replace("gain", "gains"))
    with pytest.raises(ValueError, match="c.json.*gains"):
        tx.Calibration.load(path)
    path.write_text("{")
    with pytest.raises(ValueError, match="not a calibration"):
        tx.Calibration.load(path)
    with pytest.raises(ValueError, match="gain: got 0.0"):
        replace(calibration, gain=0.0)
    with pytest.raises(ValueError, match="sheet"):
        replace(calibration, sheet=(-0.9,) * 27)
    with pytest.raises(ValueError, match="sheet: got 3, expected 14 or 27 waves"):
        replace(calibration, sheet=(0.0,) * 3)
    with pytest.raises(ValueError, match="electrodes: got .* expected numbers"):
        replace(calibration, electrodes=((0.0, np.inf),) * 64)


def test_a_calibration_of_another_sensor_is_refused(told):
    small = tx.Sensor.grid(4, 4, divisions=(16, 16))
    with pytest.raises(ValueError, match="^offset: got .64,. values, expected 16 of them"):
        tx.method(small, "points", 16, told)


def test_files_of_before_are_read(tmp_path):
    """Without electrodes, and with fewer waves."""
    path = tmp_path / "old.json"
    tx.Calibration(sheet=(0.01,) * 14).save(path)
    old = json.loads(path.read_text())
    for name in ("electrodes", "own", "deviation", "made"):
        del old[name]
    path.write_text(json.dumps(old))
    assert tx.Calibration.load(path) == tx.Calibration(sheet=(0.01,) * 14)


def test_slopes_by_the_rig():
    """Beside differences of new tables; what electrodes do as metal is left out."""
    x64 = tx.Sensor.grid(4, 4, divisions=(32, 32), dtype=np.float64)
    x, radius, grounds = jnp.array([0.052, 0.034]), jnp.array(0.005), jnp.array([1, 15])
    current = jnp.array([[1e-3], [2e-3]])

    def volts(calibration: tx.Calibration):
        sheet = tx.method(x64, "points", 16, calibration).sheet
        at = field_at(sheet.field, x, radius)
        return sheet, current * volts_per_ampere(sheet.slots, at, grounds)

    sheet, base = volts(tx.Calibration())
    none = jnp.zeros((1, 2))
    fitted = Fitted(x[None], none, none[:, 0], radius[None], current, 0 * current, base)
    slopes = np.asarray(slopes_by_rig(sheet, rig_slopes(x64), grounds, fitted))
    parts = unknowns_of(x64, tx.Calibration()).parts
    moved = np.zeros((16, 2))
    moved[6] = 3e-5, 0  # at (30, 50) mm
    waves = np.zeros(27)
    waves[4] = 0.01
    for name, value, number, step in (
        ("electrodes", moved, 6, 3e-5),
        ("sheet", waves, 4, 0.01),
        ("ground", np.eye(16)[15], 15, 1.0),
    ):
        told = [(sign * value).tolist() for sign in (1, -1)]
        told = [tuple(map(tuple, v)) if value.ndim > 1 else tuple(v) for v in told]
        one, other = (volts(tx.Calibration(**{name: v}))[1] for v in told)
        true = np.asarray(one - other) / (2 * step)
        found = slopes[..., parts[name]][..., number]
        # A grounded electrode's own voltage is not used.
        read = np.arange(16) != np.asarray(grounds)[:, None]
        off = np.abs(found - true)[read].max()
        assert off < 0.25 * np.abs(true[read]).max(), name


def recording(touch=0.0, scans=40):
    """Two corner slots; channels' zeros of 0.3 mV, and a touch in the latter half."""
    rng = np.random.default_rng(3)
    zero = 3e-4 * rng.normal(size=64)
    volts = zero + 3e-4 * rng.normal(size=(scans, 2, 64))
    volts[scans // 2 :] += touch * rng.uniform(0, 1, (1, 2, 64))
    return tx.recordings.ArrayRecording(
        tx.recordings.Rig.of(sensor()), volts, CORNERS
    ), zero


def test_zeros_are_those_of_contact_free_slots():
    for touch in (0.0, 0.003, 1.0):
        rec, zero = recording(touch)
        found = tx.calibration.tare(rec)
        assert np.abs(np.asarray(found.offset) - zero).max() < 2.5e-4
        assert 2.8e-4 < found.noise < 4e-4


def test_zeros_are_found_beside_a_dead_channel_and_with_a_negative_drive():
    rec, zero = recording(0.003, 400)
    volts = -rec.read(0, 400).voltages.astype(float)
    volts[:, :, 7] = 0.0123
    rig = replace(rec.rig, drive_voltage=-rec.rig.drive_voltage)
    found = tx.calibration.tare(tx.recordings.ArrayRecording(rig, volts, CORNERS))
    assert np.abs(np.delete(found.offset + zero, 7)).max() < 1e-4
    assert found.offset[7] == 0 and 2.8e-4 < found.noise < 4e-4


def test_a_touch_throughout_is_no_zero():
    rng = np.random.default_rng(4)
    volts = 3e-4 * rng.normal(size=(40, 2, 64)) + 0.003 * rng.uniform(0, 1, (1, 2, 64))
    rec = tx.recordings.ArrayRecording(tx.recordings.Rig.of(sensor()), volts, CORNERS)
    assert tx.calibration.tare(rec) == tx.Calibration()
    few, _ = recording(scans=4)
    assert tx.calibration.tare(few) == tx.Calibration()


@pytest.mark.parametrize(
    "name, change",
    [
        ("voltages", dict(voltages=np.zeros((3, 2, 63)))),
        ("voltages", dict(voltages=np.full((3, 2, 64), np.nan))),
        ("grounds", dict(grounds=np.full((3, 2), 64))),
        ("grounds", dict(grounds=np.zeros((3, 1), int))),
        ("places", dict(places=np.full((3, 2), 0.2))),
        ("places", dict(places=np.zeros((2, 2)))),
    ],
)
def test_bad_input(name, change):
    good = dict(
        voltages=np.zeros((3, 2, 64)),
        grounds=np.zeros((3, 2), int),
        places=np.full((3, 2), 0.08),
    )
    with pytest.raises(ValueError, match=f"^{name}: got"):
        tx.calibration.calibrate(sensor(), **good | change)


def test_places_from_files(tmp_path):
    want = np.array([[0.01, 0.02], [0.03, 0.04]])
    np.savez(tmp_path / "p.npz", xy=want)
    (tmp_path / "p.csv").write_text("x,y\n0.01,0.02\n0.03,0.04\n")
    for name in ("p.npz", "p.csv"):
        np.testing.assert_array_equal(read_places(tmp_path / name), want)
    np.savez(tmp_path / "q.npz", places=want)
    (tmp_path / "q.csv").write_text("1,2\n3,4,5\n")
    for name in ("q.npz", "q.csv", "none.csv"):
        with pytest.raises(ValueError, match=f"{name}: places: .*in metres$"):
            read_places(tmp_path / name)


def test_recordings_that_calibrate_nothing():
    rec, _ = recording()
    with pytest.raises(ValueError, match="^places: got .* per slot, or .* per scan"):
        tx.calibrate_recording(rec, np.zeros((3, 2)))
    with pytest.raises(ValueError, match="^places: got 0 usable slots"):
        tx.calibrate_recording(rec, np.full((40, 2), 0.08))
    with pytest.raises(ValueError, match="^recording: got no stretch with a contact"):
        tx.calibrate_recording(rec)


@pytest.mark.long
def test_one_touch_calibrates_nothing():
    """Nor does a recording of another thing."""
    touch = tx.voltages(sensor(), tx.Disc([0.07, 0.05], 0.006, 0.1), [0, 63])
    noise = 3e-4 * np.random.default_rng(1).normal(size=(200, 2, 64))
    volts, rig = np.asarray(touch) + noise, tx.recordings.Rig.of(sensor())
    with pytest.raises(ValueError, match="^voltages: got contacts in 1 squares .* rub the"):
        tx.calibrate_recording(tx.recordings.ArrayRecording(rig, volts, CORNERS))
    noise = np.random.default_rng(0).uniform(0, 2, (200, 2, 64))
    with pytest.raises(
        ValueError, match="^voltages: got . of 40 frames, expected 16 or more"
    ):
        tx.calibrate_recording(tx.recordings.ArrayRecording(rig, noise, CORNERS))


@pytest.mark.long
def test_derivatives_by_voltages_are_those_of_the_held_problem():
    """The implicit function theorem's, beside differences of the problem solved anew."""
    rng = np.random.default_rng(0)
    with jax.enable_x64(True):
        sensor = tx.Sensor.grid(3, 3, divisions=(12, 12))
        places = rng.uniform(0.008, 0.052, (24, 2))
        grounds = np.array([rng.choice(9, 4, replace=False) for _ in places])
        discs = [tx.Disc(xy, 0.004, 0.3) for xy in places]
        exact = np.stack([tx.voltages(sensor, d, g) for d, g in zip(discs, grounds)])
        volts = exact * (1 + 5e-4 * rng.normal(size=9)) + 3e-4 * rng.normal(
            size=exact.shape
        )
        # As rough places as `points` finds: its programs are compiled in the tests above.
        known = tx.calibration.known_frames(sensor, volts, grounds, places, spread=0.01)
        found = tx.calibration.calibrated(sensor, known)
        held = tx.calibration.HeldCalibration(sensor, found)
        deviation = np.sqrt(np.diag(found.covariance))
        weights, along = (
            rng.normal(size=len(deviation)) / deviation,
            rng.normal(size=volts.shape),
        )

        @jax.jit  # one program for all three: it takes most of the time to compile
        def both(volts: jax.Array) -> tuple[jax.Array, jax.Array]:
            state, pulled = jax.vjp(held.values, volts)
            return state, pulled(jnp.asarray(weights))[0]

        state, by_volts = both(jnp.asarray(volts))
        assert (np.abs(state - found.state) < 0.5 * deviation).all()
        step = 1e-6  # V: rounding and curvature both change the eighth digit
        ahead, behind = (both(volts + s * step * along)[0] for s in (1, -1))
        difference = (ahead - behind) @ weights / (2 * step)
        np.testing.assert_allclose((by_volts * along).sum(), difference, rtol=1e-5)
    with pytest.raises(ValueError, match="sensor: got float32, expected float64"):
        tx.calibration.HeldCalibration(tx.Sensor.grid(3, 3, dtype=np.float32), found)
