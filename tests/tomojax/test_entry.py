"""No command destroys what it is given, and each stops when it is told to."""

import errno
import json
import os
import signal
import subprocess
import sys
import time

import click
import numpy as np
import pytest
import recordings
from click.testing import CliRunner

import tomojax as tx
from tomojax._whole import whole, write_text
from tomojax.cli import app
from tomojax.cli.entry import Command, InputFile, OutputFile, OutputFolder, write_report


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


def test_a_report_has_null_where_a_number_is_missing(tmp_path) -> None:
    """JSON has no NaN: other readers than Python's refuse it."""
    row = {"g": float("nan"), "x": float("inf"), "n": 1.5}
    write_report(tmp_path / "a.json", rows=[row])
    text = (tmp_path / "a.json").read_text()
    (row,) = json.loads(text, parse_constant=int)["rows"]
    assert row == {"g": None, "x": None, "n": 1.5}


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
        "calibrate REC --older c.json -o c.json --overwrite",
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
        "export REC -o REC",
        "export REC --film REC --overwrite",
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
