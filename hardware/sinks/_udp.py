"""Sends contacts and events as datagrams; `tomojax_contacts.h` reads them in C."""

import socket
import struct
from contextlib import suppress

from tomojax.events import Event
from tomojax.hardware.loop import SlotRing
from tomojax.hardware.sinks._rows import goes_out, LiveContact, LiveRow
from tomojax.hardware.sinks._where import Where

# As the header has them: little-endian, no padding but the three bytes at the end.
HEAD = struct.Struct("<HBBIqdIB3x")
CONTACT = struct.Struct("<Iffff")
MAGIC = 0x4A54
VERSION = 1
KINDS = {"row": 1, "touch_down": 2, "lift_off": 3}


class UdpSink:
    """Sends a datagram for each row and each event; nobody has to listen."""

    def __init__(self, where: Where, ring: SlotRing):
        kind, _, _, _, self._to = socket.getaddrinfo(
            *where.address, type=socket.SOCK_DGRAM
        )[0]
        self._socket = socket.socket(kind, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        with suppress(OSError):
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._sequence = 0

    def put(self, row: LiveRow) -> bool:
        return self._send("row", row.slot, row.t, row.flags, row.contacts)

    def event(self, event: Event, row: LiveRow | None) -> None:
        one = LiveContact(event.contact, *event.xy, event.conductance, event.force)
        slot, flags = (-1, 0) if row is None else (row.slot, row.flags)
        self._send(event.kind, slot, event.t, flags, [one])

    def _send(
        self, kind: str, slot: int, t: float, flags: int, contacts: list[LiveContact]
    ) -> bool:
        number = self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        told = MAGIC, VERSION, KINDS[kind], number, slot, t, flags, len(contacts)
        data = HEAD.pack(*told) + b"".join(CONTACT.pack(*one) for one in contacts)
        # What is lost, the number tells who listens.
        return goes_out(lambda data: self._socket.sendto(data, self._to), data)

    def close(self) -> None:
        self._socket.close()
