"""What is said of a row that may be wrong: levels of flags, and checks without a truth."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from faulty import recorded, voltages_of, write

import tomojax as tx
from tomojax.bringup.signs import find_signs
from tomojax.cli.app import app

CORNERS = np.array([0, 15])


@pytest.fixture(scope="module")
def sensor() -> tx.Sensor:
    return tx.Sensor.grid(4, 4, divisions=(16, 16))


@pytest.fixture(scope="module")
def made(sensor):
    """Touches on a rig that is not ours, under every ground."""
    return voltages_of(sensor, 5, touches=24)


def rows_of(sensor, made, name="source", lines=None, change=lambda v: v, grounds=CORNERS):
    """Rows of the touches where ground line k switches electrode `lines[k]`."""
    lines = np.arange(16) if lines is None else lines
    volts = change(made.volts[:24, lines[grounds]].astype(float))
    method = tx.method(sensor, name, grid=16)
    batch = tx.Batch(method, method.choose_lambda([]), contacts=1, images=False)
    return batch(volts, np.tile(grounds, (len(volts), 1)))


def doubted(rows) -> np.ndarray:
    return rows.flags & int(tx.methods.DOUBT) > 0


def test_levels_of_flags():
    assert tx.Flag.MODEL_LIMITED.level == 0  # on clean rows too
    assert tx.Flag.GAP.level.name == "INFORMATION"
    assert (tx.Flag.GAP | tx.Flag.PLACE_UNCERTAIN).level.name == "DOUBT"
    assert tx.Flag.NO_DATA.level.name == "NO_ANSWER"
    assert tx.methods.NO_ANSWER & tx.methods.DOUBT == tx.methods.NO_ANSWER


def test_each_flag_says_what_it_means_and_what_to_do():
    for flag in tx.Flag:
        for text in (flag.meaning, flag.advice):
            assert text and text[0] == text[0].lower() and not text.endswith("."), flag
            assert len(text.split()) <= 25, flag
        assert flag.explanation.count(".") >= 2, flag
    both = tx.Flag.GAP | tx.Flag.ALL_ZERO
    assert both.meaning == f"{tx.Flag.GAP.meaning}; {tx.Flag.ALL_ZERO.meaning}"
    assert tx.Flag(0).explanation == ""


@pytest.mark.parametrize(
    "name", ["source", "linear", pytest.param("points", marks=pytest.mark.long)]
)
def test_a_drive_of_either_sign_gives_the_same_places(sensor, made, name):
    plain = rows_of(sensor, made, name)
    other = replace(sensor, drive_voltage=-sensor.drive_voltage)
    turned = rows_of(other, made, name, change=np.negative)
    np.testing.assert_array_equal(turned.contact_count, plain.contact_count)
    np.testing.assert_allclose(turned.contact_xy, plain.contact_xy, atol=2e-5)
    np.testing.assert_allclose(turned.contact_current, -plain.contact_current, rtol=2e-2)
    np.testing.assert_array_equal(turned.flags, plain.flags)


def test_sound_rows_are_not_doubted(sensor, made):
    assert not doubted(rows_of(sensor, made, "points")).any()


@pytest.mark.long
def test_a_ground_that_is_another_is_doubted(sensor, made):
    rows = rows_of(sensor, made, "points", lines=(np.arange(16) + 1) % 16)
    assert (rows.flags & tx.Flag.GROUND_NOT_LOWEST > 0).all()


def test_voltages_against_the_drive_are_doubted(sensor, made):
    rows = rows_of(sensor, made, change=np.negative)
    assert (rows.flags & tx.Flag.AGAINST_DRIVE > 0).all()


def test_a_ground_path_is_no_other_ground(sensor, made):
    """The voltage across the path lifts all electrodes alike, in proportion to currents."""
    rows = rows_of(sensor, made, change=lambda v: v + 0.1 * v.max(2, keepdims=True))
    assert not (rows.flags & tx.Flag.GROUND_NOT_LOWEST).any()


def test_a_slot_without_a_ground_is_doubted(sensor, made):
    rows = rows_of(sensor, made, change=lambda v: np.full_like(v, 4.4))
    assert (rows.flags & tx.Flag.GROUND_NOT_LOWEST > 0).all()


def test_a_step_says_the_same(sensor, made):
    step = tx.make_step(sensor, "source", ["all"], contacts=1, grid=8)
    _, out = step(step.state, made.volts[0, 1], 0)
    assert int(out.flags) & tx.Flag.GROUND_NOT_LOWEST
    _, out = step(step.state, -made.volts[0, 0], 0)
    assert int(out.flags) & tx.Flag.AGAINST_DRIVE
    _, out = step(step.state, made.volts[0, 0], 0)
    wrong = tx.Flag.GROUND_NOT_LOWEST | tx.Flag.AGAINST_DRIVE
    assert not int(out.flags) & int(wrong)


@pytest.mark.parametrize(
    "shape", [pytest.param(s, marks=pytest.mark.long) for s in ((1, 2), (1, 3), (2, 2))]
)
def test_places_of_two_to_four_electrodes_are_doubted(shape):
    """A place is as many numbers as they read: whatever they read is one."""
    few = tx.Sensor.grid(*shape, divisions=(4 * shape[0], 4 * shape[1]))
    volts = np.random.default_rng(0).uniform(0.5, 2, (6, 2, few.electrode_count))
    grounds = np.array([0, few.electrode_count - 1])
    volts[:, [0, 1], grounds] = 0.0
    method = tx.method(few, grid=16)
    batch = tx.Batch(method, method.choose_lambda([]), images=False)
    rows = batch(volts, np.tile(grounds, (6, 1)))
    assert (rows.flags & tx.Flag.PLACE_UNCERTAIN > 0).all()


def rolled(by):
    return np.roll(np.arange(16), by)


def offset(recording, volts):
    scans = recording.read(0, recording.scans)
    return tx.recordings.ArrayRecording(
        recording.rig, scans.voltages + volts, scans.grounds
    )


def negated(recording):
    scans = recording.read(0, recording.scans)
    return tx.recordings.ArrayRecording(recording.rig, -scans.voltages, scans.grounds)


SWAPPED = np.array([0, 1, 2, 3, 4, 10, 6, 7, 8, 9, 5, 11, 12, 13, 14, 15])

FAULTS = {
    "sound": ([], {}, lambda r: r),
    "index off by one": (["ground"], {"lines": rolled(-1)}, lambda r: r),
    "rolled channels": (["channels"], {"channels": rolled(1)}, lambda r: r),
    "swapped pair": (["channels"], {"channels": SWAPPED}, lambda r: r),
    "offset": (["offset"], {}, lambda r: offset(r, 1.0)),
    "offset below 0": (["offset"], {}, lambda r: offset(r, -0.3)),
    "drive": (["drive"], {}, negated),
}


@pytest.mark.parametrize("quiet", [0, 400])
@pytest.mark.parametrize("name", FAULTS)
def test_signs_of_a_fault(made, name, quiet):
    kinds, words, change = FAULTS[name]
    recording = change(recorded(made, 3, quiet=quiet, corners=(), hold=16, **words))
    found = [sign.kind for sign in find_signs(recording)]
    assert found[: len(kinds)] == kinds and bool(found) == bool(kinds)


def test_info_tells_signs(made, tmp_path):
    path = write(tmp_path / "rec.h5", recorded(made, 3, lines=rolled(-1), hold=16))
    told = CliRunner().invoke(app, ["info", str(path)]).output
    assert "index is off by +1" in told
