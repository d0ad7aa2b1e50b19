"""Sinks beside the loop, each against a receiver that is not ours."""

import json
import math
import shutil
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import tomojax.hardware
from tomojax.events import Event
from tomojax.hardware import SlotRing
from tomojax.hardware.sinks import (
    check,
    check_all,
    Counted,
    follow,
    Force,
    LiveRow,
    parse,
)
from tomojax.hardware.sinks.run import open_sink
from tomojax.recordings import attributes, Rig

SLOTS = 60


@pytest.fixture(scope="module")
def told() -> dict:
    import tomojax as tx

    return attributes(Rig.of(tx.Sensor.grid(4, 4, divisions=(16, 16))), 1e-4, 0.0)


@pytest.fixture
def ring():
    made = SlotRing.create(16, 2)
    yield made
    made.remove()


class Got:
    """As a source tells of a slot."""

    def __init__(self, number: int):
        self.number, self.lost, self.time, self.ground = number, 0, 1e-4 * number, 0


def fill(ring: SlotRing, slots: int = SLOTS, pause: float = 0.0, done: bool = True) -> None:
    """A contact that drifts, and from the 20th slot to the 39th a second one."""
    codes = np.zeros(16, np.int16)
    for k in range(slots):
        count = 2 if 20 <= k < 40 else 1
        xy = np.array([[0.03 + 1e-5 * k, 0.05], [0.06, 0.02]], np.float32)
        said = {"latency": 1e-5, "next": 0, "flags": k % 3, "count": count}
        said |= {"xy": xy, "conductance": np.array([2e-4, 1e-4], np.float32)}
        ring.put(Got(k), codes, said)
        if pause and k % 10 == 0:
            time.sleep(pause)
    ring.head["done"][...] = done


def sent(name: str, ring: SlotRing, told: dict, law: tuple | None = None) -> Counted:
    """Fills the ring, and lets a sink of that name follow it to the end."""
    fill(ring)
    where = parse(name)
    force = {} if law is None else {"force": Force(*law)}
    return follow(ring, open_sink(where, ring), told, where.rate, **force)


def started(name: str, ring: SlotRing, told: dict) -> subprocess.Popen:
    words = [str(ring.path), json.dumps(told), name]
    command = [sys.executable, "-m", "tomojax.hardware.sinks.run", *words]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def ended(process: subprocess.Popen) -> str:
    _, said = process.communicate(timeout=60)
    return said


def receiver() -> tuple[socket.socket, int]:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    made.bind(("127.0.0.1", 0))
    made.settimeout(20)
    return made, made.getsockname()[1]


def all_of(sock: socket.socket) -> list[bytes]:
    """Reads all datagrams that have come."""
    sock.setblocking(False)
    found = []
    with sock, suppress(BlockingIOError):
        while True:
            found.append(sock.recv(2048))
    return found


class Kept:
    """A sink of one's own."""

    def __init__(self) -> None:
        self.rows: list[LiveRow] = []
        self.events: list[Event] = []
        self.closed = False

    def put(self, row: LiveRow) -> None:
        self.rows.append(row)

    def event(self, event: Event, row: LiveRow | None) -> None:
        self.events.append(event)

    def close(self) -> None:
        self.closed = True


def check_events(kinds: list[tuple[str, int]]) -> None:
    want = [("touch_down", 1), ("touch_down", 2), ("lift_off", 2), ("lift_off", 1)]
    assert kinds == want


def run_here(ring: SlotRing, told: dict, **options) -> tuple[Kept, tuple]:
    sink = Kept()
    thread = threading.Thread(target=fill, args=(ring,))
    timer = threading.Timer(0.05, thread.start)
    timer.start()
    counted = follow(ring, sink, told, **options)
    timer.join()
    thread.join()
    return sink, counted


def test_a_sink_of_ones_own_has_every_row(ring, told) -> None:
    sink, counted = run_here(ring, told, force=lambda g: 1e4 * g)
    assert sink.closed and counted == (SLOTS, 0, 0)
    assert [row.slot for row in sink.rows] == list(range(SLOTS))
    assert sink.rows[30].contacts[1].number == 2
    assert sink.rows[30].contacts[0].force == pytest.approx(2.0)
    check_events([(event.kind, event.contact) for event in sink.events])


def test_a_loop_is_followed_by_number() -> None:
    force = Force((2e-4, 1.0), 1e-4, 1.44)
    assert force(2e-4) == pytest.approx(1 / 1.2)  # the loop's middle
    assert [force.of(1, g) for g in (1e-4, 2e-4, 1e-4)] == pytest.approx(
        [0.5, 1.0, 0.5 / 1.44]
    )
    assert force.of(2, 1e-4) == pytest.approx(0.5)
    force.gone(1)
    assert force.of(1, 1e-4) == pytest.approx(0.5)


def test_forces_of_a_row_know_their_way(ring, told) -> None:
    sink, _ = run_here(ring, told, force=Force((2e-4, 1.0), 1e-4, 1.44))
    told_of = {row.slot: [one.force for one in row.contacts] for row in sink.rows}
    assert told_of[0] == pytest.approx([1 / 1.2])  # without a number yet
    assert told_of[30] == pytest.approx([1.0, 0.5])


