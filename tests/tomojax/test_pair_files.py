"""Recordings of pairs: tables, MATLAB's files, protocols by name, references, a check."""

import numpy as np
import pandas
import pytest
from click.testing import CliRunner
from scipy.io import savemat

import tomojax as tx
from tomojax.cli.app import app
from tomojax.ert import PairRecording, Pairs

RADIUS = 0.05
RIM = RADIUS * np.stack([f(2 * np.pi * np.arange(8) / 8) for f in (np.cos, np.sin)], 1)
DISC = tx.recordings.Outline("disc", 2 * RADIUS)
DESCRIPTION = """
kind = "conductivity"
protocol = "opposite"
rim = 8
outline = "disc"
diameter = 0.1
electrode_diameter = 0.01
"""


def sensor() -> tx.Sensor:
    return tx.Sensor.disc(2 * RADIUS, RIM + RADIUS, electrode_diameter=0.01, dtype=float)


def pressed(pairs: Pairs, places: np.ndarray, wired=range(8)) -> np.ndarray:
    """Changes of readings under presses (n, C, R), where wires are as they are `wired`."""
    real = Pairs(np.take(wired, pairs.inject), np.take(wired, pairs.read))
    volts = np.asarray(tx.ert.sensitivities(sensor(), real, places + RADIUS))
    return volts / np.std(volts)


@pytest.fixture(scope="module")
def places() -> np.ndarray:
    return 0.03 * np.random.default_rng(1).uniform(-1, 1, (60, 2))


@pytest.fixture(scope="module")
def recorded(places) -> PairRecording:
    pairs = Pairs.opposite(8)
    volts = pressed(pairs, places)
    known = np.where(np.arange(60)[:, None] % 3, places, np.nan)
    return PairRecording(volts, pairs, RIM, 0.01, DISC, places=known, notes='"a" = b')


def alike(one: PairRecording, other: PairRecording) -> None:
    np.testing.assert_allclose(one.voltages, other.voltages, rtol=1e-6, atol=1e-7)
    np.testing.assert_array_equal(one.pairs.inject, other.pairs.inject)
    np.testing.assert_array_equal(one.pairs.read, other.pairs.read)
    np.testing.assert_allclose(one.electrode_xy, other.electrode_xy, atol=1e-12)
    assert (one.places is None) == (other.places is None)
    if one.places is not None:
        np.testing.assert_allclose(one.places, other.places, atol=1e-9)
    assert (one.box, one.magnitude, one.f_switch) == (
        other.box,
        other.magnitude,
        other.f_switch,
    )


@pytest.mark.parametrize("ending", [".csv", ".mat", ".h5"])
def test_what_is_written_comes_back(recorded, tmp_path, ending) -> None:
    path = tmp_path / f"skin{ending}"
    recorded.save(path)
    assert tx.recordings.kind_of(path) == "conductivity"
    back = tx.ert.load(path)
    alike(back, recorded)
    assert back.notes == recorded.notes
    np.testing.assert_allclose(back.t0, recorded.t0)


def test_an_unknown_ending_is_refused(recorded, tmp_path) -> None:
    with pytest.raises(ValueError, match=r"skin.xlsx, expected an ending one of .h5"):
        recorded.save(tmp_path / "skin.xlsx")


def test_a_table_without_names_is_a_frame_a_line(recorded, tmp_path) -> None:
    path = tmp_path / "skin.csv"
    np.savetxt(path, recorded.voltages.reshape(60, -1), delimiter=";")
    path.with_suffix(".toml").write_text(DESCRIPTION)
    back = tx.ert.load(path)
    np.testing.assert_allclose(back.voltages, recorded.voltages)
    np.testing.assert_allclose(back.electrode_xy, RIM, atol=1e-12)
    assert back.places is None


@pytest.mark.parametrize("index", [True, False])
def test_columns_that_pandas_counts_are_no_frame(recorded, tmp_path, index) -> None:
    path = tmp_path / "skin.csv"
    pandas.DataFrame(recorded.voltages.reshape(60, -1)).to_csv(path, index=index)
    path.with_suffix(".toml").write_text(DESCRIPTION)
    np.testing.assert_allclose(tx.ert.load(path).voltages, recorded.voltages)
    np.savetxt(path, [[np.nan] * 32, recorded.voltages[1].ravel()], delimiter=",")
    assert tx.ert.load(path).bad.sum() == 32


def test_readings_at_driven_electrodes_are_left_out(places, tmp_path) -> None:
    # As pyEIT's standard and most adjacent rigs have them: all of 8, from the own one on.
    whole = Pairs.named("adjacent", 8, rotated=True, driven=True)
    volts = pressed(whole, places)
    assert whole.read[3, 0].tolist() == [4, 3]
    path = tmp_path / "skin.npz"
    np.savez(path, v=volts.reshape(60, -1))
    told = DESCRIPTION.replace("opposite", "adjacent") + "rotated = true\n"
    path.with_suffix(".toml").write_text(told)
    back = tx.ert.load(path)
    assert back.pairs.read.shape == (8, 5, 2)
    wanted = Pairs.skip(8, 0, rotated=True)
    np.testing.assert_array_equal(back.pairs.read, wanted.read)
    scale = np.std(np.asarray(tx.ert.sensitivities(sensor(), whole, places + RADIUS)))
    single = np.asarray(tx.ert.sensitivities(sensor(), wanted, places + RADIUS)) / scale
    np.testing.assert_allclose(back.voltages, single, atol=1e-9)


