"""Says where a value's elements are, and writes types, numbers and indices in C."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

C_TYPES = {
    "float32": "float",
    "float64": "double",
    "int32": "int32_t",
    "int64": "int64_t",
    "uint32": "uint32_t",
    "uint8": "uint8_t",
    "int8": "int8_t",
    # As wide as most numbers: GCC 12.2 gets some loops wrong that mix widths.
    "bool": "int32_t",
}

Index = Sequence[str | int]


def c_type(dtype: np.dtype) -> str:
    """Names C's type. **Raises:** `ValueError` for a type that no step has.

    **Example:**

    >>> import numpy as np
    >>> from tomojax.native import c_type
    >>> c_type(np.dtype(np.float32)), c_type(np.dtype(bool))
    ('float', 'int32_t')
    """
    if dtype.name not in C_TYPES:
        raise ValueError(f"dtype: got {dtype}, expected one of {', '.join(C_TYPES)}")
    return C_TYPES[dtype.name]


def literal(value: Any, dtype: np.dtype) -> str:
    """Writes a number in C, to the last bit."""
    if dtype.kind != "f":
        whole = int(value)
        least = {-(2**31): "INT32_MIN", -(2**63): "INT64_MIN"}
        return least.get(whole, f"({whole})")
    number, suffix = float(value), "f" if dtype.itemsize == 4 else ""
    if math.isnan(number):
        return "NAN"
    if math.isinf(number):
        return "INFINITY" if number > 0 else "(-INFINITY)"
    if number == int(number) and abs(number) < 1e6:
        text = f"{number:.1f}{suffix}"
    else:
        text = f"{number.hex()}{suffix}"
    return f"({text})" if number < 0 else text


def linear(offset: str | int, index: Index, strides: Sequence[int]) -> str:
    """Writes offset + Σ index · stride."""
    whole, parts = 0, []
    for at, stride in [(offset, 1), *zip(index, strides, strict=True)]:
        if stride == 0 or at in (0, "0"):
            continue
        if isinstance(at, int):
            whole += at * stride
        else:
            parts.append(at if stride == 1 else f"({at})*{stride}")
    if whole or not parts:
        parts.append(str(whole))
    return " + ".join(parts)


def row_major(shape: Sequence[int]) -> tuple[int, ...]:
    """Returns the strides of an array without gaps."""
    strides = itertools.accumulate(reversed(shape[1:]), lambda a, b: a * b, initial=1)
    return tuple(strides)[::-1] if shape else ()


@dataclass(frozen=True)
class View:
    """Elements of a buffer."""

    buffer: str
    offset: str | int
    strides: tuple[int, ...]
    shape: tuple[int, ...]

    def at(self, index: Index) -> str:
        return f"{self.buffer}[{linear(self.offset, index, self.strides)}]"

    @property
    def whole(self) -> bool:
        """Whether the elements lie one after the other."""
        full = row_major(self.shape)
        return all(
            a == b or n == 1 for a, b, n in zip(self.strides, full, self.shape, strict=True)
        )


@dataclass(frozen=True)
class Lazy:
    """A value that is worked out where it is read."""

    shape: tuple[int, ...]
    read: Callable[[Index], str]

    def at(self, index: Index) -> str:
        return self.read(index)


Place = View | Lazy
