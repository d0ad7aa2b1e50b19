"""Writes LeRobot's dataset layout, version 3.0: episodes at a constant rate, for learners.

Frame k holds the last row at or before k/rate, like the reading of a robot's loop;
where rows since the frame before show more contacts, the last of those that show most:
a tap between two frames is in the later one. Learners take no NaN: a missing contact
has `present` 0 and zeros.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.exports._source import Progress, Source

# Of the layout.
_VERSION = "v3.0"
_CHUNK = 1000  # files of a folder
_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_DEFAULTS = ("timestamp", "frame_index", "episode_index", "index", "task_index")
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}

# Numbers of a contact, where results have them: field, and names.
_OF_CONTACT = {
    "contact_xy": ("x_m", "y_m"),
    "contact_radius": ("radius_m",),
    "contact_current": ("current_A",),
    "contact_conductance": ("conductance_S",),
    "contact_strength": ("strength",),
    "contact_force": ("force_N",),
}

# Frames a second, unless rows are slower: of a camera's or a robot's order.
_RATE = 50


def frames_per_second(source: Source) -> int:
    """Returns the rows a second, but no more than learners take."""
    t = next(source.blocks(["t"]))["t"]
    rows = 1 / float(np.median(np.diff(t))) if len(t) > 1 else _RATE
    return max(1, min(_RATE, round(rows)))


class Dataset:
    """A dataset in the making, in a folder of its own."""

    def __init__(self, folder: Path, rate: int, task: str):
        self.folder, self.rate, self.task = folder, rate, task
        self.features: dict[str, dict] = {}
        self._episodes: list[dict] = []
        self._stats: list[dict[str, dict]] = []  # of each episode, by feature
        self._frames = 0
        self._first: Path | None = None

    def add(self, source: Source, progress: Progress) -> None:
        """Adds a results file as an episode.

        **Raises:** `ValueError` where the contacts or images differ from the first file's.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        features = _features(source)
        if self._first is None:
            self.features, self._first = features, source.path
        same = features == self.features
        require(same, f"{source.path}", "other contacts or images", f"{self._first}'s")
        number = len(self._episodes)
        chunk, file = divmod(number, _CHUNK)
        place = self.folder / _DATA.format(chunk_index=chunk, file_index=file)
        place.parent.mkdir(parents=True, exist_ok=True)
        statistics = {name: _Statistics() for name in (*features, *_DEFAULTS)}
        writer, length = None, 0
        for frames in _resampled(source, self.rate, progress):
            n = len(frames["observation.residual"])
            index = np.arange(length, length + n)
            frames |= {
                "timestamp": (index / self.rate).astype(np.float32),
                "frame_index": index,
                "episode_index": np.full(n, number),
                "index": self._frames + index,
                "task_index": np.zeros(n, int),
            }
            for name, values in frames.items():
                statistics[name].add(values)
            table = pa.table({n: _nested(pa, values) for n, values in frames.items()})
            writer = writer or pq.ParquetWriter(place, table.schema)
            writer.write_table(table)
            length += n
        assert writer is not None
        writer.close()
        stats = {name: one.told() for name, one in statistics.items()}
        self._stats.append(stats)
        self._episodes.append(
            {
                "episode_index": number,
                "tasks": [self.task],
                "length": length,
                "data/chunk_index": chunk,
                "data/file_index": file,
                "dataset_from_index": self._frames,
                "dataset_to_index": self._frames + length,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                "source": source.path.name,
                **{f"stats/{n}/{k}": v for n, s in stats.items() for k, v in s.items()},
            }
        )
        self._frames += length

    def finish(self) -> None:
        """Writes the dataset's description of itself."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        meta = self.folder / "meta"
        (meta / "episodes/chunk-000").mkdir(parents=True)
        table = pa.Table.from_pylist(self._episodes)
        pq.write_table(table, meta / "episodes/chunk-000/file-000.parquet")
        tasks = pa.table({"task_index": [0], "task": [self.task]})
        tasks = tasks.replace_schema_metadata({"pandas": json.dumps(_PANDAS)})
        pq.write_table(tasks, meta / "tasks.parquet")
        one = {"shape": [1], "names": None}
        kinds = {n: "float32" if n == "timestamp" else "int64" for n in _DEFAULTS}
        features = self.features | {n: {"dtype": k, **one} for n, k in kinds.items()}
        info = {
            "codebase_version": _VERSION,
            "robot_type": "tomojax",
            "fps": self.rate,
            "features": features,
            "total_episodes": len(self._episodes),
            "total_frames": self._frames,
            "total_tasks": 1,
            "chunks_size": _CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "data_path": _DATA,
            "video_path": None,
            "splits": {"train": f"0:{len(self._episodes)}"},
        }
        (meta / "info.json").write_text(json.dumps(info, indent=4))
        stats = {name: _joined([s[name] for s in self._stats]) for name in features}
        (meta / "stats.json").write_text(json.dumps(stats, indent=4))


# pandas' own words for "the column `task` is the index", which LeRobot looks tasks up by.
_PANDAS = {
    "index_columns": ["task"],
    "column_indexes": [],
    "columns": [
        {
            "name": name,
            "field_name": name,
            "pandas_type": kind,
            "numpy_type": numpy,
            "metadata": None,
        }
        for name, kind, numpy in (
            ("task_index", "int64", "int64"),
            ("task", "unicode", "object"),
        )
    ],
    "pandas_version": "2.2.0",
}


def _features(source: Source) -> dict[str, dict]:
    names = [name for name in _OF_CONTACT if name in source.names]
    each = ["present", *(part for name in names for part in _OF_CONTACT[name])]
    told = [f"contact{c + 1}_{one}" for c in range(source.contacts) for one in each]
    found = {
        "observation.tactile": {"dtype": "float32", "shape": [len(told)], "names": told},
        "observation.residual": {"dtype": "float32", "shape": [1], "names": ["V"]},
        "observation.flags": {"dtype": "int64", "shape": [1], "names": ["bits"]},
    }
    if "image" in source.names:
        shape = list(source.shape("image"))
        image = {"dtype": "float32", "shape": shape, "names": ["x", "y"]}
        found["observation.tactile_image"] = image
    return found


def _resampled(
    source: Source, rate: int, progress: Progress
) -> Iterator[dict[str, np.ndarray]]:
    """Yields frames of the rows, a block at a time."""
    fields = [n for n in ("t", "contact_count", "residual", "flags") if n in source.names]
    fields += [n for n in (*_OF_CONTACT, "image") if n in source.names]
    begin, done, held = None, 0, None
    for block in source.blocks(fields, progress):
        if held is not None:  # since the last frame's row, which is the first of these
            block = {n: np.concatenate([held[n], values]) for n, values in block.items()}
        t, before = block["t"], int(done > 0)
        begin = float(t[0]) if begin is None else begin
        # A frame that falls on a row has it, whatever the last bit of its time is.
        last = int(np.floor((float(t[-1]) - begin) * rate + 1e-6))
        due = begin + (np.arange(done, last + 1) + 1e-6) / rate
        held = block
        if len(due):
            done = last + 1
            ends = np.maximum(np.searchsorted(t, due, "right") - 1, 0)
            rows = _most(block["contact_count"], before, ends)
            held = {name: values[ends[-1] :] for name, values in block.items()}
            yield _frames(source, {n: values[rows] for n, values in block.items()})


def _most(count: np.ndarray, begin: int, ends: np.ndarray) -> np.ndarray:
    """Returns the last row of most contacts, of those behind one end up to the next."""
    starts = np.concatenate([[begin], ends[:-1] + 1])
    rows = np.arange(len(count))
    ranked = count.astype(np.int64) * len(count) + rows
    found = np.maximum.reduceat(ranked[: ends[-1] + 1], np.minimum(starts, ends[-1]))
    return np.where(starts <= ends, found % len(count), ends)


def _frames(source: Source, rows: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    n, count = len(rows["t"]), rows["contact_count"]
    there = np.arange(source.contacts) < count[:, None]
    parts = [there[..., None].astype(np.float32)]
    for name in _OF_CONTACT:
        if name in rows:
            values = rows[name].reshape(n, source.contacts, -1)
            parts.append(np.where(there[..., None], np.nan_to_num(values), 0))
    found = {
        "observation.tactile": np.concatenate(parts, -1).reshape(n, -1),
        "observation.residual": np.nan_to_num(rows["residual"]),
        "observation.flags": rows["flags"].astype(np.int64),
    }
    if "image" in rows:
        found["observation.tactile_image"] = np.nan_to_num(rows["image"])
    return {k: v if v.dtype.kind == "i" else v.astype(np.float32) for k, v in found.items()}


def _nested(pa: Any, values: np.ndarray) -> Any:
    """Makes an array of n rows a column of lists, or lists of lists."""
    made = pa.array(np.ascontiguousarray(values).ravel())
    for size in values.shape[:0:-1]:
        made = pa.FixedSizeListArray.from_arrays(made, size)
        made = made.cast(pa.list_(made.type.value_type))
    return made


class _Statistics:
    """Statistics of an episode's feature; quantiles use some thousand frames a block."""

    _MOST = 4096

    def __init__(self) -> None:
        self._count = 0
        self._low: Any = np.inf
        self._high: Any = -np.inf
        self._sum: Any = 0.0
        self._square: Any = 0.0
        self._some: list[np.ndarray] = []

    def add(self, values: np.ndarray) -> None:
        values = (values if values.ndim > 1 else values[:, None]).astype(float)
        self._count += len(values)
        self._low = np.minimum(self._low, values.min(0))
        self._high = np.maximum(self._high, values.max(0))
        self._sum = self._sum + values.sum(0)
        self._square = self._square + (values**2).sum(0)
        self._some.append(values[:: max(1, len(values) // self._MOST)])

    def told(self) -> dict[str, Any]:
        mean = self._sum / self._count
        deviation = np.sqrt(np.maximum(self._square / self._count - mean**2, 0))
        some = np.concatenate(self._some)
        found = {"min": self._low, "max": self._high, "mean": mean, "std": deviation}
        found |= {name: np.quantile(some, q, 0) for name, q in _QUANTILES.items()}
        return {n: v.tolist() for n, v in found.items()} | {"count": [self._count]}


def _joined(each: list[dict[str, Any]]) -> dict[str, Any]:
    """Joins the episodes' statistics, weighted by frames, like LeRobot."""
    counts = np.array([one["count"][0] for one in each], float)
    arrays = {name: np.array([one[name] for one in each]) for name in each[0]}
    shape = (-1, *(1,) * (arrays["mean"].ndim - 1))
    weights = (counts / counts.sum()).reshape(shape)
    mean = (weights * arrays["mean"]).sum(0)
    spread = arrays["std"] ** 2 + (arrays["mean"] - mean) ** 2
    found = {
        "min": arrays["min"].min(0),
        "max": arrays["max"].max(0),
        "mean": mean,
        "std": np.sqrt((weights * spread).sum(0)),
        **{name: (weights * arrays[name]).sum(0) for name in _QUANTILES},
    }
    return {n: v.tolist() for n, v in found.items()} | {"count": [int(counts.sum())]}
