"""Puts the constants that code reads into tables."""

from typing import Any

import numpy as np

from tomojax.native._program import Value

# Tables begin on lines of a processor's memory.
ALIGNED = 64


class Tables:
    """Constants that the code reads: where each begins does not depend on their values.

    `halved`: large ones that are gathered from are stored in 16 bits, between the lowest
    and the highest value of each column.

    **Example:**

    >>> import numpy as np
    >>> from tomojax.native import Tables
    >>> tables = Tables()
    >>> tables.add(np.zeros(3, np.float32)), tables.add(np.ones(5)), tables.size
    (0, 64, 128)
    """

    def __init__(self, halved: bool = False) -> None:
        self.halved = halved
        self._arrays: list[tuple[int, np.ndarray]] = []
        self._offsets: dict[Any, int] = {}
        self._halves: dict[Any, Any] = {}
        self._held: list[Any] = []  # else another array could get the name of one that went
        self.size = 0

    def offset(self, value: Value) -> int:
        """Returns where a constant begins, bytes; the same array is there once."""
        array = np.ascontiguousarray(value.known)
        if array.dtype == np.bool_:
            array = array.astype(np.int32)
        alike = array.dtype.str, array.shape, array.tobytes()
        origin = array if value.origin is None else value.origin
        key = alike if value.told else id(origin)
        if key not in self._offsets:
            self._held.append(origin)
            self._offsets[key] = self.size
            self._arrays.append((self.size, array))
            self.size += -(-array.nbytes // ALIGNED) * ALIGNED
        return self._offsets[key]

    def half(self, value: Value) -> tuple[int, int, int]:
        """Returns where 16-bit codes begin, columns' lowest values and steps."""
        array = np.asarray(value.known)
        key = "half", id(array if value.origin is None else value.origin)
        if key not in self._halves:
            flat = array.reshape(-1, array.shape[-1]).astype(np.float64)
            low = flat.min(0)
            step = (flat.max(0) - low) / (2**16 - 1)
            codes = np.rint((array - low) / np.where(step > 0, step, 1)).astype(np.uint16)
            parts = codes, low.astype(array.dtype), step.astype(array.dtype)
            self._halves[key] = tuple(self.add(part) for part in parts)
        return self._halves[key]

    def add(self, array: np.ndarray) -> int:
        """Returns where an array of one's own begins, bytes."""
        return self.offset(Value(array.shape, array.dtype, array, array))

    def packed(self) -> bytes:
        """Returns all tables, each on a line of memory of its own."""
        whole = bytearray(self.size)
        for start, array in self._arrays:
            whole[start : start + array.nbytes] = array.tobytes()
        return bytes(whole)
