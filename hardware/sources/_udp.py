"""The protocol over UDP: each message is a datagram, from one rig alone."""

import socket
import time
from typing import Any

from tomojax._require import require
from tomojax.hardware.sources._frames import longest
from tomojax.hardware.sources._wire import Link, WireSource

# Messages that wait in the system, bytes.
_BUFFER = 4 << 20


class UdpLink(Link):
    """A link to the rig at (`host`, `port`); the system drops what others send."""

    def __init__(self, host: str, port: int, bind: str, electrodes: int):
        self._rig, self._bind = (host, port), bind
        self._room = bytearray(longest(electrodes) + 1)  # more is no message
        self._socket: socket.socket | None = None

    def open(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        try:
            self._socket.bind((self._bind, 0))
            self._socket.connect(self._rig)
            # While a rig on this machine is off its port is free, and may be drawn.
            if self._socket.getsockname() == self._socket.getpeername():
                raise OSError("the rig's own port was drawn")
        except OSError:
            self.close()
            raise

    def receive(self, timeout: float) -> tuple[list[bytes], float]:
        assert self._socket is not None
        found, now = [], time.perf_counter()
        self._socket.settimeout(timeout)
        try:
            while len(found) < 256:
                size = self._socket.recv_into(self._room)
                now = time.perf_counter()
                found.append(bytes(self._room[:size]))
                self._socket.setblocking(False)
        except (BlockingIOError, TimeoutError):
            pass
        except OSError:  # nobody is at that port; what came before is not lost
            if not found:
                raise
        return found, now

    def send(self, message: bytes) -> None:
        assert self._socket is not None
        self._socket.send(message)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def hand_over(self) -> tuple[int, bool, bytes] | None:
        return None if self._socket is None else (self._socket.fileno(), False, b"")

    def take_back(self, rest: bytes) -> list[bytes]:
        found = []
        while rest:
            end = 2 + int.from_bytes(rest[:2], "little")
            found.append(rest[2:end])
            rest = rest[end:]
        return found


class UdpSource(WireSource):
    """A rig at `host` and `port`; listens at `bind`, on this machine alone by default."""

    def __init__(
        self,
        host: str,
        port: int,
        bind: str = "127.0.0.1",
        electrodes: int = 64,
        conditions: Any = None,
    ):
        require(0 < port < 65536, "port", port, "1 to 65535")
        super().__init__(UdpLink(host, port, bind, electrodes), electrodes, conditions)