@pytest.mark.parametrize("compressed", [False, True])
def test_matlabs_older_files_are_read(recorded, tmp_path, compressed) -> None:
    path = tmp_path / "skin.mat"
    told = {"kind": "conductivity", "protocol": "opposite", "rim": 8.0, "outline": "disc"}
    told |= {"diameter": 0.1, "electrode_diameter": 0.01, "v": recorded.voltages}
    told["reference"] = recorded.voltages[7]  # a frame, as the first has its shape
    savemat(path, told, do_compression=compressed)
    wanted = recorded.voltages - recorded.voltages[7]
    np.testing.assert_allclose(tx.ert.load(path).voltages, wanted)
    del told["reference"]
    savemat(path, told | {"reference": "first", "frames": 2.0})
    wanted = recorded.voltages - recorded.voltages[:2].mean(0)
    np.testing.assert_allclose(tx.ert.load(path).voltages, wanted, atol=1e-12)


def test_a_contact_recording_in_matlabs_older_format_is_read(tmp_path) -> None:
    path = tmp_path / "rec.mat"
    rng = np.random.default_rng(0)
    codes = rng.integers(-900, 900, (6, 2, 64)).astype(np.int16)
    xy = 0.01 + 0.02 * np.indices((8, 8)).reshape(2, -1).T
    told = {"schema": tx.recordings.SCHEMA, "schema_version": 1.0, "v": codes}
    told |= {"ground": np.tile([0, 63], (6, 1)), "t0": np.arange(6) / 5000.0}
    told |= {"electrode_xy": xy, "size": [0.16, 0.16], "scale": 5 / 32768, "offset": 0.0}
    told |= {"units": "V", "f_switch": 1e4, "drive_voltage": 5.0, "sheet_resistance": 1e4}
    told |= {"electrode_diameter": 5e-3, "settle_delay": 1e-5, "convert_period": 1e-6}
    told |= {"contact_resistance": 4.0, "converter_bits": 16.0, "ground_resistance": 4.0}
    savemat(path, told)
    with tx.open_recording(path) as recording:
        got = recording.read(0, 6)
    np.testing.assert_allclose(got.voltages, codes * (5 / 32768), rtol=1e-6)
    np.testing.assert_array_equal(got.grounds, told["ground"])


def test_a_running_reference_follows_a_drift(places) -> None:
    pairs, n = Pairs.opposite(8), 600
    rng = np.random.default_rng(2)
    press = pressed(pairs, places[:8])
    volts = 5 + np.linspace(0, 3, n)[:, None, None] + 1e-3 * rng.normal(size=(n, 8, 4))
    held = np.zeros(n, bool)
    for k, one in enumerate(press):
        volts[50 + 70 * k : 65 + 70 * k] += one
        held[50 + 70 * k : 65 + 70 * k] = True
    recording = PairRecording(volts, pairs, RIM, 0.01, DISC, t0=np.arange(n) / 10)
    found = recording.against("running", seconds=10).voltages
    assert np.sqrt((found[~held] ** 2).mean()) < 0.1
    np.testing.assert_allclose(found[57], press[0], atol=0.15)
    # Of a rig at rest the first quiet frames, behind a press that is there at first.
    still = 5 + 1e-3 * rng.normal(size=(100, 8, 4))
    still[:7] += np.linspace(1, 0.2, 7)[:, None, None] * press[1]
    still[60:80] += press[2]
    quiet = PairRecording(still, pairs, RIM, 0.01, DISC)
    found = quiet.against("quiet").voltages
    assert abs(found[10:60]).max() < 0.01 and abs(found[70] - press[2]).max() < 0.01
    assert abs(quiet.against("first").voltages[70] - press[2]).max() > 0.1
    given = quiet.against(still[50]).voltages
    np.testing.assert_array_equal(given[50], 0 * still[50])
    with pytest.raises(ValueError, match="reference: got no stretch of 10 frames that is"):
        PairRecording(pressed(pairs, places), pairs, RIM, 0.01, DISC).against("quiet")
    with pytest.raises(ValueError, match="reference: got 'mean', expected one of first"):
        quiet.against("mean")
    with pytest.raises(ValueError, match="reference: got shape"):
        quiet.against(still)


def test_a_description_tells_the_reference(places, tmp_path) -> None:
    pairs = Pairs.opposite(8)
    volts = 3 + np.concatenate([np.zeros((5, 8, 4)), pressed(pairs, places)])
    path = tmp_path / "skin.csv"
    np.savetxt(path, volts.reshape(65, -1), delimiter=",")
    more = 'reference = "first"\nframes = 5\n'
    path.with_suffix(".toml").write_text(DESCRIPTION + more)
    np.testing.assert_allclose(tx.ert.load(path).voltages, volts - 3, atol=1e-12)


