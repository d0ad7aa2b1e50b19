"""Runs slots: by a program of JAX, or by the C that was written of it."""

import ctypes
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from tomojax._require import require
from tomojax.step._packing import Packed, Packing
from tomojax.step._state import About, silent
from tomojax.step._traced import Traced
from tomojax.step.c._code import check_tables

# Slots of a compiled call of `replay`: a tenth of a second of work, 1 MB.
_BLOCK = 4096


class InC(NamedTuple):
    """A step's function for callers in C: `tomojax_step_arrays` of step.c."""

    function: int  # its address
    tables: int  # its first argument
    said: tuple[int, int]  # how many numbers and whole numbers it says of a slot
    dtype: np.dtype


class AbstractRuns(ABC):
    """Runs slots from packed states to packed states and results."""

    first: Packed  # before any slot
    native: bool
    in_c: "InC | None" = None

    @property
    @abstractmethod
    def traces(self) -> int:
        """How often Python has traced the step."""

    @abstractmethod
    def given(self, state: Packed) -> Packed:
        """Returns NumPy's arrays as a state, of the kind that slots give."""

    @abstractmethod
    def slot(self, state: Packed, volts: np.ndarray, slot: np.ndarray) -> tuple:
        """Runs one slot: the state after it, and its results, packed, in NumPy's arrays."""

    @abstractmethod
    def slots(self, state: Packed, volts: np.ndarray, slots: np.ndarray) -> tuple:
        """Runs slots one after the other: the last state, and all results."""

    @abstractmethod
    def image(self, state: Packed) -> Any:
        """Draws the image after a slot."""


class JaxRuns(AbstractRuns):
    """Runs slots by programs of JAX."""

    native = False

    def __init__(self, traced: Traced):
        self._traced, self.first = traced, traced.state
        self._step = traced.compiled

    @property
    def traces(self) -> int:
        return self._traced.traces

    def given(self, state: Packed) -> Packed:
        return Packed(jnp.asarray(state.numbers), jnp.asarray(state.whole))

    def slot(self, state: Packed, volts: np.ndarray, slot: np.ndarray) -> tuple:
        after, said = self._step(state, volts, slot)
        return after, (np.asarray(said.numbers), np.asarray(said.whole))

    def slots(self, state: Packed, volts: np.ndarray, slots: np.ndarray) -> tuple:
        # Blocks of one size, the last filled up: one program serves any number of slots.
        parts = []
        for start in range(0, max(1, len(volts)), _BLOCK):
            some = volts[start : start + _BLOCK], slots[start : start + _BLOCK]
            count = len(some[0])
            some = [np.resize(a, (_BLOCK, *a.shape[1:])) for a in some]
            state, said = self._traced.replayed(state, *some, np.int32(count))
            parts.append([np.asarray(a)[:count] for a in said])
        numbers, whole = map(np.concatenate, zip(*parts))
        return state, (numbers, whole)

    def image(self, state: Packed) -> Any:
        return self._traced.drawn(state)


class NativeRuns(AbstractRuns):
    """Runs slots by a compiled library; a call takes three microseconds beside its slot."""

    native = True

    def __init__(self, about: About, library: Path, tables: Path, name: str, traces: int):
        dtype = np.dtype(about.dtype)
        # The system reads what is used, once for all processes; a page begins on a line.
        self._tables = np.memmap(tables, np.uint8, "r")
        check_tables(self._tables, name)
        self._data = self._tables.ctypes.data + 64
        loaded = ctypes.CDLL(str(library))
        pointer, whole = ctypes.c_void_p, ctypes.c_int64
        self._run, self._draw = loaded.tomojax_step_arrays, loaded.tomojax_image_arrays
        self._run.argtypes = [pointer] * 5 + [whole] + [pointer] * 4
        self._draw.argtypes = [pointer] * 4
        self._run.restype = self._draw.restype = None
        self._traces, self._dtype, self._shape = traces, dtype, about.image
        sizes = (ctypes.c_int64 * 2)()
        loaded.tomojax_state_sizes(sizes)
        self._sizes = tuple(sizes)
        said = Packing(silent(about.contact_count, dtype), dtype).sizes
        self._said = said
        address = ctypes.cast(self._run, pointer).value or 0
        self.in_c = InC(address, self._data, said, dtype)
        self._kinds = dtype, np.dtype(np.int32)
        first = Packed(*(np.zeros(n, t) for n, t in zip(self._sizes, self._kinds)))
        loaded.tomojax_first_arrays.argtypes = [pointer] * 3
        loaded.tomojax_first_arrays(self._data, *map(_memory, first))
        self.first = first

    @property
    def traces(self) -> int:
        return self._traces

    def given(self, state: Packed) -> Packed:
        return state

    def slot(self, state: Packed, volts: np.ndarray, slot: np.ndarray) -> tuple:
        after, said = self._ran(state, volts, slot, 1)
        return after, (said[0][0], said[1][0])

    def slots(self, state: Packed, volts: np.ndarray, slots: np.ndarray) -> tuple:
        return self._ran(state, volts, slots, len(volts))

    def _ran(self, state: Packed, volts: np.ndarray, slots: np.ndarray, n: int) -> tuple:
        before = self._checked(state)
        real, whole = self._kinds
        sizes, said = self._sizes, self._said
        said = np.empty((n, said[0]), real), np.empty((n, said[1]), whole)
        if n == 0:
            return before, said
        after = Packed(np.empty(sizes[0], real), np.empty(sizes[1], whole))
        volts = np.ascontiguousarray(volts)
        given = map(_memory, (*before, volts, slots))
        self._run(self._data, *given, n, *map(_memory, (*after, *said)))
        return after, said

    def image(self, state: Packed) -> Any:
        image = np.empty(self._shape, self._dtype)
        self._draw(self._data, *map(_memory, (*self._checked(state), image)))
        return image

    def _checked(self, state: Packed) -> Packed:
        """Returns a state in memory of its size and type: C would read beyond another."""
        arrays = []
        for array, size, kind in zip(state, self._sizes, self._kinds):
            array = np.ascontiguousarray(array)
            if array.shape != (size,) or array.dtype != kind:
                got = f"{array.dtype} {array.shape}"
                require(
                    False, "state", got, f"{kind} ({size},), as this step's first state"
                )
            arrays.append(array)
        return Packed(*arrays)


# Made of an array, it passes C the address of the array's memory.
_NoBytes = ctypes.c_char * 0


def _memory(array: Any) -> Any:
    """Returns an array's memory as an argument of C."""
    if array.flags.writeable:  # four times as quick
        return _NoBytes.from_buffer(array)
    return array.__array_interface__["data"][0]
