"""Moments that somebody has marked: from the ring into recordings, and on from there."""

import json

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

import tomojax as tx
from tomojax.cli.app import app
from tomojax.hardware import Got, SlotRing
from tomojax.hardware.loop.recorder import Recorder
from tomojax.recordings import attributes

RATE, M = 10_000, 16
NOTHING = {"latency": np.nan, "next": -1, "flags": 0, "count": 0}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A recording with marks, one of them by somebody who means no good."""
    folder = tmp_path_factory.mktemp("marks")
    ring = SlotRing.create(M, length=1 << 12, folder=folder)
    with pytest.raises(ValueError, match="mark: got no slot yet"):
        ring.mark("early")
    sensor = tx.Sensor.grid(4, 4, dtype=np.float32, divisions=(32, 32))
    told = attributes(tx.recordings.Rig.of(sensor, float(RATE)), 5 / 32768, 0.0)
    path = folder / "push.h5"
    for number in range(1000):
        got = Got(number % M, 0, number, number / RATE, 0.0)
        codes = ((number * 7 + 13 * np.arange(M)) % 200).astype("i2")
        ring.put(got, codes, NOTHING)
        if number == 500:
            assert ring.mark("the spanner falls") == 0.05
        if number == 700:
            ring.mark("\x1b[2Jä" + 100 * "ü")
        if number == 900:
            ring.mark("")
    recorder = Recorder(ring, path, told)
    ring.head["done"][...] = 1
    recorder.close()
    assert ring.unrecorded_marks() == []
    ring.remove()
    return path


def test_marks_are_in_the_recording_and_steer_no_terminal(recorded):
    with tx.open_recording(recorded) as recording:
        marks = recording.marks
    assert [t for t, _ in marks] == [0.05, 0.07, 0.09]
    texts = [text for _, text in marks]
    assert texts[0] == "the spanner falls" and texts[2] == ""
    assert texts[1].startswith("[2Jä") and len(texts[1].encode()) <= 80
    with h5py.File(recorded) as file:
        assert file.attrs["schema_version"] == 1
        assert file["marks"].dtype == "S80" and file["marks_t"].dtype == "f8"
    told = CliRunner().invoke(app, ["info", str(recorded)])
    assert "mark at 0.05 s: the spanner falls" in told.output
    assert "\x1b" not in told.output


def test_escapes_in_a_file_are_not_printed(recorded, tmp_path):
    path = tmp_path / "bad.h5"
    path.write_bytes(recorded.read_bytes())
    with h5py.File(path, "r+") as file:
        file["marks"][0] = b"\x1b]0;owned\x07\xff"
    told = CliRunner().invoke(app, ["info", str(path)])
    assert "\x1b" not in told.output and "\x07" not in told.output
    with h5py.File(path, "r+") as file:
        del file["marks"]
        file["marks"] = np.zeros((3, 2))
    with tx.open_recording(path) as recording:
        assert recording.marks == () and "marks" in " ".join(recording.mended)


def test_repair_and_results_keep_marks(recorded, tmp_path):
    sound, part = tmp_path / "sound.h5", tmp_path / "part.h5"
    with tx.open_recording(recorded) as recording:
        tx.recordings.repair_recording(recording, sound)
        tx.recordings.repair_recording(recording, part, scans=(600, 800))
        marks = recording.marks
    with tx.open_recording(sound) as recording:
        assert recording.marks == marks
    with tx.open_recording(part) as recording:
        assert recording.marks == marks[1:2]
        settings = tx.results.Settings("linear", contacts=1, tare=False)
        out = tx.reconstruct_recording(recording, tmp_path / "out.h5", settings)
    with h5py.File(out) as file:
        assert json.loads(file.attrs["marks"]) == [list(marks[1])]


def test_a_late_recorder_loses_no_mark_unseen(tmp_path):
    ring = SlotRing.create(M, length=256, folder=tmp_path)
    ring.put(Got(0, 0, 0, 0.0, 0.0), np.zeros(M, "i2"), NOTHING)
    for _ in range(64):
        ring.mark("again")
    with pytest.raises(ValueError, match="recorder in time"):
        ring.mark("one more")
    ring.remove()
