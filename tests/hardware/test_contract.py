"""What every source promises, on every source."""

import signal
import time

import numpy as np
import pytest
from ni import Device
from nidaqmx import utils

import tomojax as tx
from tomojax.hardware import open_source, ReplaySource
from tomojax.hardware.sources import check_source
from tomojax.hardware.sources.ni import NiSource
from tomojax.hardware.sources.virtual_rig import VirtualRig

SOURCES = ("replay", "serial", "udp", "ni")


def recorded():
    """A recording in memory: 300 scans of three slots."""
    sensor = tx.Sensor.grid(dtype=np.float32, divisions=(32, 32))
    rng = np.random.default_rng(0)
    volts = rng.uniform(0, 4, (300, 3, 64))
    return tx.recordings.ArrayRecording(
        tx.recordings.Rig.of(sensor, rails=(-5.0, 5.0)), volts, [0, 63, 8]
    )


@pytest.fixture(params=SOURCES)
def source(request, scene, monkeypatch):
    if request.param == "replay":
        yield ReplaySource(recorded())
        return
    if request.param == "ni":
        device = Device(np.load(scene)["voltages"][0])
        monkeypatch.setattr(utils, "_select_interpreter", lambda *_: device)
        yield NiSource(rate=2000.0)
        return
    link = "pty" if request.param == "serial" else "udp"
    with VirtualRig(scene, link=link, rate=2000) as rig:
        yield open_source(rig.where)


def some(source, count):
    """So many slots."""
    codes, found = np.zeros(source.electrodes, np.int16), []
    while len(found) < count:
        got = source.read(codes, 1.0)
        assert got is not None
        found.append((got, codes.copy()))
    return found


def test_slots_come_with_what_was_grounded_and_are_counted(source):
    with source:
        assert source.electrodes == 64 and source.rate > 0
        found = some(source, 200)
    gots = [got for got, _ in found]
    assert all(0 <= got.ground < 64 for got in gots)
    assert gots[0].time == 0
    numbers = np.array([got.number for got in gots])
    lost = np.array([got.lost for got in gots])
    np.testing.assert_array_equal(np.diff(numbers), 1 + lost[1:])
    times = np.array([got.time for got in gots])
    np.testing.assert_allclose(times, (numbers - numbers[0]) / source.rate, atol=1e-4)
    count = source.counters
    assert count.slots >= 200 and count.bad == count.late == 0
    volts = source.scale * np.stack([codes for _, codes in found]) + source.offset
    assert np.abs(volts).max() <= 5.01 and np.abs(volts).max() > 1e-3


def test_codes_are_written_into_the_array_given(source):
    with source:
        codes = np.full(64, 12345, np.int16)
        view = codes[:]
        assert source.read(codes, 1.0) is not None
        assert not (view == 12345).all()


def test_grounds_that_there_are_not_are_an_error(source):
    with source:
        for wrong in ([], [64], [-1]):
            with pytest.raises(ValueError, match="grounds"):
                source.set_grounds(wrong)
        some(source, 3)


def test_grounds_are_what_was_asked_for_or_are_told(source):
    with source:
        source.set_grounds([9, 40])
        time.sleep(0.05)
        grounds = [got.ground for got, _ in some(source, 300)]
    asked = set() if isinstance(source, ReplaySource) else {9, 40}
    assert set(grounds[200:]) == (asked or {0, 8, 63})


def test_it_stops_twice_and_starts_again(source):
    with source:
        some(source, 5)
        source.stop()
    source.start()
    found = some(source, 5)
    source.stop()
    assert all(0 <= got.ground < 64 for got, _ in found)


def test_waiting_for_what_does_not_come_ends(source):
    codes, end = np.zeros(64, np.int16), time.perf_counter() + 5
    with source:
        while time.perf_counter() < end:
            begin = time.perf_counter()
            try:
                got = source.read(codes, 0.0)
            except EOFError:
                break
            assert time.perf_counter() - begin < 1
            if got is None:
                break
    assert time.perf_counter() < end


def test_what_is_promised_is_kept(source):
    """As `check_source` tries it on sources of one's own."""
    assert check_source(source, obeys=not isinstance(source, ReplaySource)) == []


def test_a_replay_that_is_asked_for_grounds():
    (text,) = check_source(ReplaySource(recorded()))
    assert "set_grounds([0, 63]) is not obeyed" in text and "obeys=False" in text


def test_a_replay_is_the_recording():
    recording = recorded()
    recording.gaps = np.array([[4, 2], [100, 1]])
    source = ReplaySource(recording)
    codes, volts, gots = np.zeros(64, np.int16), [], []
    with source:
        while True:
            try:
                got = source.read(codes)
            except EOFError:
                break
            gots.append(got)
            volts.append(source.scale * codes + source.offset)
    exact = recording.read(0, 300).voltages.reshape(900, 64)
    np.testing.assert_allclose(volts, exact, atol=0.51 * source.scale)
    lost = {k: got.lost for k, got in enumerate(gots) if got.lost}
    assert lost == {12: 6, 294: 3}
    assert gots[-1].number == 900 + 9 - 1


def test_a_replay_at_its_own_speed_takes_its_time():
    source = ReplaySource(recorded(), speed=10.0)
    with source:
        begin = time.perf_counter()
        found = some(source, 500)
        spent = time.perf_counter() - begin
    assert spent > 0.9 * found[-1][0].time / 10


@pytest.mark.parametrize("where", ["udp://nowhere", "udp://127.0.0.1:x", "nothing.h5"])
def test_names_of_no_source(where):
    with pytest.raises(ValueError):
        open_source(where)


def test_options_that_a_source_has_not():
    with pytest.raises(ValueError, match="baud"):
        open_source("udp://127.0.0.1:4000", baud=9600)


def test_a_virtual_rig_ends_where_ctrl_c_is_ignored(scene):
    """As in what a script starts with &."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with VirtualRig(scene, link="udp") as rig:
            pass
    finally:
        signal.signal(signal.SIGINT, before)
    assert rig.slots is not None
