"""A results file that is stopped, resumed, or has no room: nothing is lost."""

import errno
import fcntl
import json
import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import tomojax as tx
from tomojax.cli.entry import check_paths, interrupts, Written


@pytest.fixture(scope="module")
def touched():
    """A recording of few electrodes; nothing in it takes long."""
    sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    volts = np.asarray(tx.voltages(sensor, tx.Disc([0.03, 0.05], 0.006, 1.0), [0, 15]))
    volts = np.tile(volts, (40, 1, 1)) * np.linspace(1, 1.1, 40)[:, None, None]
    return tx.recordings.ArrayRecording(tx.recordings.Rig.of(sensor), volts, [0, 15])


def settings(**more) -> tx.results.Settings:
    given = {"method": "source", "grid": 16, "contacts": 2, "chunk": 10, "tare": False}
    return tx.results.Settings(**(given | more))


def test_two_runs_do_not_write_one_file(touched, tmp_path) -> None:
    out, lock = tmp_path / "o.h5", tmp_path / "o.h5.partial.lock"
    with lock.open("w") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(ValueError, match="o.h5: another run is writing it"):
            tx.reconstruct_recording(touched, out, settings(), overwrite=True)
        out.with_name("o.h5.partial").touch()  # the other run has begun
        with pytest.raises(ValueError, match="o.h5: another run is writing it"):
            tx.reconstruct_recording(touched, out, settings())
        with pytest.raises(ValueError, match="o.h5: another run is writing it"):
            check_paths([], [Written(out, "--out", "results", True, ())], False, False)
        out.with_name("o.h5.partial").unlink()
    # Its owner was killed: the lock is nobody's.
    tx.reconstruct_recording(touched, out, settings())
    assert list(tmp_path.iterdir()) == [out]


def test_a_start_that_fails_leaves_nothing(touched, tmp_path) -> None:
    out, path = tmp_path / "o.h5", tmp_path / "c.json"
    tx.Calibration(gain=(1.0,) * 5).save(path)
    with pytest.raises(ValueError):
        tx.reconstruct_recording(touched, out, settings(calibration=str(path)))
    assert list(tmp_path.iterdir()) == [path]


def full(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_is_a_line_and_can_be_resumed(touched, tmp_path, monkeypatch) -> None:
    out, one = tmp_path / "o.h5", tmp_path / "one.h5"
    tx.reconstruct_recording(touched, one, settings())
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)  # where a disk tells that it is full
        with pytest.raises(ValueError, match="o.h5: No space left.*--resume goes on"):
            tx.reconstruct_recording(touched, out, settings())
    assert not out.exists()
    tx.reconstruct_recording(touched, out, settings(), resume=True)
    assert out.read_bytes() == one.read_bytes()
    assert sorted(tmp_path.iterdir()) == [out, one]


def test_resumed_with_something_else_is_a_line(touched, tmp_path) -> None:
    out, path = tmp_path / "o.h5", tmp_path / "c.json"
    tx.Calibration(gain=1.0).save(path)

    def stop(done: int, total: int) -> None:
        if done:
            raise KeyboardInterrupt

    given = settings(calibration=str(path))
    with pytest.raises(KeyboardInterrupt):
        tx.reconstruct_recording(touched, out, given, progress=stop)
    left = (tmp_path / "o.h5.partial").read_bytes()
    again = lambda given: tx.reconstruct_recording(touched, out, given, resume=True)  # noqa: E731
    with pytest.raises(ValueError, match="method: begun with source, now linear"):
        again(settings(calibration=str(path), method="linear"))
    with pytest.raises(ValueError, match="calibration: begun with .*, now None"):
        again(settings())
    tx.Calibration(gain=1.01).save(path)
    with pytest.raises(ValueError, match="calibration_sha256: begun with"):
        again(given)
    assert (tmp_path / "o.h5.partial").read_bytes() == left
    # The same calibration counts wherever it lies.
    moved = tmp_path / "moved.json"
    tx.Calibration(gain=1.0).save(moved)
    again(settings(calibration=str(moved)))
    assert out.exists()


def test_chunks_are_as_long_as_the_method_lets_them(tmp_path) -> None:
    """Without a clock: two runs with the same configuration make the same bytes."""
    sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    quiet = np.zeros((20_000, 1, 16), np.float32)
    recording = tx.recordings.ArrayRecording(tx.recordings.Rig.of(sensor), quiet, [0])
    for method, longest in (("auto", 2528), ("source", 1 << 16)):
        given = settings(method=method, rate="slot", images=False, chunk=None, lam=1.0)
        path = tx.reconstruct_recording(recording, tmp_path / f"{method}.h5", given)
        with h5py.File(path) as file:
            chunk = json.loads(str(file.attrs["configuration"]))["chunk"]
        assert longest / 2 < chunk <= longest  # of whole films


def test_a_batch_hears_ctrl_c_between_its_parts(touched) -> None:
    method = tx.method(touched.rig.sensor(), "source", grid=16)
    batch = tx.Batch(method, 1.0, contacts=2)
    some = touched.read(0, 4)
    with interrupts() as asked:
        asked.set()
        with pytest.raises(KeyboardInterrupt):
            batch(np.asarray(some.voltages, np.float64), some.grounds)


@pytest.mark.long
def test_killed_and_stopped_at_random_moments(shared_data, tmp_path) -> None:
    """An excerpt of tests/fuzz/interrupts.py, which has 200 of all commands."""
    script = Path(__file__).parents[1] / "fuzz" / "interrupts.py"
    words = ["--count", "2", "--only", "source scan", "--folder", str(tmp_path)]
    words += ["--data", str(shared_data)]
    run = subprocess.run([sys.executable, script, *words], capture_output=True, text=True)
    told = json.loads(run.stdout or run.stderr)
    assert told["moments"] == 2 and told["ends"] and not told["wrong"], told
    assert not told["strays"] and max(told["ctrl_c_s"], default=0) < 20
