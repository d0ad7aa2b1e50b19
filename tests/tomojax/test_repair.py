"""`tomojax repair`: what only a person may decide; the old file stays as it is."""

import h5py
import numpy as np
import pytest
import recordings
from click.testing import CliRunner

import tomojax as tx
from tomojax.cli.app import app


@pytest.fixture
def path(tmp_path):
    codes, _ = recordings.touched(scans=40)
    made = recordings.write(tmp_path / "rec.h5", codes)
    with h5py.File(made, "r+") as file:
        file.attrs["f_switch"] = 2 * file.attrs["f_switch"]  # as somebody typed it
        file["t0"][20:] -= 0.01  # the clock fell
    return made


def run(*words):
    return CliRunner().invoke(app, ["repair", *map(str, words)])


def test_what_it_should_have_said(path, tmp_path):
    before = path.read_bytes()
    with tx.open_recording(path) as old:
        told = old.rig.f_switch
    out = tmp_path / "sound.h5"
    done = run(path, "-o", out, "--set", f"f_switch={told / 2}", "--scans", "5:35")
    assert done.exit_code == 0 and "put right" in done.output, done.output
    assert path.read_bytes() == before
    with tx.open_recording(path) as old, tx.open_recording(out) as new:
        assert new.scans == 30 and new.rig.f_switch == told / 2 and new.mended == ()
        a, b = old.read(5, 35), new.read(0, 30)
        np.testing.assert_array_equal(a.voltages, b.voltages)
        np.testing.assert_array_equal(a.grounds, b.grounds)
        assert (np.diff(b.t0) > 0).all()
        assert "rec.h5" in new.rig.notes


def test_order(path, tmp_path):
    with tx.open_recording(path) as old:
        m, was = old.electrodes, old.read(0, 40)
    turned = np.roll(np.arange(m), 3)
    lines = np.where(np.arange(m) == was.grounds[0, 1], -1, turned)
    order = tmp_path / "order.toml"
    order.write_text(f"channels = {turned.tolist()}\ngrounds = {lines.tolist()}\n")
    out = tmp_path / "sound.h5"
    assert run(path, "-o", out, "--order", order).exit_code == 0
    with tx.open_recording(out) as new:
        now = new.read(0, 40)
        np.testing.assert_array_equal(now.voltages[..., turned], was.voltages)
        assert now.grounds[0, 0] == turned[was.grounds[0, 0]]
        # A line that grounds nothing grounds no electrode of the sensor.
        assert tx.recordings.read_chunk(new, 0, 40).flags[0] & tx.Flag.UNKNOWN_GROUND


def test_slots_of_a_rig_are_joined_to_scans(tmp_path):
    """Slots are lost at two places; scans that lack a slot count as lost."""
    pattern, present = np.array([3, 9, 20, 40]), np.ones(40, bool)
    present[9:16], present[22:30], present[38:] = False, False, False
    slots = np.flatnonzero(present)
    codes = (slots[:, None, None] * np.ones((1, 1, 64))).astype(np.int16)
    starts = np.flatnonzero(np.diff(slots) > 1)
    gaps = np.stack([slots[starts] + 1, np.diff(slots)[starts] - 1], 1)
    rec = recordings.write(
        tmp_path / "rec.h5", codes, pattern[slots % 4][:, None], t0=slots / 10e3, gaps=gaps
    )
    out = tmp_path / "scans.h5"
    done = run(rec, "-o", out, "--join", 4)
    assert done.exit_code == 0, done.output
    with tx.open_recording(rec) as old, tx.open_recording(out) as new:
        assert old.read(0, 1).voltages.shape == (1, 1, 64) and new.slots == 4
        held, scale = new.read(0, new.scans), recordings.ATTRIBUTES["scale"]
        whole = [0, 1, 4, 8]  # 2, 3 lack slots, 5 to 7 too, 9 ends early
        assert new.scans == len(whole) and new.mended == ()
        expected = 4 * np.array(whole)[:, None] + np.arange(4)
        np.testing.assert_allclose(held.voltages[..., 5], scale * expected)
        assert (held.grounds == pattern).all()
        np.testing.assert_allclose(held.t0, 4 * np.array(whole) / 10e3)
        assert new.gaps.tolist() == [[2, 2], [5, 3]]
        assert "each 4 scans joined" in new.rig.notes
    # Joined by a number that is not the pattern's: said, as scans then repeat a ground.
    assert "twice" not in done.output
    done = run(rec, "-o", tmp_path / "five.h5", "--join", 5)
    assert done.exit_code == 0 and "scans have a ground twice: --join is" in done.output
    # Not joined, and a part: gaps by the new file's own numbers.
    for words, expected in (([], gaps.tolist()), (["--scans", "9:20"], [[6, 8]])):
        same = tmp_path / f"same{len(words)}.h5"
        assert run(rec, "-o", same, *words).exit_code == 0
        with tx.open_recording(same) as new:
            assert new.gaps.tolist() == expected


def test_a_file_that_says_too_little(path, tmp_path):
    with h5py.File(path, "r+") as file:
        del file.attrs["drive_voltage"]
    out = tmp_path / "sound.h5"
    assert run(path, "-o", out).exit_code == 1 and not out.exists()
    assert run(path, "-o", out, "--set", "drive_voltage=4.5").exit_code == 0
    with tx.open_recording(out) as new:
        assert new.rig.drive_voltage == 4.5


@pytest.mark.parametrize(
    "words, told",
    [
        (["--set", "colour=1"], "colour"),
        (["--set", "f_switch=fast"], "f_switch"),
        (["--set", "f_switch=1,2"], "f_switch"),
        (["--set", "scale=0"], "scale"),
        (["--scans", "all"], "FIRST:BEHIND"),
        (["--scans", "30:90"], "scans"),
        (["--join", "0"], "join"),
        (["--join", "41"], "join"),
    ],
)
def test_mistakes(path, tmp_path, words, told):
    out = tmp_path / "sound.h5"
    done = run(path, "-o", out, *words)
    assert done.exit_code and not out.exists()
    assert told in f"{done.output}{done.exception}"


def test_it_replaces_nothing(path, tmp_path):
    for out in (path, tmp_path / "there.h5"):
        out.exists() or out.write_text("somebody's")
        before = out.read_bytes()
        assert run(path, "-o", out).exit_code
        assert out.read_bytes() == before
