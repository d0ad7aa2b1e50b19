"""Fills the structure that the loop in C works on, and reads it again."""

import ctypes
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tomojax.hardware.loop._ring import LONGEST, SlotRing
from tomojax.hardware.sources import Handed, SlotSource

# Bytes that may wait: those of a thousand slots of 64 electrodes.
_ROOM = 1 << 18

_FIRMWARE = Path(__file__).parents[2] / "firmware"

_POINTER, _INT, _LONG = ctypes.c_void_p, ctypes.c_int32, ctypes.c_int64
_FLOAT, _DOUBLE = ctypes.c_float, ctypes.c_double
_IN_A_ROW = (
    "number", "lost", "time", "latency", "ground", "next", "flags", "count", "xy",
    "conductance", "codes",
)  # fmt: skip

# Fields of `Handed` that C goes on with, and that the source takes back.
_OF_A_WIRE = ("descriptor", "serial", "trusted", "next", "number", "last", "origin", "base")


class _At(ctypes.Structure):
    _fields_ = [(name, _INT) for name in _IN_A_ROW]


def _fields(kind: Any, names: str) -> list[tuple[str, Any]]:
    return [(name, kind) for name in names.split()]


class Loop(ctypes.Structure):
    """The loop's memory, with the names and the order of loop.c."""

    _fields_ = [
        *_fields(_POINTER, "step tables numbers said whole said_whole rows"),
        *_fields(_LONG, "length row_bytes"),
        *_fields(_POINTER, "written latencies"),
        ("longest", _LONG),
        ("trim", _POINTER),
        ("at", _At),
        *_fields(_INT, "electrodes conditions contacts serial descriptor trusted"),
        *_fields(_POINTER, "channels electrode_of line_of"),
        *_fields(_FLOAT, "scale offset"),
        *_fields(_DOUBLE, "period hurry usual"),
        ("bytes", _POINTER),
        *_fields(_LONG, "room first end"),
        ("arrived", _DOUBLE),
        ("next", ctypes.c_uint32),
        *_fields(_LONG, "number last origin slots lost"),
        ("base", _DOUBLE),
        *_fields(_LONG, "missed skipped"),
        *_fields(_INT, "asked unheeded again ground"),
    ]


class LoopInC:
    """A wire, a step and a ring in the hands of C; `run` works on slots for a while."""

    def __init__(self, library: ctypes.CDLL, step: Any, ring: SlotRing, **told: float):
        self._run, self._ring = library.tomojax_loop, ring
        self._run.argtypes = [ctypes.POINTER(Loop), _DOUBLE]
        c, first = step.in_c, step.state
        self._state = np.array(first.numbers), np.array(first.whole)
        self._said = np.zeros(c.said[0], c.dtype), np.zeros(c.said[1], np.int32)
        self._bytes = np.zeros(_ROOM, np.uint8)
        self._maps: list[np.ndarray] = []  # alive while C reads them
        kind = ring.rows.dtype
        self.loop = Loop(
            step=c.function,
            tables=c.tables,
            numbers=_address(self._state[0]),
            whole=_address(self._state[1]),
            said=_address(self._said[0]),
            said_whole=_address(self._said[1]),
            rows=_address(ring.rows),
            length=ring.length,
            row_bytes=kind.itemsize,
            written=_address(ring.head["rows"]),
            latencies=_address(ring.head["latency"]),
            longest=LONGEST,
            trim=_address(ring.trim),
            at=_At(*((kind.fields or {})[name][1] for name in _IN_A_ROW)),
            electrodes=ring.electrodes,
            contacts=ring.contacts,
            bytes=_address(self._bytes),
            room=_ROOM,
            asked=-1,
            **told,
        )
        self._handed: Handed | None = None

    def take_over(self, source: SlotSource, state: Any, **where: int) -> bool:
        """Takes the wire and the step's state; returns whether C has them.

        `where`: what `where` gives, by name.
        """
        if self._handed is not None:
            return True
        handed = source.hand_over()
        if handed is None:
            return False
        loop, self._handed = self.loop, handed
        self._maps = [np.ascontiguousarray(a, np.int32) for a in handed.maps]
        loop.channels, loop.electrode_of, loop.line_of = map(_address, self._maps)
        loop.conditions = len(self._maps[1])
        loop.scale, loop.offset = source.scale, source.offset
        for name in _OF_A_WIRE:
            setattr(loop, name, getattr(handed, name))
        for name, value in where.items():
            setattr(loop, name, value)
        loop.first, loop.end = 0, len(handed.rest)
        self._bytes[: loop.end] = np.frombuffer(handed.rest, np.uint8)
        for mine, given in zip(self._state, state):
            mine[...] = given
        return True

    def run(self, source: SlotSource, until: float) -> bool:
        """Works on slots until then, s; returns whether all that came was ordinary."""
        loop = self.loop
        done = self._run(ctypes.byref(loop), until) == 0
        source.counters.slots += loop.slots
        source.counters.lost += loop.lost
        loop.slots = loop.lost = 0
        return done

    @property
    def where(self) -> tuple[int, int, int, int]:
        """Slots missed and skipped, the ground that was asked for, slots with another."""
        loop = self.loop
        return loop.missed, loop.skipped, loop.asked, loop.unheeded

    @property
    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """The step's state after the last slot, in arrays of its own."""
        return self._state[0].copy(), self._state[1].copy()

    def give_back(self, source: SlotSource) -> None:
        """Gives the wire back to its source, with what was not worked on."""
        if self._handed is None:
            return
        loop, handed, self._handed = self.loop, self._handed, None
        rest = self._bytes[loop.first : loop.end].tobytes()
        told = {name: getattr(loop, name) for name in _OF_A_WIRE}
        source.take_back(
            replace(handed, **told, rest=rest), loop.arrived, loop.ground, loop.asked
        )


def loop_in_c(
    source: SlotSource, step: Any, ring: SlotRing, period: float, hurry: float, again: int
) -> LoopInC | None:
    """Compiles the loop for a step that runs as C; None where Python has to do it."""
    # The clock of `time.perf_counter` is the one that C asks on Linux alone.
    if step is None or step.in_c is None or not sys.platform.startswith("linux"):
        return None
    if type(source).hand_over is SlotSource.hand_over:
        return None
    from tomojax.native import compile_c

    real = {"float32": "float", "float64": "double"}[str(step.in_c.dtype)]
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "loop.so"
        try:
            here = Path(__file__).with_name("loop.c")
            compile_c(here, target, f"-DREAL={real}", f"-I{_FIRMWARE}", "-march=native")
            library = ctypes.CDLL(str(target))
        except (ValueError, OSError):
            return None
    return LoopInC(library, step, ring, period=period, hurry=hurry, again=again)


def _address(array: Any) -> int:
    return array.__array_interface__["data"][0]
