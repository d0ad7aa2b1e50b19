"""Reads an MCAP file: messages of one type, as columns.

This file runs in the reader's process, see `reader`. The message is
`tomojax_msgs/msg/Slot`, whose text is in `SLOT`. A file's messages all have one length, so
that they are read as a table.
"""

import json
import struct
from collections.abc import Iterable
from contextlib import suppress
from operator import itemgetter
from typing import Any

import numpy as np

from tomojax.files._served import encode, Refused, Served

SLOT = """std_msgs/Header header
float64 device_time
uint64 number
uint32 ground
float32[] volts"""

_SCHEMA = "tomojax_msgs/msg/Slot"


class Mcap(Served):
    """A file's slots in the form of `Hdf5`'s datasets; metadata "tomojax" as attributes."""

    def __init__(self, path: str):
        from mcap.reader import NonSeekingReader

        self.attributes = {}
        slots, encoding = [], ""
        with open(path, "rb") as file:
            # As streams: what comes before a place where the file is cut off, or damaged by
            # its checksums, is read.
            with suppress(Exception):
                self._describe(NonSeekingReader(file, validate_crcs=True).iter_metadata())
            file.seek(0)
            reader = NonSeekingReader(file, validate_crcs=True)
            try:
                for schema, channel, message in reader.iter_messages(log_time_order=False):
                    if schema is not None and schema.name == _SCHEMA:
                        told = f"{schema.encoding} {channel.message_encoding}"
                        encoding = encoding or told
                        slots.append((message.log_time, message.data))
            except Exception:
                if not slots:
                    raise
                self.attributes["cut"] = encode(True)
        if not slots:
            raise Refused(f"no message {_SCHEMA}")
        if encoding != "ros2msg cdr":
            raise Refused(f"{_SCHEMA} as {encoding}, expected ros2msg cdr")
        slots.sort(key=itemgetter(0))
        self._columns = _table([data for _, data in slots])
        self.members = {
            name: {"shape": list(a.shape), "dtype": a.dtype.str, "stored": a.nbytes}
            for name, a in self._columns.items()
        }

    def _describe(self, records: Iterable[Any]) -> None:
        """Reads the file's description of the rig."""
        for metadata in records:
            if metadata.name == "tomojax":
                self.attributes = _attributes(metadata.metadata)

    def read(self, name: str, start: int, stop: int, axis: int) -> np.ndarray:
        return self._columns[name][start:stop]


def _attributes(told: dict[str, str]) -> dict[str, Any]:
    """Reads attributes whose values are JSON: numbers, lists and texts."""
    found = {}
    for name, text in told.items():
        try:
            value = json.loads(text)
            found[name] = encode(np.array(value) if isinstance(value, list) else value)
        except (ValueError, RecursionError, Refused):
            found[name] = {"refused": "no number, list or text"}
    return found


def _table(data: list[bytes]) -> dict[str, np.ndarray]:
    """Reads CDR's layout: each number is aligned to its size, from the fifth byte on."""
    first = data[0]
    if len({len(one) for one in data}) > 1 or len(first) < 16:
        raise Refused("slots of several lengths")
    if first[:2] != b"\0\1":
        raise Refused("big-endian slots")
    (length,) = struct.unpack_from("<I", first, 12)
    at = 16 + length  # behind the name of the frame
    at += -(at - 4) % 8
    if at + 28 > len(first):
        raise Refused("a name of a frame that is longer than its message")
    (count,) = struct.unpack_from("<I", first, at + 20)
    if at + 24 + 4 * count != len(first):
        raise Refused(f"{count} voltages in {len(first)} bytes")
    kind = np.dtype(
        [
            ("head", "V12"),
            ("length", "<u4"),
            ("frame", f"V{at - 16}"),
            ("time", "<f8"),
            ("number", "<u8"),
            ("ground", "<u4"),
            ("count", "<u4"),
            ("volts", "<f4", (count,)),
        ]
    )
    table = np.frombuffer(b"".join(data), kind)
    if (table["length"] != length).any() or (table["count"] != count).any():
        raise Refused("slots of several lengths")
    names = ("time", "number", "ground", "volts")
    return {name: np.ascontiguousarray(table[name]) for name in names}
