"""The protocol over a serial line (pyserial), messages coded by COBS."""

import os
import select
import sys
import time
from typing import Any

import serial
from cobs import cobs

from tomojax.hardware.sources._frames import longest
from tomojax.hardware.sources._wire import Link, WireSource


class Frames:
    """Turns a stream of bytes into messages: decodes the bytes between two zero bytes."""

    def __init__(self, longest: int):
        self._longest = longest + longest // 254 + 1  # coded
        self._rest = b""

    def __call__(self, data: bytes) -> list[bytes]:
        """Returns the messages that `data` ends; an undecodable message comes empty."""
        *whole, self._rest = (self._rest + data).split(b"\0")
        found = [self._decoded(piece) for piece in whole if piece]
        if len(self._rest) > self._longest:  # no message: what ends it, starts the next
            self._rest = b"\1" * (self._longest + 1)
        return found

    def rest(self) -> bytes:
        """Takes out the bytes of a message that has no end yet."""
        rest, self._rest = self._rest, b""
        return rest

    def _decoded(self, piece: bytes) -> bytes:
        if len(piece) > self._longest:
            return b""
        try:
            return cobs.decode(piece)
        except cobs.DecodeError:
            return b""


class SerialLink(Link):
    """A link over a serial port by its name; a pseudo-terminal works, too."""

    def __init__(self, port: str, baud: int, electrodes: int):
        self._port, self._baud = port, baud
        self._longest = longest(electrodes)
        self._line: serial.Serial | None = None

    def open(self) -> None:
        self._line = serial.Serial(self._port, self._baud, timeout=0, write_timeout=0.1)
        self._frames = Frames(self._longest)
        self._poll = None
        # Of a line, macOS' poll tells nothing.
        if hasattr(select, "poll") and sys.platform != "darwin":
            self._poll = select.poll()
            self._poll.register(self._line.fileno(), select.POLLIN)
        self.send(b"")  # an end: whatever half a message the rig has from before

    def receive(self, timeout: float) -> tuple[list[bytes], float]:
        assert self._line is not None
        if self._poll is None:
            if not self._line.in_waiting:
                time.sleep(min(timeout, 5e-4))
            data, now = self._line.read(self._line.in_waiting), time.perf_counter()
            return self._frames(data), now
        events = self._poll.poll(1e3 * timeout)
        now = time.perf_counter()
        if not events:
            return [], now
        # As pyserial does on such systems, without its loops and locks.
        data = os.read(self._line.fileno(), 65536)
        if not data:
            raise ConnectionResetError("the line is cut")
        return self._frames(data), now

    def send(self, message: bytes) -> None:
        assert self._line is not None
        coded = cobs.encode(message) + b"\0"
        if self._poll is None:
            self._line.write(coded)
        else:
            os.write(self._line.fileno(), coded)

    def close(self) -> None:
        if self._line is not None:
            self._line.close()
        self._line = None

    def hand_over(self) -> tuple[int, bool, bytes] | None:
        if self._line is None or self._poll is None:
            return None
        return self._line.fileno(), True, self._frames.rest()

    def take_back(self, rest: bytes) -> list[bytes]:
        return self._frames(rest)


class SerialSource(WireSource):
    """A rig at a serial `port`."""

    def __init__(
        self, port: str, baud: int = 4_000_000, electrodes: int = 64, conditions: Any = None
    ):
        super().__init__(SerialLink(port, baud, electrodes), electrodes, conditions)
