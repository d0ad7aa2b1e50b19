"""Reads tables of numbers from text: CSV and its neighbours."""

import re
import warnings
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tomojax._require import require
from tomojax.files._text import _line, _require_file

# Largest file, bytes: an hour at 10 kHz is better kept in HDF5.
_MOST = 1 << 29


class Table(NamedTuple):
    """Columns of numbers: their names, none where no line names them, and the values."""

    names: list[str]
    values: Float[np.ndarray, "n columns"]
    cut: bool  # whether a last line without an end was left out


def read_csv(path: Path | str, what: str) -> Table:
    """Reads numbers in columns: separated by commas, semicolons or tabs.

    The first line may name the columns, or count them from 0 or 1. Commas may be decimal
    where semicolons or tabs separate. A field that is no number is NaN. A column without a
    name that is empty, or counts the lines, is left out, and so is one that is empty where
    lines without names end with a separator.

    **Raises:** `ValueError`, one line: the file, the text `what`, and why.

    **Example:**

    >>> from pathlib import Path
    >>> from tomojax.files import read_csv
    >>> _ = Path("places.csv").write_text("x;y\\n0,03;0,05\\n")
    >>> table = read_csv("places.csv", "places")
    >>> print(table.names, table.values)
    ['x', 'y'] [[0.03 0.05]]
    """
    path = Path(path)
    _require_file(path, what, _MOST)
    with path.open("rb") as raw:
        wide = raw.read(2) in (b"\xff\xfe", b"\xfe\xff")
    try:
        text = path.read_text("utf-16" if wide else "utf-8-sig")
        require("\0" not in text, "bytes", "no text", "CSV")
        names, separator, rest = _head(StringIO(text))
        values, cut = _table(rest, separator, len(names))
        closed = rest.partition("\n")[0].rstrip("\r").endswith(separator)
        return Table(*_named(names, values, closed), cut)
    except UnicodeDecodeError:
        raise ValueError(
            f"{path}: {what}: got bytes that are no such text, "
            "expected CSV in UTF-8 or UTF-16"
        ) from None
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: {what}: {_line(error)}") from None


def _head(file: StringIO) -> tuple[list[str], str, str]:
    """Reads the columns' names, if a line has them; finds the separator, and the rest."""
    line = ""
    while not line.strip() or line.startswith(("#", "sep=")):  # Excel's line
        line = file.readline(1 << 20)
        require(line, "lines", "none", "a line of numbers or names")
    separator = next((s for s in ("\t", ";", ",") if s in line), ",")
    names = [name.strip().strip('"') for name in line.rstrip("\r\n").split(separator)]
    words = [bool(re.search("[A-Za-z]", name)) and not _number(name) for name in names]
    bare = any(_number(name) for name in names)
    if (bare or not any(words)) and not _counted(names):
        return [""] * len(names), separator, line + file.read()
    return names, separator, file.read()


def _counted(names: list[str]) -> bool:
    """Tells names that pandas gives to columns without one: 0, 1, 2 …"""
    some = names[1:] if names[0] == "" else names
    return len(some) > 2 and some in (
        [str(k + a) for k in range(len(some))] for a in (0, 1)
    )


def _number(text: str) -> bool:
    """Tells what stands for a number, NaN and infinities among them."""
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _named(
    names: list[str], values: np.ndarray, closed: bool
) -> tuple[list[str], np.ndarray]:
    """Leaves out columns without a name, and pandas' column that counts the lines."""
    if not any(names):
        return [], values[:, :-1] if closed and np.isnan(values[:, -1]).all() else values
    counted = values - values[:1] == np.arange(len(values))[:, None]
    empty = counted.all(0) | np.isnan(values).all(0)
    bare = np.array(
        [not n or n.lower() == "index" or n.startswith("Unnamed") for n in names]
    )
    lost = np.flatnonzero(bare & ~empty)
    require(not len(lost), "columns", f"no name for column {lost + 1}", "a name")
    return [n for n, out in zip(names, bare) if not out], values[:, ~bare]


def _table(text: str, separator: str, columns: int) -> tuple[np.ndarray, bool]:
    """Reads the lines; tells whether the last was cut off, and left out."""
    if separator != "," and "," in text:
        text = text.replace(",", ".")
    lines = [line for line in text.splitlines() if line.strip()]
    ended = text.endswith("\n") or len(lines) < 2
    cut = not ended and lines[-1].count(separator) + 1 < columns
    lines = lines[:-1] if cut else lines
    require(lines, "lines", "none of numbers", "one at least")
    options = {"delimiter": separator, "comments": "#", "ndmin": 2}
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
            first = "first line, of names, has; # begins lines that are left out"
            raise ValueError(f"got {told}, expected {columns}, as the {first}") from None
    wide = values.shape[1]
    require(wide == columns, "columns", wide, f"{columns}, as the first line has")
    return np.asarray(values, float), cut
