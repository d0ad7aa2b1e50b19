"""Writes C: where values are, loops over them, and the memory that they share."""

import itertools
import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from tomojax.native._program import Body, Op, Value

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

# Elements of a table that is worth storing in half as many bits.
_LARGE = 1 << 16

# Tables begin on lines of a processor's memory.
ALIGNED = 64

# Operations that read each element of what they are given once: it need not be stored.
READ_ONCE = {
    "reshape",
    "squeeze",
    "transpose",
    "expand_dims",
    "slice",
    "concatenate",
    "pad",
}


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


class Writer:
    """The text of one function."""

    def __init__(self, tables: Tables) -> None:
        self.lines: list[tuple[int, str]] = []
        self.places: dict[int, Place] = {}
        self.buffers: dict[str, tuple[str, int]] = {}
        self.tables = tables
        self._names = itertools.count()
        self._unit = 0
        self._loops: list[tuple[int, int]] = []
        self._begun: dict[str, int] = {}  # buffers in use before they are written
        self._uses: dict[int, int] = {}
        self._reader: dict[int, Op] = {}
        self._other: set[int] = set()  # values that are read otherwise than by `gather`

    # What reads what.

    def count(self, body: Body, again: bool = False) -> None:
        """Counts how often each value is read; what a loop reads is read often."""
        own = {id(v) for v in body.inputs}

        def note(value: Value, op: Op | None, often: bool) -> None:
            self._uses[id(value)] = self._uses.get(id(value), 0) + (2 if often else 1)
            if op is not None:
                self._reader[id(value)] = op
            if op is None or op.name != "gather":
                self._other.add(id(value))

        for op in body.ops:
            for value in op.inputs:
                note(value, op, again and id(value) not in own)
            for inner in op.bodies:
                self.count(inner, again=op.name in ("scan", "while"))
            own |= {id(v) for v in op.outputs}
        for value in body.outputs:
            note(value, None, again and id(value) not in own)

    def once(self, value: Value) -> bool:
        """Whether a value is read once, element by element: it need not be stored."""
        op = self._reader.get(id(value))
        if op is None or self._uses.get(id(value), 0) != 1:
            return False
        if op.name in ELEMENTWISE:
            return all(v.size == 1 or v.shape == value.shape for v in op.inputs)
        if op.name == "broadcast_in_dim":
            return op.outputs[0].size == value.size
        return op.name in READ_ONCE or op.name.startswith("reduce_")

    def half(self, value: Value) -> tuple[View, str, str] | None:
        """Returns codes of a large constant, lowest values and steps of its last axis."""
        large = value.known is not None and value.size >= _LARGE and not value.told
        fits = large and value.dtype.kind == "f" and len(value.shape) > 1
        if not (self.tables.halved and fits) or id(value) in self._other:
            return None
        codes, low, step = self.tables.half(value)
        kind = c_type(value.dtype)
        view = View(
            f"((const uint16_t *)(T + {codes}))", 0, row_major(value.shape), value.shape
        )
        return view, f"((const {kind} *)(T + {low}))", f"((const {kind} *)(T + {step}))"

    # Names and lines.

    def name(self, kind: str) -> str:
        return f"{kind}{next(self._names)}"

    def line(self, text: str) -> None:
        self.lines.append((self._unit, text))

    def buffer(self, dtype: np.dtype, size: int) -> str:
        name = self.name("b")
        self.buffers[name] = c_type(dtype), max(1, size)
        return name

    @contextmanager
    def block(self, head: str) -> Iterator[None]:
        self.line(f"{head} {{")
        yield
        self.line("}")

    @contextmanager
    def loops(self, shape: Sequence[int], simd: str = "") -> Iterator[list[str | int]]:
        """Opens a loop for each axis that is longer than 1; `simd` marks the innermost."""
        index: list[str | int] = []
        long = [axis for axis, n in enumerate(shape) if n != 1]
        for axis, n in enumerate(shape):
            if n == 1:
                index.append(0)
                continue
            at = self.name("i")
            if simd and axis == long[-1] and n >= 4:
                self.line(f"#pragma omp simd {simd}")
            self.line(f"for (int {at} = 0; {at} < {n}; {at}++) {{")
            index.append(at)
        yield index
        if long:
            self.line("}" * len(long))

    @contextmanager
    def repeated(self, head: str) -> Iterator[None]:
        """Opens a loop around operations: what it reads lives until its end."""
        start = self._unit
        with self.block(head):
            yield
        self._unit += 1
        self._loops.append((start, self._unit))

    def begin(self, view: View) -> None:
        """Takes a buffer into use: each turn of a loop writes a part, and none the rest."""
        self._begun[view.buffer] = self._unit

    # Values.

    def place(self, value: Value) -> Place:
        found = self.places.get(id(value))
        if found is None:
            if value.known is None:
                raise AssertionError("a value is read before it is made")
            found = self.places[id(value)] = self._known(value)
        return found

    def at(self, value: Value, index: Index) -> str:
        return self.place(value).at(index)

    def number(self, value: Value) -> str:
        """Gives the one element of a value."""
        return self.place(value).at((0,) * len(value.shape))

    def stored(self, value: Value) -> View:
        """Returns a value's elements in memory; stores them where they are not."""
        place = self.place(value)
        if isinstance(place, Lazy):
            place = self.store(value, place)
            self.places[id(value)] = place
        return place

    def store(self, value: Value, place: Place, whole: bool = False) -> View:
        """Copies elements into a buffer of their own."""
        view = self.target(value)
        with self.loops(value.shape) as index:
            self.line(f"{view.at(index)} = {place.at(index)};")
        return view

    def contiguous(self, value: Value) -> View:
        """Returns a value's elements one after the other."""
        view = self.stored(value)
        return view if view.whole else self.store(value, view)

    def target(self, value: Value) -> View:
        """Returns a new buffer for a value."""
        name = self.buffer(value.dtype, value.size)
        return View(name, 0, row_major(value.shape), value.shape)

    def set(self, value: Value, read: Callable[[Index], str]) -> None:
        """Gives a value by its elements: one number now, an array where it has to be."""
        if value.size == 1:
            name = self.name("s")
            text = read((0,) * len(value.shape))
            self.line(f"const {c_type(value.dtype)} {name} = {text};")
            self.places[id(value)] = Lazy(value.shape, lambda _: name)
        elif self.once(value):
            self.places[id(value)] = Lazy(value.shape, read)
        else:
            self.places[id(value)] = self.store(value, Lazy(value.shape, read))

    def _known(self, value: Value) -> Place:
        if value.told and value.size == 1 and value.known is not None:
            text = literal(value.known.ravel()[0], value.dtype)
            return Lazy(value.shape, lambda _: text)
        kind, offset = c_type(value.dtype), self.tables.offset(value)
        name = f"((const {kind} *)(T + {offset}))"
        return View(name, 0, row_major(value.shape), value.shape)

    # Bodies.

    def body(self, body: Body, emit: Callable[["Writer", Op], None]) -> None:
        for op in body.ops:
            self._unit += 1
            emit(self, op)
        self._unit += 1

    def text(self) -> str:
        """Returns the lines, with buffers that are never in use together as one."""
        first, last = dict(self._begun), {}
        for unit, text in self.lines:
            for name in re.findall(r"\bb\d+\b", text):
                first.setdefault(name, unit)
                last[name] = unit
        for start, end in self._loops:  # inner ones first
            for name, begun in first.items():
                if begun <= start and start < last[name] <= end:
                    last[name] = end
        made: list[tuple[str, int]] = []  # types and sizes of arrays
        until: list[int] = []  # and the unit in which each was read last
        shared: dict[str, str] = {}
        for name in sorted(first, key=lambda n: first[n]):
            kind, size = self.buffers[name]
            # The smallest array that is free and large enough.
            spare = [
                (n, i) for i, (k, n) in enumerate(made)
                if k == kind and n >= size and until[i] < first[name]
            ]  # fmt: skip
            if spare:
                at = min(spare)[1]
            else:
                at = len(made)
                made.append((kind, size))
                until.append(0)
            shared[name], until[at] = f"m{at}", last[name]
        declared = [f"{k} m{i}[{n}] TJ_ALIGNED;" for i, (k, n) in enumerate(made)]
        swap = lambda found: shared[found.group()]  # noqa: E731
        lines = [re.sub(r"\bb\d+\b", swap, text) for _, text in self.lines]
        return "\n".join(declared + lines)


# Filled by the rooms of operations.
ELEMENTWISE: dict[str, Callable] = {}
