"""Reads an MCAP file: messages of one type, as columns.

This file runs in the reader's process, see `reader`. The message is
`tomojax_msgs/msg/Slot`, whose text is in `SLOT`. A file's messages all have one length, so
that they are read as a table.
"""

import json
import struct
from typing import Any

import numpy as np

from tomojax.files._served import encode, Refused

SLOT = """std_msgs/Header header
float64 device_time
uint64 number
uint32 ground
float32[] volts"""

_SCHEMA = "tomojax_msgs/msg/Slot"


class Mcap:
    """A file's slots in the form of `Hdf5`'s datasets; metadata "tomojax" as attributes."""

    def __init__(self, path: str, options: dict[str, Any]):
        from mcap.reader import make_reader, NonSeekingReader

        self._columns: dict[str, np.ndarray] = {}
        self.attributes: dict[str, Any] = {}
        data: list[bytes] = []
        with open(path, "rb") as file:
            # Messages come in order of time. Checksums tell of damage.
            try:
                told = self._read(make_reader(file, validate_crcs=True), data)
            except Exception:
                # Cut off, or damaged: what comes before that is read, as a stream.
                data.clear()
                for take in (self._describe, self._read):
                    file.seek(0)
                    reader = NonSeekingReader(file, validate_crcs=True)
                    told = take(reader, data, False)
                self.attributes["cut"] = encode(True)
        if not data:
            raise Refused(f"no message {_SCHEMA}")
        if told != "ros2msg cdr":
            raise Refused(f"{_SCHEMA} as {told}, expected ros2msg cdr")
        self._columns = _table(data)
        self.members = {
            name: {"shape": list(a.shape), "dtype": a.dtype.str, "stored": a.nbytes}
            for name, a in self._columns.items()
        }

    def _read(self, reader: Any, data: list[bytes], whole: bool = True) -> str:
        """Collects the slots; returns the slots' encoding."""
        told = ""
        try:
            for schema, channel, message in reader.iter_messages(log_time_order=whole):
                if schema is not None and schema.name == _SCHEMA:
                    told = told or f"{schema.encoding} {channel.message_encoding}"
                    data.append(message.data)
            if whole:
                self._describe(reader, data)
        except Exception:
            if whole or not data:
                raise
        return told

    def _describe(self, reader: Any, data: list[bytes], whole: bool = True) -> str:
        """Reads the file's description of the rig."""
        try:
            for metadata in reader.iter_metadata():
                if metadata.name == "tomojax":
                    self.attributes = _attributes(metadata.metadata)
        except Exception:
            if whole:
                raise
        return ""

    def about(self) -> dict[str, Any]:
        """Returns all that is known before a row is read."""
        told = {"attributes": self.attributes, "members": self.members}
        return told | {"growing": False}

    def read(self, name: str, start: int, stop: int, axis: int) -> np.ndarray:
        """Reads a stretch of a column."""
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
