"""Turns recordings of any length into results files: reads ahead, writes behind.

Chunks are judged, solved and written one by one, in this process or on a cluster. No chunk
depends on another. A later run writes the chunks left undone with the same bytes. `follow`
and `--adapt` do chunks in order, see `_following` and `_adapting`. One process writes a
file.
"""

import errno
import json
from collections.abc import Callable, Iterable
from concurrent.futures import as_completed, Future, ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

import numpy as np

from tomojax._require import require
from tomojax._stopping import stop_if_asked
from tomojax._whole import refuse_held
from tomojax.recordings import open_recording, Progress, Recording
from tomojax.results._file import check_output, partial_path, ResultsFile, RowWriter
from tomojax.results._settings import chunk_scans, configuration, require_same, Settings
from tomojax.results._work import Here, There
from tomojax.results.loading import attributes as attributes_of

# What a disk says that is full, may hold no larger file, or fails.
_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)

# Files that a cluster's workers share, at least and at most.
_FEW, _MANY = 4, 64


def reconstruct_recording(
    recording: Recording,
    out: Path | str,
    settings: Settings | None = None,
    *,
    resume: bool = False,
    overwrite: bool = False,
    client: Any = None,
    progress: Progress = lambda done, total: None,
) -> Path:
    """Writes images and contacts of every scan (or slot) of a recording to a results file.

    **Arguments:** `resume` goes on with OUT.partial of a run that ended; `overwrite`
    begins anew over OUT.partial and OUT; `client` of Dask `distributed`: its cluster's
    workers compute the chunks; `progress` is called with the chunks done and the number of
    all.
    **Returns:** the path of the finished file.
    **Raises:** `ValueError`; `KeyboardInterrupt` leaves OUT.partial to be resumed.

    **Example:**

    >>> import h5py
    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> volts = np.asarray(tx.voltages(sensor, tx.Disc([0.03, 0.05], 0.006, 1.0), [0, 15]))
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> recording = tx.recordings.ArrayRecording(rig, volts[None], [0, 15])
    >>> settings = tx.results.Settings(method="source", grid=16, contacts=2)
    >>> path = tx.reconstruct_recording(recording, "out.h5", settings, overwrite=True)
    >>> with h5py.File(path) as results:
    ...     print(results["contact_xy"].shape, results["image"].shape)
    (1, 2, 2) (1, 16, 16)
    """
    settings, out = settings or Settings(), Path(out)
    settings.check()
    refuse_held(out.with_name(f"{out.name}.partial.lock"))
    check_output(out, resume, overwrite)
    size = chunk_scans(recording, settings)
    file = ResultsFile(out, -(-recording.scans // size))
    with file.locked():
        check_output(out, resume, overwrite)  # as another run has left it
        given = recording, settings, size
        place = There(client, *given) if client else Here(*given)
        config = configuration(*given, place.digest())
        begun = file.partial.exists()
        if begun and resume and not overwrite:
            require_same(config, attributes_of(file.partial), file.partial)
        if resume and out.exists() and not begun:
            require_same(config, attributes_of(out), out)
            file.discard()  # the marks of a run that was killed as it ended
            return out
        try:
            _make(place, file, config, begun and not overwrite, progress)
        except OSError as error:
            if error.errno not in _DISK:
                raise
            raise ValueError(
                f"{out}: {error.strerror}; make room, then --resume goes on with it"
            ) from None
    return out


class Made(NamedTuple):
    """A recording that `reconstruct_many` is done with; `error` says why it has no rows."""

    file: Path
    results: Path
    seconds: float
    error: OSError | ValueError | None


def reconstruct_many(
    files: Iterable[Path | str],
    folder: Path | str,
    settings: Settings | None = None,
    *,
    resume: bool = False,
    overwrite: bool = False,
    client: Any = None,
    opened: Callable[[Path], Recording] = open_recording,
    begun: Callable[[Path], Progress] = lambda file: lambda done, total: None,
    done: Callable[[Made], None] = lambda made: None,
) -> list[Made]:
    """Writes results of each recording to a folder; an error stops that recording alone.

    **Arguments:** `client` of Dask `distributed`: its cluster's workers compute the chunks
    of several files at once. `opened` opens a file. `begun` is called with each file as its
    turn comes, and returns what the file's progress is told. `done` is called after each
    file. The rest is as for `reconstruct_recording`.
    **Returns:** for each file its results, FOLDER/NAME.results.h5, or the error.
    **Raises:** `ValueError` where results are there already, or two files' would have one
    name.

    **Example:**

    >>> from pathlib import Path
    >>> import tomojax as tx
    >>> demo = Path(tx.__file__).with_name("demo.h5")  # comes with the package
    >>> settings = tx.results.Settings(method="source", images=False)
    >>> made = tx.results.reconstruct_many([demo, "none.h5"], "found", settings)
    >>> print(made[0].results.name, made[1].error)
    demo.results.h5 none.h5: no such file; give the path of a recording
    """
    places = places_of([Path(file) for file in files], Path(folder))
    there = [one for one in places.values() if one.exists() or partial_path(one).exists()]
    mend = "--resume to go on, --overwrite, or another folder"
    asked = not there or resume or overwrite
    require(asked, f"{folder}", f"results of {len(there)} already", mend)
    Path(folder).mkdir(exist_ok=True)

    def one(file: Path) -> Made:
        stop_if_asked()
        began, error = monotonic(), None
        try:
            with opened(file) as recording:
                given: dict[str, Any] = {"client": client, "progress": begun(file)}
                given |= {"resume": resume, "overwrite": overwrite}
                reconstruct_recording(recording, places[file], settings, **given)
        except (OSError, ValueError) as wrong:
            error = wrong
        return Made(file, places[file], monotonic() - began, error)

    made: dict[Path, Made] = {}

    def add(new: Made) -> None:
        made[new.file] = new
        done(new)

    if client is None:
        for file in places:
            add(one(file))
        return list(made.values())
    at_once = min(max(sum(client.nthreads().values()), _FEW), _MANY)
    with ThreadPoolExecutor(at_once) as pool:
        try:
            for ready in as_completed([pool.submit(one, file) for file in places]):
                add(ready.result())
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [made[file] for file in places]


def places_of(recordings: list[Path], out: Path) -> dict[Path, Path]:
    """Returns the results file of each recording.

    **Raises:** `ValueError` for two recordings whose results would have one name.
    """
    places: dict[Path, Path] = {}
    taken: dict[Path, Path] = {}
    for one in recordings:
        place = out / f"{one.stem}.results.h5"
        if place in taken:
            place = out / f"{one.name}.results.h5"
        other = f"{place}, as {taken.get(place)} has"
        require(place not in taken, f"{one}", other, "recordings of other names")
        taken[place] = places[one] = place
    return places


def _make(
    place: Here | There,
    file: ResultsFile,
    config: dict[str, Any],
    begun: bool,
    progress: Progress,
) -> None:
    """Makes the file, or goes on with OUT.partial; `config` decides the rows."""
    if not begun:
        datasets, attributes = place.ask("head")
        attributes |= {
            "recording_sha256": config["recording_sha256"],
            "versions": json.dumps(config["versions"]),
            "configuration": json.dumps(config, sort_keys=True),
        }
        file.create(datasets, attributes)
    try:
        attributes = attributes_of(file.partial)
        require_same(config, attributes, file.partial)
        lam, left = float(attributes["lam"]), np.flatnonzero(~file.done())
        state = file.kept(place.ask("remembered", lam))
        if place.in_order:  # marked chunks behind the state are done again
            left = np.arange(int(state.get("chunk", 0)), file.chunks)
        _write(place, file, left.tolist(), lam, state, progress)
    except ValueError:
        if not begun and not file.done().any():
            file.discard()  # bad input: the next run does not stumble over it
        raise
    file.finish()


def _write(
    place: Here | There,
    file: ResultsFile,
    todo: list[int],
    lam: float,
    state: dict[str, Any],
    progress: Progress,
) -> None:
    """Does chunks `todo`: writes a chunk while another one is computed."""
    done = file.chunks - len(todo)
    progress(done, file.chunks)
    writing: Future | None = None
    with closing(RowWriter(file)) as writer, ThreadPoolExecutor(1) as behind:
        try:
            with closing(place.run(todo, lam, state)) as coming:
                for found in coming:
                    if writing:
                        writing.result()
                    writing = behind.submit(writer.write, *found)
                    done += 1
                    progress(done, file.chunks)
        finally:  # also when interrupted: what is computed is kept
            if writing:
                writing.result()
            writer.mark()
