"""Bring-up: faulty rigs of another model, on a small array that is not square."""

import json
import tomllib
from dataclasses import replace

import faulty
import numpy as np
import pytest
from click.testing import CliRunner

import tomojax as tx
from tomojax.bringup.sheet import Plane
from tomojax.cli import app
from tomojax.hardware import OrderedSource, ReplaySource

ROWS, COLUMNS = 5, 4
M = ROWS * COLUMNS


@pytest.fixture(scope="module")
def sensor():
    return faulty.grid(ROWS, COLUMNS, 0.012, sheet_resistance=2e3, drive_voltage=3.3)


@pytest.fixture(scope="module")
def made(sensor):
    return faulty.voltages_of(sensor, 3, touches=40)


def kinds(found):
    return {(fault.kind, fault.channels) for fault in found.faults}


def swapped(*pairs):
    order = np.arange(M)
    for i, j in pairs:
        order[[i, j]] = order[[j, i]]
    return order


def without(line):
    return np.where(np.arange(M) == line, -1, np.arange(M))


def test_a_sound_rig_has_no_fault(made):
    found = tx.bringup.check(faulty.recorded(made, 1))
    assert not found.faults and not found.unjudged
    assert (found.channels == np.arange(M)).all() and (found.grounds == np.arange(M)).all()
    assert abs(found.figures["drive_V"] - 3.3) < 0.15
    assert found.figures["residual_percent"] < 0.3
    assert abs(found.figures["noise_V"] - made.rig.chain.noise) < 5e-5


FEW = {2: [0, M - 1], 10: [0, M - 1, *range(2, M - 2, 2)][:10]}


@pytest.mark.long
@pytest.mark.parametrize("slots", FEW)
@pytest.mark.parametrize("leak", [0.0, 200.0, 5e3])
def test_a_leaky_switch_of_a_few_grounds(made, slots, leak):
    words = {"leaks": {9: leak}} if leak else {}
    given = faulty.recorded(made, 1, slots=slots, pattern=FEW[slots], **words)
    found = tx.bringup.check(given)
    assert kinds(found) == ({("leak", (9,))} if leak else set())
    if leak:
        assert found.faults[0].value == pytest.approx(leak, rel=0.2)


@pytest.mark.parametrize("slots", FEW)
def test_a_ground_that_does_not_open_of_a_few(made, slots):
    found = tx.bringup.check(
        faulty.recorded(made, 1, slots=slots, pattern=FEW[slots], on=9)
    )
    assert kinds(found) == {("ground_stuck", (9,))}


@pytest.mark.long
def test_slow_channels_under_two_grounds_are_no_leak(made):
    given = faulty.recorded(made, 1, slots=2, pattern=FEW[2], settling=0.12)
    assert kinds(tx.bringup.check(given)) == {("settling", ())}


@pytest.mark.parametrize("slots", FEW)
@pytest.mark.parametrize("part", [0.1, 0.5])
def test_electrodes_under_a_lifted_sheet(made, slots, part):
    loose = [e for e in (9, 10, 13, 14) if e not in FEW[slots]]
    gain = dict.fromkeys(loose, part)
    given = faulty.recorded(made, 1, slots=slots, pattern=FEW[slots], gain=gain)
    found = tx.bringup.check(given).faults
    assert {fault.channels[0] for fault in found} == set(loose)
    assert all("hardly touch" in fault.text for fault in found)
    np.testing.assert_allclose([fault.value for fault in found], part, rtol=0.05)


