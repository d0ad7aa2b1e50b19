"""The recorder: what it writes, and what is left when it is killed or the disk is full."""

import os
import resource
import signal
import time
from collections.abc import Callable
from datetime import datetime, UTC
from pathlib import Path

import h5py
import numpy as np
import pytest

import tomojax as tx
from tomojax.hardware import Got, SlotRing
from tomojax.hardware.loop.recorder import Recorder
from tomojax.recordings import attributes, info

RATE, M = 10_000, 64
NOTHING = {"latency": np.nan, "next": -1, "flags": 0, "count": 0}


@pytest.fixture
def told():
    sensor = tx.Sensor.grid(dtype=np.float32, divisions=(32, 32))
    return attributes(tx.recordings.Rig.of(sensor, float(RATE)), 5 / 32768, 0.0)


@pytest.fixture
def ring(tmp_path):
    made = SlotRing.create(M, length=1 << 16, folder=tmp_path)
    yield made
    made.remove()


def codes_of(number: int) -> np.ndarray:
    """Codes by which a slot is known again."""
    return ((number * 7 + 13 * np.arange(M)) % 30_000).astype("i2")


def put(ring, numbers, before=-1):
    """Slots of those numbers; those between are lost."""
    for number in numbers:
        got = Got(number % M, number - before - 1, number, number / RATE, 0.0)
        ring.put(got, codes_of(number), NOTHING)
        before = number
    return before


def feed(ring, seconds, start, meanwhile=lambda: None):
    """At RATE, in steps of a millisecond; the number after the last."""
    begin, number = time.monotonic(), start
    while (spent := time.monotonic() - begin) < seconds:
        until = start + int(spent * RATE)
        put(ring, range(number, until), number - 1)
        number = max(number, until)
        meanwhile()
        time.sleep(1e-3)
    return number


def wait_until(there: Callable[[], bool], seconds: float = 60.0) -> None:
    """Waits for another process."""
    end = time.monotonic() + seconds
    while not there():
        assert time.monotonic() < end
        time.sleep(0.01)


def files(path: Path) -> list[Path]:
    """In the order of what they hold."""
    return sorted(path.parent.glob(f"{path.stem}*.h5"), key=_first)


def _first(path: Path) -> float:
    with tx.open_recording(path) as recording:
        return float(recording.read(0, 1).t0[0])


def numbers_in(path: Path) -> np.ndarray:
    """Numbers of the slots of a file; each row is whole and right."""
    with tx.open_recording(path) as recording:
        scans = recording.read(0, recording.scans)
        assert recording.slots == 1 and recording.electrodes == M
        rig = recording.rig
        assert rig.f_switch == RATE and rig.drive_voltage == 4.5
    numbers = np.rint(scans.t0 * RATE).astype(int)
    codes = np.rint(scans.voltages[:, 0] / (5 / 32768))
    np.testing.assert_array_equal(codes, np.stack([codes_of(n) for n in numbers]))
    np.testing.assert_array_equal(scans.grounds[:, 0], numbers % M)
    return numbers


def test_all_of_it_and_gaps_are_records(ring, told, tmp_path):
    path = tmp_path / "push.h5"
    recorder = Recorder(ring, path, told)
    some = [*range(50), *range(53, 90), *range(97, 300)]
    before = put(ring, some)
    wait_until(lambda: int(ring.head["recorded"]) == len(some))
    put(ring, range(before + 6, 900), before)
    ring.head["done"][...] = 1
    recorder.close()
    expected = [*some, *range(before + 6, 900)]
    np.testing.assert_array_equal(numbers_in(path), expected)
    with tx.open_recording(path) as recording:
        assert recording.gaps.tolist() == [[50, 3], [90, 7], [300, 5]]
        after = recording.rows_after_gaps()
    assert after.tolist() == [50, 87, 290]
    assert int(ring.head["dropped"]) == 0


def test_two_rigs_have_the_hosts_clock(tmp_path):
    """Two clocks began at other times, and drift; a late row tells nothing."""
    t = np.arange(60.0)
    sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    for begin, drift in ((1e9, 1.0), (1e9 - 4e4, 1 + 1e-4)):
        rig = tx.recordings.Rig.of(sensor)
        recording = tx.recordings.ArrayRecording(rig, np.zeros((3, 1, 16)), [0])
        late = np.where(np.arange(60) % 3, 0.25, 0.001)
        recording.host_time = np.stack([t, begin + drift * t + late], 1)
        away = recording.on_host(t) - (begin + drift * t + 0.001)
        assert abs(away).max() < 1e-3
    with pytest.raises(ValueError, match="host_time: got none"):
        tx.recordings.ArrayRecording(rig, np.zeros((3, 1, 16)), [0]).on_host(0.0)


