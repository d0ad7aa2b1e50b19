"""Reads arrays of .npz files, and judges sizes before any array is unpacked."""

import math
import zipfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tomojax.files._text import _line, _require_file

# Bytes of a file, and of all arrays together; a place of each slot of a long recording
# takes 16.
_MOST = 1 << 30

_RATIO = 200  # unpacked bytes over packed ones
_SLACK = 1 << 24  # bytes that any file may have, whatever the ratio (arrays of zeros)


def read_npz(
    path: Path | str, what: str, needed: Iterable[str], more: Iterable[str] | None = ()
) -> dict[str, np.ndarray]:
    """Reads arrays of numbers by name: all that are `needed`, and `more` if the file has
    them (None: every array).

    **Raises:** `ValueError`, one line: the file, the text `what`, and why.

    **Example:**

    >>> import numpy as np
    >>> from tomojax.files import read_npz
    >>> np.savez("places.npz", xy=np.zeros((3, 2)))
    >>> read_npz("places.npz", "places", ["xy"])["xy"].shape
    (3, 2)
    >>> read_npz("places.npz", "no table", ["idle"])
    Traceback (most recent call last):
        ...
    ValueError: places.npz: no table: no array 'idle'
    """
    path = Path(path)
    _require_file(path, what, _MOST)
    needed = list(needed)
    try:
        with zipfile.ZipFile(path) as pack:
            members = {m.filename.removesuffix(".npy"): m for m in pack.infolist()}
            for name in needed:
                if name not in members:
                    raise ValueError(f"no array {name!r}")
            told = members if more is None else (*needed, *more)
            wanted = [n for n in told if n in members]
            size = sum(members[n].file_size for n in wanted)
            packed = sum(members[n].compress_size for n in wanted)
            if size > _MOST or size > _SLACK + _RATIO * packed:
                raise ValueError(f"{size} bytes packed in {packed}")
            return {name: _array(pack, members[name]) for name in wanted}
    except RecursionError:
        raise ValueError(f"{path}: {what}: damaged") from None
    except Exception as error:  # whatever zipfile, zlib or NumPy make of it
        raise ValueError(f"{path}: {what}: {_line(error)}") from None


def _array(pack: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """Reads one array; compares its shape with its bytes before memory is asked for."""
    with pack.open(member) as raw:
        version = np.lib.format.read_magic(raw)
        if version == (1, 0):
            told = np.lib.format.read_array_header_1_0(raw)
        else:
            told = np.lib.format.read_array_header_2_0(raw)
        shape, fortran, dtype = told
        if dtype.kind not in "biuf" or any(n < 0 for n in shape):
            raise ValueError(f"{member.filename}: {dtype} {shape}, expected numbers")
        left = member.file_size - raw.tell()
        if math.prod(shape) * dtype.itemsize != left:
            raise ValueError(f"{member.filename}: {left} bytes do not make {shape}")
        content = raw.read(left + 1)
    if len(content) != left:
        raise ValueError(f"{member.filename}: {len(content)} bytes, expected {left}")
    values = np.frombuffer(content, dtype)
    return values.reshape(shape, order="F" if fortran else "C").copy()