MIRRORED = faulty.symmetry(ROWS, COLUMNS, False, True, False)
TURNED = faulty.symmetry(ROWS, COLUMNS, False, True, True)
SLOW = np.where(np.arange(M) == 9, 0.3, 0.0)
SINGLE = {
    "dead": ({"dead": [6]}, ("dead", (6,))),
    "stuck": ({"stuck": {13: 1.2}}, ("stuck", (13,))),
    "swapped": ({"channels": swapped((5, 14))}, ("swapped", (5, 14))),
    "wires": (
        {"channels": swapped((5, 6)), "lines": swapped((5, 6))},
        ("swapped", (5, 6)),
    ),
    "mirrored": ({"channels": MIRRORED}, ("mirrored", ())),
    "all turned": ({"channels": TURNED, "lines": TURNED}, ("turned", ())),
    "lines mirrored": ({"lines": MIRRORED}, ("ground_permuted", ())),
    "permuted": ({"lines": swapped((2, 17))}, ("ground_permuted", (2, 17))),
    "off by one": ({"lines": np.arange(M) - 1}, ("ground_off_by", ())),
    "never": ({"lines": without(11)}, ("ground_stuck", (11,))),
    "always": ({"on": 9}, ("ground_stuck", (9,))),
    "leak": ({"leaks": {6: 1e3}}, ("leak", (6,))),
    "drive": ({"told": {"drive_voltage": 1.3}}, ("drive", ())),
    "sheet": ({"told": {"sheet_resistance": 0.4}}, ("sheet_resistance", ())),
    "gain": ({"gain": {7: 0.93}}, ("gain", (7,))),
    "settling": ({"settling": 0.12}, ("settling", ())),
    "one settles": ({"settling": SLOW}, ("settling", (9,))),
    "hum": ({"hum": 0.01, "f_switch": 2000.0}, ("hum", ())),
    "noise": ({"noise": {3: 0.01}}, ("noise", (3,))),
}


# These take longest.
SLOWEST = ("settling", "one settles", "hum")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.long) if name in SLOWEST else name
        for name in SINGLE
    ],
)
def test_a_fault_is_named_and_nothing_else(made, name):
    given, named = SINGLE[name]
    found = tx.bringup.check(faulty.recorded(made, 2, **given))
    assert kinds(found) == {named}
    fault = found.faults[0]
    assert 0.5 <= fault.certainty <= 0.999 and fault.mend and fault.text


@pytest.mark.long
def test_amounts_are_right(made):
    def value(**given):
        return tx.bringup.check(faulty.recorded(made, 4, **given)).faults[0].value

    assert value(gain={7: 0.93}) == pytest.approx(0.93, abs=0.005)
    assert value(settling=0.12) == pytest.approx(0.12, abs=0.01)
    assert value(lines=np.arange(M) - 1) == -1
    assert value(told={"drive_voltage": 1.3}) == pytest.approx(3.3, rel=0.04)
    hum = value(hum=0.01, hum_frequency=60.0, f_switch=2000.0)
    assert hum["frequency_Hz"] == pytest.approx(60, abs=0.3)
    assert hum["amplitude_V"] == pytest.approx(0.01, rel=0.1)


@pytest.mark.long
def test_faults_of_the_sheet_are_placed(sensor):
    size = np.asarray(sensor.size, float)

    def tear(points):
        on = np.abs(points[:, 0] - 0.4 * size[0]) < 0.001
        return np.where(on & (points[:, 1] < 0.55 * size[1]), 60.0, 1.0)

    torn = faulty.voltages_of(sensor, 5, touches=40, tear=tear)
    found = tx.bringup.check(faulty.recorded(torn, 5))
    assert [fault.kind for fault in found.faults] == ["tear"]
    assert found.faults[0].value["x_mm"] == pytest.approx(400 * size[0], abs=4)
    assert found.faults[0].value["y_mm"] < 550 * size[1]
    off = {13: (0.003, 0.001)}
    moved = faulty.voltages_of(sensor, 6, touches=40, misplaced=off)
    found = tx.bringup.check(faulty.recorded(moved, 6))
    assert kinds(found) == {("misplaced", (13,))}
    place = found.faults[0].value
    assert place["x_mm"] == pytest.approx(3, abs=0.4)
    assert place["y_mm"] == pytest.approx(1, abs=0.4)


