"""Reads recordings as CSV: a line for each slot, with ground and a column per electrode."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.files import read_csv
from tomojax.recordings._described import sidecar
from tomojax.recordings.formats._memory import MemoryRecording

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
    names, values, cut = read_csv(path, "file")
    require(names, "columns", "no names", "a first line that names them")
    plain = [re.sub(r" *[\[(]s[\])]$", "_s", name.lower()) for name in names]
    known = [_OTHERS.get(name, "") for name in plain]
    twice = [name for name in set(known) - {""} if known.count(name) > 1]
    require(not twice, "columns", f"{twice} twice", "each once")
    pairs = "one named ground (of pairs: kind and protocol in a file .toml beside)"
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
