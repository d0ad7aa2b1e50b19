"""`export`: finds the module that writes a kind, and checks the module's library."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from tomojax._require import require, require_library
from tomojax.exports._columns import events_beside
from tomojax.exports._source import Progress, Source


class Kind(NamedTuple):
    """A format: the endings of files, the writing module, and the library needed.

    **Example:**

    >>> from tomojax.exports import KINDS
    >>> KINDS["parquet"].endings, KINDS["parquet"].extra
    (('.parquet',), 'parquet')
    """

    endings: tuple[str, ...]  # of files, the usual one first; none of a folder
    module: str
    library: str = ""  # that is imported
    extra: str = ""  # of tomojax, which brings it


KINDS = {
    "csv": Kind((".csv",), "_csv"),
    "parquet": Kind((".parquet",), "_parquet", "pyarrow", "parquet"),
    "netcdf": Kind((".nc",), "_netcdf", "h5netcdf", "netcdf"),
    "mcap": Kind((".mcap",), "_mcap", "mcap_ros2", "mcap"),
    "svg": Kind((".svg",), "_svg"),
    "film": Kind((".mp4", ".gif"), "_film"),
    "lerobot": Kind((), "_lerobot", "pyarrow", "parquet"),
}


def ending(kind: str) -> str:
    """Returns a file ending of a kind, "" for a folder; films without ffmpeg are GIFs."""
    if kind == "film":
        return ".mp4" if shutil.which("ffmpeg") else ".gif"
    return KINDS[kind].endings[0] if KINDS[kind].endings else ""


def beside(out: Path, kind: str) -> list[Path]:
    """Lists the files that are written beside `out`."""
    return [events_beside(out)] if kind in ("csv", "parquet") else []


def check_kind(kind: str) -> Kind:
    """Finds a kind. **Raises:** `ValueError` if unknown, or if its library is missing."""
    require(kind in KINDS, "kind", repr(kind), ", ".join(KINDS))
    found = KINDS[kind]
    if found.library:
        require_library(found.library, found.extra)
    return found


def export(
    results: Path | str | Sequence[Path | str],
    out: Path | str,
    kind: str,
    since: float | None = None,
    until: float | None = None,
    *,
    rate: int | None = None,
    task: str = "touch",
    slow: float | None = None,
    progress: Progress = lambda done, total: None,
) -> None:
    """Writes results in another format; whole or not at all.

    **Arguments:** `results` is one file, or for `kind` "lerobot" a file for each episode;
    `kind` of `KINDS`; `since` and `until` s after the first row of a file; `rate`, frames a
    second of "lerobot" and pictures of "film"; `task` of "lerobot": the robot's task in
    words; `slow` of "film": how many times slower than real time.
    **Raises:** `ValueError` for a file without results, an unknown kind, or an empty
    stretch.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> from tomojax.exports import export
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> touch = tx.Disc([0.03, 0.05], 0.006, 1.0)
    >>> volts = np.asarray(tx.voltages(sensor, touch, [0, 15]))
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> recording = tx.recordings.ArrayRecording(rig, volts[None], [0, 15])
    >>> settings = tx.results.Settings(method="source", grid=16, contacts=2)
    >>> out = tx.reconstruct_recording(recording, "touch.h5", settings)
    >>> export("touch.h5", "touch.csv", "csv")
    >>> with open("touch.csv") as file:
    ...     print(file.readline()[:28])
    t_s,contact_count,residual_V
    """
    found, out = check_kind(kind), Path(out)
    each = [results] if isinstance(results, str | Path) else list(results)
    require(len(each) > 0, "results", "none", "a results file")
    if kind == "lerobot":
        from tomojax.exports._lerobot import Dataset, frames_per_second

        dataset = None
        with _whole_folder(out) as part:
            for one in each:
                with Source(Path(one), since, until) as source:
                    rate = rate or frames_per_second(source)
                    dataset = dataset or Dataset(part, rate, task)
                    dataset.add(source, progress)
            assert dataset is not None
            dataset.finish()
        return
    require(len(each) == 1, "results", f"{len(each)} files", f"one, of kind {kind!r}")
    write: Callable = import_module(f"tomojax.exports.{found.module}").write
    more = {"rate": rate, "slow": slow} if kind == "film" else {}
    with Source(Path(each[0]), since, until) as source:
        write(source, out, progress, **more)


@contextmanager
def _whole_folder(out: Path) -> Iterator[Path]:
    """Gives a folder to write to, which takes the name `out` at the end."""
    require(not out.exists(), f"{out}", "a file or folder that is there", "a new name")
    part = out.with_name(f".{out.name}.partial")
    shutil.rmtree(part, ignore_errors=True)
    try:
        part.mkdir()
        yield part
        part.rename(out)
    finally:
        shutil.rmtree(part, ignore_errors=True)
