"""The loop in C beside the loop in Python, on the same bytes: each row of the ring."""

import socket
import sys
import time
from contextlib import suppress

import numpy as np
import pytest
from cobs import cobs

import tomojax as tx
from tomojax.hardware import open_source, OrderedSource, run, SlotRing, sources as frames
from tomojax.hardware.loop.in_c import loop_in_c
from tomojax.hardware.sources import Link, SlotSource, WireSource
from tomojax.hardware.sources.serial import Frames
from tomojax.hardware.sources.virtual_rig import VirtualRig, write_scene
from tomojax.native import compiler

M = 16
pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux") or compiler() is None,
    reason="the loop in C needs Linux and a C compiler",
)


class Line(Link):
    """A line on which slots come in bursts; `sent` is what the loop sends."""

    def __init__(self, messages, serial, in_c, broken=None):
        super().__init__()
        kind = socket.SOCK_STREAM if serial else socket.SOCK_DGRAM
        self._here, self.rig = socket.socketpair(socket.AF_UNIX, kind)
        for end in (self._here, self.rig):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
            end.setblocking(False)
        self._serial, self._in_c, self._frames = serial, in_c, Frames(100)
        self.opened = False
        self._messages, self.taken = list(messages), 0
        self._broken = broken  # draws which bytes are broken
        self.burst, self.piece = 16, 64  # slots that come at once, bytes read at once

    def some(self):
        """A few slots come."""
        for message in self._messages[: self.burst]:
            data = bytearray(cobs.encode(message) + b"\0" if self._serial else message)
            if self._broken is not None and self.opened and self._broken.random() < 0.2:
                at = int(self._broken.integers(len(data)))
                kind = self._broken.integers(4)
                more = self._broken.bytes(int(self._broken.integers(1, 400)))
                data[at : at + (kind > 0)] = (b"", b"\0", more[:1], more)[kind]
            self.rig.send(data)
        del self._messages[: self.burst]
        self.opened = True

    def open(self):
        self.some()

    def receive(self, timeout):
        try:
            if self._serial:
                return self._frames(self._here.recv(self.piece)), time.perf_counter()
            return [self._here.recv(4096)], time.perf_counter()
        except BlockingIOError:
            if self._messages:
                self.some()
                return [], time.perf_counter()
            raise EOFError("the test's end") from None

    def send(self, message):
        self._here.send(cobs.encode(message) + b"\0" if self._serial else message)

    def close(self):
        self._here.close()

    def hand_over(self):
        if not self._in_c:
            return None
        self.taken += 1
        return self._here.fileno(), self._serial, self._frames.rest()

    def take_back(self, rest):
        if self._serial:
            return self._frames(rest)
        found = []
        while rest:
            end = 2 + int.from_bytes(rest[:2], "little")
            found, rest = [*found, rest[2:end]], rest[end:]
        return found

    def sent(self):
        data = b""
        with suppress(BlockingIOError), self.rig:
            while piece := self.rig.recv(1 << 16):
                data += piece if self._serial else cobs.encode(piece) + b"\0"
        told = [frames.unpack_command(m, M) for m in Frames(100)(data)]
        grounds = [which for kind, which in told if kind == frames.GROUNDS]
        # A busy machine is silent so long that the same is asked for again.
        return [a for a, before in zip(grounds, [(), *grounds]) if a != before]


def made(dtype):
    sensor = tx.Sensor.grid(4, 4, dtype=dtype, divisions=(16, 16))
    policy = "around_contacts"
    return tx.make_step(sensor, "source", policy, contacts=1, grid=8, native=True)


@pytest.fixture(scope="module")
def step():
    return made("float32")


@pytest.fixture(scope="module")
def volts():
    sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    return np.asarray(tx.voltages(sensor, tx.Disc([0.03, 0.02], 0.005, 0.5)))


SCALE = 2e-4
HALF = 0.01  # m, of the distance of electrodes: few grounds on a coarse grid


