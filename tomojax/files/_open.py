"""Opens a container of datasets, HDF5, MCAP or TDMS, in a process with limits."""

import json
import math
import os
import threading
from operator import index
from pathlib import Path
from typing import Any, BinaryIO, Literal, NoReturn, SupportsIndex, TYPE_CHECKING

import numpy as np

from tomojax._require import memory
from tomojax.files._readers import readers

if TYPE_CHECKING:
    from tomojax.files._served import Served

_PIECE = 1 << 25  # bytes of one answer
_WHOLE = 0.25  # part of the machine's memory that one dataset may take

# Bytes of a dataset over those that hold it. Measured numbers and times pack to a third.
_PACKED = 200
_FEW = 1 << 24  # bytes that any dataset may have, whatever the ratio

# A reader that does not answer ends itself; nobody waits longer, s.
_WAIT = 120.0


class OpenContainer:
    """Attributes and datasets of a file from outside; a context that closes the file.

    `attributes` by name (numbers, arrays and texts); `names` of the file's members.
    `growing` tells whether a writer has the file open in SWMR mode, or had at a crash.
    `whole_rows` by name: the number of a dataset's rows that lie in such a file.

    **Example:**

    >>> import h5py
    >>> from tomojax.files import open_container, OpenContainer
    >>> with h5py.File("numbers.h5", "w") as file:
    ...     file["v"], file.attrs["unit"] = [1, 2, 3], "V"
    >>> with open_container("numbers.h5") as opened:
    ...     print(isinstance(opened, OpenContainer), opened.attributes["unit"])
    ...     print(opened.read("v"), opened.shape("v"))
    True V
    [1 2 3] (3,)
    """

    def __init__(self, path: Path, kind: str):
        self.path = path
        self._lock = threading.Lock()
        self._served: Served | None = None
        self._connection = readers.connect({"kind": kind, "path": os.path.abspath(path)})
        about = self._about(kind)
        self.growing: bool = about["growing"]
        self._attributes, self._members = about["attributes"], about["members"]

    def _about(self, kind: str) -> dict[str, Any]:
        if self._connection is not None:
            with self._lock:
                told = self._received()
            if "about" in told:
                return told["about"]
            self.close()
            if told["kind"] == "ModuleNotFoundError":
                raise ModuleNotFoundError(told["error"], name=told["missing"])
            # `OSError` is HDF5's; others are of what this package has looked at itself.
            raise (OSError if told["kind"] == "OSError" else ValueError)(told["error"])
        from tomojax.files.reader import KINDS

        try:
            served = KINDS[kind](os.path.abspath(self.path))
        except (OSError, ValueError, ModuleNotFoundError):
            raise
        except Exception as error:
            raise ValueError(" ".join(str(error).split())) from None
        self._served = served
        return served.about()

    @property
    def names(self) -> list[str]:
        return list(self._members)

    @property
    def attributes(self) -> dict[str, Any]:
        """Returns the attributes that can be read."""
        return _readable(self._attributes)

    def attributes_of(self, name: str) -> dict[str, Any]:
        """Returns the attributes of a member that can be read."""
        return _readable(self._member(name).get("attributes", {}))

    def refused(self, name: str) -> str | None:
        """Tells why an attribute or member of that name is unreadable; None if readable."""
        told = self._members.get(name) or self._attributes.get(name) or {}
        return told.get("refused")

    def shape(self, name: str) -> tuple[int, ...]:
        return tuple(self._member(name)["shape"])

    def dtype(self, name: str) -> np.dtype:
        return np.dtype(self._member(name)["dtype"])

    def whole_rows(self, name: str) -> int | None:
        return self._member(name).get("whole_rows")

    def stored(self, name: str) -> int:
        """Returns the bytes of a member in the file."""
        return self._member(name)["stored"]

    def place(self, name: str) -> int | None:
        """Returns the member's offset in the file, if the member lies in one piece."""
        return self._member(name).get("place")

    def _member(self, name: str) -> dict[str, Any]:
        told = self._members.get(name)
        why = "nothing" if told is None else told.get("refused")
        if told is None or why:
            raise ValueError(f"{name}: got {why}, expected numbers in the file itself")
        return told

    def read(
        self,
        name: str,
        start: SupportsIndex = 0,
        stop: SupportsIndex | None = None,
        axis: int = 0,
    ) -> Any:
        """Reads a dataset, or a stretch along its first axis, or its last axis (`axis` -1).

        **Raises:** `OSError` for data that cannot be read, `ValueError` for more data than
        the machine holds.
        """
        shape, item = self.shape(name), self.dtype(name).itemsize
        if not shape:
            return self._piece(name, 0, 0, 0)
        count = shape[axis]
        # NumPy's whole numbers as Python's: JSON has no others.
        stop = count if stop is None else min(index(stop), count)
        start = min(index(start), stop)
        row = max(1, math.prod(shape) // max(1, count)) * item
        if row * (stop - start) > _WHOLE * memory() or row > 2 * _PIECE:
            size = f"{row * (stop - start)} bytes"
            raise ValueError(f"{name}: got {size}, expected what this machine holds")
        each = max(1, _PIECE // row)
        if stop - start <= each:
            return self._piece(name, start, stop, axis)
        made = np.empty(
            (*shape[:-1], stop - start) if axis else (stop - start, *shape[1:]),
            self.dtype(name),
        )
        for at in range(start, stop, each):
            part = slice(at - start, min(at + each, stop) - start)
            piece = self._piece(name, at, min(at + each, stop), axis)
            made[(..., part) if axis else part] = piece
        return made

    def read_whole(self, name: str) -> np.ndarray:
        """Reads a whole dataset at once, for rows that lie in the file.

        **Raises:** as `read`; `ValueError` for a dataset much larger than its stored bytes:
        a small file must not cost the machine's memory.
        """
        shape, stop = self.shape(name), self.whole_rows(name)
        size = math.prod(shape) * self.dtype(name).itemsize
        if size > _FEW + _PACKED * self.stored(name):
            told = f"shape {shape} in {self.stored(name)} bytes"
            raise ValueError(f"{name}: got {told}, expected measured numbers")
        return self.read(name, 0, stop)

    def _piece(self, name: str, start: int, stop: int, axis: int) -> np.ndarray:
        if self._served is not None:
            return self._served.read(name, start, stop, axis)
        if self._connection is None:
            raise OSError("the file is closed")
        with self._lock:
            try:
                self._connection.send_bytes(json.dumps([name, start, stop, axis]).encode())
            except OSError:
                self._gone()
            told = self._received()
            if "error" in told:
                raise OSError(told["error"])
            shape, kind = tuple(told["shape"]), np.dtype(told["dtype"])
            if not math.prod(shape):
                return np.zeros(shape, kind)
            content = self._bytes()
        # Its own memory, which can be written.
        return np.frombuffer(bytearray(content), kind).reshape(shape)

    def _received(self) -> dict[str, Any]:
        return json.loads(self._bytes())

    def _bytes(self) -> bytes:
        assert self._connection is not None
        try:
            if self._connection.poll(_WAIT):
                return self._connection.recv_bytes()
        except (EOFError, OSError):
            pass
        except BaseException:  # Ctrl-C: an answer that comes later is no other's
            self.close()
            raise
        self._gone()

    def _gone(self) -> NoReturn:
        self.close()
        raise OSError("damaged: its library crashes or does not come back")

    def close(self) -> None:
        """Ends the process that reads the file."""
        self._served = None
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def __enter__(self) -> "OpenContainer":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()


def open_container(
    path: Path | str, kind: Literal["hdf5", "mcap", "tdms"] = "hdf5"
) -> OpenContainer:
    """Opens a file of datasets in a process of its own, with limits.

    In place of HDF5 the file may be MATLAB's of before version 7.3.

    **Raises:** `OSError` with the library's words for a file that the library cannot open;
    `ValueError` for a file that is damaged otherwise; `ModuleNotFoundError` without the
    library.

    **Example:**

    >>> import h5py
    >>> from tomojax.files import open_container
    >>> with h5py.File("numbers.h5", "w") as file:
    ...     file["v"] = [1, 2, 3]
    ...     file["other"] = h5py.ExternalLink("/etc/passwd", "/")
    >>> with open_container("numbers.h5") as opened:
    ...     opened.read("v"), opened.refused("other")
    (array([1, 2, 3]), 'a link that leads elsewhere')
    """
    path, told = Path(path), str(kind)
    if kind == "hdf5":
        with path.open("rb") as raw:
            told = "mat" if is_mat(raw) else kind
    return OpenContainer(path, told)


def is_mat(raw: BinaryIO) -> bool:
    """Tells a file of MATLAB before version 7.3 by its first bytes."""
    start = raw.read(10)
    raw.seek(0)
    return start == b"MATLAB 5.0"


def _readable(attributes: dict[str, dict[str, Any]]) -> dict[str, Any]:
    return {n: decode(told) for n, told in attributes.items() if "refused" not in told}


def decode(told: dict[str, Any]) -> Any:
    """Restores the value that `encode` was given."""
    if "text" in told:
        return told["text"]
    if "texts" in told:
        return np.array(told["texts"], object)
    if "numbers" in told:
        return np.array(told["numbers"], told["dtype"]).reshape(told["shape"])[()]
    if "shape" in told:
        texts = [one.encode("latin-1") for one in told["bytes"]]
        return np.array(texts, told["dtype"]).reshape(told["shape"])[()]
    return told["bytes"].encode("latin-1")