def test_a_recording_notes_the_hosts_time(ring, told, tmp_path):
    path, began = tmp_path / "clock.h5", time.time()
    recorder = Recorder(ring, path, told)
    put(ring, range(50))
    wait_until(lambda: int(ring.head["recorded"]) == 50)
    put(ring, range(50, 90))
    recorder.close()
    with tx.open_recording(path) as recording:
        tx.recordings.repair_recording(recording, tmp_path / "again.h5")
    for one in (path, tmp_path / "again.h5"):
        with tx.open_recording(one) as recording:
            assert len(recording.host_time) == 2
            last = recording.on_host(recording.t0[-1])
            assert began < last < time.time()
            told_of = info.text(one, info.summary(recording), [])
        assert f"began at {datetime.now(UTC):%Y-}" in told_of


def test_a_late_recorder_loses_the_oldest_and_says_so(told, tmp_path):
    ring = SlotRing.create(M, length=256, folder=tmp_path)
    put(ring, range(1000))
    path = tmp_path / "late.h5"
    recorder = Recorder(ring, path, told)
    recorder.close(timeout=30)  # ends the ring itself
    np.testing.assert_array_equal(numbers_in(path), np.arange(745, 1000))
    with tx.open_recording(path) as recording:
        assert recording.gaps.tolist() == [[0, 745]]
    assert int(ring.head["dropped"]) == 745


def test_files_roll(ring, told, tmp_path):
    path = tmp_path / "long.h5"
    recorder = Recorder(ring, path, told, file_seconds=0.7)
    last, began = 0, time.monotonic()
    while len(files(path)) < 3:  # however late its process starts
        last = feed(ring, 0.5, last)
        assert time.monotonic() - began < 120
    ring.head["done"][...] = 1
    recorder.close()
    found = files(path)
    parts = [numbers_in(file) for file in found]
    np.testing.assert_array_equal(np.concatenate(parts), np.arange(last))


@pytest.mark.long
def test_killed_ten_times(ring, told, tmp_path):
    """Every file opens, no half row, nothing lost while another starts."""
    path = tmp_path / "killed.h5"
    recorder = Recorder(ring, path, told)
    rng, number, kills = np.random.default_rng(3), 0, 0
    while kills < 10:
        number = feed(ring, float(rng.uniform(0.05, 0.6)), number, recorder.look)
        # Killed while it writes, not while it starts.
        if recorder.process.poll() is None and int(ring.head["recorded"]) > number - RATE:
            recorder.process.send_signal(signal.SIGKILL)
            kills += 1
    ring.head["done"][...] = 1
    recorder.close()
    assert recorder.deaths == 10
    parts = [numbers_in(file) for file in files(path)]
    assert len(parts) >= 2
    everything = np.concatenate(parts)
    # A slot may be in two files, where the first was not told of in time; none is lost.
    np.testing.assert_array_equal(np.unique(everything), np.arange(number))
    assert len(everything) - number < 10 * RATE


def test_disk_full_once(ring, told, tmp_path):
    """A limit on a file's size does what a full disk does: writes fail."""
    path = tmp_path / "full.h5"
    recorder = Recorder(ring, path, told)
    number, began = 0, time.monotonic()
    while int(ring.head["recorded"]) < RATE // 2:  # however late its process starts
        number = feed(ring, 0.3, number, recorder.look)
        assert time.monotonic() - began < 120
    pid = recorder.process.pid
    size = path.stat().st_size
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (size + 20_000, resource.RLIM_INFINITY))
    while recorder.deaths == 0:
        number = feed(ring, 0.3, number, recorder.look)
        assert time.monotonic() - began < 120
    number = feed(ring, 1.0, number, recorder.look)
    assert recorder.deaths == 1
    ring.head["done"][...] = 1
    recorder.close()
    parts = [numbers_in(file) for file in files(path)]
    assert len(parts) == 2
    np.testing.assert_array_equal(np.unique(np.concatenate(parts)), np.arange(number))


def test_the_ring_says_what_a_slow_reader_lost(tmp_path):
    ring = SlotRing.create(4, length=16, folder=tmp_path)
    codes = np.arange(4, dtype="i2")
    for number in range(40):
        ring.put(Got(1, 0, number, 0.0, 0.0), codes + number, NOTHING)
    rows, row, gone = SlotRing(ring.path, writable=False).since(0)
    assert rows["number"].tolist() == list(range(25, 40)) and (row, gone) == (40, 25)
    np.testing.assert_array_equal(rows["codes"][:, 0], np.arange(25, 40))
    rows, row, gone = ring.since(row)
    assert (len(rows), row, gone) == (0, 40, 0)
    assert os.path.getsize(ring.path) < 500_000


@pytest.mark.parametrize("damage", ["text", "far", "half"])
def test_a_damaged_host_time_is_left_out(ring, told, tmp_path, damage):
    path = tmp_path / "clock.h5"
    recorder = Recorder(ring, path, told)
    put(ring, range(50))
    recorder.close()
    with h5py.File(path, "r+") as file:
        kept = file["host_time"][()]
        del file["host_time"]
        row = {"far": [[0, 1e300]], "half": [[np.nan, np.nan]], "text": kept}[damage]
        file["host_time"] = np.concatenate([kept, row]).astype(
            "S8" if damage == "text" else float
        )
    with tx.open_recording(path) as recording:
        assert len(recording.host_time) == (0 if damage == "text" else 1)
        assert info.text(path, info.summary(recording), []).startswith(f"{path}: can be")
