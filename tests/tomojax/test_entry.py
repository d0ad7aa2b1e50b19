"""No command destroys what it is given, and each stops when it is told to."""

import errno
import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import click
import h5py
import numpy as np
import pytest
import recordings
from click.testing import CliRunner

import tomojax as tx
from tomojax._whole import whole, write_text
from tomojax.cli import app
from tomojax.cli.entry import Command, InputFile, interrupts, OutputFile, OutputFolder


def run(monkeypatch, capsys, *words) -> tuple[int, str]:
    """Status and standard error, one line at most where it failed."""
    monkeypatch.setattr(sys, "argv", ["tomojax", "--no-cache", *map(str, words)])
    with pytest.raises(SystemExit) as stop:
        app.run()
    errors = capsys.readouterr().err.strip()
    assert stop.value.code == 0 or len(errors.splitlines()) == 1, errors
    return int(stop.value.code or 0), errors


@pytest.fixture
def rec(tmp_path):
    return recordings.write(
        tmp_path / "rec.h5", recordings.noise(np.random.default_rng(0), 40)
    )


def test_every_path_says_whether_it_is_read_or_written() -> None:
    for command in app.app.commands.values():
        assert isinstance(command, Command), command.name
        for parameter in command.params:
            if isinstance(parameter.type, click.Path):
                ours = InputFile | OutputFile | OutputFolder
                assert isinstance(parameter.type, ours), (command.name, parameter.name)


@pytest.mark.parametrize(
    "words",
    [
        "reconstruct REC -o REC --overwrite",
        "reconstruct REC -o LINK --overwrite",
        "reconstruct REC -o HARD --overwrite",
        "reconstruct REC --json REC",
        "reconstruct REC --picture LINK.png",
        "reconstruct REC --json REC.results.h5",
        "reconstruct REC --json rec.results.h5",
        "reconstruct REC --json rec.results.h5.partial",
        "reconstruct REC --json a.json --picture new/../a.json",
        "reconstruct REC -o rec.h5 --overwrite",
        "reconstruct REC --calibration c.json --json c.json",
        "reconstruct REC --policy c.json --outlines c.json --method shape",
        "reconstruct o.h5.partial -o o.h5 --overwrite",
        "reconstruct REC -o OTHER --overwrite",
        "info REC --json REC",
        "info REC --json HARD",
        "info REC --calibration c.json --json c.json",
        "info REC --json OTHER",
        "track REC -o REC --overwrite",
        "track REC --json REC",
        "calibrate REC -o REC --overwrite",
        "calibrate REC -o OTHER --overwrite",
        "calibrate REC c.json -o c.json --overwrite",
        "calibrate REC --from c.json -o c.json --overwrite",
        "calibrate REC -o n.json --json n.json",
        "check REC --json REC",
        "check REC --write REC",
        "check REC --picture LINK.png",
        "design --like REC --json REC",
        "design --like REC --policy REC",
        "design --policy n.npz --json n.npz",
        "frontier --like REC --json REC",
        "stability --like REC --json REC",
        "table1 --json OTHER",
        "table1 --out . --json table1_table.png",
        "record REC -o REC",
        "live REC --record REC",
        "live REC --rrd REC",
    ],
)
def test_nothing_that_is_there_is_destroyed(
    monkeypatch, capsys, tmp_path, rec, words
) -> None:
    """Nor is anything made: the line comes before the work."""
    monkeypatch.chdir(tmp_path)
    for name in ("link.h5", "link.png"):
        (tmp_path / name).symlink_to(rec)
    os.link(rec, tmp_path / "hard.json")
    (tmp_path / "other.h5").write_bytes(rec.read_bytes())
    (tmp_path / "o.h5.partial").write_bytes(rec.read_bytes())
    tx.Calibration(gain=1.0).save(tmp_path / "c.json")
    names = {
        "REC": rec,
        "LINK": tmp_path / "link.h5",
        "LINK.png": tmp_path / "link.png",
        "HARD": tmp_path / "hard.json",
        "OTHER": tmp_path / "other.h5",
        "REC.results.h5": tmp_path / "rec.results.h5",
    }
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    given = [names.get(word, word) for word in words.split()]
    status, line = run(monkeypatch, capsys, *given)
    assert status == 2, line
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_report_is_replaced_by_the_next_and_nothing_else_is(
    monkeypatch, capsys, tmp_path, rec
) -> None:
    report = tmp_path / "told.json"
    for _ in range(2):
        status, _ = run(monkeypatch, capsys, "info", rec, "--json", report)
        assert status == 0 and "environment" in json.loads(report.read_text())
    report.write_text("{}")
    status, line = run(monkeypatch, capsys, "info", rec, "--json", report)
    assert status == 2 and "a report of --json to replace" in line
    assert report.read_text() == "{}"
    status, line = run(
        monkeypatch, capsys, "info", rec, "--json", tmp_path / "no/told.json"
    )
    assert status == 2 and "no such folder" in line


