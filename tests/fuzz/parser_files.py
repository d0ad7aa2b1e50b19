"""Parsers of whole files that `parsers.py` fuzzes, beside those of `parser_targets.py`."""

import contextlib
import io
import zipfile
from typing import Any

import numpy as np
import parser_targets as targets


def kinds(data: bytes) -> None:
    """What a file is, before it is replaced: an answer, whatever its bytes are."""
    from tomojax.cli.entry._kinds import KINDS

    path = targets._file("any", data)
    for _, is_one in KINDS.values():
        assert is_one(path) in (True, False)


def npz(data: bytes) -> None:
    """Whatever arrays an .npz file has: numbers, as many as it is long."""
    from tomojax.files import read_npz

    path = targets._file("any.npz", targets.packed(data))
    with targets.one_line():
        for values in read_npz(path, "no state", (), None).values():
            assert values.dtype.kind in "biuf" and values.nbytes <= 2 * len(data) + 64


def superblock(data: bytes) -> None:
    """The start of a file that grows: read to its end and no farther."""
    from tomojax.files._superblock import Growing, growing, lookup3

    given = targets.Bytes(data)
    sealed, at, size = given.number() & 1, given.number(2), given.number(2)
    content = given.rest()
    if sealed:
        head = content[:44].ljust(44, b"\0")
        content = head + lookup3(head).to_bytes(4, "little") + content[44:]
    path = targets._file("grows.h5", content)
    growing(content[:12])
    with targets.one_line(), contextlib.suppress(OSError):
        with Growing(path) as file:
            assert file.size == len(content)
            file.seek(at)
            read = file.read(size) or b""
            assert len(read) <= max(0, len(content) - at), "more than there is"
            assert at < 48 or read == content[at : at + size], "other bytes"


def kinds_seeds() -> list[bytes]:
    pack = io.BytesIO()
    with zipfile.ZipFile(pack, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("table.npy", b"1")
        file.writestr("idle.npy", b"2")
    texts = b'{"environment": 1}', b'{"schema": "tomojax-calibration"}', b"<svg", b"RRF"
    more = b'{"type": "FeatureCollection"', b"channels = [1, 0]", b"\x89PNG"
    return [pack.getvalue(), *texts, *more]


def superblock_seeds() -> list[bytes]:
    start = b"\x89HDF\r\n\x1a\n\3\x08\x08\5" + bytes(range(32))
    return [bytes([1, at, 0, 40, 0]) + start + bytes(100) for at in (0, 30, 60)]


def npz_seeds(arrays: Any) -> list[bytes]:
    """By `parser_seeds.arrays`."""
    numbers = np.linspace(0, 1, 5), np.arange(4, dtype=np.int32), np.array(2)
    return [arrays(table=numbers[0], idle=numbers[1], size=numbers[2]), arrays(lam=1.0)]
