"""Reads recordings as CSV: a line for each slot, with ground and a column per electrode."""

import re
import warnings
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
    flagged.
    **Raises:** `ValueError` for a file that is no such table.
    """
    size = path.stat().st_size
    require(size <= _MOST, "file", f"{size} bytes", f"up to {_MOST} of CSV, or HDF5")
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            names, separator = _head(file)
            values = _table(file, separator, len(names))
    except UnicodeDecodeError:
        raise ValueError("file: got bytes that are no text, expected CSV") from None
    known = [_OTHERS.get(name.lower(), "") for name in names]
    twice = [name for name in set(known) - {""} if known.count(name) > 1]
    require(not twice, "columns", f"{twice} twice", "each once")
    require("ground" in known, "columns", names[:8], "one named ground")
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
    return MemoryRecording(
        path, told, v, column["ground"], column.get("t"), number, None, codes
    )


def _head(file: TextIO) -> tuple[list[str], str]:
    """Reads the columns' names, and finds the separator."""
    line = ""
    while not line or line.startswith("#"):
        line = file.readline(1 << 20)
        require(line, "file", "no line of names", "names of columns: t, ground, v0, …")
        line = line.strip()
    separator = next((s for s in ("\t", ";", ",") if s in line), ",")
    names = [name.strip().strip('"') for name in line.split(separator)]
    words = sum(bool(re.search("[A-Za-z]", name)) for name in names)
    require(words == len(names), "columns", names[:4], "a first line that names them")
    return names, separator


def _table(file: TextIO, separator: str, columns: int) -> np.ndarray:
    text = file.read()
    if separator != "," and "," in text:
        text = text.replace(",", ".")
    lines = [line for line in text.splitlines() if line.strip()]
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
            told = " ".join(str(error).split())[:150]
            raise ValueError(f"file: got {told}, expected {columns} columns") from None
    wide = values.shape[1]
    require(wide == columns, "file", f"{wide} columns", f"{columns}, as it names")
    return np.asarray(values, float)
