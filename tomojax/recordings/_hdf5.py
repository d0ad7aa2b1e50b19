"""Reads recording version 1 from HDF5, or from the variables of a MATLAB v7.3 file."""

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.files import open_container, OpenContainer
from tomojax.recordings._clock import mended_gaps, mended_times
from tomojax.recordings._recording import (
    check,
    Recording,
    Rig,
    Scans,
    SCHEMA,
    VERSION,
)

_NUMBERS = (
    "f_switch",
    "scale",
    "offset",
    "drive_voltage",
    "ground_resistance",
    "sheet_resistance",
    "electrode_diameter",
)

_MEND = "copy it again from where it was recorded"

# What no rig has.
_MOST_ELECTRODES, _MOST_SLOTS = 4096, 1 << 16


class Hdf5Recording(Recording):
    """A file of the form "Recording, version 1".

    A writer may still have the file open in HDF5's SWMR mode, or may have crashed. The
    recording then has the whole scans that the file holds when opened. MATLAB's files have
    no attributes, but variables of the same names. Every array of MATLAB has its axes in
    MATLAB's order.
    """

    def __init__(self, path: Path, header: dict[str, Any] | None = None):
        self.path, self._header = path, header or {}
        self._file = _open(path)
        self._growing = self._file.growing
        try:
            self._load()
        except OSError as error:
            self._file.close()
            reason = str(error).strip("'\"")
            raise ValueError(f"file: damaged ({reason}); {_MEND}") from None
        except BaseException:
            self._file.close()
            raise

    def _load(self) -> None:
        named = [n for n in self._file.names if self._file.refused(n) is None]
        matlab = any("MATLAB_class" in self._file.attributes_of(n) for n in named)
        field = _variables(self._file) if matlab else _attributes(self._file)
        field = self._told(field)
        _check_schema(field)
        v, ground = self._shape("v", 3, "iu"), self._shape("ground", 2, "iu")
        t0 = self._shape("t0", 2 if matlab else 1, "fiu")
        self._axes = -1 if matlab else 0
        require(not matlab or 1 in t0, "t0", f"shape {t0}", "one row or column")
        scans, self.slots, self.electrodes = v[::-1] if matlab else v
        counts = self.electrodes <= _MOST_ELECTRODES and self.slots <= _MOST_SLOTS
        most = f"up to {_MOST_SLOTS} slots of {_MOST_ELECTRODES} electrodes"
        require(counts, "v", f"{self.slots} of {self.electrodes}", most)
        lengths = {
            "v": scans,
            "ground": ground[self._axes],
            "t0": max(t0) if matlab else t0[0],
        }
        self.scans = min(lengths.values()) if self._growing else scans
        for name, length in lengths.items():
            fits = length == self.scans or self._growing
            require(fits, name, f"{length} scans", f"{scans}, as v has")
        slots = ground[::-1][1] if matlab else ground[1]
        require(slots == self.slots, "ground", f"{slots} slots", f"{self.slots}, as v has")
        kind = self._file.dtype("v")
        require(kind.itemsize <= 4, "v", kind, "integer codes")
        self._shape("electrode_xy", 2, "f")
        xy = self._file.read_whole("electrode_xy")
        gaps = _NO_GAPS
        if "gaps" in self._file.names:
            self._shape("gaps", 2, "iuf")
            gaps = self._file.read_whole("gaps")
        require(np.isfinite(gaps).all(), "gaps", "NaN or infinite", "whole numbers")
        self.gaps = (gaps.T if matlab and gaps.size else gaps).astype(int)
        if not gaps.size:
            self.gaps = _NO_GAPS
        self._scale, self._offset = _number(field, "scale"), _number(field, "offset")
        require(self._scale != 0, "scale", 0, "V per code")
        units = _text(field, "units")
        require(units == "V", "units", repr(units), "'V': scale·code + offset in volts")
        codes = np.iinfo(kind)
        rails = sorted(
            self._scale * float(c) + self._offset for c in (codes.min, codes.max)
        )
        finite = bool(np.isfinite(rails).all())
        require(finite, "scale", self._scale, "V per code, and readings that are numbers")
        numbers = {n: _number(field, n) for n in _NUMBERS if n not in ("scale", "offset")}
        self.rig = Rig(
            size=(_number(field, "size", 2, 0), _number(field, "size", 2, 1)),
            electrode_xy=xy.T if matlab else xy,
            rails=(rails[0], rails[1]),
            resolution=abs(self._scale),
            notes=_text(field, "notes") if field("notes", "") != "" else "",
            **numbers,
        )
        self._load_times()
        self._load_marks()
        self.gaps, said = mended_gaps(self.gaps, self.scans)
        self.mended += said
        check(self)
        self._believe()

    def _told(self, field: Callable) -> Callable:
        """Returns a reader of fields: the given header's first, then the file's."""
        known = {*_NUMBERS, "size", "notes", "units", "schema", "schema_version"}
        unknown = sorted(self._header.keys() - known)
        require(not unknown, "header", unknown, f"some of {sorted(known)}")

        def told(name: str, *default: Any) -> Any:
            return self._header[name] if name in self._header else field(name, *default)

        return told

    def _believe(self) -> None:
        """Keeps a clock's credible times; makes other times from the scans' numbers."""
        rows = self.rows_after_gaps()
        lost = np.zeros(self.scans + 1, np.int64)
        np.add.at(lost, np.minimum(rows, self.scans), self.gaps[:, 1])
        numbers = np.arange(self.scans) + np.cumsum(lost)[: self.scans]
        usual = self.slots / self.rig.f_switch
        self._t0, self.retimed, said = mended_times(self._t0, numbers, usual)
        self.mended += said

    def _load_times(self) -> None:
        """Reads the start of each scan; counts the whole scans."""
        self._t0 = np.ravel(self._file.read_whole("t0")).astype(float)
        if not self._growing:
            return
        told = self.scans
        some = [self._file.whole_rows(name) for name in ("v", "ground", "t0")]
        self.scans = min([told, *(n for n in some if n is not None)])
        self._t0 = self._t0[: self.scans]
        # Times are written last: a row without one is not whole yet.
        whole = np.flatnonzero(np.isfinite(self._t0))
        last = int(whole[-1]) + 1 if len(whole) else 0
        if self.scans < told:
            cut = f"the file is cut off: {last} of {told} scans can be read"
            self.mended = (*self.mended, cut)
            before = np.cumsum(self.gaps[:, 1]) - self.gaps[:, 1]
            self.gaps = self.gaps[self.gaps[:, 0] - before < last]
        self.scans, self._t0 = last, self._t0[:last]

    def _load_marks(self) -> None:
        """Reads moments that somebody marked; damaged marks are left out."""
        file, names = self._file, ("marks_t", "marks")
        if not all(name in file.names for name in names):
            return
        try:
            self._shape("marks_t", 1, "f")
            self._shape("marks", 1, "S")
            some = file.read_whole("marks_t"), file.read_whole("marks")
        except (OSError, ValueError) as error:
            self.mended = (
                *self.mended,
                f"the marks cannot be read and are left out ({error})",
            )
            return
        self.marks = tuple(
            (float(t), _printable(bytes(text).decode(errors="replace")))
            for t, text in zip(*some)
            if np.isfinite(t)
        )

    def _shape(self, name: str, axes: int, kinds: str) -> tuple[int, ...]:
        here = sorted(self._file.names)[:20]
        require(name in here or name in self._file.names, name, f"only {here}", "it")
        shape, kind = self._file.shape(name), self._file.dtype(name)
        require(len(shape) == axes, name, f"shape {shape}", f"{axes} axes")
        require(kind.kind in kinds, name, f"type {kind}", f"type of kind {kinds}")
        return shape

    @property
    def code_type(self) -> np.dtype:
        return self._file.dtype("v")

    @property
    def codes_to_volts(self) -> tuple[float, float]:
        """Returns `scale` and `offset`, V."""
        return self._scale, self._offset

    def start_times(self) -> np.ndarray:
        return self._t0

    def times(self, start: int, stop: int) -> np.ndarray:
        """Returns the start of scans, s."""
        return self._t0[start:stop]

    def read_codes(self, start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Reads codes (n, S, M) and grounds (n, S) unchanged from the file."""
        try:
            codes = self._file.read("v", start, stop, self._axes)
            ground = self._file.read("ground", start, stop, self._axes)
            if self._axes:
                codes, ground = np.swapaxes(codes, 0, 2), ground.T
        except OSError as error:
            raise ValueError(
                f"{self.path}: v: scans {start} to {stop} cannot be read ({error}); copy"
                " the file again, or cut it before them"
            ) from None
        return codes, ground.astype(int)

    def read(self, start: int, stop: int) -> Scans:
        stop = min(stop, self.scans)
        codes, ground = self.read_codes(start, stop)
        volts = np.multiply(codes, self._scale, dtype=np.float64)
        volts += self._offset
        return Scans(volts.astype(np.float32), ground, self._t0[start:stop])

    @cached_property  # asked for with every chunk
    def interval(self) -> float:  # pyright: ignore (a property of its base)
        """Returns the usual interval, s: a rig may rest between scans."""
        if self.scans < 2:
            return self.slots / self.rig.f_switch
        return float(np.median(np.diff(self._t0)))

    def close(self) -> None:
        self._file.close()


# Of a variable that stands for an attribute, values.
_LONGEST = 1 << 16

_NO_GAPS = np.zeros((0, 2), int)


def _printable(text: str) -> str:
    """Replaces characters that would steer a terminal."""
    return "".join(c if c.isprintable() else "�" for c in text)


def _open(path: Path) -> OpenContainer:
    with path.open("rb") as raw:
        require(_is_hdf5(raw), "file", "no HDF5 file", "a recording in HDF5 or .tdms")
    try:
        return open_container(path)
    except OSError as error:
        reason = str(error)
    except ValueError as error:
        raise ValueError(f"{error}; {_MEND}") from None
    if "truncated" in reason:
        raise ValueError(f"file: cut off ({reason}), expected all of it; {_MEND}")
    raise ValueError(f"file: cannot be opened as HDF5 ({reason}); {_MEND}")


def _is_hdf5(raw: Any) -> bool:
    """Finds HDF5's signature at the start or behind a user's block (MATLAB's has 512 B)."""
    at = 0
    while len(start := raw.read(8)) == 8:
        if start == b"\x89HDF\r\n\x1a\n":
            return True
        at = max(512, 2 * at)
        raw.seek(at)
    return False


def _attributes(file: OpenContainer) -> Callable:
    told = file.attributes

    def field(name: str, *default: Any) -> Any:
        if name not in told:
            why = file.refused(name) or "no such attribute"
            require(default, name, why, "it, as in recording version 1")
            return default[0]
        return told[name]

    return field


def _variables(file: OpenContainer) -> Callable:
    def field(name: str, *default: Any) -> Any:
        if name not in file.names:
            require(default, name, "no such variable", "it, as in recording version 1")
            return default[0]
        shape = file.shape(name)
        require(np.prod(shape) <= _LONGEST, name, f"shape {shape}", "a number or a text")
        value = file.read(name)
        if file.attributes_of(name).get("MATLAB_class") == b"char":
            text = np.ravel(value)
            fine = text.dtype.kind == "u" and not (text > 0x10FFFF).any()
            require(fine, name, f"type {text.dtype}", "a text's codes")
            return "".join(map(chr, text))
        return value

    return field


def _number(field: Callable, name: str, count: int = 1, index: int = 0) -> float:
    """Reads one of a field's `count` numbers."""
    value = field(name)
    try:
        number = np.asarray(value, float).ravel()
    except (TypeError, ValueError):
        number = np.zeros(0)
    fine = number.size == count and np.isfinite(number).all()
    require(fine, name, repr(value), "one number" if count == 1 else f"{count} numbers")
    return float(number[index])


def _text(field: Callable, name: str) -> str:
    value = field(name)
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _check_schema(field: Callable) -> None:
    schema = _text(field, "schema")
    require(schema == SCHEMA, "schema", repr(schema), f"{SCHEMA!r}")
    version = _number(field, "schema_version")
    require(
        version == VERSION,
        "schema_version",
        f"{version:g}",
        f"{VERSION}; a newer tomojax may read it",
    )