def test_rows_are_thinned_and_events_are_not(ring, told) -> None:
    sink, counted = run_here(ring, told, rate=1000.0)
    assert counted.sent + counted.thinned == SLOTS and 5 <= counted.sent <= 8
    check_events([(event.kind, event.contact) for event in sink.events])


def test_a_slow_sink_loses_its_own_rows_and_says_so(told) -> None:
    ring = SlotRing.create(16, 2, length=32)
    try:
        sink = Kept()
        sink.put = lambda row: time.sleep(0.01)  # type: ignore
        thread = threading.Thread(target=fill, args=(ring, 400, 0.001))
        timer = threading.Timer(0.05, thread.start)
        timer.start()
        counted = follow(ring, sink, told)
        thread.join()
        assert counted.lost > 0 and counted.sent + counted.lost == 400
    finally:
        ring.remove()


def test_datagrams(ring, told, tmp_path) -> None:
    sock, port = receiver()
    counted = sent(f"udp://127.0.0.1:{port}", ring, told, ((0.02, 1.0), 1e-4))
    packets = all_of(sock)
    assert counted == (SLOTS, 0, 0)
    assert len(packets) == SLOTS + 4
    program = tmp_path / "reads"
    if shutil.which("cc") is None:
        pytest.skip("needs a C compiler")
    header = Path(tomojax.hardware.__file__).parent / "sinks"
    (tmp_path / "reads.c").write_text(READS)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{header}"]
    subprocess.run(["cc", *flags, tmp_path / "reads.c", "-o", program], check=True)
    data = b"".join(bytes([len(p) & 255, len(p) >> 8]) + p for p in packets)
    done = subprocess.run([program], input=data, capture_output=True, check=True)
    lines = [line.split() for line in done.stdout.decode().splitlines()]
    check_events(
        [
            ({"2": "touch_down", "3": "lift_off"}[kind], int(number))
            for kind, _, _, _, _, number, *_ in lines
            if kind != "1"
        ]
    )
    rows = [line for line in lines if line[0] == "1"]
    assert [int(row[1]) for row in rows] == list(range(SLOTS))
    for k, (_, _, t, flags, count, _, x, y, g, force) in enumerate(rows):
        assert (int(flags), int(count)) == (k % 3, 2 if 20 <= k < 40 else 1)
        assert float(t) == pytest.approx(1e-4 * k)
        assert float(x) == pytest.approx(0.03 + 1e-5 * k) and float(y) == pytest.approx(
            0.05
        )
        assert float(g) == pytest.approx(2e-4)
        # F = g/c where k is 1, whatever the area.
        assert float(force) == pytest.approx(0.01)


READS = """
#include <stdio.h>
#include "tomojax_contacts.h"
int main(void)
{
    uint8_t data[2048];
    tomojax_packet p;
    int low, high;
    while ((low = getchar()) != EOF && (high = getchar()) != EOF) {
        size_t size = (size_t)low + 256 * (size_t)high;
        if (fread(data, 1, size, stdin) != size || !tomojax_read(data, size, &p))
            return 1;
        if (tomojax_read(data, size - 1, &p) || tomojax_read(data, size, &p) != 1)
            return 2;
        printf("%d %lld %.9g %lu %d %lu %.9g %.9g %.9g %.9g\\n", p.kind,
               (long long)p.slot, p.time, (unsigned long)p.flags, p.count,
               (unsigned long)p.contact[0].number, (double)p.contact[0].x,
               (double)p.contact[0].y, (double)p.contact[0].conductance,
               (double)p.contact[0].force);
    }
    return 0;
}
"""


def test_json_lines(ring, told, tmp_path) -> None:
    out = tmp_path / "rows.jsonl"
    process = started(f"jsonl:{out}", ring, told)
    fill(ring)
    assert f"{SLOTS} rows" in ended(process)
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    rows = [line for line in lines if "event" not in line]
    assert [row["slot"] for row in rows] == list(range(SLOTS))
    assert rows[25]["contacts"][1]["x_m"] == pytest.approx(0.06)
    assert rows[0]["contacts"][0]["force_N"] is None
    check_events([(line["event"], line["contact"]) for line in lines if "event" in line])


def test_osc(ring, told) -> None:
    pytest.importorskip("pythonosc")
    from pythonosc.osc_packet import OscPacket

    sock, port = receiver()
    fill(ring)
    assert f"{SLOTS} rows" in ended(
        started(f"osc://127.0.0.1:{port}?rate=10000", ring, told)
    )
    messages = [
        timed.message for data in all_of(sock) for timed in OscPacket(data).messages
    ]
    counts = [m.params[0] for m in messages if m.address == "/tomojax/count"]
    assert len(counts) >= SLOTS - 2 and max(counts) == 2
    down = [m.params for m in messages if m.address == "/tomojax/touch_down"]
    assert [p[0] for p in down] == [1, 2] and down[1][1] == pytest.approx(0.06)
    assert math.isnan(down[0][4])


