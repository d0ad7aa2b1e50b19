"""Reads MATLAB's files before version 7.3 as that version would hold them in HDF5.

This file runs in the reader's process, see `reader`. A variable has its axes from the last
to the first, and an attribute with its class; a text is an array of codes.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tomojax.files._served import encode, Refused, Served, told_by


class Mat(Served):
    """A file's variables in the form of `Hdf5`'s datasets."""

    def __init__(self, path: str):
        from scipy.io import loadmat

        found = loadmat(path)
        self.attributes, self._size = {}, Path(path).stat().st_size
        self._arrays: dict[str, np.ndarray] = {}
        names = [name for name in found if not name.startswith("__")]
        self.members = {n: told_by(partial(self._member, n, found[n])) for n in names}

    def _member(self, name: str, value: Any) -> dict[str, Any]:
        array, kind = np.asarray(value), b"double"
        if array.dtype.kind == "U":
            text = "".join(map(str, array.ravel()))
            array, kind = np.array([list(map(ord, text))], np.uint32), b"char"
        if array.dtype.kind not in "biuf" or array.dtype.itemsize > 8:
            raise Refused(f"type {array.dtype}")
        array = self._arrays[name] = np.ascontiguousarray(array.T)
        told = {"shape": list(array.shape), "dtype": array.dtype.str, "stored": self._size}
        return told | {"attributes": {"MATLAB_class": encode(kind)}}

    def read(self, name: str, start: int, stop: int, axis: int) -> np.ndarray:
        array = self._arrays[name]
        return array[..., start:stop] if axis else array[start:stop]
