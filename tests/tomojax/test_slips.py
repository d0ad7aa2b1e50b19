"""Slips of users: each is told in a sentence that names the argument."""

import h5py
import jax
import numpy as np
import pytest
from click.testing import CliRunner

import tomojax as tx
from tomojax.cli.app import app

GRID = tx.Sensor.grid(4, 4, divisions=(16, 16))
TOUCH = tx.Disc([0.03, 0.05], 0.006, 1.0)
TABLE = {"conditions": np.eye(16) / 4.0}


def disc(named, **others):
    return tx.Sensor.disc(0.09, named, divisions=(54, 54), **others)


def volts(*scene, **options):
    return tx.voltages(GRID, *(scene or (TOUCH, [0])), **options)


@pytest.mark.parametrize(
    "make, told",
    [
        (lambda: disc({"ring": 16}), "electrodes: got .'ring'., expected some of rim"),
        (lambda: disc({"rim": 2.5}), "rim: got 2.5"),
        (lambda: disc({"rim": "16"}), "rim: got '16'"),
        (lambda: disc({"grid": "wide"}), "grid: got 'wide'"),
        (lambda: disc({"points": np.zeros((9, 3))}), r"points: got shape \(9, 3\)"),
        (lambda: disc({"points": np.zeros((2, 9))}), r"points: got shape \(2, 9\)"),
        (lambda: disc({"rim": 8}, drive_voltage=None), "drive_voltage"),
        (lambda: disc({"rim": 8}, electrode_diameter="5"), "electrode_diameter: got '5'"),
        (lambda: disc({"rim": 8}, told=3), "told: got 3, expected a tomojax ToldSheet"),
        (lambda: disc({"rim": 8}, dtype="float99"), "dtype: got 'float99'"),
        (lambda: disc({"rim": 8}, dtype=int), "dtype"),
        (lambda: tx.Sensor([0.1, 0.1], [[0.02, 0.02]] * 2, outline="disc"), "outline: got"),
        (lambda: tx.Disc([0.03, 0.05], "6", 1.0), "radius: got '6'"),
        (lambda: volts(tx.Disc([0.03, 0.05], 6, 1.0), [0]), "6 m.*lengths are in metres"),
        (lambda: volts(converter="16 bits"), "converter: got '16 bits'"),
        (lambda: volts(converter=tx.Converter(), key=0), "key: got 0, expected a jax"),
        (lambda: tx.voltages(None, TOUCH, [0]), "sensor: got None"),
        (lambda: tx.method("grid", "source"), "sensor: got 'grid'"),
        (lambda: tx.method(GRID, "source", calibration="a.json"), "calibration: got 'a.j"),
        (lambda: tx.make_step(GRID, "source", calibration="a.json"), "calibration: got"),
        (lambda: tx.Batch("source"), "method: got 'source'"),
        (lambda: tx.reconstruct(np.ones((1, 4, 9)), 1j * np.ones((1, 4))), "voltages: got"),
        (lambda: tx.design.design(None, 2), "objective: got None"),
        (lambda: tx.design.exchange(np.sum, np.ones(9), 3), "chosen: got 9 slots"),
        (lambda: tx.ert.Pairs.opposite("16"), "electrodes: got '16'"),
        (lambda: tx.ert.Pairs.skip(16, 0.5), "skipped: got 0.5"),
    ],
)
def test_a_slip_in_python_names_the_argument(make, told):
    with pytest.raises(ValueError, match=told):
        make()


def test_a_contact_off_a_round_sheet_is_refused_within_its_box_too():
    round_skin = disc({"rim": 8})
    assert (tx.voltages(round_skin, tx.Disc([0.012, 0.012], 0.006, 1.0), [0]) > 0).any()
    with pytest.raises(ValueError, match="off the sheet"):
        tx.voltages(round_skin, tx.Disc([0.004, 0.004], 0.006, 1.0), [0])


def test_scenes_of_a_table_of_conditions_say_what_makes_them():
    paired = tx.Sensor.grid(4, 4, divisions=(16, 16), **TABLE)
    with pytest.raises(ValueError, match=r"table of conditions.*tomojax\.voltages"):
        tx.design.simulate_scenes(paired, np.array([[0.03, 0.05]]), rigs=1)


def test_descend_sets_asks_for_a_number_of_slots():
    places = tx.design.design_places(GRID, count=4)
    scenes = tx.design.simulate_scenes(GRID, places, rigs=1)
    method = tx.method(GRID, "linear", grid=16)
    objective = tx.design.ImageError.of(method, scenes, width=0.008)
    for name, given in (("n", 0), ("n", 17), ("n", "6"), ("steps", 0), ("draws", 0)):
        options = {"n": 2, "steps": 2, "draws": 1, name: given}
        with pytest.raises(ValueError, match=f"^{name}: got"):
            tx.design.descend_sets(objective, **options)


