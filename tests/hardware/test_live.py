"""The live loop against virtual rigs, and its commands."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import tomojax as tx
from tomojax import Flag
from tomojax.cli import app
from tomojax.hardware import open_source, run, SlotRing
from tomojax.hardware.sources.virtual import Pty
from tomojax.hardware.sources.virtual_rig import VirtualRig

# Slots a second: what a machine that is busy with other tests keeps up with.
RATE = 500


@pytest.fixture(scope="module")
def step():
    sensor = tx.Sensor.grid(dtype=np.float32, divisions=(32, 32))
    return tx.make_step(sensor, "follow", "around_contacts", contacts=1)


def looped(step, scene, tmp_path, seconds=1.5, **options):
    """Rows of a ring after so long, with the ring and the source."""
    ring = SlotRing.create(64, 1, folder=tmp_path)
    with VirtualRig(scene, rate=RATE, **options) as rig, open_source(rig.where) as source:
        end = time.perf_counter() + seconds
        run(source, step, ring, until=lambda: time.perf_counter() > end, budget=1.0)
    rows, _, gone = ring.since(0)
    assert gone == 0
    numbers, counted = rows["number"], ring.counted()
    assert numbers[-1] + 1 == counted["slots"] + counted["lost"]
    np.testing.assert_array_equal(np.diff(numbers, prepend=-1), 1 + rows["lost"])
    return rows, counted, source


@pytest.mark.parametrize("link", ["pty", "udp"])
def test_the_loop_is_closed(step, scene, places, tmp_path, link):
    rows, counted, _ = looped(step, scene, tmp_path, link=link)
    assert step.traces == 1
    done = np.isfinite(rows["latency"])
    # A machine that is busy with other work keeps up with some of them only.
    assert done.sum() > 30
    assert counted["skipped"] == (~done).sum()
    # What was asked for is grounded in the next slot or the one after, or where a slot had
    # come already, in the third.
    asked, grounds = rows["next"][:-3].astype(int), rows["ground"].astype(int)
    obeyed = (asked == [grounds[k : len(grounds) - 3 + k] for k in (1, 2, 3)]).any(0)
    # Of those that were answered before the next was read: what the machine is busy with
    # is not the loop's.
    quick = done[:-3] & (rows["latency"][:-3] < 0.8 / RATE)
    assert quick.sum() > 20 and obeyed[quick].mean() > 0.5
    worked = rows[done]
    on = worked["count"] == 1
    off = np.linalg.norm(worked["xy"][on][:, 0, None] - places, axis=-1).min(1)
    assert on.mean() > 0.5 and np.median(off) < 1e-3


def test_through_every_fault(step, scene, places, tmp_path):
    faults = {
        "loss": 0.02,
        "corrupt": 0.02,
        "reorder": 0.02,
        "contrary": 0.05,
        "jitter": 0.004,
        "drift": 300,
        "dead": [5, 17],
        "stall": 0.5,
        "disconnect": 1.2,
        "away": 0.2,
    }
    rows, counted, _ = looped(step, scene, tmp_path, 2.5, **faults)
    assert step.traces == 1
    assert counted["lost"] > 50 and counted["bad"] > 5 and counted["disconnects"] >= 1
    worked = rows[np.isfinite(rows["latency"])]
    flags = worked["flags"]
    assert (flags & Flag.GAP).any() and (flags & Flag.SATURATED).all()
    assert np.diff(rows["time"]).max() > 0.15 and (np.diff(rows["time"]) > 0).all()
    on = worked["count"] == 1
    off = np.linalg.norm(worked["xy"][on][:, 0, None] - places, axis=-1).min(1)
    assert on.mean() > 0.5 and np.median(off) < 1e-3
    assert rows["time"][-1] > 2.0  # it went on


def test_a_rig_switched_off_and_on(scene, tmp_path):
    rows, counted, _ = looped(None, scene, tmp_path, 2.0, link="udp", restart=0.8, away=0.3)
    assert counted["restarts"] == 1
    assert rows["time"][-1] > 1.5 and (np.diff(rows["time"]) > 0).all()


class Done(NamedTuple):
    """A command that has ended."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def command(monkeypatch, capfd, tmp_path):
    """Runs a command in this process; what the processes beside it print counts, too."""
    monkeypatch.chdir(tmp_path)

    def ended(*words):
        monkeypatch.setattr(sys, "argv", ["tomojax", *map(str, words)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as stop:
            app.run()
        return Done(stop.value.code, *capfd.readouterr())

    return ended


def test_record_then_info_and_reconstruct(command, scene, tmp_path):
    with VirtualRig(scene, rate=RATE) as rig:
        words = "record", rig.where, "-o", "a.h5", "--seconds", 2, "--pattern", "edge"
        done = command(*words)
        assert done.returncode == 0, done.stderr
        assert "recording: a.h5" in done.stdout and "slots" in done.stdout
        again = command("record", rig.where, "-o", "a.h5")
    assert again.returncode == 2 and "is there" in again.stderr
    with tx.open_recording(tmp_path / "a.h5") as recording:
        assert recording.scans > RATE and recording.rig.f_switch == RATE
        grounds = recording.read(recording.scans // 2, recording.scans).grounds[:, 0]
    edge = np.asarray(tx.pattern(tx.Sensor.grid(), "edge"))
    np.testing.assert_array_equal(np.unique(grounds), np.unique(edge))
    told = command("info", "a.h5")
    assert told.returncode == 0, told.stderr


@pytest.mark.long
def test_live_into_a_file_of_rerun(command, scene, tmp_path):
    with VirtualRig(scene, rate=RATE, link="udp") as rig:
        words = "live", rig.where, "--view", "rerun", "--rrd", "c.rrd", "--seconds", 4
        done = command(*words)
    assert done.returncode == 0, done.stderr
    told = (tmp_path / "c.rrd").read_bytes()
    assert all(name in told for name in (b"contacts_mm", b"image", b"latency_us"))


@pytest.mark.long
def test_live_draws_shapes(command, held):
    """At the end, if it has not begun before."""
    with VirtualRig(held, rate=RATE, link="udp") as rig:
        words = "live", rig.where, "--view", "none", "--shapes", "--seconds", 2
        done = command(*words)
    assert done.returncode == 0, done.stderr
    (line,) = [x for x in done.stdout.splitlines() if "images of what touches" in x]
    assert int(line.split()[0]) > 0


def test_the_latest_slots_of_an_image():
    from tomojax.hardware.loop.drawing import latest

    rows = np.zeros(40, [("ground", "i2"), ("time", "f8")])
    rows["ground"], rows["time"] = np.arange(40) % 12, 0.001 * np.arange(40)
    some = latest(rows)
    assert len(some) == 10 and (np.diff(some["time"]) > 0).all()
    assert set(some["ground"]) == set(range(12)) - {4, 5}  # the two that are oldest
    rows["time"][:37] -= 1.0
    assert len(latest(rows)) == 2
    assert len(latest(rows[:1])) == 1


@pytest.mark.long
def test_live_with_a_config_and_a_recording(command, held, tmp_path):
    (tmp_path / "rig.toml").write_text(
        'method = "follow"\ncontacts = 1\nseconds = 4.0\nfile-seconds = 60.0\n'
    )
    with VirtualRig(held, rate=RATE) as rig:
        words = "live", rig.where, "--config", "rig.toml", "--record", "b.h5"
        done = command(*words)
    assert done.returncode == 0, done.stderr
    assert "ground command" in done.stdout and "contact at" in done.stdout
    with tx.open_recording(tmp_path / "b.h5") as recording:
        assert recording.scans > RATE
    replayed = command("live", "b.h5", "--seconds", 3, "--view", "none")
    assert replayed.returncode == 0, replayed.stderr
    assert "slots" in replayed.stdout


@pytest.mark.parametrize(
    "words, told",
    [
        (("live", "udp://127.0.0.1"), "udp://HOST:PORT"),
        (("live", "none.h5"), "none.h5: no such file"),
        (("live", "serial:/dev/none"), "/dev/none"),
        (("live", "virtual", "--config", "none.toml"), "none.toml"),
        (("live", "virtual", "--config", "rig.toml"), "got metod, expected one of"),
        (("record", "virtual", "-o", "a.h5", "--pattern", "x"), "'x'"),
    ],
)
def test_mistakes_are_one_line(words, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("rig.toml").write_text("metod = 1\n")
    monkeypatch.setattr(sys, "argv", ["tomojax", *words])
    with pytest.raises(SystemExit) as stop:
        app.run()
    said = capsys.readouterr().err.strip().splitlines()
    said = [line for line in said if line != "scenes for a virtual rig …"]
    assert stop.value.code == 2 and len(said) == 1 and told in said[0]


def test_record_grounds_of_ones_own(command, scene, tmp_path):
    with VirtualRig(scene, rate=RATE, link="udp") as rig:
        words = "record", rig.where, "-o", "a.h5", "--seconds", 2, "--pattern", "9,40,3"
        done = command(*words)
    assert done.returncode == 0, done.stderr
    # Nothing is worked on, and so nothing is said of latencies.
    assert "nan" not in done.stdout and "ground command" not in done.stdout
    with tx.open_recording(tmp_path / "a.h5") as recording:
        grounds = recording.read(recording.scans // 2, recording.scans).grounds[:, 0]
    assert set(grounds.tolist()) == {9, 40, 3}


_OWNER = """
import os, sys
from tomojax.hardware.sources.virtual import Pty
from tomojax.hardware.sources.virtual_rig import VirtualRig
rig = VirtualRig(sys.argv[1], link="udp")
print(os.getpgid(rig._process.pid) == os.getpgid(0), flush=True)
os._exit(0)
"""


def test_a_terminal_that_is_cut_has_no_name_until_it_is_back(tmp_path):
    """Its number may be another rig's by then, which a source would listen to."""
    link = Pty(tmp_path / "rig")
    assert link.name.exists()
    link.close()
    assert not os.path.lexists(link.name)
    link.open()
    assert link.name.exists()
    link.close()


@pytest.mark.skipif(os.name != "posix", reason="no groups of processes")
def test_a_virtual_rig_whose_owner_is_gone_ends_without_a_word(scene):
    """Ctrl-C in the terminal is its owner's: the rig is in no group with that."""
    line = [sys.executable, "-c", _OWNER, str(scene)]
    done = subprocess.run(line, capture_output=True, text=True, timeout=60)
    assert done.stdout == "False\n" and done.stderr == ""


@pytest.mark.skipif(os.name != "posix", reason="no groups of processes")
@pytest.mark.parametrize(
    "said, seconds",
    [
        ("later runs start in seconds", 0.0),
        ("later runs start in seconds", 2.0),
        ("scenes for a virtual rig", 0.0),
    ],
)
def test_ctrl_c_while_live_prepares_is_a_line(tmp_path, said, seconds):
    """As in a terminal, where all processes of the group hear it."""
    code = "from tomojax.cli import main; main()"
    words = "--no-cache", "live", "virtual", "--view", "none"
    process = subprocess.Popen(
        [sys.executable, "-c", code, *words],
        cwd=tmp_path, stdout=-1, stderr=-1, text=True, process_group=0,
    )  # fmt: skip
    assert process.stderr is not None
    assert any(said in line for line in process.stderr)
    time.sleep(seconds)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert errors.strip().splitlines()[-1].startswith("tomojax: stopped")


def test_a_mistake_ends_the_process(tmp_path):
    code = "from tomojax.cli import main; main()"
    line = [sys.executable, "-c", code, "live", "none.h5"]
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
