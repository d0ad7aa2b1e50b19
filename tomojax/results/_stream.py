"""Turns a recording of any length into a results file: reads ahead, writes behind.

Chunks are judged, solved and written one by one; no chunk depends on another. A later run,
or another process, writes the chunks left undone with the same bytes. `follow` and
`--adapt` do chunks in order, see `_following` and `_adapting`.
"""

import errno
import json
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.calibration import force
from tomojax.methods import Batch, method as make_method, Rows
from tomojax.recordings import Chunk, read_chunk, Recording
from tomojax.results._chosen import Chosen
from tomojax.results._settings import (
    calibration_of,
    choose_lambda,
    chunk_scans,
    configuration,
    film_rows,
    require_same,
    Settings,
)
from tomojax.results.loading import attributes as attributes_of

# Seconds after which what is written is marked.
_MARK_SECONDS = 2.0

# What a disk says that is full, may hold no larger file, or fails.
_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)


def reconstruct_recording(
    recording: Recording,
    out: Path | str,
    settings: Settings | None = None,
    *,
    resume: bool = False,
    overwrite: bool = False,
    share: tuple[int, int] = (0, 1),
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Writes images and contacts of every scan (or slot) of a recording to a results file.

    **Arguments:** `resume` goes on with OUT.partial of a run that ended; `overwrite`
    begins anew over OUT.partial and OUT; `share` (i, n): this process is the i-th of n that
    work on the same file; `progress` is called with the chunks done and the number of all.
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
    from tomojax.results import _adapting, _file, _following

    settings, out = settings or Settings(), Path(out)
    settings.check()
    if settings.method == "follow":
        _following.require_alone(share)
    if settings.adapt:
        _adapting.require_alone(share)
    goes_on = resume or share[0] > 0
    _file.check_output(out, goes_on, overwrite)
    size = chunk_scans(recording, settings)
    file = _file.ResultsFile(out, -(-recording.scans // size))
    config = configuration(recording, settings, size)
    with file.locked(shared=share[1] > 1):
        _file.check_output(out, goes_on, overwrite)  # as another run has left it
        if goes_on and out.exists() and not file.partial.exists():
            require_same(config, attributes_of(out), out)
            if share == (0, 1):
                file.discard()  # the marks of a run that was killed as it ended
            return out
        try:
            _reconstruct(recording, settings, file, config, share, overwrite, progress)
        except OSError as error:
            if error.errno not in _DISK:
                raise
            raise ValueError(
                f"{out}: {error.strerror}; make room, then --resume goes on with it"
            ) from None
    return out


def _reconstruct(
    recording: Recording,
    settings: Settings,
    file: Any,
    config: dict,
    share: tuple[int, int],
    overwrite: bool,
    progress: Callable[[int, int], None],
) -> None:
    """Makes the file, or goes on with OUT.partial."""
    from tomojax.results import _adapting, _following

    alone, follows = share == (0, 1), settings.method == "follow"
    calibration = calibration_of(recording, settings)
    if follows:
        size = config["chunk"]
        model: Any = _following.Following(recording, settings, calibration, size)
    else:
        sensor = recording.rig.sensor()
        model = make_method(sensor, settings.method, settings.pixels, calibration)
    given = settings.policy
    chosen = None
    if given:
        chosen = Chosen(given, recording, settings.contacts, settings.method)
    if share[0] > 0:
        _wait_for(file.partial)
    begun = file.partial.exists() and not (overwrite and share[0] == 0)
    if not begun:
        if follows:
            lam = model.scale()
        elif settings.lam is None and chosen is not None and chosen.median:
            lam = chosen.median * model.scale()
        else:
            lam = choose_lambda(recording, model, settings, calibration)
        file.discard()
        _create(file, recording, settings, calibration, model, lam, config)
    try:
        attributes = attributes_of(file.partial)
        require_same(config, attributes, file.partial)
        if follows:
            solve: Any = model
        else:
            batch = Batch(
                model,
                float(attributes["lam"]),
                settings.contacts,
                settings.images,
                settings.threshold,
                film=film_rows(recording, settings),
            )
            solve = partial(_solved, settings, calibration, chosen, batch)
        if settings.adapt:
            solve = _adapting.Adapting(recording, calibration, model, solve)
        if follows or settings.adapt:
            solve.resume(_following.checked(file, solve.remembered()))
        with closing(file.writer()) as writer:
            work = partial(_work, recording, settings, calibration, solve, file, writer)
            if follows or settings.adapt:
                work(np.arange(solve.start, file.chunks), progress)
            else:
                _share_out(file, share, work, progress)
    except ValueError:
        if alone and not begun and not file.done().any():
            file.discard()  # bad input: the next run does not stumble over it
        raise
    # Process 0 gives the file its name: the others may still be about to write.
    if share[0] == 0 and file.done().all():
        file.finish()


def _share_out(file: Any, share: tuple[int, int], work: Any, progress: Any) -> None:
    left = np.flatnonzero(~file.done())
    mine = left % share[1] == share[0]
    work(left[mine], progress)
    if share != (0, 1):
        # What another process has not done comes last, from its end: done twice it is
        # the same bytes, and nobody need wait for a process that was killed.
        left = np.flatnonzero(~file.done())
        work(left[::-1], progress)


def _create(file, recording, settings, calibration, model, lam, config) -> None:
    from tomojax.results import _file

    rows = recording.scans * (recording.slots if settings.rate == "slot" else 1)
    layout = _file.fields(
        model.sizes(settings.contacts, settings.images),
        model.image_unit,
        model.tells_covariance,
        model.tells_rung,
        calibration.pressure is not None,
    )
    file.create(
        rows,
        layout,
        {
            "method": settings.method,
            "rate": settings.rate,
            "lam": lam,
            "lam_relative": lam / model.scale(),
            "pattern": recording.read(0, 1).grounds[0],  # of the first scan
            "size": recording.rig.size,
            "electrode_xy": recording.rig.electrode_xy,
            "drive_voltage": recording.rig.drive_voltage,
            "sheet_resistance": recording.rig.sheet_resistance,
            "calibration": json.dumps(asdict(calibration)),
            "recording": recording.path.name,
            "recording_sha256": config["recording_sha256"],
            "versions": json.dumps(config["versions"]),
            **({"marks": json.dumps(recording.marks)} if recording.marks else {}),
            "configuration": json.dumps(config, sort_keys=True),
        },
        _file.adapted_fields(recording.electrodes) if settings.adapt else None,
    )


def _wait_for(path: Path, seconds: float = 600.0) -> None:
    """Waits until the first process has laid the file out."""
    end = monotonic() + seconds
    while not path.exists():
        require(
            monotonic() < end, f"{path}", f"nothing in {seconds:g} s", "process 0's file"
        )
        sleep(0.1)


def _work(recording, settings, calibration, solve, file, writer, todo, progress) -> None:
    """Does chunks `todo`: reads a chunk and writes a chunk while computing a third.

    `solve` gives a chunk's rows, and a state to keep once the rows are marked.
    """
    size = chunk_scans(recording, settings)
    per_scan = recording.slots if settings.rate == "slot" else 1

    def read(chunk: int) -> Chunk:
        start = chunk * size
        return read_chunk(
            recording, start, min(start + size, recording.scans), settings.rate
        )

    marked, kept = monotonic(), None

    def mark() -> None:
        writer.mark()
        if kept is not None:
            file.keep(**kept)

    def write(chunk: int, t: np.ndarray, rows: Rows, state: Any) -> None:
        nonlocal marked, kept
        more = {}
        if calibration.pressure is not None:
            g, radius = rows.contact_conductance, rows.contact_radius
            more["contact_force"] = force(calibration, g, radius)
        if settings.adapt:
            writer.log(chunk, state)
        writer.write(chunk, chunk * size * per_scan, t, rows, **more)
        kept = state
        if monotonic() - marked > _MARK_SECONDS:
            mark()
            marked = monotonic()

    done = int(file.done().sum())
    progress(done, file.chunks)
    writing: Future | None = None
    with ThreadPoolExecutor(1) as reader, ThreadPoolExecutor(1) as behind:
        try:
            for chunk, frames in _read_ahead(reader, read, [int(c) for c in todo]):
                # What is marked may be done again where the state is of earlier.
                in_order = settings.adapt or settings.method == "follow"
                if file.finished(chunk) and not in_order:
                    continue
                rows, state = solve(chunk, frames)
                if writing:
                    writing.result()
                writing = behind.submit(write, chunk, frames.t, rows, state)
                done = min(done + 1, file.chunks)
                progress(done, file.chunks)
        finally:  # also when interrupted: what is computed is kept
            if writing:
                writing.result()
            mark()


def _solved(
    settings, calibration, chosen, batch: Batch, chunk: int, frames: Chunk
) -> tuple[Rows, None]:
    """Computes a chunk's rows; a table, if given, chooses the slots."""
    _, voltages, grounds, good, flags = frames
    volts = calibration.voltages(voltages)
    if chosen is None:
        return batch(volts, grounds, good, flags), None
    parts, lams = chosen(frames, volts)
    rows = batch.empty(len(volts))
    for part in parts:
        some = part.of(volts), part.of(grounds), part.of(good), flags[part.frames]
        each = (
            lams[part.frames] * batch.method.scale()
            if lams is not None and settings.lam is None
            else None
        )
        rows.put(part.frames, batch(*some, each))
    return rows, None


def _read_ahead(reader, read, todo) -> Iterator[tuple[int, Any]]:
    """Yields each chunk of `todo` with its data; reads the next chunk meanwhile."""
    coming = [(c, reader.submit(read, c)) for c in todo[:2]]
    for following in [*todo[2:], None, None][: len(todo)]:
        chunk, result = coming.pop(0)
        if following is not None:
            coming.append((following, reader.submit(read, following)))
        yield chunk, result.result()
