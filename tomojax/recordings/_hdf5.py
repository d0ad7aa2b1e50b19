"""Recording version 1 in HDF5, and the same fields as variables of a MATLAB v7.3 file."""
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportCallIssue=false, reportOptionalMemberAccess=false, reportOperatorIssue=false
# (h5py does not say whether a name is a group or a dataset)

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tomojax._require import require
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


class Hdf5Recording(Recording):
    """A file of the form "Recording, version 1".

    Also one that is still being written in HDF5's SWMR mode, or that a crash left so: the
    scans that are there when it is opened. MATLAB's files have no attributes: there they
    are variables of the same names, and every array has its axes in MATLAB's order.
    """

    def __init__(self, path: Path):
        self.path = path
        self._file, self._growing = _open(path)
        try:
            self._load()
        except (KeyError, RuntimeError, OSError) as error:
            self._file.close()
            reason = str(error).strip("'\"")
            raise ValueError(f"file: damaged ({reason}); {_MEND}") from None
        except BaseException:
            self._file.close()
            raise

    def _load(self) -> None:
        matlab = any("MATLAB_class" in item.attrs for item in self._file.values())
        field = _variables(self._file) if matlab else _attributes(self._file)
        _check_schema(field)
        v, ground = self._dataset("v", 3, "iu"), self._dataset("ground", 2, "iu")
        t0 = self._dataset("t0", 2 if matlab else 1, "fiu")
        self._axes = -1 if matlab else 0
        self._v, self._ground = v, ground
        shape = v.shape[::-1] if matlab else v.shape
        scans, self.slots, self.electrodes = shape
        lengths = {
            "v": scans,
            "ground": ground.shape[self._axes],
            "t0": max(t0.shape) if matlab else t0.shape[0],
        }
        self.scans = min(lengths.values()) if self._growing else scans
        for name, length in lengths.items():
            fits = length == self.scans or self._growing
            require(fits, name, f"{length} scans", f"{scans}, as v has")
        slots = ground.shape[::-1][1] if matlab else ground.shape[1]
        require(slots == self.slots, "ground", f"{slots} slots", f"{self.slots}, as v has")
        require(self._file["v"].dtype.itemsize <= 4, "v", v.dtype, "integer codes")
        xy = self._dataset("electrode_xy", 2, "f")[()]
        gaps = self._dataset("gaps", 2, "iuf")[()] if "gaps" in self._file else _NO_GAPS
        self.gaps = (gaps.T if matlab and gaps.size else gaps).astype(int)
        if not gaps.size:
            self.gaps = _NO_GAPS
        self._scale, self._offset = _number(field, "scale"), _number(field, "offset")
        require(self._scale != 0, "scale", 0, "V per code")
        units = _text(field, "units")
        require(units == "V", "units", repr(units), "'V': scale·code + offset in volts")
        codes = np.iinfo(v.dtype)
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
        self._t0 = np.ravel(t0[()])[: self.scans].astype(float)
        if self._growing:
            # Times are written last: a row without one is not whole yet.
            whole = np.flatnonzero(np.isfinite(self._t0))
            self.scans = int(whole[-1]) + 1 if len(whole) else 0
            self._t0 = self._t0[: self.scans]
        self.gaps, said = mended_gaps(self.gaps, self.scans)
        self.mended += said
        check(self)
        self._believe()

    def _believe(self) -> None:
        """Times of a clock that can be believed, and elsewhere by the scans' numbers."""
        rows = self.rows_after_gaps()
        lost = np.zeros(self.scans + 1, np.int64)
        np.add.at(lost, np.minimum(rows, self.scans), self.gaps[:, 1])
        numbers = np.arange(self.scans) + np.cumsum(lost)[: self.scans]
        usual = self.slots / self.rig.f_switch
        self._t0, self.retimed, said = mended_times(self._t0, numbers, usual)
        self.mended += said

    def _dataset(self, name: str, axes: int, kinds: str) -> h5py.Dataset:
        found = self._file.get(name)
        here = sorted(self._file)
        require(isinstance(found, h5py.Dataset), name, f"only {here}", "this dataset")
        assert isinstance(found, h5py.Dataset)
        shape, kind = found.shape, found.dtype.kind
        require(len(shape) == axes, name, f"shape {shape}", f"{axes} axes")
        require(kind in kinds, name, f"type {found.dtype}", f"type of kind {kinds}")
        return found

    def read(self, start: int, stop: int) -> Scans:
        stop = min(stop, self.scans)
        try:
            if self._axes:
                codes = np.swapaxes(self._v[..., start:stop], 0, 2)
                ground = self._ground[..., start:stop].T
            else:
                codes, ground = self._v[start:stop], self._ground[start:stop]
        except OSError as error:
            raise ValueError(
                f"{self.path}: v: scans {start} to {stop} cannot be read ({error}); copy"
                " the file again, or cut it before them"
            ) from None
        volts = np.multiply(codes, self._scale, dtype=np.float64)
        volts += self._offset
        return Scans(volts.astype(np.float32), ground.astype(int), self._t0[start:stop])

    @cached_property  # asked for with every chunk
    def interval(self) -> float:  # pyright: ignore (a property of its base)
        """The usual one: a rig may rest between scans."""
        if self.scans < 2:
            return self.slots / self.rig.f_switch
        return float(np.median(np.diff(self._t0)))

    def close(self) -> None:
        self._file.close()


_NO_GAPS = np.zeros((0, 2), int)


def _open(path: Path) -> tuple[h5py.File, bool]:
    """The file, and whether a writer has (or had) it open."""
    require(h5py.is_hdf5(path), "file", "no HDF5 file", "a recording in HDF5 or .tdms")
    growing = _written_in_swmr_mode(path)
    try:
        if growing:
            return h5py.File(path, "r", libver="latest", swmr=True), True
        return h5py.File(path, "r"), False
    except OSError as error:
        reason = str(error)
    if "truncated" in reason:
        raise ValueError(f"file: cut off ({reason}), expected all of it; {_MEND}")
    raise ValueError(f"file: cannot be opened as HDF5 ({reason}); {_MEND}")


def _written_in_swmr_mode(path: Path) -> bool:
    """Whether a SWMR writer has the file open, or had it at a crash: so the superblock.

    HDF5 leaves out its check of the file's length in that mode: asked for without need
    it would read a file that is cut off.
    """
    with path.open("rb") as file:
        start = file.read(12)
        whole = len(start) == 12 and start[:4] == b"\x89HDF"
        return whole and start[8] >= 3 and bool(start[11] & 4)


def _attributes(file: h5py.File) -> Callable:
    def field(name: str, *default: Any) -> Any:
        if name not in file.attrs:
            require(default, name, "no such attribute", "it, as in recording version 1")
            return default[0]
        return file.attrs[name]

    return field


def _variables(file: h5py.File) -> Callable:
    def field(name: str, *default: Any) -> Any:
        if name not in file:
            require(default, name, "no such variable", "it, as in recording version 1")
            return default[0]
        data = file[name]
        value = data[()]  # pyright: ignore
        if data.attrs.get("MATLAB_class") == b"char":
            return "".join(map(chr, np.ravel(value)))
        return value

    return field


def _number(field: Callable, name: str, count: int = 1, index: int = 0) -> float:
    """One of `count` numbers."""
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
