"""UDP: who is listened to, and what is believed."""

import socket
from contextlib import ExitStack

import numpy as np
import pytest

from tomojax.hardware import sources as frames, UdpSource

M = 64


@pytest.fixture
def sockets():
    """Two, at ports of their own."""
    with ExitStack() as stack:
        made = [
            stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            for _ in range(2)
        ]
        for one in made:
            one.bind(("127.0.0.1", 0))
            one.settimeout(5)
        yield made


def test_only_the_rig_is_listened_to_and_only_on_this_machine(sockets):
    there, stranger = sockets
    source = UdpSource("127.0.0.1", there.getsockname()[1])
    source._link.open()
    source._open = True
    source._ask()
    command, host = there.recvfrom(100)
    assert frames.unpack_command(command, M) == (frames.START, ())
    assert host[0] == "127.0.0.1"
    # What it listens at can be reached from this machine alone.
    assert source._link._socket.getsockname()[0] == "127.0.0.1"
    numbers = 1, 0, 1e4, 1e-4, 0.0
    told = frames.pack_description(frames.Description(M, *numbers))
    codes, got = np.zeros(M, np.int16), []
    mine, others = np.full(M, 7, "i2"), np.full(M, 8, "i2")
    there.sendto(told, host)
    for k in range(20):
        stranger.sendto(frames.pack_slot(1, k, 100 * k, others), host)
        there.sendto(bytes(60_000), host)  # too much
        there.sendto(b"", host)
        there.sendto(frames.pack_slot(2, k, 100 * k, mine), host)
    while len(got) < 20:
        found = source.read(codes, 2.0)
        assert found is not None and (codes == 7).all() and found.ground == 2
        got.append(found)
    assert source.counters.bad == 40 and source.counters.lost == 0
    assert len(source._link._room) < 200
    source.stop()


def test_a_rig_that_is_not_there_is_one_error(sockets, monkeypatch):
    port = sockets[0].getsockname()[1]
    sockets[0].close()
    monkeypatch.setattr("tomojax.hardware.sources._wire._NO_ANSWER", 0.3)
    with pytest.raises(TimeoutError, match="no rig answers"):
        UdpSource("127.0.0.1", port).start()
