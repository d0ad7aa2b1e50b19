"""Writes Parquet: the columns of the CSV, and images, with types and units."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._whole import whole
from tomojax.exports._columns import columns, event_columns
from tomojax.exports._source import plain, Progress, Source, WORDS
from tomojax.results.loading import flag_names, IMAGES


def write(source: Source, out: Path, progress: Progress) -> None:
    """Writes rows, and a file of events. An image is a list of nx·ny numbers, by x."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    told = columns(source)
    images = [name for name in source.names if name in IMAGES]
    about = {c.name: {"unit": c.unit, "description": c.words} for c in told}
    about["flag_names"] = {"unit": "1", "description": "names of the flags"}
    for name in images:
        shape = json.dumps(list(source.shape(name)))
        words = {"unit": source.unit(name), "description": WORDS[name]}
        about[name] = {**words, "shape": shape}
    fields = list(dict.fromkeys([*(c.field for c in told), *images]))
    writer: Any = None
    with whole(out) as part:
        for block in source.blocks(fields, progress):
            table = {c.name: pa.array(c.of(block)) for c in told}
            table["flag_names"] = pa.array(flag_names(block["flags"]), pa.string())
            for name in images:
                flat = np.ascontiguousarray(block[name]).reshape(len(block["t"]), -1)
                table[name] = pa.FixedSizeListArray.from_arrays(
                    pa.array(flat.ravel()), flat.shape[1]
                )
            schema = pa.schema(
                [pa.field(n, a.type, metadata=about[n]) for n, a in table.items()],
                {"tomojax": json.dumps(plain(source.attributes))},
            )
            if writer is None:
                writer = pq.ParquetWriter(part, schema)
            writer.write_table(pa.Table.from_arrays(list(table.values()), schema=schema))
        writer.close()
    with whole(out.with_name(f"{out.stem}.events{out.suffix}")) as part:
        pq.write_table(pa.table(_typed(pa, event_columns(source.events()))), part)


def _typed(pa: Any, table: dict[str, np.ndarray]) -> dict[str, Any]:
    return {
        name: pa.array(values, pa.string() if values.dtype == object else None)
        for name, values in table.items()
    }