def test_an_input_that_ends_early_is_no_ctrl_c(monkeypatch, capsys, tmp_path, rec) -> None:
    """click takes `EOFError` for Ctrl-C: status 130, and no word."""
    places = tmp_path / "places.npz"
    places.touch()
    status, line = run(monkeypatch, capsys, "calibrate", rec, places)
    assert status == 2 and "places.npz: got an empty file" in line

    @click.command(cls=Command)
    @click.argument("rec", type=InputFile())
    def cut(rec):
        raise EOFError("No data left in file")

    monkeypatch.setitem(app.app.commands, "cut", cut)
    status, line = run(monkeypatch, capsys, "cut", rec)
    assert status == 2 and "rec.h5: ends too early: No data left" in line


def test_files_are_whole_or_not_at_all(tmp_path) -> None:
    path, link = tmp_path / "a.json", tmp_path / "b.json"
    link.symlink_to(path)
    write_text(link, "whole")
    assert path.read_text() == "whole" and link.is_symlink()
    with pytest.raises(RuntimeError), whole(path) as part:
        part.write_text("hal")
        raise RuntimeError
    with pytest.raises(OSError, match="a.json: No space left"), whole(path):
        raise OSError(errno.ENOSPC, "No space left on device")
    # As HDF5 says it, in two lines.
    told = "Can't close file (time = 1\n, error message = 'No space left on device')"
    with pytest.raises(OSError, match="a.json: No space left on device$"), whole(path):
        raise OSError(told)
    assert path.read_text() == "whole"
    assert sorted(tmp_path.iterdir()) == [path, link]


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
        fcntl.flock(other, fcntl.LOCK_SH)  # processes that share the work
        with pytest.raises(ValueError, match="another run is writing it"):
            tx.reconstruct_recording(touched, out, settings())
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
        patch.setattr(os, "pwrite", full)
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


_STUCK = """
import hashlib, signal
from tomojax.cli.entry import listening
with listening(lambda: "tomojax: stopped"):
    signal.signal(signal.SIGINT, lambda number, frame: None)
    print("begun", flush=True)
    # One call that does not come back, as a compiler's.
    hashlib.pbkdf2_hmac("sha512", b"", b"", 2_000_000_000)
"""


@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_ends_a_call_that_does_not_come_back(times) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", _STUCK], stdout=-1, stderr=-1, text=True, process_group=0
    )
    assert process.stdout is not None
    process.stdout.readline()
    began = time.monotonic()
    for _ in range(times):
        process.send_signal(signal.SIGINT)
        time.sleep(0.1)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 130 and errors.strip() == "tomojax: stopped"
    assert time.monotonic() - began < 10


def test_blas_has_one_thread_unless_the_user_says_otherwise(monkeypatch, rec) -> None:
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    for given in ({}, {"OMP_NUM_THREADS": "3"}):
        for name in names:
            monkeypatch.setenv(name, "")  # so that what the command sets is undone
            monkeypatch.delenv(name)
        for name, value in given.items():
            monkeypatch.setenv(name, value)
        result = CliRunner().invoke(app.app, ["--no-cache", "info", str(rec)])
        assert result.exit_code == 0
        found = {name: os.environ[name] for name in names if name in os.environ}
        assert found == (given or dict.fromkeys(names, "1"))


def test_killed_and_stopped_at_random_moments(shared_data, tmp_path) -> None:
    """An excerpt of tests/fuzz/interrupts.py, which has 200 of all commands."""
    script = Path(__file__).parents[1] / "fuzz" / "interrupts.py"
    words = ["--count", "2", "--only", "source scan", "--folder", str(tmp_path)]
    words += ["--data", str(shared_data)]
    run = subprocess.run([sys.executable, script, *words], capture_output=True, text=True)
    told = json.loads(run.stdout or run.stderr)
    assert told["moments"] == 2 and told["ends"] and not told["wrong"], told
    assert not told["strays"] and max(told["ctrl_c_s"], default=0) < 20
