"""Reads a TDMS file: the file's properties and its channels' numbers.

This file runs in the reader's process, see `reader`. A channel's name is "group/channel".
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tomojax.files._served import encode, Refused, Served, told_by


class Tdms(Served):
    """A file's properties and channels in the form of `Hdf5`'s attributes and datasets."""

    def __init__(self, path: str):
        from nptdms import TdmsFile

        size = Path(path).stat().st_size
        self._file = TdmsFile.open(path)
        properties = self._file.properties.items()
        self.attributes = {n: told_by(partial(encode, value)) for n, value in properties}
        self._channels = {
            f"{group.name}/{channel.name}": channel
            for group in self._file.groups()
            for channel in group.channels()
        }
        self.members = {
            name: told_by(partial(_member, channel, size))
            for name, channel in self._channels.items()
        }

    def read(self, name: str, start: int, stop: int, axis: int) -> np.ndarray:
        return np.asarray(self._channels[name].read_data(start, stop - start))


def _member(channel: Any, size: int) -> dict[str, Any]:
    kind, length = np.dtype(channel.dtype), len(channel)
    if kind.kind not in "biuf" or kind.itemsize > 8:
        raise Refused(f"type {kind}")
    if length * _stored(channel, kind) > size:
        raise Refused(f"{length} values in {size} bytes")
    return {"shape": [length], "dtype": kind.str}


def _stored(channel: Any, kind: np.dtype) -> int:
    """Returns a value's bytes in the file, fewer than when read for scaled values."""
    raw = getattr(channel.data_type, "size", None)
    return int(raw) if raw else 1 if kind.itemsize else 0
