"""Reads the present state of an HDF5 file that a SWMR writer has, or had, open.

HDF5 itself opens such a file in SWMR mode alone. HDF5 then retries a wrong checksum again
and again, for longer each time: one damaged bit takes for ever. This module checks the
superblock's own checksum first. HDF5 is shown a superblock of a closed file with the
present length. Damaged metadata are then an error at once.
"""

import io
import os
from pathlib import Path

_SIGNATURE, _SIZE, _SWMR = b"\x89HDF\r\n\x1a\n", 48, 0x05
_MASK = 0xFFFFFFFF


def lookup3(data: bytes) -> int:
    """Computes Bob Jenkins' hash (`hashlittle`, 2006), HDF5's checksum of metadata."""
    a = b = c = (0xDEADBEEF + len(data)) & _MASK

    def turned(x: int, by: int) -> int:
        return ((x << by) | (x >> (32 - by))) & _MASK

    while len(data) > 12:
        words = (int.from_bytes(data[k : k + 4], "little") for k in (0, 4, 8))
        a, b, c = ((x + w) & _MASK for x, w in zip((a, b, c), words))
        a = ((a - c) & _MASK) ^ turned(c, 4)
        c = (c + b) & _MASK
        b = ((b - a) & _MASK) ^ turned(a, 6)
        a = (a + c) & _MASK
        c = ((c - b) & _MASK) ^ turned(b, 8)
        b = (b + a) & _MASK
        a = ((a - c) & _MASK) ^ turned(c, 16)
        c = (c + b) & _MASK
        b = ((b - a) & _MASK) ^ turned(a, 19)
        a = (a + c) & _MASK
        c = ((c - b) & _MASK) ^ turned(b, 4)
        b = (b + a) & _MASK
        data = data[12:]
    if not data:
        return c
    data = data.ljust(12, b"\0")
    words = (int.from_bytes(data[k : k + 4], "little") for k in (0, 4, 8))
    a, b, c = ((x + w) & _MASK for x, w in zip((a, b, c), words))
    c = ((c ^ b) - turned(b, 14)) & _MASK
    a = ((a ^ c) - turned(c, 11)) & _MASK
    b = ((b ^ a) - turned(a, 25)) & _MASK
    c = ((c ^ b) - turned(b, 16)) & _MASK
    a = ((a ^ c) - turned(c, 4)) & _MASK
    b = ((b ^ a) - turned(a, 14)) & _MASK
    return ((c ^ b) - turned(b, 24)) & _MASK


def growing(start: bytes) -> bool:
    """Tells by its first bytes whether a writer has a file open, or had at a crash."""
    return (
        start[:8] == _SIGNATURE and len(start) > 11 and start[8] >= 3 and start[11] & 4 > 0
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
        told = start[:11] + bytes([start[11] & ~_SWMR]) + start[12:28]
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
