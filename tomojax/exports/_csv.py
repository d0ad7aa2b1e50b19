"""Writes CSV: a line for each row, and a second file of events."""

import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tomojax._whole import whole
from tomojax.exports._columns import columns, event_columns, events_beside, tables
from tomojax.exports._source import Progress, Source


def write(source: Source, out: Path, progress: Progress) -> None:
    """Writes both files; a cell without a number is empty."""
    _lines(out, tables(source, columns(source), progress))
    _lines(events_beside(out), [event_columns(source.events())])


def _lines(out: Path, tables: Iterable[dict[str, np.ndarray]]) -> None:
    with whole(out) as part, part.open("w", newline="", encoding="utf-8") as file:
        to = csv.writer(file, lineterminator="\n")
        for number, table in enumerate(tables):
            if number == 0:
                to.writerow(table)
            to.writerows(zip(*map(_texts, table.values())))


def _texts(values: np.ndarray) -> list:
    if values.dtype.kind != "f":
        return values.tolist()
    # As few digits as give the same number back, in the type that it has.
    form = "{:.9g}".format if values.dtype.itemsize == 4 else repr
    return [form(v) if v == v else "" for v in values.tolist()]