@pytest.mark.parametrize(
    "change, told",
    [
        (("rim = 8", ""), "electrode_xy: got none, expected it, or rim"),
        (("rim = 8", "rim = 2"), "rim: got 2, expected how many electrodes"),
        (('"opposite"', '"round"'), "protocol: got 'round', expected 'adjacent'"),
        (("diameter = 0.1\n", ""), "rim_diameter: got none, expected m, or the disc's"),
        (("rim = 8", "rim = 12"), "v: got shape .60, 32., expected .frames, 12, 8."),
        (("rim = 8", "rim = 8\nrims = 1"), "description: got ..rims.., expected some of"),
        (("electrode_diameter = 0.01", ""), "electrode_diameter: got none"),
        (('"conductivity"', '"contact"'), "kind: got 'contact'"),
        (("rim = 8", 'rim = 8\nclockwise = "no"'), "clockwise: got 'no', expected true"),
        (('"opposite"', '"opposite"\nreference = "now"'), "reference: got 'now'"),
        (('"opposite"', '"opposite"\nreference = [1.0]'), "reference: got shape"),
        (
            ('"opposite"', '"opposite"\nreference = "first"\nframes = 2.5'),
            "frames: got 2.5, expected a whole number",
        ),
    ],
)
def test_bad_descriptions_are_told_in_a_line(recorded, tmp_path, change, told) -> None:
    path = tmp_path / "skin.csv"
    np.savetxt(path, recorded.voltages.reshape(60, -1), delimiter=",")
    text = DESCRIPTION.replace(*change, 1)
    assert text != DESCRIPTION
    path.with_suffix(".toml").write_text(text)
    with pytest.raises(ValueError, match=f"^{path}: {told}") as error:
        tx.ert.load(path)
    assert "\n" not in str(error.value)


def run(*words) -> str:
    done = CliRunner().invoke(app, ["--no-cache", *map(str, words)])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.output


def test_commands_take_a_table(recorded, tmp_path) -> None:
    path, out = tmp_path / "skin.csv", tmp_path / "out.h5"
    recorded.save(path)
    assert "frames: 60\n" in run("info", path)
    assert "places known of 40: off by" in run("reconstruct", path, "-o", out)
    assert run("check", path) == "no fault found\n"


def kinds(volts: np.ndarray, pairs: Pairs, **more) -> list:
    recording = PairRecording(volts, pairs, RIM, 0.01, DISC, **more)
    return [(f.kind, tuple(sorted(f.electrodes))) for f in tx.ert.check(recording)]


@pytest.mark.parametrize("protocol", ["adjacent", "opposite"])
def test_exchanged_electrodes_are_named(protocol, places, rng) -> None:
    pairs = Pairs.named(protocol, 8)
    noise = 0.05 * rng.normal(size=(60, *pairs.read.shape[:2]))
    assert kinds(pressed(pairs, places) + noise, pairs) == []
    for one, other in ((2, 3), (1, 5)):
        wired = np.arange(8)
        wired[[one, other]] = other, one
        volts = pressed(pairs, places, wired) + noise
        assert kinds(volts, pairs) == [("swapped", (one, other))]


def test_magnitudes_tell_exchanged_electrodes(places) -> None:
    pairs = Pairs.adjacent(8)
    wired = [0, 1, 2, 6, 4, 5, 3, 7]
    real = Pairs(np.take(wired, pairs.inject), np.take(wired, pairs.read))
    sign = np.sign(np.asarray(tx.ert.background(sensor(), real)))
    volts = pressed(pairs, places, wired) * sign
    assert kinds(volts, pairs, magnitude=True) == [("swapped", (3, 6))]


def test_dead_electrodes_and_reversed_wires_are_named(places, rng) -> None:
    pairs = Pairs.adjacent(8)
    sound = pressed(pairs, places)
    noise = 1e-3 * rng.normal(size=sound.shape)
    at = (pairs.read == 3).any(2) | (pairs.inject == 3).any(1)[:, None]
    assert kinds(np.where(at, 0, sound) + noise, pairs)[0] == ("dead", (3,))
    jumping = np.where(at, 300 * rng.normal(size=sound.shape), sound)
    assert kinds(jumping, pairs)[0] == ("loud", (3,))
    turned = sound.copy()
    turned[:, 5] *= -1  # an injection
    assert kinds(turned, pairs) == [("reversed", (5, 6)), ("reciprocity", (5, 6))]


def test_too_few_presses_are_refused(places) -> None:
    pairs = Pairs.adjacent(8)
    with pytest.raises(ValueError, match="v: got 5 frames with a change, expected twenty"):
        kinds(pressed(pairs, places[:5]), pairs)
    with pytest.raises(ValueError, match="v: got readings that never change"):
        kinds(0 * pressed(pairs, places), pairs)


def test_measured_skins_have_no_fault(shared_data) -> None:
    for name in ("skin_nopattern.h5", "skin_radial.h5"):
        assert tx.ert.check(tx.ert.load(shared_data / name)) == []
