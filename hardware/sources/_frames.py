"""Packs and unpacks the rig's messages; PROTOCOL.md tells firmware's authors their bytes.

Every message ends in a CRC-32 of the bytes before. Each kind of message has a known length.
No length in a message decides how much is allocated or read. A serial line carries messages
coded by COBS, each ended by a zero byte. UDP carries each message as a datagram.
"""

import struct
import zlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tomojax._require import require
from tomojax.recordings import check_table

VERSION = 1
TABLES = 2  # the version of a START with a table, and of the answer

# Kinds of messages: two of the rig, three commands.
SLOT = 0x01
DESCRIPTION = 0x02
START = 0x10
STOP = 0x11
GROUNDS = 0x12

_HEAD = struct.Struct("<BBHIQ")  # kind, ground, 0, sequence, µs
_DESCRIPTION = struct.Struct("<BBHIIddd")
_HELD = struct.Struct("<IHH")  # table, rows held, 0
_ROW = struct.Struct("<BBHIHH")  # kind, version, rows, table, row, 0
_CRC = struct.Struct("<I")


class Slot(NamedTuple):
    """One slot as it came."""

    ground: int
    sequence: int  # of all slots since the rig was switched on, modulo 2³²
    microseconds: int  # of the rig's clock, at the slot's end
    codes: np.ndarray  # (M,) int16, a view of the message


class Description(NamedTuple):
    """A rig's description of itself, sent before its first slot."""

    electrodes: int
    session: int  # another one each time that it is switched on
    sequence: int  # of its next slot
    rate: float  # slots a second
    scale: float  # V = scale·code + offset
    offset: float
    table: int | None = None  # the CRC-32 of the table of conditions that it has
    held: int = 0  # rows of the table, from the first on


class Row(NamedTuple):
    """A START with one row of a table of ground conditions."""

    rows: int  # of the table
    table: int  # the CRC-32 of all its rows
    row: int
    conductances: np.ndarray  # (M,) float32, S to ground, a view of the message


def slot_size(electrodes: int) -> int:
    """Returns the bytes of a slot's message."""
    return _HEAD.size + 2 * electrodes + _CRC.size


def longest(electrodes: int) -> int:
    """Returns the bytes of a rig's longest message."""
    return max(slot_size(electrodes), _DESCRIPTION.size + _HELD.size + _CRC.size)


def sealed(body: bytes) -> bytes:
    """Adds the CRC-32 that ends each message."""
    return body + _CRC.pack(zlib.crc32(body))


def pack_slot(ground: int, sequence: int, microseconds: int, codes: np.ndarray) -> bytes:
    """Packs one slot; codes (M,) are the converter's numbers."""
    head = _HEAD.pack(SLOT, ground, 0, sequence & 0xFFFFFFFF, microseconds)
    return sealed(head + codes.astype("<i2").tobytes())


def pack_description(told: Description) -> bytes:
    """Packs what a rig says of itself before its first slot."""
    m, session, sequence = told.electrodes, told.session, told.sequence & 0xFFFFFFFF
    numbers = told.rate, told.scale, told.offset
    version = VERSION if told.table is None else TABLES
    body = _DESCRIPTION.pack(DESCRIPTION, version, m, session, sequence, *numbers)
    return sealed(
        body + (b"" if told.table is None else _HELD.pack(told.table, told.held, 0))
    )


def pack_command(kind: int, grounds: Sequence[int] = ()) -> bytes:
    """Packs START, STOP, or GROUNDS with the ground conditions to repeat in turn."""
    count = len(grounds) if kind == GROUNDS else VERSION
    return sealed(bytes((kind, count, 0, 0, *grounds)))


def pack_row(told: Row) -> bytes:
    """Packs a START with one row of a table."""
    head = _ROW.pack(START, TABLES, told.rows, told.table, told.row, 0)
    return sealed(head + told.conductances.astype("<f4").tobytes())


def rows_of(conditions: np.ndarray, electrodes: int) -> list[Row]:
    """Returns the rows of a table of ground conditions (L, M), S, as they are sent.

    **Raises:** `ValueError` unless there are 1 to 256 rows of M conductances.
    """
    table = check_table(np.asarray(conditions, "<f4"), electrodes).astype("<f4")
    require(len(table) <= 256, "conditions", f"{len(table)} rows", "256 at most")
    number = zlib.crc32(table.tobytes())
    return [Row(len(table), number, k, row) for k, row in enumerate(table)]


def _sound(message: bytes) -> bool:
    return _CRC.unpack_from(message, len(message) - 4)[0] == zlib.crc32(message[:-4])


def unpack(
    message: bytes, electrodes: int, conditions: int | None = None
) -> Slot | Description | None:
    """Unpacks a message of a rig with `electrodes`; returns None for a bad message.

    `conditions`: how many ground conditions there are; by default one an electrode.
    """
    # By its kind: of ten electrodes a slot is as long as a description.
    if message[:1] == bytes((SLOT,)) and len(message) == slot_size(electrodes):
        _, ground, zero, sequence, time = _HEAD.unpack_from(message)
        fits = ground < (conditions or electrodes) and not zero
        if not (fits and _sound(message)):
            return None
        codes = np.frombuffer(message, "<i2", electrodes, _HEAD.size)
        return Slot(ground, sequence, time, codes)
    more = len(message) - _DESCRIPTION.size - _CRC.size
    if more not in (0, _HELD.size):
        return None
    kind, version, *rest = _DESCRIPTION.unpack_from(message)
    table, held, zero = None, 0, 0
    if more:
        table, held, zero = _HELD.unpack_from(message, _DESCRIPTION.size)
    fits = kind == DESCRIPTION and version == (TABLES if more else VERSION) and not zero
    return Description(*rest, table, held) if fits and _sound(message) else None


def unpack_row(message: bytes, electrodes: int) -> Row | None:
    """Unpacks a START with a row of a table; returns None for a bad one."""
    if len(message) != _ROW.size + 4 * electrodes + _CRC.size or not _sound(message):
        return None
    kind, version, rows, table, row, zero = _ROW.unpack_from(message)
    each = np.frombuffer(message, "<f4", electrodes, _ROW.size)
    fits = kind == START and version == TABLES and row < rows <= 256 and not zero
    fine = bool((np.isfinite(each) & (each >= 0)).all() and each.any())
    return Row(rows, table, row, each) if fits and fine else None


def unpack_command(message: bytes, electrodes: int) -> tuple[int, tuple[int, ...]] | None:
    """Unpacks a command and its grounds; returns None for a bad command.

    `electrodes`: or ground conditions, of a rig with a table.
    """
    if len(message) < 8 or len(message) > 8 + electrodes:
        return None
    kind, count, zero, nought = message[:4]
    grounds = tuple(message[4:-4])
    if kind == GROUNDS:
        fits = count == len(grounds) >= 1 and max(grounds) < electrodes
    else:
        fits = kind in (START, STOP) and count == VERSION and not grounds
    return (kind, grounds) if fits and not (zero or nought) and _sound(message) else None


def check_grounds(grounds: Sequence[int], electrodes: int) -> tuple[int, ...]:
    """Returns the grounds as a tuple.

    **Raises:** `ValueError` unless there are 1 to M electrode numbers, at most 255.
    """
    wanted, most = tuple(int(g) for g in grounds), min(electrodes, 255)  # a byte counts
    fits = 1 <= len(wanted) <= most and all(0 <= g < electrodes for g in wanted)
    require(fits, "grounds", wanted, f"1 to {most} of 0 to {electrodes - 1}")
    return wanted
