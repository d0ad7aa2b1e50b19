"""The command line as its user meets it."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import recordings
from click.testing import CliRunner
from PIL import Image

import tomojax as tx
from tomojax.cli import app
from tomojax.cli.demo import SCENES


@pytest.mark.long
def test_demo_finds_both_fingers(tmp_path) -> None:
    result = CliRunner().invoke(app.app, ["demo", "--out", str(tmp_path / "pictures")])
    assert result.exit_code == 0, result.output
    assert "64 electrodes" in result.output and "contacts  rows" in result.output
    for name in ("demo.png", "demo.gif", "contacts.png", "results.h5"):
        assert (tmp_path / "pictures" / name).stat().st_size > 10_000
    with Image.open(tmp_path / "pictures" / "demo.gif") as film:
        assert film.n_frames > 90
    told = re.search(r"right in ([\d.]+) % of rows .* ([\d.]+) mm off", result.output)
    assert told and float(told[1]) >= 98 and float(told[2]) < 0.5


@pytest.mark.long
def test_demo_of_a_shape_shares_its_area(tmp_path) -> None:
    result = CliRunner().invoke(app.app, ["demo", "palm", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    told = re.search(r"share (\d+) %", result.output)
    assert told and int(told[1]) >= 70


@pytest.mark.long
def test_demo_of_a_round_skin(tmp_path) -> None:
    result = CliRunner().invoke(app.app, ["demo", "round", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    told = re.search(r"right in ([\d.]+) % of rows .* ([\d.]+) mm off", result.output)
    assert told and float(told[1]) >= 98 and float(told[2]) < 0.5


@pytest.mark.parametrize("name", ["round", "glove"])
def test_demo_leaves_empty_what_is_off_the_sheet(name) -> None:
    """The truth is on the sheet; the pictures' pixels are empty in holes and outside."""
    path = Path(tx.__file__).with_name(SCENES[name].file)
    with tx.open_recording(path) as recording, h5py.File(path) as file:
        sensor, truth = recording.rig.sensor(), np.asarray(file["truth_touched"])
    middles = (np.indices(truth.shape[1:]).reshape(2, -1).T + 0.5) / truth.shape[1:]
    inside = np.asarray(sensor.on_sheet(middles * np.asarray(sensor.size)))
    inside = inside.reshape(truth.shape[1:])
    assert truth.any() and not truth[:, ~inside].any()
    part = float(sensor.area / np.prod(np.asarray(sensor.size)))
    assert abs(inside.mean() - part) < 0.02
    if name == "glove":  # the middles of its holes
        holes = np.array([[0.038, 0.081], [0.0705, 0.026]])
        cell = np.floor(holes / np.asarray(sensor.size) * 64).astype(int)
        assert not inside[tuple(cell.T)].any() and inside[32, 32]


