"""Reads an HDF5 file from outside: plain datasets that lie in the file itself.

This file runs in the reader's process, see `reader`. No link, virtual dataset or external
storage is followed. Sizes are compared with the file's bytes before any are read.
"""
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportCallIssue=false, reportOptionalMemberAccess=false, reportOperatorIssue=false
# (h5py does not say whether a name is a group or a dataset)

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tomojax.files._superblock import Growing, growing

# deflate, shuffle, fletcher32, szip, nbit, scaleoffset and h5py's lzf: what HDF5 and h5py
# bring with them. Others would be loaded from a folder of plugins.
_FILTERS = (1, 2, 3, 4, 5, 6, 32000)

# Blosc, LZ4, bitshuffle, Zstd and Blosc2, which `hdf5plugin` brings.
_PLUGGED = (32001, 32004, 32008, 32015, 32026)

_CHUNK = 1 << 27  # bytes of a chunk once it is unpacked
_NAMES = 4096  # in a file
_ATTRIBUTE = 1 << 24  # bytes
_VALUES = 1 << 20  # of an attribute
_TEXT = 1 << 16  # bytes of one text

# Bytes of a dataset over those that are stored: deflate packs 1032 into one at best.
_RATIO = 1100
_SLACK = 1 << 24  # bytes that any dataset may have, whatever the ratio

# A file that is being written may be torn as it is opened: again, s.
_AGAIN = (0.02, 0.1, 0.3)


# Imported before a file is open, beside which nothing else may be opened.
try:
    import hdf5plugin as _PLUGIN
except ImportError:
    _PLUGIN = None


class Refused(Exception):
    """A fault of a file: the contents found in place of those expected."""


class Served(ABC):
    """A file of one kind: attributes and members are known before a row is read."""

    attributes: dict[str, dict[str, Any]]
    members: dict[str, dict[str, Any]]
    growing = False

    @abstractmethod
    def read(self, name: str, start: int, stop: int, axis: int) -> np.ndarray:
        """Reads a stretch of a member along its first or its last axis."""

    def about(self) -> dict[str, Any]:
        """Returns all that is known before a row is read."""
        names = ("attributes", "members", "growing")
        return {name: getattr(self, name) for name in names}