def test_lab_streaming_layer(ring, told) -> None:
    pylsl = pytest.importorskip("pylsl")
    process = started("lsl:tomojax-test", ring, told)
    try:
        found = pylsl.resolve_byprop("name", "tomojax-test", timeout=15)
        if not found:
            pytest.skip("no multicast here")
        inlet = pylsl.StreamInlet(found[0])
        inlet.open_stream(timeout=15)
        fill(ring)
        samples = []
        end = time.monotonic() + 20
        while len(samples) < SLOTS and time.monotonic() < end:
            sample, _ = inlet.pull_sample(timeout=1.0)
            samples += [] if sample is None else [sample]
        assert len(samples) == SLOTS and len(samples[0]) == 13
        assert samples[30][2] == 2 and samples[30][9] == pytest.approx(0.06)
    finally:
        ring.head["done"][...] = 1
        ended(process)


@pytest.mark.long
def test_foxglove(ring, told) -> None:
    pytest.importorskip("foxglove")
    client = pytest.importorskip("websockets.sync.client")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    where = parse(f"foxglove:{port}?rate=10000")
    sink = open_sink(where, ring)
    with client.connect(
        f"ws://127.0.0.1:{port}",
        subprotocols=["foxglove.sdk.v1"],
        open_timeout=20,
        close_timeout=1,
    ) as page:
        topics: dict[str, int] = {}
        while len(topics) < 4:
            message = page.recv(timeout=20)
            told_json = json.loads(message) if isinstance(message, str) else {}
            if told_json.get("op") == "advertise":
                topics |= {c["topic"]: c["id"] for c in told_json["channels"]}
        wanted = {"id": 1, "channelId": topics["/tomojax/state"]}
        page.send(json.dumps({"op": "subscribe", "subscriptions": [wanted]}))
        follower = threading.Thread(target=follow, args=(ring, sink, told, where.rate))
        follower.start()
        state, until = b"", time.monotonic() + 60
        # Nothing says when the server has heard of it: rows go on until one arrives.
        while not state and time.monotonic() < until:
            fill(ring, done=False)
            with suppress(TimeoutError):
                message = page.recv(timeout=0.1)
                data = isinstance(message, bytes) and message[0] == 1
                state = message if data else b""
        ring.head["done"][...] = 1
        follower.join(20)
        row = json.loads(state[13:])
        assert row["contacts"][0]["y_m"] == pytest.approx(0.05)
    assert "/tomojax/contacts" in topics and "/tomojax/image" in topics


def test_nobody_listens(ring, told) -> None:
    sock, port = receiver()
    sock.close()
    assert sent(f"udp://127.0.0.1:{port}", ring, told) == (SLOTS, 0, 0)


@pytest.mark.parametrize(
    "name, says",
    [
        ("ftp://x:1", "one of udp:"),
        ("udp://127.0.0.1", "HOST:PORT"),
        ("udp://127.0.0.1:99999", "HOST:PORT"),
        ("jsonl:", "nothing"),
        ("jsonl:a?rate=-1", "rows a second"),
        ("jsonl:a?speed=1", "the option rate"),
        ("jsonl:no/such/folder.jsonl", "no such folder"),
        ("foxglove:here", "PORT"),
    ],
)
def test_names_are_checked(name, says) -> None:
    with pytest.raises(ValueError, match=says):
        check(name)


def test_a_file_is_not_replaced_and_a_port_in_use_is_told(tmp_path) -> None:
    (tmp_path / "a.jsonl").write_text("{}")
    with pytest.raises(ValueError, match="a new name"):
        check(f"jsonl:{tmp_path / 'a.jsonl'}")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(ValueError, match="foxglove"):
            check(f"foxglove:{taken.getsockname()[1]}")
    assert parse("udp://127.0.0.1:9000?rate=50").rate == 50


def test_two_sinks_do_not_meet(tmp_path) -> None:
    one = f"jsonl:{tmp_path / 'a.jsonl'}"
    for names in ([one, one + "?rate=5"], ["foxglove:45999"] * 2, ["lsl:a", "lsl:a"]):
        with pytest.raises(ValueError, match="has already"):
            check_all(names)
    with pytest.raises(ValueError, match="the recording has already"):
        check_all([one], tmp_path / "a.jsonl")
    assert parse("udp://[::1]:9000").address == ("::1", 9000)


def test_what_did_not_go_out_is_lost(ring, told) -> None:
    sink = Kept()
    sink.put = lambda row: row.slot % 2 == 0  # type: ignore
    threading.Thread(target=fill, args=(ring,)).start()
    counted = follow(ring, sink, told)
    assert counted == (SLOTS // 2, SLOTS // 2, 0)


def test_a_reader_that_is_gone_ends_the_sink_in_a_line(ring, told) -> None:
    words = [str(ring.path), json.dumps(told), "jsonl:-"]
    command = [sys.executable, "-m", "tomojax.hardware.sinks.run", *words]
    pipe = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, text=True, **pipe)
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    fill(ring, pause=0.05)
    said = process.stderr.read()
    process.stderr.close()
    process.wait(60)
    assert "nothing more goes there" in said and said.count("\n") == 1
