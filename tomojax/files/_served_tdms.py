"""Reads a TDMS file: the file's properties and its channels' numbers.

This file runs in the reader's process, see `reader`. A channel's name is "group/channel".
"""

from pathlib import Path
from typing import Any

import numpy as np

from tomojax.files._served import encode, Refused


class Tdms:
    """A file's properties and channels in the form of `Hdf5`'s attributes and datasets."""

    def __init__(self, path: str, options: dict[str, Any]):
        from nptdms import TdmsFile

        size = Path(path).stat().st_size
        self._file = TdmsFile.open(path)
        self.attributes = {}
        for name, value in self._file.properties.items():
            try:
                self.attributes[name] = encode(value)
            except Refused as error:
                self.attributes[name] = {"refused": str(error)}
        self._channels, self.members = {}, {}
        for group in self._file.groups():
            for channel in group.channels():
                name = f"{group.name}/{channel.name}"
                kind = np.dtype(channel.dtype)
                if kind.kind not in "biuf" or kind.itemsize > 8:
                    self.members[name] = {"refused": f"type {kind}"}
                    continue
                length = len(channel)
                if length * _stored(channel, kind) > size:
                    told = f"{length} values in {size} bytes"
                    self.members[name] = {"refused": told}
                    continue
                self._channels[name] = channel
                self.members[name] = {"shape": [length], "dtype": kind.str}

    def about(self) -> dict[str, Any]:
        """Returns all that is known before a row is read."""
        told = {"attributes": self.attributes, "members": self.members}
        return told | {"growing": False}

    def read(self, name: str, start: int, stop: int, axis: int) -> np.ndarray:
        """Reads a stretch of a channel."""
        return np.asarray(self._channels[name].read_data(start, stop - start))


def _stored(channel: Any, kind: np.dtype) -> int:
    """Returns a value's bytes in the file, fewer than when read for scaled values."""
    raw = getattr(channel.data_type, "size", None)
    return int(raw) if raw else 1 if kind.itemsize else 0