def told_by(read: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Returns what `read` tells of a member or an attribute, or why nothing is told."""
    try:
        return read()
    except Refused as error:
        return {"refused": str(error)}
    except Exception as error:  # h5py's are of any class
        return {"refused": f"what is damaged ({_line(error)})"}


class Hdf5(Served):
    """A file's attributes and datasets."""

    def __init__(self, path: str):
        self.size = Path(path).stat().st_size
        with open(path, "rb") as raw:
            self.growing = growing(raw.read(12))
        self._datasets: dict[str, Any] = {}
        for wait in (*_AGAIN, None) if self.growing else (None,):
            try:
                self._load(path)
                return
            except Exception:
                if wait is None:
                    raise
                time.sleep(wait)

    def _load(self, path: str) -> None:
        if self.growing:
            raw = Growing(Path(path))
            self.size = raw.size
            self._file = h5py.File(raw, "r")
        else:
            # A reader that is about to end must not keep its owner from writing.
            self._file = h5py.File(path, "r", locking=False)
        names = list(self._file)
        for name in names[:_NAMES]:  # a group's own members, one level down
            link = self._file.get(name, getlink=True)
            with suppress(Exception):  # damaged: its own turn tells
                inner = self._file[name] if type(link) is h5py.HardLink else None
                if isinstance(inner, h5py.Group):
                    names += [f"{name}/{each}" for each in inner]
        if len(names) > _NAMES:
            raise Refused(f"{len(names)} names in it")
        self.attributes = _attributes(self._file)
        self.members = {name: told_by(partial(self._member, name)) for name in names}

    def _member(self, name: str) -> dict[str, Any]:
        link = self._file.get(name, getlink=True)
        if type(link) is not h5py.HardLink:
            raise Refused("a link that leads elsewhere")
        found = h5py.h5o.open(self._file.id, name.encode("utf-8", "surrogateescape"))
        if not isinstance(found, h5py.h5d.DatasetID):
            raise Refused("a group, or another thing without numbers")
        stored = _stored(found, self.size, self.growing)
        _require_own(found, self.size, stored)
        dataset = h5py.Dataset(found)
        told = _numbers(dataset) | {
            "whole_rows": self._rows(dataset),
            "attributes": _attributes(dataset),
            "place": found.get_offset(),
            "stored": stored,
        }
        self._datasets[name] = dataset
        return told

    def _rows(self, dataset: Any) -> int | None:
        """Counts rows along the first axis whose chunks lie in a file, perhaps cut off."""
        if not self.growing or dataset.chunks is None:
            return None
        whole, step = 0, dataset.chunks[0]
        across = [range(0, n, c) for n, c in zip(dataset.shape[1:], dataset.chunks[1:])]
        others = math.prod(map(len, across))
        if others > 1:  # no recorder of ours cuts scans
            return None
        rest = (0,) * (dataset.ndim - 1)
        for start in range(0, dataset.shape[0], step):
            try:
                chunk = dataset.id.get_chunk_info_by_coord((start, *rest))
            except Exception:  # the index itself ends here
                break
            if chunk.byte_offset is None or chunk.byte_offset + chunk.size > self.size:
                break
            whole = min(start + step, dataset.shape[0])
        return whole

    def read(self, name: str, start: int, stop: int, axis: int) -> np.ndarray:
        dataset = self._datasets[name]
        if not dataset.ndim:
            return np.asarray(dataset[()])
        return np.asarray(dataset[..., start:stop] if axis else dataset[start:stop])


def _stored(found: Any, size: int, growing: bool) -> int:
    """Returns a dataset's bytes in the file, of which a part may be cut off."""
    try:
        return min(found.get_storage_size(), size)
    except Exception:
        if not growing:
            raise
        return size  # the index of chunks is not all there


def _require_own(found: Any, size: int, stored: int) -> None:
    """Refuses data outside the file, or of a wrong size. **Raises:** `Refused`."""
    plist = found.get_create_plist()
    layout = plist.get_layout()
    if layout == h5py.h5d.VIRTUAL:
        raise Refused("a virtual dataset")
    if plist.get_external_count():
        raise Refused("data in another file")
    filters = [plist.get_filter(k)[0] for k in range(plist.get_nfilters())]
    for number in filters:
        if number in _PLUGGED and not _PLUGIN:
            raise Refused(f"filter {number} without hdf5plugin: tomojax[filters]")
        if number not in _FILTERS + _PLUGGED:
            raise Refused(f"data packed by filter {number}")
    item = found.get_type().get_size()
    shape = found.shape
    declared = math.prod(shape) * item
    if layout == h5py.h5d.CHUNKED:
        chunk = math.prod(plist.get_chunk()) * item
        if chunk > _CHUNK:
            raise Refused(f"chunks of {chunk} bytes")
    if layout == h5py.h5d.CONTIGUOUS:
        place = found.get_offset()
        if place is not None and place + declared > size:
            raise Refused(f"{declared} bytes, beyond the file's end")
    if declared > _SLACK + _RATIO * stored:
        raise Refused(f"shape {shape} in {stored} bytes")


def _numbers(dataset: Any) -> dict[str, Any]:
    kind = dataset.dtype
    most = _TEXT if kind.kind == "S" else 8
    if kind.kind not in "biufS" or not 0 < kind.itemsize <= most:
        raise Refused(f"type {kind}")
    if dataset.shape is None:
        raise Refused("no data")
    return {"shape": list(dataset.shape), "dtype": kind.str}


def _attributes(item: Any) -> dict[str, Any]:
    return {name: told_by(partial(_attribute, item, name)) for name in item.attrs}


def _attribute(item: Any, name: str) -> dict[str, Any]:
    number = h5py.h5a.open(item.id, name.encode("utf-8", "surrogateescape"))
    values = math.prod(number.shape or ())
    if number.get_storage_size() > _ATTRIBUTE or values > _VALUES:
        raise Refused("too many values")
    return encode(item.attrs[name])


def encode(value: Any) -> dict[str, Any]:
    """Encodes a value for JSON; `decode` restores the value."""
    if isinstance(value, str):
        return {"text": value}
    if isinstance(value, bytes):
        return {"bytes": value.decode("latin-1")}
    if isinstance(value, bool | int | float):
        value = np.asarray(value)[()]
    if not isinstance(value, np.ndarray | np.generic):
        raise Refused(f"type {type(value).__name__}")
    array = np.asarray(value)
    if array.dtype.kind == "O" and all(isinstance(one, str) for one in array.flat):
        return {"texts": array.tolist()}
    if array.dtype.kind == "S":
        texts = [one.decode("latin-1") for one in array.ravel()]
        return {"bytes": texts, "shape": list(array.shape), "dtype": array.dtype.str}
    if array.dtype.kind not in "biuf" or array.dtype.itemsize > 8:
        raise Refused(f"type {array.dtype}")
    told = {"shape": list(array.shape), "dtype": array.dtype.str}
    return {"numbers": array.ravel().tolist(), **told}


def _line(error: Exception) -> str:
    text = str(error).strip("'\"") or type(error).__name__
    return " ".join(text.split())[:160]
