"""Makes rows a flat table: a column for each number, with the unit in the column's name."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tomojax.events import Event
from tomojax.exports._source import Progress, Source, WORDS
from tomojax.results.loading import flag_names, IMAGES, label, parts_of


class Column(NamedTuple):
    """A column of the table, and its place in a field's rows."""

    name: str
    unit: str
    words: str
    field: str
    at: tuple[int, ...]

    def of(self, block: dict[str, np.ndarray]) -> np.ndarray:
        """Returns the column's values in a block of rows."""
        values = block[self.field][(slice(None), *self.at)]
        return flag_names(values) if self.name == "flag_names" else values


def columns(source: Source, images: bool = False) -> list[Column]:
    """Lists the columns of results: t_s, contact_count, flags, contact1_x_m, ….

    Fields of the whole row come first, then those of each contact, the flags' names and,
    where asked for, the images.
    """
    whole, each, pictures = [], [], []
    for name in source.names:
        unit, words, shape = source.unit(name), WORDS[name], source.shape(name)
        if name in IMAGES:
            pictures.append(Column(name, unit, words, name, ()))
        elif not shape:
            whole.append(Column(label(name, unit=unit), unit, words, name, ()))
        else:
            for c in range(source.contacts):
                for k, part in enumerate(parts_of(name)):
                    told = label(f"contact{c + 1}", part, unit=unit)
                    at = (c, k) if len(shape) > 1 else (c,)
                    each.append(Column(told, unit, words, name, at))
    each.sort(key=lambda column: column.at[0])
    names = Column("flag_names", "1", "names of the flags", "flags", ())
    return [*whole, *each, names, *(pictures if images else [])]


def tables(
    source: Source, told: list[Column], progress: Progress
) -> Iterator[dict[str, np.ndarray]]:
    """Yields the columns `told`, a block of rows at a time."""
    fields = list(dict.fromkeys(column.field for column in told))
    for block in source.blocks(fields, progress):
        yield {column.name: column.of(block) for column in told}


def events_beside(out: Path) -> Path:
    """Returns the file of events that lies beside a table."""
    return out.with_name(f"{out.stem}.events{out.suffix}")


def event_columns(events: list[Event]) -> dict[str, Any]:
    """Makes columns of the events in order: touch-down, lift-off and marks."""

    def column(name: str, kind: Any = np.float32) -> np.ndarray:
        return np.array([getattr(event, name) for event in events], kind)

    x, y = column("xy").reshape(-1, 2).T
    return {
        "t_s": column("t", float),
        "event": column("kind", object),
        "contact": column("contact", np.int64),
        "x_m": x,
        "y_m": y,
        "conductance_S": column("conductance"),
        "force_N": column("force"),
        "text": column("text", object),
    }
