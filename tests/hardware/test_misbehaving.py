"""Every rig of the table misbehaves once: all of it is in a file that can be read."""

import socket
import threading

import numpy as np
import pytest
from fuzz import rigs

from tomojax.hardware import sources as frames, UdpSource


@pytest.mark.parametrize("name", rigs.RIGS)
def test_recorded_and_read(name, tmp_path):
    rigs.check(name, tmp_path)


def test_there_are_enough_of_them():
    assert len(rigs.RIGS) >= 30


def test_forged_senders_are_not_let_in():
    """Sound slots from another address, to the port that the host listens at."""
    rig, other = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    rig.bind(("127.0.0.1", 0))
    rig.settimeout(10)
    player = rigs.Rig(np.random.default_rng(0))

    def play():
        host = rig.recvfrom(100)[1]
        other.sendto(rigs.told(7, 99), host)
        rig.sendto(rigs.told(), host)
        for k in range(100):
            other.sendto(player.slot(k, 100 * k, False), host)
            rig.sendto(player.slot(k, 100 * k), host)

    thread = threading.Thread(target=play)
    thread.start()
    codes = np.zeros(rigs.M, np.int16)
    with UdpSource("127.0.0.1", rig.getsockname()[1], electrodes=rigs.M) as source:
        thread.join()
        found = []
        while source.read(codes, 0.2) is not None:
            found.append(int(codes[0]))
    rig.close()
    other.close()
    assert found == player.sent
    assert source.counters.late == source.counters.bad == source.counters.restarts == 0


def test_a_rig_that_ignores_start_is_told(monkeypatch):
    monkeypatch.setattr("tomojax.hardware.sources._wire._NO_ANSWER", 2.0)
    rig = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    rig.bind(("127.0.0.1", 0))
    source = UdpSource("127.0.0.1", rig.getsockname()[1], electrodes=rigs.M)
    with pytest.raises(TimeoutError, match="no rig answers"):
        source.start()
    asked = 0
    with rig:
        while rig.recv(100) == frames.pack_command(frames.START):
            asked += 1
    assert asked >= 5  # and then STOP


def test_a_link_is_not_connected_to_itself(monkeypatch):
    """A rig on this machine is off: its port is free, and the system may draw it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    bind = socket.socket.bind

    class Drawn(socket.socket):
        def bind(self, address):
            bind(self, (address[0], port))

    monkeypatch.setattr(socket, "socket", Drawn)
    source = UdpSource("127.0.0.1", port, electrodes=rigs.M)
    with pytest.raises(OSError, match="own port"):
        source.start()
