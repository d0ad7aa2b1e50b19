"""Writes CSV: a line for each row, and a second file of events."""

import csv
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._whole import whole
from tomojax.exports._columns import event_columns, tables
from tomojax.exports._source import Progress, Source


def write(source: Source, out: Path, progress: Progress) -> None:
    """Writes both files; a cell without a number is empty."""
    with whole(out) as part, part.open("w", newline="", encoding="utf-8") as file:
        for number, table in enumerate(tables(source, progress)):
            _lines(file, table, head=number == 0)
    with (
        whole(out.with_name(f"{out.stem}.events{out.suffix}")) as part,
        part.open("w", newline="", encoding="utf-8") as file,
    ):
        _lines(file, event_columns(source.events()), head=True)


def _lines(file: Any, table: dict[str, np.ndarray], head: bool) -> None:
    to = csv.writer(file, lineterminator="\n")
    if head:
        to.writerow(table)
    to.writerows(zip(*(_texts(values) for values in table.values())))


def _texts(values: np.ndarray) -> list:
    if values.dtype.kind != "f":
        return values.tolist()
    # As few digits as give the same number back, in the type that it has.
    form = "{:.9g}".format if values.dtype.itemsize == 4 else repr
    return [form(v) if v == v else "" for v in values.tolist()]