@pytest.mark.parametrize("rows, columns", [(3, 5), (5, 3)])
def test_slopes_of_the_plane(rows, columns):
    """Beside differences; more places than are computed at once."""
    rig = tx.recordings.Rig.of(faulty.grid(rows, columns))
    plane, h = Plane(rig), 1e-6
    places = np.random.default_rng(0).uniform(0.1, 0.9, (300, 2)) * plane.size
    off = np.hypot(*(places[:, None] - plane.xy).transpose(2, 0, 1)) > 1e-3

    def moved(by, at):
        return plane.green(places[:, None] + by, plane.xy + at)

    steps = h * np.eye(2)
    for found, ways in (
        (plane.with_slopes(places)[1:], [(d, 0) for d in steps]),
        (plane.slopes(places), [(0, d) for d in steps]),
    ):
        ahead = np.stack([moved(by, at) for by, at in ways])
        behind = np.stack([moved(-by, -at) for by, at in ways])
        want = (ahead - behind) / (2 * h)
        scale = np.abs(want[:, off]).max()
        np.testing.assert_allclose(found[:, off], want[:, off], atol=1e-6 * scale)


@pytest.mark.long
def test_two_faults_are_two(made):
    given = {"channels": MIRRORED, "dead": [6], "told": {"drive_voltage": 0.8}}
    found = tx.bringup.check(faulty.recorded(made, 7, **given))
    assert kinds(found) == {("mirrored", ()), ("dead", (6,)), ("drive", ())}


@pytest.mark.long
def test_parts_that_are_missing_are_not_judged(made):
    scans = {"slots": 10, "pattern": np.arange(0, M, 2), "f_switch": 1000.0}
    found = tx.bringup.check(faulty.recorded(made, 8, quiet=0, corners=(), **scans))
    assert not found.faults
    missing = {"mirrored or turned array", "zeros, noise and hum"}
    assert missing | {"ground lines not commanded"} <= set(found.unjudged)
    # The array and its lines against each other are told without corners.
    recording = faulty.recorded(made, 8, corners=(), channels=MIRRORED)
    found = tx.bringup.check(recording, corners=None)
    assert kinds(found) == {("mirrored", ())} and found.faults[0].certainty == 0.5
    # Other corners than the usual ones.
    ends = 0, M - COLUMNS
    there = faulty.recorded(made, 8, corners=(0, 2), channels=TURNED, lines=TURNED)
    assert kinds(tx.bringup.check(there, ends)) == {("turned", ())}


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"rub": [], "corners": ()}, "0 slots with a contact"),
        ({"rub": [4] * 10, "corners": ()}, "one touch alone"),
    ],
)
def test_nothing_can_be_said(made, given, word):
    with pytest.raises(ValueError, match=word):
        tx.bringup.check(faulty.recorded(made, 9, **given))


@pytest.mark.long
def test_voltages_of_another_sensor(made):
    recording = faulty.recorded(made, 9)
    volts = np.random.default_rng(0).uniform(0.5, 3, (recording.scans, 1, M))
    grounds = recording.read(0, recording.scans).grounds
    other = tx.recordings.ArrayRecording(recording.rig, volts, grounds)
    with pytest.raises(ValueError, match="fit no contact on this sensor"):
        tx.bringup.check(other)


def invoke(*arguments):
    return CliRunner().invoke(app.app, [*map(str, arguments)], standalone_mode=False)


@pytest.mark.long
def test_a_rig_is_recorded_first(tmp_path, capfd):
    """The corners are told in words by default."""
    seconds = ("--quiet", 0.3, "--rub", 0.5, "--touch", 0.2)
    done = invoke("check", "virtual", *seconds, "-o", tmp_path / "rig.h5")
    said = capfd.readouterr().err
    assert done.return_value in (0, 1) or "slots with a contact" in str(done.exception)
    for words in ("leave the sheet alone", "rub the sheet", "electrode 0", "end of row 0"):
        assert words in said + done.output
    assert tx.open_recording(tmp_path / "rig.h5").scans > 1000