def messages(volts, count=160):
    """Slots a second apart, with every fault that a line may have."""
    rng = np.random.default_rng(4)
    start = 2**32 - 40  # numbers go round
    told = frames.Description(M, 1, start, 1.0, SCALE, 0.01)
    made, clock = [], 10**6 * (2**32 // 10**6 - 60)  # its lowest bits go round
    for k in range(count):
        ground = int(rng.integers(M))
        codes = np.rint((volts[ground] - 0.01 + rng.normal(0, 3e-4, M)) / SCALE)
        time_of = (clock + 10**6 * k) % 2**32
        made.append(frames.pack_slot(ground, start + k, time_of, codes))
    broken = bytearray(made[30])
    broken[7] ^= 1
    made[30] = bytes(broken)
    made[50], made[51] = made[51], made[50]
    made[60] = made[60][:20]
    made[70] = made[69]  # twice
    made[80] = frames.sealed(b"\x01\xff" + made[80][2:-4])  # a ground that is not there
    made[90] = frames.pack_description(told._replace(sequence=(start + 90) % 2**32))
    del made[120:125], made[100]
    return [frames.pack_description(told), *made]


def looped(step, volts, tmp_path, serial, in_c, wires=None, broken=None):
    line = Line(messages(volts), serial, in_c, broken)
    source = WireSource(line, M)
    source = OrderedSource(source, *wires) if wires else source
    ring = SlotRing.create(M, 1, length=512, folder=tmp_path)
    ring.trim[0] = np.linspace(0.99, 1.01, M)
    source.start()
    run(source, step, ring, images=False)
    source.stop()
    rows = ring.since(0)[0]
    assert (line.taken > 5) == in_c
    return rows, ring.counted(), line.sent(), ring.head["latency"].sum()


WIRES = np.random.default_rng(1).permutation(M), np.random.default_rng(2).permutation(M)


CASES = {
    "float32, serial, wires in order": ("float32", True, None),
    "float64, udp, in another order": ("float64", False, WIRES),
}


@pytest.mark.parametrize("dtype, serial, wires", CASES.values(), ids=CASES)
def test_rows_are_those_of_python(dtype, volts, tmp_path, serial, wires):
    step = made(dtype)
    assert step.native
    rows, counted, sent, seen = looped(step, volts, tmp_path, serial, True, wires)
    expected, count, said, there = looped(step, volts, tmp_path, serial, False, wires)
    assert counted == count and sent == said and seen == there
    assert count["bad"] == 3 and count["late"] == 2 and count["lost"] > 8
    assert len(rows) == len(expected) > 140
    for name in ("number", "lost", "time", "ground", "next", "flags", "count", "codes"):
        np.testing.assert_array_equal(rows[name], expected[name], err_msg=name)
    for name in ("xy", "conductance"):
        np.testing.assert_allclose(rows[name], expected[name], rtol=1e-4, err_msg=name)
    assert expected["count"].sum() > 50 and np.isfinite(rows["latency"]).all()


@pytest.mark.parametrize("period, skips", [(1e-6, True), (4e-4, False)])
@pytest.mark.parametrize("in_c", [True, False])
def test_a_burst_is_skipped_where_answers_take_more_than_half_a_slot(
    step, volts, tmp_path, in_c, period, skips
):
    """A burst takes many times `period`; no answer of C takes half of 0.4 ms."""
    codes = np.rint(volts[0] / SCALE)
    told = frames.Description(M, 1, 0, 1 / period, SCALE, 0.0)
    slots = [frames.pack_slot(0, k, 100 * k, codes) for k in range(240)]
    line = Line([frames.pack_description(told), *slots], True, in_c)
    line.burst, line.piece = 300, 1 << 16
    source, ring = WireSource(line, M), SlotRing.create(M, 1, length=512, folder=tmp_path)
    source.start()
    run(source, step, ring, images=False)
    source.stop()
    line.rig.close()
    skipped, rows = ring.counted()["skipped"], ring.since(0)[0]
    assert len(rows) == 240 and skipped == np.isnan(rows["latency"]).sum()
    assert skipped > 100 if skips else skipped == 0
    late = rows["latency"][np.isfinite(rows["latency"])]
    assert skips or late.max() > period


class Own(SlotSource):
    """A source that has no line to hand over."""

    start = stop = read = set_grounds = None


def test_it_is_not_compiled_for_other_sources(step, tmp_path):
    ring = SlotRing.create(M, 1, length=8, folder=tmp_path)
    assert loop_in_c(Own(), step, ring, 1.0, 1.0, 20) is None


@pytest.mark.parametrize("serial, seed", [(True, 0), (True, 1), (False, 2)])
def test_broken_bytes_are_to_it_what_they_are_to_python(
    step, volts, tmp_path, serial, seed
):
    both = [
        looped(step, volts, tmp_path, serial, in_c, None, np.random.default_rng(seed))
        for in_c in (True, False)
    ]
    (rows, counted, *_), (expected, count, *_) = both
    assert counted == count and count["bad"] > 10 and len(rows) > 80
    for name in ("number", "lost", "time", "ground", "flags", "codes"):
        np.testing.assert_array_equal(rows[name], expected[name], err_msg=name)


@pytest.mark.parametrize("link", ["pty", "udp"])
def test_a_rig_that_loses_breaks_and_goes_away(step, volts, tmp_path, link):
    write_scene(tmp_path / "scene.npz", volts[None], 1.0)
    ring = SlotRing.create(M, 1, folder=tmp_path)
    faults = {
        "loss": 0.02,
        "corrupt": 0.02,
        "reorder": 0.02,
        "disconnect": 0.6,
        "away": 0.1,
    }
    with (
        VirtualRig(tmp_path / "scene.npz", rate=500, link=link, **faults) as rig,
        open_source(rig.where, electrodes=M) as source,
    ):
        end, count = time.perf_counter() + 20, ring.head["rows"]
        enough = lambda: count > 400 or time.perf_counter() > end  # noqa: E731
        run(source, step, ring, until=enough, budget=1.0)
    rows, counted = ring.since(0)[0], ring.counted()
    np.testing.assert_array_equal(np.diff(rows["number"], prepend=-1), 1 + rows["lost"])
    assert rows["number"][-1] + 1 == counted["slots"] + counted["lost"]
    assert counted["bad"] > 0 and counted["lost"] > 5
    answered = np.isfinite(rows["latency"])
    done = rows[answered]
    assert len(done) > 50 and counted["skipped"] == len(rows) - len(done)
    assert np.isin(done["ground"][-20:], done["next"]).all()  # what was asked for comes
    assert np.median(np.linalg.norm(done["xy"][:, 0] - [0.03, 0.02], axis=1)) < HALF
    assert ring.head["image"].any()
