"""Reads the present state of an HDF5 file that a writer has, or had at a crash, open.

HDF5 itself opens such a file in SWMR mode, or not at all. In SWMR mode HDF5 retries a
wrong checksum again and again, for longer each time: one damaged bit takes for ever.
This module checks the superblock's own checksum first. HDF5 is shown a superblock of a
closed file with the present length. Damaged metadata are then an error at once.
"""

import io
import os
from pathlib import Path

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_SIZE = 48  # bytes of the superblock
_OPEN = 0x05  # bits of a file that a writer has open: at all, and in SWMR mode
_MASK = 0xFFFFFFFF

# By so many bits the hash turns its words, round for round: of all the data, and at last.
_TURNS = (4, 6, 8, 16, 19, 4)
_LAST_TURNS = (14, 11, 25, 16, 4, 14, 24)


def lookup3(data: bytes) -> int:
    """Computes Bob Jenkins' hash (`hashlittle`, 2006), HDF5's checksum of metadata."""
    a = b = c = (0xDEADBEEF + len(data)) & _MASK

    def turned(x: int, by: int) -> int:
        return ((x << by) | (x >> (32 - by))) & _MASK

    if not data:
        return c
    for at in range(0, len(data), 12):
        part = data[at : at + 12].ljust(12, b"\0")
        words = (int.from_bytes(part[k : k + 4], "little") for k in (0, 4, 8))
        a, b, c = ((x + w) & _MASK for x, w in zip((a, b, c), words))
        if at + 12 >= len(data):
            break
        for by in _TURNS:
            a = ((a - c) & _MASK) ^ turned(c, by)
            a, b, c = b, (c + b) & _MASK, a
    for by in _LAST_TURNS:
        c = ((c ^ b) - turned(b, by)) & _MASK
        a, b, c = b, c, a
    return b


def growing(start: bytes) -> bool:
    """Tells by its first bytes whether a writer has a file open, or had at a crash."""
    return (
        start[:8] == _SIGNATURE
        and len(start) > 11
        and start[8] >= 3
        and start[11] & _OPEN > 0
    )


class Growing(io.RawIOBase):
    """The file in its present state, with the superblock of a closed file.

    **Raises:** `ValueError` for a damaged superblock; `OSError` where HDF5 asks for missing
    bytes.
    """

    def __init__(self, path: Path):
        self._file = path.open("rb", buffering=0)
        start = self._file.read(_SIZE)
        sizes = len(start) == _SIZE and start[9:11] == b"\x08\x08"
        if not sizes or lookup3(start[:44]) != int.from_bytes(start[44:], "little"):
            self._file.close()
            raise ValueError("file: damaged (the checksum of its superblock is wrong)")
        self.size = os.fstat(self._file.fileno()).st_size
        told = start[:11] + bytes([start[11] & ~_OPEN]) + start[12:28]
        told += self.size.to_bytes(8, "little") + start[36:44]
        self._start = told + lookup3(told).to_bytes(4, "little")
        self._at = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = 0) -> int:
        self._at = offset + (0, self._at, self.size)[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer) -> int:  # pyright: ignore (any buffer)
        view = memoryview(buffer).cast("B")
        done = 0
        if self._at < _SIZE:
            some = self._start[self._at : self._at + len(view)]
            view[: len(some)] = some
            done = len(some)
        self._file.seek(self._at + done)
        while done < len(view):
            count = self._file.readinto(view[done:])
            if not count:
                raise OSError("the file ends before its data")
            done += count
        self._at += done
        return done

    def close(self) -> None:
        self._file.close()
        super().close()