def test_the_command(made, tmp_path):
    wrong = {"channels": swapped((5, 14)), "lines": swapped((2, 3))}
    path = faulty.write(tmp_path / "bad.h5", faulty.recorded(made, 10, **wrong))
    names = {name: tmp_path / f"rig.{name}" for name in ("toml", "json", "png")}
    options = "--write", names["toml"], "--json", names["json"], "--picture", names["png"]
    done = invoke("check", path, *options)
    assert done.return_value == 1, done.output
    assert "swapped: channels 5 and 14" in done.output
    report = json.loads(names["json"].read_text())
    faults = {(f["kind"], tuple(f["channels"])) for f in report["faults"]}
    assert faults == {("swapped", (5, 14)), ("ground_permuted", (2, 3))}
    assert {"channels", "value", "certainty", "mend"} <= set(report["faults"][0])
    order = tomllib.loads(names["toml"].read_text())
    assert order["channels"] == swapped((5, 14)).tolist()
    assert order["grounds"] == swapped((2, 3)).tolist()
    assert names["png"].stat().st_size > 10_000
    # `record` takes the order, and then nothing is wrong.
    again = tmp_path / "again.h5"
    done = invoke("record", path, "-o", again, "--view", "none", "--config", names["toml"])
    assert done.exception is None, done.output
    done = invoke("check", again)
    assert done.return_value == 0, done.output


def test_bad_input_is_one_line_and_writes_nothing(made, tmp_path, monkeypatch, capsys):
    nothing = faulty.recorded(made, 11, rub=[], corners=())
    path = faulty.write(tmp_path / "nothing.h5", nothing)
    other = faulty.grid(3, 3)
    volts = np.zeros((4, 1, 9))
    rig = replace(tx.recordings.Rig.of(other, rails=(-5.0, 5.0)), resolution=1e-4)
    small = tx.recordings.ArrayRecording(rig, volts, [0])
    small = faulty.write(tmp_path / "small.h5", small)
    before = sorted(tmp_path.iterdir())
    outputs = "--json", tmp_path / "o.json", "--write", tmp_path / "o.toml"
    for arguments, word in (
        (("check", path), "0 slots with a contact"),
        (("check", path, "--like", small), "20 channels"),
        (("check", path, "--corners", "0;3"), "corners"),
        (("check", tmp_path / "absent.h5"), "absent.h5"),
    ):
        monkeypatch.setattr("sys.argv", ["tomojax", *map(str, (*arguments, *outputs))])
        with pytest.raises(SystemExit) as stop:
            app.run()
        lines = capsys.readouterr().err.strip().splitlines()
        assert stop.value.code == 2 and len(lines) == 1 and word in lines[0]
    assert sorted(tmp_path.iterdir()) == before


def test_an_ordered_source_reads_right(made):
    """Through the order of a faulty rig slots are those of a sound one."""
    order, lines = np.roll(np.arange(M), 3), np.arange(M) - 1
    recording = faulty.recorded(made, 12, quiet=0, channels=order, lines=lines)
    scans = recording.read(0, recording.scans)
    source = OrderedSource(ReplaySource(recording), order.tolist(), lines.tolist())
    codes = np.zeros(M, np.int16)
    asked = []
    source._source.set_grounds = asked.extend  # what the rig is told
    with source:
        for row in range(50):
            got = source.read(codes)
            assert got is not None
            line = int(scans.grounds[row, 0])
            assert got.ground == (line - 1 if line else M)  # line 0 grounds nothing
            volts = source.scale * codes + source.offset
            step = recording.rig.resolution
            assert np.abs(volts[order] - scans.voltages[row, 0]).max() < 2 * step
        source.set_grounds([0, 4, M - 1])  # no line switches the last
    assert asked == [1, 5]
    for channels, grounds in (([0] * M, None), (None, [M] * M), ([0, 1], None)):
        with pytest.raises(ValueError, match="channels|grounds"):
            OrderedSource(ReplaySource(recording), channels, grounds)
    with pytest.raises(ValueError, match="grounds"):
        source.set_grounds([M - 1])