def test_batch_takes_lists_and_refuses_codes_and_broken_grounds():
    method = tx.method(GRID, "source", grid=16)
    v, grounds = np.asarray(volts(TOUCH, [0, 15]))[None], np.array([[0, 15]])
    batch = tx.Batch(method, contacts=1)
    rows = batch(v.tolist(), grounds.tolist())
    np.testing.assert_allclose(rows.contact_xy, batch(v, grounds).contact_xy, rtol=1e-5)
    np.testing.assert_array_equal(rows.contact_count, [1])
    for name, *given in (
        ("voltages", (1e4 * v).astype(np.int16), grounds),
        ("grounds", v, grounds * 1.0),
        ("good", v, grounds, np.ones(v.shape, int)),
    ):
        with pytest.raises(ValueError, match=f"^{name}: got"):
            batch(*given)
    with pytest.raises(ValueError, match="lam: got auto"):
        tx.Batch(method, "auto")
    assert tx.Batch(method, jax.numpy.asarray(1e6)).lam == 1e6


def _csv(path, lost=(), cut=0, odd=False):
    """Five scans of four slots as text; the file beside does not say how many slots."""
    rng, lines = np.random.default_rng(0), ["number,ground,a,b,c,d"]
    for slot in range(40):
        if slot // 4 not in lost:
            readings = ",".join(f"{v:.6f}" for v in rng.normal(1, 0.1, 4))
            lines.append(f"{slot},{slot % 4},{readings}")
    if odd:
        lines.insert(7, "1,2,3")
    text = "\n".join(lines) + "\n"
    path.write_text(text[: len(text) - cut])
    path.with_suffix(".toml").write_text(
        "f_switch = 400\ndrive_voltage = 4.5\nground_resistance = 4\nrows = 2\n"
        "sheet_resistance = 1e4\nelectrode_diameter = 0.005\ncolumns = 2\npitch = 0.02\n"
    )
    return path


def test_lost_scans_leave_the_period_of_the_grounds(tmp_path):
    with tx.open_recording(_csv(tmp_path / "a.csv", lost=(2, 5, 6))) as found:
        assert (found.slots, found.scans) == (4, 7)
        np.testing.assert_array_equal(found.gaps[:, 1], [1, 2])


def test_a_csv_that_ends_in_mid_line_is_read_up_to_there(tmp_path):
    with tx.open_recording(_csv(tmp_path / "a.csv", cut=20)) as found:
        assert found.scans == 10  # of the last scan a slot is missing
        assert any("cut off" in one for one in found.mended)
        assert np.isnan(found.read(9, 10).voltages[0, 3]).all()


def test_a_csv_that_lacks_something_says_all_of_it(tmp_path):
    path = _csv(tmp_path / "a.csv", odd=True)
    with pytest.raises(ValueError, match="line 7 below the names, expected 6, as"):
        tx.open_recording(path)
    path = _csv(tmp_path / "b.csv")
    path.with_suffix(".toml").write_text("slots = 4\n")
    with pytest.raises(ValueError, match="drive_voltage, ground_resistance, sheet_res"):
        tx.open_recording(path)
    path.write_text("time,i0r0,i0r1\n0,1,2\n")
    with pytest.raises(ValueError, match="of pairs: kind and protocol in a file .toml"):
        tx.open_recording(path)


@pytest.mark.parametrize(
    "words, told",
    [
        ("reconstruct a.h5 --resume --overwrite", "--resume: got --overwrite too"),
        ("reconstruct a.h5 --cluster nowhere", "--cluster: got nowhere, expected HOST:"),
        ("export a.h5 --film a.gif --slow 0", "expected a number above 0"),
        ("design --region 0.06 0.06 0.1 0.1", "sides of 1 mm or more"),
        ("compile-step --method auto", "--method: got 'auto'"),
        ("compile-step --cheaper shape", "--cheaper: got 'shape'"),
    ],
)
def test_a_slip_at_a_command_is_a_line(words, told, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rig = tx.recordings.Rig.of(GRID)
    with h5py.File("a.h5", "w") as file:
        told_rig = tx.recordings.attributes(rig, 2e-4, 0.0)
        tx.recordings.write_attributes(file, told_rig)
        file["v"] = np.ones((3, 2, 16), np.int16)
        file["ground"], file["t0"] = np.tile([0, 15], (3, 1)), np.arange(3) * 2e-4
    done = CliRunner().invoke(app, words.split())
    assert done.exit_code != 0
    assert told in (str(done.exception) + done.output)


def test_a_calibration_that_is_no_response_is_named(tmp_path):
    path = tmp_path / "check.json"
    path.write_text("{}")
    with pytest.raises(ValueError, match=r"check\.json: file: got no HDF5"):
        tx.ert.Response.load(path)
