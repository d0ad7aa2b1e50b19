"""Writes C: loops over values, and the memory that they share."""

import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from tomojax.native._places import c_type, Index, Lazy, literal, Place, row_major, View
from tomojax.native._program import Body, Op, Value
from tomojax.native._tables import Tables

# Elements of a table that is worth storing in half as many bits.
_LARGE = 1 << 16

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
