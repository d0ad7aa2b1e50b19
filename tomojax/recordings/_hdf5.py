"""Reads recordings, version 1 or 2, from HDF5, or from variables of a MATLAB file."""

from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tomojax._require import require
from tomojax.files import is_mat, open_container, OpenContainer
from tomojax.recordings._described import (
    FIELDS,
    MOST_SLOTS,
    number,
    rails_of,
    size_of,
    volts_of,
    whole_numbers,
)
from tomojax.recordings._outline import Outline
from tomojax.recordings._recording import (
    PAPER,
    Recording,
    Rig,
    Scans,
    SCHEMA,
    settle,
    VERSIONS,
)

_MEND = "copy it again from where it was recorded"

_MOST_ELECTRODES = 4096  # no rig has as many

_SAMPLE = 256  # scans that tell whether numbers with a point are whole: codes

_LONGEST = 1 << 16  # values of a variable that stands for an attribute


class Hdf5Recording(Recording):
    """A file of the form "Recording, version 1".

    A writer may still have the file open in HDF5's SWMR mode, or may have crashed. The
    recording then has the whole scans that the file holds when opened. MATLAB's files have
    no attributes, but variables of the same names. Every array of MATLAB has its axes in
    MATLAB's order.
    """

    def __init__(self, path: Path, header: dict[str, Any] | None = None):
        self.path = path
        self._file = _open(path)
        self._growing = self._file.growing
        try:
            self._load(header or {})
        except OSError as error:
            self._file.close()
            reason = str(error).strip("'\"")
            raise ValueError(f"file: damaged ({reason}); {_MEND}") from None
        except BaseException:
            self._file.close()
            raise

    def _load(self, header: dict[str, Any]) -> None:
        file = self._file
        named = [n for n in file.names if file.refused(n) is None]
        self._matlab = any("MATLAB_class" in file.attributes_of(n) for n in named)
        told = _Fields(file, header, self._matlab)
        _check_schema(told)
        self._load_shape()
        self._shape("electrode_xy", 2, "f")
        xy = file.read_whole("electrode_xy")
        if "gaps" in file.names:
            self._shape("gaps", 2, "iuf")
            gaps = file.read_whole("gaps")
            require(np.isfinite(gaps).all(), "gaps", "NaN or infinite", "whole numbers")
            if gaps.size:
                self.gaps = (gaps.T if self._matlab else gaps).astype(int)
        if self.code_type.kind == "f":  # volts, unless the file tells of codes
            for name, value in {"scale": 1.0, "offset": 0.0, "units": "V"}.items():
                told.setdefault(name, value)
        scale, offset = (number(name, told[name]) for name in ("scale", "offset"))
        self.codes_to_volts = scale, offset
        require(scale != 0, "scale", 0, "V per code")
        units = _text(told["units"])
        require(units == "V", "units", repr(units), "'V': scale·code + offset in volts")
        codes, rails = self._codes(scale), (-np.inf, np.inf)
        if codes is None:
            self.mended += ("v has volts: what saturates below the drive is not seen",)
        else:
            rails = rails_of(codes, scale, offset)
            finite = bool(np.isfinite(rails).all())
            require(finite, "scale", scale, "V per code, and readings that are numbers")
        self.rig = Rig(
            size=size_of(told["size"]),
            electrode_xy=xy.T if self._matlab else xy,
            rails=rails,
            resolution=abs(scale) if codes else 0.0,
            notes=_text(told.get("notes", "")),
            outline=Outline.read(told, self._dataset),
            conditions=self._dataset("conditions/to_ground"),
            **{name: number(name, told[name]) for name in PAPER},
        )
        self._load_times()
        self._load_marks()
        self._load_host_time()
        settle(self)

    def _dataset(self, name: str) -> np.ndarray | None:
        """Reads a table that a file need not have."""
        if name not in self._file.names:
            return None
        found = self._file.read_whole(name)
        return found.T if self._matlab else found

    def _load_shape(self) -> None:
        """Reads how many scans, slots and electrodes the arrays have."""
        self._ground = "condition" if "condition" in self._file.names else "ground"
        v, ground = self._shape("v", 3, "iuf"), self._shape(self._ground, 2, "iuf")
        t0 = self._shape("t0", 2 if self._matlab else 1, "fiu")
        fits = not self._matlab or 1 in t0
        require(fits, "t0", f"shape {t0}", "one row or column")
        if self._matlab:
            v, ground = v[::-1], ground[::-1]
        scans, self.slots, self.electrodes = v
        counts = self.electrodes <= _MOST_ELECTRODES and self.slots <= MOST_SLOTS
        most = f"up to {MOST_SLOTS} slots of {_MOST_ELECTRODES} electrodes"
        require(counts, "v", f"{self.slots} of {self.electrodes}", most)
        lengths = {"v": scans, self._ground: ground[0], "t0": max(t0)}
        self.scans = min(lengths.values()) if self._growing else scans
        for name, length in lengths.items():
            fits = length == self.scans or self._growing
            require(fits, name, f"{length} scans", f"{scans}, as v has")
        fits = ground[1] == self.slots
        require(fits, self._ground, f"{ground[1]} slots", f"{self.slots}, as v has")
        fits = self.code_type.itemsize <= 4 or self.code_type.kind == "f"
        require(fits, "v", self.code_type, "codes of up to 32 bits, or volts")

    def _codes(self, scale: float) -> np.dtype | None:
        """Returns the type of the converter's codes; None of volts.

        MATLAB keeps whole numbers as double: of these, a scale tells that they are codes.
        """
        if self.code_type.kind != "f":
            return self.code_type
        some = self.read_codes(0, min(self.scans, _SAMPLE))[0]
        some = some[np.isfinite(some)]
        whole = (some == np.round(some)) & (some >= -(2**15)) & (some < 2**15)
        return np.dtype(np.int16) if scale != 1 and whole.all() else None

    def _load_times(self) -> None:
        """Reads the start of each scan; counts the whole scans."""
        self.t0 = np.ravel(self._file.read_whole("t0")).astype(float)
        if not self._growing:
            return
        told = self.scans
        some = [self._file.whole_rows(name) for name in ("v", self._ground, "t0")]
        self.scans = min([told, *(n for n in some if n is not None)])
        self.t0 = self.t0[: self.scans]
        # Times are written last: a row without one is not whole yet.
        whole = np.flatnonzero(np.isfinite(self.t0))
        last = int(whole[-1]) + 1 if len(whole) else 0
        if self.scans < told:
            self.mended += (f"the file is cut off: {last} of {told} scans can be read",)
            before = np.cumsum(self.gaps[:, 1]) - self.gaps[:, 1]
            self.gaps = self.gaps[self.gaps[:, 0] - before < last]
        self.scans, self.t0 = last, self.t0[:last]

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
            self.mended += (f"the marks cannot be read and are left out ({error})",)
            return
        self.marks = tuple(
            (float(t), _printable(bytes(text).decode(errors="replace")))
            for t, text in zip(*some)
            if np.isfinite(t)
        )

    def _load_host_time(self) -> None:
        """Reads moments by the rig's clock and the host's; damaged ones are left out."""
        try:
            if "host_time" in self._file.names:
                self._shape("host_time", 2, "f")
            host = self._dataset("host_time")
        except (OSError, ValueError) as error:
            self.mended += (f"host_time cannot be read and is left out ({error})",)
            return
        if host is not None and host.shape[1] == 2:
            # A day before the year 9999 is one that a calendar has.
            sound = np.isfinite(host).all(1) & (abs(host) < 2.5e11).all(1)
            self.host_time = host[sound].astype(float)

    def _shape(self, name: str, axes: int, kinds: str) -> tuple[int, ...]:
        here = sorted(self._file.names)
        require(name in here, name, f"only {here[:20]}", "it")
        shape, kind = self._file.shape(name), self._file.dtype(name)
        require(len(shape) == axes, name, f"shape {shape}", f"{axes} axes")
        require(kind.kind in kinds, name, f"type {kind}", f"type of kind {kinds}")
        return shape

    @property
    def code_type(self) -> np.dtype:
        """Returns the type of the file's codes."""
        return self._file.dtype("v")

    def read_codes(self, start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Reads codes (n, S, M) and grounds (n, S) unchanged from the file."""
        try:
            axis = -1 if self._matlab else 0
            codes = self._file.read("v", start, stop, axis)
            ground = self._file.read(self._ground, start, stop, axis)
            if self._matlab:
                codes, ground = np.swapaxes(codes, 0, 2), ground.T
        except OSError as error:
            raise ValueError(
                f"{self.path}: v: scans {start} to {stop} cannot be read ({error}); copy"
                " the file again, or cut it before them"
            ) from None
        return codes, whole_numbers(ground)

    def read(self, start: int, stop: int) -> Scans:
        stop = min(stop, self.scans)
        codes, ground = self.read_codes(start, stop)
        return Scans(volts_of(codes, *self.codes_to_volts), ground, self.t0[start:stop])

    def close(self) -> None:
        self._file.close()


def _printable(text: str) -> str:
    """Replaces characters that would steer a terminal."""
    return "".join(c if c.isprintable() else "�" for c in text)


def _open(path: Path) -> OpenContainer:
    with path.open("rb") as raw:
        told = is_mat(raw) or is_hdf5(raw)
        require(told, "file", "no HDF5 file", "a recording: HDF5, .csv, .npz …")
    try:
        return open_container(path)
    except OSError as error:
        whole = f"cannot be opened as HDF5 ({error})"
        cut = f"cut off ({error}), expected all of it"
        told = cut if "truncated" in str(error) else whole
        raise ValueError(f"file: {told}; {_MEND}") from None
    except ValueError as error:
        raise ValueError(f"{error}; {_MEND}") from None


def is_hdf5(raw: BinaryIO) -> bool:
    """Finds HDF5's signature at the start or behind a user's block (MATLAB's has 512 B)."""
    at = 0
    while len(start := raw.read(8)) == 8:
        if start == b"\x89HDF\r\n\x1a\n":
            return True
        at = max(512, 2 * at)
        raw.seek(at)
    return False


class _Fields(dict[str, Any]):
    """Fields of a recording by name; says why a field that is asked for is missing."""

    def __init__(self, file: OpenContainer, header: dict[str, Any], matlab: bool):
        unknown = sorted(header.keys() - FIELDS)
        require(not unknown, "header", unknown, f"some of {sorted(FIELDS)}")
        own = file.attributes
        if matlab:
            names = (FIELDS & {*file.names}) - header.keys()
            own = {name: variable(file, name) for name in sorted(names)}
        super().__init__(own | header)
        self._none = "no such variable" if matlab else "no such attribute"
        self._refused = file.refused
        self._holds = sorted(file.names)[:8]

    def __missing__(self, name: str) -> Any:
        why = self._refused(name) or self._none
        if name == "schema":  # of another program's file
            why += f" in a file with {self._holds}"
        raise ValueError(f"{name}: got {why}, expected it, as in recording version 1")


def variable(file: OpenContainer, name: str) -> Any:
    """Reads a variable of MATLAB that stands for an attribute."""
    shape = file.shape(name)
    require(np.prod(shape) <= _LONGEST, name, f"shape {shape}", "a number or a text")
    value = file.read(name)
    if file.attributes_of(name).get("MATLAB_class") != b"char":
        return value
    text = np.ravel(value)
    fine = text.dtype.kind == "u" and not (text > 0x10FFFF).any()
    require(fine, name, f"type {text.dtype}", "a text's codes")
    return "".join(map(chr, text))


def _text(value: Any) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _check_schema(told: dict[str, Any]) -> None:
    schema = _text(told["schema"])
    require(schema == SCHEMA, "schema", repr(schema), f"{SCHEMA!r}")
    version = number("schema_version", told["schema_version"])
    expected = f"{VERSIONS[-1]} or less; a newer tomojax may read it"
    require(version in VERSIONS, "schema_version", f"{version:g}", expected)
    kind = _text(told.get("kind", "contact"))
    expected = "'contact'; info, calibrate and reconstruct take others, file by file"
    require(kind == "contact", "kind", repr(kind), expected)
