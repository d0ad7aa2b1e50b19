"""Reading recordings: what is right is read exactly, what is wrong is one clear line."""

import os

import h5py
import numpy as np
import pytest
import recordings

import tomojax as tx


def test_reads_what_was_written(tmp_path, rng):
    codes = recordings.noise(rng, 5)
    path = recordings.write(tmp_path / "a.h5", codes, gaps=np.array([[2, 3], [8, 1]]))
    recording = tx.open_recording(path)
    assert (recording.scans, recording.slots, recording.electrodes) == (5, 2, 64)
    scans = recording.read(1, 4)
    want = (codes[1:4] * (5 / 32768)).astype(np.float32)
    np.testing.assert_array_equal(scans.voltages, want)
    np.testing.assert_array_equal(scans.grounds, [[0, 63]] * 3)
    np.testing.assert_allclose(scans.t0, [2e-4, 4e-4, 6e-4])
    # Scans 2 to 4 and 8 were lost: rows 2 and 5 come after.
    np.testing.assert_array_equal(recording.rows_after_gaps(), [2, 5])


def test_matlab_file_is_the_same_recording(tmp_path, rng):
    codes = recordings.noise(rng, 6, 3)
    one = tx.open_recording(recordings.write(tmp_path / "a.h5", codes, [0, 63, 7]))
    other = tx.open_recording(
        recordings.write_matlab(tmp_path / "a.mat", codes, [0, 63, 7])
    )
    for a, b in zip(one.read(1, 5), other.read(1, 5)):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(one.rig.electrode_xy, other.rig.electrode_xy)
    assert one.rig.size == other.rig.size and one.rig.rails == other.rig.rails


def test_tdms_and_hdf5_are_the_same_recording(shared_data):
    tdms = shared_data / "bounce_spanner_copline.tdms"
    how = dict(group="scan", channels="ai{}", ground="ground", slots="10", rail="5")
    with tx.open_recording(tdms.with_suffix(".h5")) as one:
        for options in ({}, how):
            with tx.open_recording(tdms, **options) as other:
                for a, b in zip(one.read(0, one.scans), other.read(0, other.scans)):
                    np.testing.assert_array_equal(a, b)
    for wrong in (dict(group="x"), dict(channels="ai"), dict(ground="g"), dict(slots="0")):
        with pytest.raises(ValueError, match=f"{tdms}: {[*wrong][0]}: got "):
            tx.open_recording(tdms, **wrong)


def test_file_that_is_still_being_written(tmp_path, rng):
    """In SWMR mode: what is there when it is opened; also left so by a crash."""
    codes = recordings.noise(rng, 40)
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", libver="latest") as file:
        for name, value in recordings.ATTRIBUTES.items():
            file.attrs[name] = value
        file["electrode_xy"] = recordings.electrode_xy()
        file["gaps"] = np.zeros((0, 2), np.int64)
        v = file.create_dataset("v", (0, 2, 64), "i2", maxshape=(None, 2, 64))
        ground = file.create_dataset("ground", (0, 2), "u1", maxshape=(None, 2))
        t0 = file.create_dataset("t0", (0,), "f8", maxshape=(None,))
        file.swmr_mode = True
        for data, rows in ((v, 40), (ground, 39), (t0, 38)):
            data.resize(rows, 0)
        v[:], ground[:], t0[:] = codes, [0, 63], np.arange(38) * 2e-4
        file.flush()
        recording = tx.open_recording(path)
        assert recording.scans == 38
        want = (codes[:38] * (5 / 32768)).astype(np.float32)
        np.testing.assert_array_equal(recording.read(0, 99).voltages, want)
        recording.close()
        crashed = tmp_path / "crashed.h5"
        crashed.write_bytes(path.read_bytes())
    assert tx.open_recording(crashed).scans == 38


WRONG = {
    "missing dataset": (dict(leave_out=["ground"]), "ground"),
    "missing attribute": (dict(leave_out=["f_switch"]), "f_switch"),
    "no schema": (dict(leave_out=["schema"]), "schema"),
    "another schema": (dict(schema="results"), "schema"),
    "future version": (dict(schema_version=3), "schema_version"),
    "millivolts": (dict(units="mV"), "units"),
    "scale in millivolts": (dict(scale=5000 / 32768), "scale"),
    "sheet in millimetres": (dict(size=[160.0, 160.0]), "size"),
    "electrodes in millimetres": (
        dict(electrode_xy=1e3 * recordings.electrode_xy()),
        "electrode_xy",
    ),
    "rows too few": (dict(t0=np.arange(4) * 2e-4), "t0"),
    "grounds of other slots": (dict(ground=np.zeros((5, 3), np.uint8)), "ground"),
    "electrodes too few": (
        dict(electrode_xy=recordings.electrode_xy()[:60]),
        "electrode_xy",
    ),
    "two axes": (dict(v=np.zeros((5, 128), np.int16)), "v"),
    "volts of an unknown sheet": (
        dict(v=np.zeros((5, 2, 64)), leave_out=("size",)),
        "size",
    ),
    "complex codes": (dict(v=np.zeros((5, 2, 64), complex)), "v"),
    "gaps of three": (dict(gaps=np.zeros((1, 3), int)), "gaps"),
    "gap of less than none": (dict(gaps=np.array([[2, -1]])), "gaps"),
    "negative resistance": (dict(sheet_resistance=-1.0), "sheet_resistance"),
    "no frequency": (dict(f_switch=0.0), "f_switch"),
    "text for a number": (dict(scale="five"), "scale"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_file_names_the_field(tmp_path, rng, wrong):
    changed, field = WRONG[wrong]
    path = recordings.write(tmp_path / "a.h5", recordings.noise(rng, 5), **changed)
    with pytest.raises(ValueError, match=rf"^{path}: {field}: got .*, expected ") as caught:
        tx.open_recording(path)
    assert "\n" not in str(caught.value)


def test_files_that_are_no_recording(tmp_path, rng):
    good = recordings.write(tmp_path / "good.h5", recordings.noise(rng, 50)).read_bytes()
    contents = {"empty.h5": b"", "text.h5": b"volts\n1 2\n", "text.tdms": b"volts"}
    contents["cut.h5"] = good[: len(good) // 2]
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=f"{name}: file: ") as caught:
            tx.open_recording(tmp_path / name)
        assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="no such file"):
        tx.open_recording(tmp_path / "absent.h5")
    with pytest.raises(ValueError, match="a folder"):
        tx.open_recording(tmp_path)
    if os.geteuid():  # root reads everything
        (tmp_path / "good.h5").chmod(0)
        with pytest.raises(ValueError, match="Permission denied"):
            tx.open_recording(tmp_path / "good.h5")


def test_arrays_are_a_recording(rng):
    rig = tx.recordings.Rig.of(tx.Sensor.grid())
    v = rng.normal(0, 3e-4, (7, 2, 64))
    recording = tx.recordings.ArrayRecording(rig, v, [0, 63])
    assert recording.read(2, 4).grounds.tolist() == [[0, 63]] * 2
    with pytest.raises(ValueError, match="grounds: got shape"):
        tx.recordings.ArrayRecording(rig, v, [0, 63, 5])
    with pytest.raises(ValueError, match="voltages: got shape"):
        tx.recordings.ArrayRecording(rig, v[0], [0, 63])
