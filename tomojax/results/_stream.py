"""Turns a recording of any length into a results file: reads ahead, writes behind.

Chunks are judged, solved and written one by one; no chunk depends on another. A later run,
or another process, writes the chunks left undone with the same bytes. `follow` and
`--adapt` do chunks in order, see `_following` and `_adapting`.
"""

import errno
import json
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np

from tomojax import methods
from tomojax._require import require
from tomojax.calibration import force
from tomojax.recordings import Chunk, Progress, read_chunk, Recording, Rig
from tomojax.results._adapting import Adapting
from tomojax.results._file import check_output, Dataset, ResultsFile, RowWriter
from tomojax.results._following import Following
from tomojax.results._settings import (
    calibration_of,
    choose_lambda,
    chunk_scans,
    configuration,
    film_rows,
    require_same,
    Settings,
)
from tomojax.results._solving import AbstractSolver, Chosen, EachAlone
from tomojax.results.loading import attributes as attributes_of

# The datasets of contacts on a curved sheet, and their units.
_IN_SPACE = {"contact_xyz": "m", "contact_normal": "1"}

_PATIENCE = 600.0  # s, in which the first process lays the file out

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
    progress: Progress = lambda done, total: None,
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
    settings, out = settings or Settings(), Path(out)
    settings.check()
    fits, why = share[1] == 1 or not settings.in_order, settings.in_order
    require(fits, "--processes", share[1], f"one process: {why}")
    goes_on = resume or share[0] > 0
    check_output(out, goes_on, overwrite)
    size = chunk_scans(recording, settings)
    file = ResultsFile(out, -(-recording.scans // size))
    config = configuration(recording, settings, size)
    with file.locked(shared=share[1] > 1):
        check_output(out, goes_on, overwrite)  # as another run has left it
        begun = file.partial.exists()
        if begun and resume and not overwrite:
            require_same(config, attributes_of(file.partial), file.partial)
        if goes_on and out.exists() and not begun:
            require_same(config, attributes_of(out), out)
            if share == (0, 1):
                file.discard()  # the marks of a run that was killed as it ended
            return out
        try:
            _Run(recording, settings, file, config).make(share, overwrite, progress)
        except OSError as error:
            if error.errno not in _DISK:
                raise
            raise ValueError(
                f"{out}: {error.strerror}; make room, then --resume goes on with it"
            ) from None
    return out


class _Run:
    """The work of one process on a results file; `config` decides the rows."""

    def __init__(
        self,
        recording: Recording,
        settings: Settings,
        file: ResultsFile,
        config: dict[str, Any],
    ):
        self._recording, self._settings = recording, settings
        self._file, self._config, self._size = file, config, config["chunk"]
        self._rows_of_a_scan = recording.slots if settings.rate == "slot" else 1
        self._calibration = calibration_of(recording, settings)
        if settings.method == "follow":
            self._model = Following(recording, settings, self._calibration, self._size)
        else:
            sensor, grid = recording.rig.sensor(), settings.pixels
            self._model = methods.method(sensor, settings.method, grid, self._calibration)
        outline, self._curved = recording.rig.outline, None
        if outline is not None and outline.surface is not None:
            self._curved = recording.rig.sensor()
        self._chosen = None
        if settings.policy:
            contacts, method = settings.contacts, settings.method
            self._chosen = Chosen(settings.policy, recording, contacts, method)

    def make(self, share: tuple[int, int], overwrite: bool, progress: Progress) -> None:
        """Makes the file, or goes on with OUT.partial."""
        file = self._file
        if share[0] > 0:
            _wait_for(file.partial)
        begun = file.partial.exists() and not (overwrite and share[0] == 0)
        if not begun:
            lam = self._lam()
            file.discard()
            self._create(lam)
        try:
            attributes = attributes_of(file.partial)
            require_same(self._config, attributes, file.partial)
            solver = self._solver(float(attributes["lam"]))
            solver.resume(file.kept(solver.remembered()))
            with closing(RowWriter(file)) as writer:
                work = partial(self._work, solver, writer, progress)
                if self._settings.in_order:
                    work(range(solver.start, file.chunks))
                else:
                    self._share_out(share, work)
        except ValueError:
            if share == (0, 1) and not begun and not file.done().any():
                file.discard()  # bad input: the next run does not stumble over it
            raise
        # Process 0 gives the file its name: the others may still be about to write.
        if share[0] == 0 and file.done().all():
            file.finish()

    def _lam(self) -> float:
        """Returns λ: the settings', the table's, or the method's choice."""
        settings, model, chosen = self._settings, self._model, self._chosen
        if isinstance(model, Following):
            return model.scale()
        if settings.lam is None and chosen is not None and chosen.median:
            return chosen.median * model.scale()
        return choose_lambda(self._recording, model, settings, self._calibration)

    def _create(self, lam: float) -> None:
        recording, settings, model = self._recording, self._settings, self._model
        marks = {"marks": json.dumps(recording.marks)} if recording.marks else {}
        attributes = {
            "method": settings.method,
            "rate": settings.rate,
            "lam": lam,
            "lam_relative": lam / model.scale(),
            "pattern": recording.read(0, 1).grounds[0],  # of the first scan
            "size": recording.rig.size,
            "electrode_xy": recording.rig.electrode_xy,
            "drive_voltage": recording.rig.drive_voltage,
            "sheet_resistance": recording.rig.sheet_resistance,
            "calibration": json.dumps(asdict(self._calibration)),
            "recording": recording.path.name,
            "recording_sha256": self._config["recording_sha256"],
            "versions": json.dumps(self._config["versions"]),
            **marks,
            **_outline(recording.rig),
            "configuration": json.dumps(self._config, sort_keys=True),
        }
        self._file.create(self._datasets(), attributes)

    def _datasets(self) -> dict[str, Dataset]:
        """Lists the file's datasets: of rows, and what `--adapt` logs for each chunk."""
        settings, model = self._settings, self._model
        count = self._recording.scans * self._rows_of_a_scan
        empty = methods.empty_rows(0, model.sizes(settings.contacts, settings.images))
        told = {"contact_covariance": model.tells_covariance, "rung": model.tells_rung}
        found = {"t": Dataset((count,), "<f8", "s")}
        for name, values in empty._asdict().items():
            if values is not None and told.get(name, True):
                field, shape = methods.fields_of_rows()[name], (count, *values.shape[1:])
                found[name] = Dataset(shape, field.kind, field.unit or model.image_unit)
            if name == "contact_conductance" and self._calibration.pressure is not None:
                found["contact_force"] = Dataset((count, settings.contacts), "<f4", "N")
        if self._curved is not None:
            for name, unit in _IN_SPACE.items():
                found[name] = Dataset((count, settings.contacts, 3), "<f4", unit)
        if settings.adapt:
            chunks, m = self._file.chunks, self._recording.electrodes
            found["adapted_t"] = Dataset((chunks,), "<f8", "s")
            found["adapted_zero"] = Dataset((chunks, m), "<f8", "V")
            found["adapted_gain"] = Dataset((chunks, m), "<f8", "1")
        return found

    def _solver(self, lam: float) -> AbstractSolver:
        recording, settings, model = self._recording, self._settings, self._model
        if isinstance(model, Following):
            solver, points = model, None
        else:
            batch = methods.Batch(
                model,
                lam,
                settings.contacts,
                settings.images,
                settings.threshold,
                film=film_rows(recording, settings),
            )
            own = settings.lam is None
            solver = EachAlone(batch, self._calibration, self._chosen, own)
            alone = isinstance(model, methods.Points)
            points = model if alone else getattr(model, "points", None)
        if not settings.adapt:
            return solver
        return Adapting(recording, self._calibration, points, solver)

    def _share_out(
        self, share: tuple[int, int], work: Callable[[Iterable[int]], None]
    ) -> None:
        left = np.flatnonzero(~self._file.done())
        mine = left % share[1] == share[0]
        work(left[mine].tolist())
        if share != (0, 1):
            # What another process has not done comes last, from its end: done twice it is
            # the same bytes, and nobody need wait for a process that was killed.
            left = np.flatnonzero(~self._file.done())
            work(left[::-1].tolist())

    def _work(
        self,
        solver: AbstractSolver,
        writer: RowWriter,
        progress: Progress,
        todo: Iterable[int],
    ) -> None:
        """Does chunks `todo`: reads a chunk and writes a chunk while computing a third."""
        file, done = self._file, int(self._file.done().sum())
        progress(done, file.chunks)
        writing: Future | None = None
        with ThreadPoolExecutor(1) as reader, ThreadPoolExecutor(1) as behind:
            try:
                for chunk, frames in _read_ahead(reader, self._read, list(todo)):
                    # What is marked may be done again where the state is of earlier.
                    if file.finished(chunk) and not self._settings.in_order:
                        continue
                    rows, state = solver(chunk, frames)
                    values = {"t": frames.t, **rows._asdict(), **self._forces(rows)}
                    if self._curved is not None:
                        values |= zip(_IN_SPACE, self._curved.in_space(rows.contact_xy))
                    start = chunk * self._size * self._rows_of_a_scan
                    if writing:
                        writing.result()
                    writing = behind.submit(writer.write, chunk, start, values, state)
                    done = min(done + 1, file.chunks)
                    progress(done, file.chunks)
            finally:  # also when interrupted: what is computed is kept
                if writing:
                    writing.result()
                writer.mark()

    def _read(self, chunk: int) -> Chunk:
        start = chunk * self._size
        stop = min(start + self._size, self._recording.scans)
        return read_chunk(self._recording, start, stop, self._settings.rate)

    def _forces(self, rows: methods.Rows) -> dict[str, np.ndarray]:
        if self._calibration.pressure is None:
            return {}
        g, radius = rows.contact_conductance, rows.contact_radius
        return {"contact_force": force(self._calibration, g, radius)}


def _wait_for(path: Path) -> None:
    """Waits until the first process has laid the file out."""
    end = monotonic() + _PATIENCE
    while not path.exists():
        told = f"nothing in {_PATIENCE:g} s"
        require(monotonic() < end, f"{path}", told, "process 0's file")
        sleep(0.1)


def _read_ahead(
    reader: Executor, read: Callable[[int], Chunk], todo: list[int]
) -> Iterator[tuple[int, Chunk]]:
    """Yields each chunk of `todo` with its data; reads the next chunk meanwhile."""
    coming = [(c, reader.submit(read, c)) for c in todo[:2]]
    for following in [*todo[2:], None, None][: len(todo)]:
        chunk, result = coming.pop(0)
        if following is not None:
            coming.append((following, reader.submit(read, following)))
        yield chunk, result.result()


def _outline(rig: Rig) -> dict[str, str]:
    """Returns the outline of a sheet that does not fill its box, as lines, m."""
    if rig.outline is None:
        return {}
    return {"outline": json.dumps([line.tolist() for line in rig.outline.lines(rig.size)])}