def test_demo_lists_its_scenes(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    listed = CliRunner().invoke(app.app, ["demo", "--list"])
    for name in ("fingers", "letters", "spanner", "palm", "round", "glove"):
        assert f"tomojax demo {name}" in listed.output
    assert not list(tmp_path.iterdir())


def line_of(monkeypatch, capsys, *arguments) -> str:
    """What a command that fails prints: exactly one line, and status 2."""
    monkeypatch.setattr(sys, "argv", ["tomojax", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        app.run()
    assert stop.value.code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def test_the_command_as_a_process() -> None:
    code = "from tomojax.cli import main; main()"
    run = subprocess.run(
        [sys.executable, "-c", code, "paint"], capture_output=True, text=True
    )
    assert run.returncode == 2
    assert len(run.stderr.strip().splitlines()) == 1 and "paint" in run.stderr


@pytest.mark.parametrize(
    "arguments, word", [(["paint"], "paint"), (["demo", "--out"], "--out")]
)
def test_mistakes_are_one_line_and_status_2(monkeypatch, capsys, arguments, word) -> None:
    assert word in line_of(monkeypatch, capsys, *arguments)


def test_output_folder_that_is_a_file(tmp_path, monkeypatch, capsys) -> None:
    (tmp_path / "file").write_text("")
    line_of(monkeypatch, capsys, "demo", "--out", tmp_path / "file")


@pytest.mark.parametrize("package", ["click", "h5py"])
def test_missing_extra_is_named(monkeypatch, capsys, tmp_path, package) -> None:
    from tomojax import cli

    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, "tomojax.cli.app", raising=False)
    monkeypatch.delattr("tomojax.cli.app", raising=False)
    monkeypatch.setattr(sys, "argv", ["tomojax", "demo", "--out", str(tmp_path)])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 2
    line = capsys.readouterr().err
    assert package in line and "tomojax[app]" in line


@pytest.fixture(scope="module")
def recording_path(tmp_path_factory):
    codes, _ = recordings.touched(scans=30)
    return recordings.write(tmp_path_factory.mktemp("cli") / "rec.h5", codes)


def invoke(*arguments):
    return CliRunner().invoke(app.app, [*map(str, arguments)])


def test_reconstruct_and_info(recording_path, tmp_path) -> None:
    shown = invoke("info", recording_path, "--json", tmp_path / "info.json")
    assert shown.exit_code == 0, shown.output
    assert "can be read" in shown.output and "no faults" in shown.output
    assert json.loads((tmp_path / "info.json").read_text())["summary"]["scans"] == 30
    out, picture = tmp_path / "o.h5", tmp_path / "o.png"
    arguments = ("reconstruct", recording_path, "-o", out, "--grid", 16)
    done = invoke(*arguments, "--picture", picture, "--json", tmp_path / "o.json")
    assert done.exit_code == 0, done.output
    assert picture.stat().st_size > 10_000 and f"results: {out}" in done.output
    report = json.loads((tmp_path / "o.json").read_text())
    assert report["summary"]["rows_by_contacts"] == {"0": 20, "1": 10}
    assert set(report) == {"rows", "summary", "environment"}
    # Something is said before the first result, also to those who see no bar.
    assert "preparing auto: its programs are compiled the first time" in done.stderr
    assert "no forces: they need --calibration" in done.stdout
    assert done.stdout.count(tx.Flag.NO_CONTACT.explanation) == 1
    with h5py.File(out) as file:
        meanings = json.loads(file["flags"].attrs["meanings"])
    assert meanings == {flag.name: flag.explanation for flag in tx.Flag}
    slots = invoke(
        *arguments[:3], tmp_path / "s.h5", "--rate", "slot", "--method", "linear"
    )
    assert slots.exit_code == 0, slots.output
    with h5py.File(tmp_path / "s.h5") as file:
        assert len(file["t"]) == 60 and "image" not in file


def test_info_explains_each_flag_once(tmp_path) -> None:
    codes, _ = recordings.touched(scans=30)
    codes[:, :, 9] = 0
    rec = recordings.write(tmp_path / "rec.h5", codes)
    shown = invoke("info", rec)
    assert shown.exit_code == 0, shown.output
    assert shown.output.count(tx.Flag.DEAD_CHANNEL.explanation) == 1


def test_info_tells_the_channel_that_is_out_longest_first(tmp_path) -> None:
    codes, _ = recordings.touched(scans=60)
    volts = codes * recordings.ATTRIBUTES["scale"]
    for e in range(25):
        volts[e, :, e] = np.nan
    volts[:, :, 60] = np.nan
    grounds = np.tile([0, 63], (60, 1))
    np.savez(tmp_path / "a.npz", v=volts, ground=grounds, f_switch=1e4)
    lines = [line for line in invoke("info", tmp_path / "a.npz").output.splitlines()]
    lines = [line.strip() for line in lines if "not used" in line and "channel" in line]
    told = [line for line in lines if line.startswith("channel ")]
    assert told[0] == "channel 60 not used: 60 scans" and len(told) == 20
    assert "6 more channels not used in fewer scans" in lines


def test_bad_recordings_are_one_line(monkeypatch, capsys, tmp_path, recording_path) -> None:
    good = recording_path.read_bytes()
    (tmp_path / "empty.h5").write_bytes(b"")
    (tmp_path / "text.h5").write_text("volts")
    (tmp_path / "cut.h5").write_bytes(good[: len(good) // 2])
    codes = np.zeros((3, 2, 64), np.int16)
    recordings.write(tmp_path / "missing.h5", codes, leave_out=["ground"])
    recordings.write(tmp_path / "shape.h5", codes, ground=np.zeros((3, 5), np.uint8))
    recordings.write(tmp_path / "units.h5", codes, units="mV")
    recordings.write(tmp_path / "future.h5", codes, schema_version=7)
    words = dict(missing="ground", shape="ground", units="units", future="schema_version")
    for name in ("absent", "empty", "text", "cut", *words):
        path = tmp_path / f"{name}.h5"
        line = line_of(monkeypatch, capsys, "reconstruct", path, "-o", tmp_path / "o.h5")
        assert str(path) in line and words.get(name, "") in line
        assert str(path) in line_of(monkeypatch, capsys, "info", path)
    if os.geteuid():  # root may do everything
        (tmp_path / "future.h5").chmod(0)
        line = line_of(monkeypatch, capsys, "info", tmp_path / "future.h5")
        assert "Permission denied" in line
    assert not list(tmp_path.glob("o.h5*"))


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--method", "magic"], "method"),
        (["--rate", "row"], "rate"),
        (["--lam", "much"], "lam"),
        (["--lam", "-1"], "lam"),
        (["--grid", "0"], "grid"),
        (["--grid", "3"], "grid"),
        (["--contacts", "0"], "contacts"),
        (["--threshold", "-1"], "threshold"),
        (["--chunk", "0"], "chunk"),
        (["--tdms", "slots=3"], "header"),
        (["--tdms", "what"], "tdms"),
        (["--picture", "/absent/p.png"], "/absent"),
    ],
)
def test_bad_options_are_one_line(
    monkeypatch, capsys, tmp_path, recording_path, options, word
) -> None:
    out = tmp_path / "o.h5"
    line = line_of(monkeypatch, capsys, "reconstruct", recording_path, "-o", out, *options)
    assert word in line
    assert not list(tmp_path.iterdir())


def test_calibrations_that_cannot_be_made_are_one_line(
    monkeypatch, capsys, tmp_path
) -> None:
    """A recording of noise, too few frames, and a calibration that exists already."""
    noise = np.random.default_rng(0).normal(0, 2, (40, 2, 64))
    path, out = tmp_path / "nothing.h5", tmp_path / "rig.json"
    recordings.write(path, np.round(noise).astype(np.int16), np.array([0, 63]))
    line = line_of(monkeypatch, capsys, "calibrate", path, "-o", out)
    assert str(path) in line and "no stretch with a contact" in line
    assert not out.exists()
    line = line_of(monkeypatch, capsys, "calibrate", path, "--frames", "3")
    assert "frames: got 3" in line
    out.write_text("{}")
    line = line_of(monkeypatch, capsys, "calibrate", path, "-o", out)
    assert "--overwrite" in line and out.read_text() == "{}"
