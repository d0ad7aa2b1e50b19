"""Writes results, version 1 (HDF5), so that no finished chunk is ever lost.

The file is laid out whole before the first row: every dataset contiguous at a fixed
place. Plain writes then fill in rows, chunk by chunk, in any order. HDF5's own structures
are never touched again: the process may be killed at any moment. OUT.partial.done lies
beside OUT.partial: one byte a chunk, set after the chunk is on disk. The finished file gets
its own name at the end.
"""
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportCallIssue=false, reportOptionalMemberAccess=false, reportOperatorIssue=false
# (h5py does not say whether a name is a group or a dataset)

import contextlib
import json
import math
import os
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

import h5py
import numpy as np

from tomojax._require import require
from tomojax._whole import held, reason
from tomojax.files import open_container, read_npz
from tomojax.kernels.flags import Flag
from tomojax.methods import Rung
from tomojax.results.loading import places, SCHEMA, VERSION

# Seconds after which what is written is marked.
_MARK_SECONDS = 2.0


class Dataset(NamedTuple):
    """A dataset that a file is laid out with."""

    shape: tuple[int, ...]
    kind: str  # NumPy's type
    unit: str


@dataclass(frozen=True)
class ResultsFile:
    """A results file in the making: OUT.partial, and the marks of finished chunks."""

    out: Path
    chunks: int

    @property
    def partial(self) -> Path:
        return partial_path(self.out)

    def beside(self, ending: str) -> Path:
        return partial_path(self.out, ending)

    def create(self, datasets: dict[str, Dataset], attributes: dict[str, Any]) -> None:
        """Lays the file out anew. **Raises:** `ValueError` where the disk is too small."""
        self.discard()
        building = self.beside(".new")
        try:
            with h5py.File(building, "w") as file:
                for name, dataset in datasets.items():
                    _contiguous(file, name, dataset.shape, dataset.kind)
                    file[name].attrs["unit"] = dataset.unit
                about = {
                    "bits": {f.name: f.value for f in Flag},
                    "levels": {f.name: f.level.name for f in Flag},
                    "meanings": {f.name: f.explanation for f in Flag},
                }
                for name, told in about.items():
                    file["flags"].attrs[name] = json.dumps(told, ensure_ascii=False)
                if "rung" in datasets:
                    names = {rung.name.lower(): rung.value for rung in Rung}
                    file["rung"].attrs["models"] = json.dumps(names)
                file.attrs.update(
                    {"schema": SCHEMA, "schema_version": VERSION, **attributes}
                )
            # All of it now, rather than too little later.
            if hasattr(os, "posix_fallocate"):
                with building.open("r+b") as raw:
                    os.posix_fallocate(raw.fileno(), 0, os.path.getsize(building))
            self.beside(".done").write_bytes(bytes(self.chunks))
            building.replace(self.partial)
        except (OSError, RuntimeError) as error:  # HDF5 says it in either way
            self.discard()
            each = datasets.values()
            size = sum(np.dtype(a.kind).itemsize * math.prod(a.shape) for a in each)
            told = f"{reason(error)}; {size / 1e9:.3g} GB are needed there"
            raise ValueError(f"{self.out}: {told}") from None

    def done(self) -> np.ndarray:
        """Returns the chunks that are written."""
        marks = (path := self.beside(".done")).read_bytes()
        fits = len(marks) == self.chunks
        require(fits, f"{path}", f"{len(marks)} marks", f"{self.chunks}: --overwrite")
        return np.frombuffer(marks, np.uint8) == 1

    def keep(self, **arrays: Any) -> None:
        """Puts arrays beside the rows, replacing earlier arrays: at once or not at all."""
        new = self.beside(".state.new")
        try:
            with open(new, "wb") as file:
                np.savez(file, **arrays)
                file.flush()
                os.fsync(file.fileno())
            new.replace(self.beside(".state"))
        except OSError:
            new.unlink(missing_ok=True)
            raise

    def kept(self, now: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Reads the arrays that `keep` put there last, if any; `now` are a run's first.

        **Raises:** `ValueError` for the state of another kind of run.
        """
        where, again = self.beside(".state"), "; begin anew with --overwrite"
        if not where.exists():
            return {}
        try:
            kept = read_npz(where, "no state of a run", (), None)
        except ValueError as error:
            raise ValueError(f"{error}{again}") from None
        for name, own in now.items():
            found = kept.get(name)
            told = "none" if found is None else f"{found.dtype} {found.shape}"
            expected = f"{own.dtype} {own.shape}"
            require(told == expected, f"{where}: {name}", told, f"{expected}{again}")
        chunk, done = kept.get("chunk", np.array(np.nan)), self.done()
        # Chunks are marked before what is remembered after them is kept.
        fits = chunk.shape == () and chunk.dtype.kind in "iu"
        fits = fits and 1 <= chunk <= self.chunks and done[: int(chunk)].all()
        require(fits, f"{where}: chunk", chunk, f"1 to {done.sum()}, as are done{again}")
        return kept

    def locked(self) -> contextlib.AbstractContextManager[None]:
        """Keeps other runs from this file."""
        return held(self.beside(".lock"))

    def discard(self) -> None:
        """Removes the files that an earlier run left."""
        for ending in (".new", ".done", "", ".state", ".state.new"):
            self.beside(ending).unlink(missing_ok=True)

    def finish(self) -> None:
        """Renames OUT.partial to OUT."""
        self.partial.replace(self.out)
        self.beside(".done").unlink(missing_ok=True)
        self.beside(".state").unlink(missing_ok=True)


def write_rows(
    out: Path,
    columns: dict[str, tuple[Dataset, np.ndarray]],
    attributes: dict[str, Any],
    overwrite: bool = False,
) -> None:
    """Writes a whole results file at once: datasets, each with its values.

    **Raises:** `ValueError` where OUT cannot be made, or is there already.
    """
    check_output(out, False, overwrite)
    file = ResultsFile(out, 1)
    with file.locked():
        file.create({name: dataset for name, (dataset, _) in columns.items()}, attributes)
        with contextlib.closing(RowWriter(file)) as writer:
            rows = {name: values for name, (_, values) in columns.items()}
            writer.write(0, 0, rows, None)
            writer.mark()
        file.finish()


class RowWriter:
    """A writer of rows to their places; marks chunks once their rows are on disk."""

    def __init__(self, file: ResultsFile):
        self._file = file
        self._place = places(file.partial)
        # Without buffers; bytes as they are, where Windows' `os.open` changes line ends.
        self._data = open(file.partial, "r+b", buffering=0)
        self._marks = open(file.beside(".done"), "r+b", buffering=0)
        self._unmarked: list[int] = []
        self._marked = monotonic()
        self._state: dict[str, Any] | None = None

    def write(
        self,
        chunk: int,
        start: int,
        values: dict[str, np.ndarray | None],
        state: dict[str, Any] | None,
    ) -> None:
        """Writes the rows of a chunk, by names, from row `start` on.

        The entries of the chunk in the log are in `state`. The next mark keeps `state`.
        """
        self._put(chunk, {n: np.asarray(value)[None] for n, value in (state or {}).items()})
        self._put(start, values)
        self._unmarked.append(chunk)
        self._state = state
        if monotonic() - self._marked > _MARK_SECONDS:
            self.mark()

    def _put(self, start: int, values: dict[str, np.ndarray | None]) -> None:
        for name, some in values.items():
            if name not in self._place:
                continue
            offset, kind, shape = self._place[name]
            some = np.ascontiguousarray(some, kind)
            require(some.shape[1:] == shape, name, f"shape {shape}", f"{some.shape[1:]}")
            row = kind.itemsize * int(np.prod(shape))
            _write(self._data, some, offset + start * row)

    def mark(self) -> None:
        """Marks all chunks written so far as done; keeps the last one's state."""
        os.fsync(self._data.fileno())
        for chunk in self._unmarked:
            _write(self._marks, b"\x01", chunk)
        os.fsync(self._marks.fileno())
        self._unmarked.clear()
        self._marked = monotonic()
        if self._state is not None:
            self._file.keep(**self._state)

    def close(self) -> None:
        self._data.close()
        self._marks.close()


def is_results(path: Path) -> bool:
    """Tells whether a file holds results, of this version or another."""
    try:
        with open_container(path) as file:
            return file.attributes.get("schema") == SCHEMA
    except (OSError, ValueError):
        return False


def partial_path(out: Path, ending: str = "") -> Path:
    """Returns the path of a results file in the making, or of a file beside it."""
    return out.with_name(f"{out.name}.partial{ending}")


def _contiguous(file: h5py.File, name: str, shape: tuple[int, ...], kind: str) -> None:
    """Makes an empty dataset in one piece, whose place is fixed now."""
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_layout(h5py.h5d.CONTIGUOUS)
    plist.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    plist.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    plist.set_obj_track_times(False)
    space = h5py.h5s.create_simple(shape)
    kind_id = h5py.h5t.py_create(np.dtype(kind))
    h5py.h5d.create(file.id, name.encode(), kind_id, space, plist)


def _write(file: FileIO, values: np.ndarray | bytes, offset: int) -> None:
    left = memoryview(values).cast("B")
    file.seek(offset)
    while left:  # an unbuffered file takes as much as it likes at once
        left = left[file.write(left) :]


def check_output(out: Path, resume: bool, overwrite: bool, resumes: bool = True) -> None:
    """Checks before any work that OUT can be made and that no file there would be lost.

    `resumes`: whether this work can go on with OUT.partial.
    """
    require(out.parent.is_dir(), f"{out}", "no such folder", "a folder that exists")
    require(os.access(out.parent, os.W_OK), f"{out}", "no permission", "a writable folder")
    require(not out.is_dir(), f"{out}", "a folder", "a file's name")
    # Whatever else lies there may be somebody's recording.
    ours = not out.is_file() or out.stat().st_size == 0 or is_results(out)
    if resume or overwrite:
        require(ours, f"{out}", "a file that holds no results", "a new name")
    if not (overwrite or resume):
        require(not out.exists(), f"{out}", "a file", "a new name, or --overwrite")
        begun, mend = partial_path(out), "--resume to go on with it, or --overwrite"
        require(not (resumes and begun.exists()), f"{begun}", "work begun there", mend)
