"""Reads recordings as CSV: a line for each slot, with ground and a column per electrode."""

import re
import warnings
from io import StringIO
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from tomojax._require import require
from tomojax.recordings._described import sidecar
from tomojax.recordings.formats._memory import MemoryRecording

# Largest file, bytes: an hour at 10 kHz is better kept in HDF5.
_MOST = 1 << 29

# Names of columns that are no voltages, and what they are.
_OTHERS = {
    **dict.fromkeys(("t", "t_s", "time", "time_s"), "t"),
    "ground": "ground",
    "number": "number",
}


def open_csv(path: Path, told: dict[str, Any]) -> MemoryRecording:
    """Opens the recording in a CSV file.

    The first line names the columns: `ground`, and optionally `t` (s) and `number` (of the
    slot, counting lost slots). All other columns are electrodes in order, in volts, or in
    codes where `scale` is told. Separators are commas, semicolons or tabs. Commas may be
    decimal where semicolons or tabs separate. A field that is no number becomes NaN, and is
    flagged. A column without a name that is empty, or counts the lines, is left out.
    **Raises:** `ValueError` for a file that is no such table.
    """
    size = path.stat().st_size
    require(size <= _MOST, "file", f"{size} bytes", f"up to {_MOST} of CSV, or HDF5")
    with path.open("rb") as raw:
        wide = raw.read(2) in (b"\xff\xfe", b"\xfe\xff")
    try:
        text = path.read_text("utf-16" if wide else "utf-8-sig")
        require("\0" not in text, "file", "bytes that are no text", "CSV")
    except UnicodeDecodeError:
        raise ValueError("file: got bytes that are no text, expected CSV") from None
    file = StringIO(text)
    names, separator = _head(file)
    values, cut = _table(file, separator, len(names))
    names, values = _named(names, values)
    known = [_OTHERS.get(name.lower(), "") for name in names]
    twice = [name for name in set(known) - {""} if known.count(name) > 1]
    require(not twice, "columns", f"{twice} twice", "each once")
    pairs = "one named ground (a skin read between pairs: tomojax.ert.PairRecording)"
    require("ground" in known, "columns", names[:8], pairs)
    electrodes = [k for k, name in enumerate(known) if not name]
    require(electrodes, "columns", names[:8], "a column of voltages each electrode")
    column = {name: values[:, known.index(name)] for name in set(known) - {""}}
    v = values[:, electrodes]
    told = {**sidecar(path), **told}
    codes = None
    if "scale" in told:
        # Of a converter of another width only `rails` tell where it saturates.
        some = v[np.isfinite(v)]
        whole = bool((some == np.round(some)).all())
        small = bool((some >= -(2**15)).all() and (some < 2**15).all())
        codes = np.dtype(np.int16) if whole and small else None
    number = column.get("number")
    if number is not None:
        whole = np.isfinite(number).all() and (abs(number) < 2**53).all()
        require(whole, "number", "what is no whole number", "numbers of slots")
        number = number.astype(np.int64)
    recording = MemoryRecording(
        path, told, v, column["ground"], column.get("t"), number, None, codes
    )
    recording.mended += ("the last line is cut off: left out",) * cut
    return recording


def _head(file: TextIO) -> tuple[list[str], str]:
    """Reads the columns' names, and finds the separator."""
    line = ""
    while not line.strip() or line.startswith(("#", "sep=")):  # Excel's line
        line = file.readline(1 << 20)
        require(line, "file", "no line of names", "names of columns: t, ground, v0, …")
    separator = next((s for s in ("\t", ";", ",") if s in line), ",")
    names = [name.strip().strip('"') for name in line.rstrip("\r\n").split(separator)]
    words = [bool(re.search("[A-Za-z]", name)) or not name for name in names]
    fits = all(words) and any(names)
    require(fits, "columns", names[:4], "a first line that names them")
    return names, separator


def _named(names: list[str], values: np.ndarray) -> tuple[list[str], np.ndarray]:
    """Leaves out columns without a name, and pandas' column that counts the lines."""
    counted = values - values[:1] == np.arange(len(values))[:, None]
    empty = counted.all(0) | np.isnan(values).all(0)
    bare = np.array(
        [not n or n.lower() == "index" or n.startswith("Unnamed") for n in names]
    )
    lost = np.flatnonzero(bare & ~empty)
    require(not len(lost), "columns", f"no name for column {lost + 1}", "a name")
    return [n for n, out in zip(names, bare) if not out], values[:, ~bare]


def _table(file: TextIO, separator: str, columns: int) -> tuple[np.ndarray, bool]:
    """Reads the lines; tells whether the last was cut off, and left out."""
    text = file.read()
    if separator != "," and "," in text:
        text = text.replace(",", ".")
    lines = [line for line in text.splitlines() if line.strip()]
    ended = text.endswith("\n") or len(lines) < 2
    cut = not ended and lines[-1].count(separator) + 1 < columns
    lines = lines[:-1] if cut else lines
    require(lines, "file", "no slots", "a line for each")
    options: dict[str, Any] = {"delimiter": separator, "comments": "#", "ndmin": 2}
    try:
        values = np.loadtxt(lines, **options)
    except ValueError:  # cells without a number
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                values = np.genfromtxt(lines, **options)
        except ValueError as error:
            odd = re.search(r"#(\d+) \(got (\d+)", str(error))
            told = f"{odd[2]} columns in line {odd[1]} below the names" if odd else error
            raise ValueError(f"file: got {told}, expected {columns}") from None
    wide = values.shape[1]
    require(wide == columns, "file", f"{wide} columns", f"{columns}, as it names")
    return np.asarray(values, float), cut
