"""Writes Parquet: the columns of the CSV, and images, with types and units."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._whole import whole
from tomojax.exports._columns import columns, event_columns, events_beside, tables
from tomojax.exports._source import plain, Progress, Source
from tomojax.results.loading import IMAGES


def write(source: Source, out: Path, progress: Progress) -> None:
    """Writes rows, and a file of events. An image is a list of nx·ny numbers, by x."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    told = columns(source, images=True)
    about = {c.name: {"unit": c.unit, "description": c.words} for c in told}
    for name in about.keys() & set(IMAGES):
        about[name]["shape"] = json.dumps(list(source.shape(name)))
    writer: Any = None
    with whole(out) as part:
        for block in tables(source, told, progress):
            table = {name: _typed(pa, values) for name, values in block.items()}
            schema = pa.schema(
                [pa.field(n, a.type, metadata=about[n]) for n, a in table.items()],
                {"tomojax": json.dumps(plain(source.attributes))},
            )
            writer = writer or pq.ParquetWriter(part, schema)
            writer.write_table(pa.Table.from_arrays(list(table.values()), schema=schema))
        writer.close()
    events = event_columns(source.events()).items()
    with whole(events_beside(out)) as part:
        pq.write_table(pa.table({n: _typed(pa, values) for n, values in events}), part)


def _typed(pa: Any, values: np.ndarray) -> Any:
    """Makes an array of Parquet: texts, numbers, or lists of an image's numbers."""
    if values.ndim == 1:
        return pa.array(values, pa.string() if values.dtype == object else None)
    flat = np.ascontiguousarray(values).reshape(len(values), -1)
    return pa.FixedSizeListArray.from_arrays(pa.array(flat.ravel()), flat.shape[1])
