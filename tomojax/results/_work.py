"""Computes the rows of a recording's chunks: in this process, or on a cluster.

`Here` and `There` have one face. `There` gives each chunk as a task to the workers of a
Dask cluster. A worker opens the recording by its path. Dask gives the task of a worker that
was killed to another worker.
"""

import json
from collections.abc import Callable, Generator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import jax

from tomojax import methods
from tomojax.recordings import Chunk, read_chunk, Recording
from tomojax.results._file import Dataset
from tomojax.results._settings import (
    calibration_of,
    choose_lambda,
    FILES,
    film_rows,
    Settings,
)
from tomojax.results._solving import AbstractSolver, Chosen, EachAlone

# The datasets of contacts on a curved sheet, and their units.
_IN_SPACE = {"contact_xyz": "m", "contact_normal": "1"}

# Chunks that are given out beyond two for each of a cluster's threads: workers that are to
# come find work.
_AHEAD = 8

# A program uses all cores that it has: a worker computes one chunk at a time.
_ONE = Lock()


class Found(NamedTuple):
    """The rows of a chunk by their names, and what is kept after them, if anything."""

    chunk: int
    row: int  # the first
    values: dict[str, Any]
    state: dict[str, Any] | None


class Work:
    """Finds the rows of chunks of `size` scans."""

    def __init__(self, recording: Any, settings: Settings, size: int):
        self.settings, self._size = settings, size
        recording = self.recording = _opened(recording)
        self._calibration = calibration_of(recording, settings)
        sensor, method = recording.rig.sensor(), settings.method
        self._curved = None if sensor.surface is None else sensor
        self._model: Any
        if method == "follow":
            from tomojax.results._following import Following

            self._model = Following(recording, settings, self._calibration, size)
        else:
            grid = settings.pixels
            self._model = methods.method(sensor, method, grid, self._calibration)
        self._chosen = None
        if settings.policy:
            self._chosen = Chosen(settings.policy, recording, settings.contacts, method)
        self._solvers: dict[float, AbstractSolver] = {}

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_solvers": {}}

    def head(self) -> tuple[dict[str, Dataset], dict[str, Any]]:
        """Returns the file's datasets, and attributes that tell how its rows are made."""
        lam, model = self._lam(), self._model
        recording, settings = self.recording, self.settings
        marks = {"marks": json.dumps(recording.marks)} if recording.marks else {}
        size, edge = recording.rig.size, recording.rig.outline
        lines = [] if edge is None else [line.tolist() for line in edge.lines(size)]
        outline = {} if edge is None else {"outline": json.dumps(lines)}
        return self._datasets(), {
            "method": settings.method,
            "rate": settings.rate,
            "lam": lam,
            "lam_relative": lam / model.scale(),
            "pattern": recording.read(0, 1).grounds[0],  # of the first scan
            "size": size,
            "electrode_xy": recording.rig.electrode_xy,
            "drive_voltage": recording.rig.drive_voltage,
            "sheet_resistance": recording.rig.sheet_resistance,
            "calibration": json.dumps(asdict(self._calibration)),
            "recording": recording.path.name,
            **marks,
            **outline,
        }

    def remembered(self, lam: float) -> dict[str, Any]:
        """Returns what a run of chunks in order begins with."""
        return self.solver(lam).remembered()

    def solver(self, lam: float) -> AbstractSolver:
        if lam not in self._solvers:
            self._solvers[lam] = self._solver(lam)
        return self._solvers[lam]

    def read(self, chunk: int) -> Chunk:
        start = chunk * self._size
        stop = min(start + self._size, self.recording.scans)
        return read_chunk(self.recording, start, stop, self.settings.rate)

    def found(self, lam: float, chunk: int, frames: Chunk) -> Found:
        """Returns the rows of a chunk that was read."""
        rows, state = self.solver(lam)(chunk, frames)
        values = {"t": frames.t, **rows._asdict(), **self._forces(rows)}
        if self._curved is not None:
            values |= zip(_IN_SPACE, self._curved.in_space(rows.contact_xy))
        each = self.recording.slots if self.settings.rate == "slot" else 1
        return Found(chunk, chunk * self._size * each, values, state)

    def alone(self, lam: float, chunk: int, state: dict[str, Any] | None) -> Found:
        """Returns the rows of a chunk on a worker; `state` is of the chunk before."""
        if self.settings.in_order:
            self.solver(lam).resume(state or {})
        return self.found(lam, chunk, self.read(chunk))

    def _lam(self) -> float:
        """Returns λ: the settings', the table's, or the method's choice."""
        settings, model, chosen = self.settings, self._model, self._chosen
        if settings.method == "follow":
            return model.scale()
        if settings.lam is None and chosen is not None and chosen.median:
            return chosen.median * model.scale()
        return choose_lambda(self.recording, model, settings, self._calibration)

    def _datasets(self) -> dict[str, Dataset]:
        """Lists the file's datasets: of rows, and what `--adapt` logs for each chunk."""
        settings, model, recording = self.settings, self._model, self.recording
        count = recording.scans * (recording.slots if settings.rate == "slot" else 1)
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
            chunks, m = -(-recording.scans // self._size), recording.electrodes
            found["adapted_t"] = Dataset((chunks,), "<f8", "s")
            found["adapted_zero"] = Dataset((chunks, m), "<f8", "V")
            found["adapted_gain"] = Dataset((chunks, m), "<f8", "1")
        return found

    def _solver(self, lam: float) -> AbstractSolver:
        recording, settings, model = self.recording, self.settings, self._model
        if settings.method == "follow":
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
            alone = settings.method == "points"
            points = model if alone else getattr(model, "points", None)
        if not settings.adapt:
            return solver
        from tomojax.results._adapting import Adapting

        return Adapting(recording, self._calibration, points, solver)

    def _forces(self, rows: methods.Rows) -> dict[str, Any]:
        if self._calibration.pressure is None:
            return {}
        from tomojax.calibration import force

        g, radius = rows.contact_conductance, rows.contact_radius
        return {"contact_force": force(self._calibration, g, radius)}


class Here:
    """This process: reads a chunk while another one is computed."""

    def __init__(self, recording: Recording, settings: Settings, size: int):
        self._given, self.in_order = (recording, settings, size), settings.in_order

    @cached_property
    def _work(self) -> Work:
        return Work(*self._given)

    def digest(self) -> str:
        """Returns the SHA-256 of the recording."""
        return self._given[0].digest()

    def ask(self, name: str, *args: Any) -> Any:
        """Calls a method of the work."""
        return getattr(self._work, name)(*args)

    def run(
        self, todo: list[int], lam: float, state: dict[str, Any] | None
    ) -> Generator[Found]:
        """Yields each chunk of `todo` once it is found; `state` is of the chunk before."""
        work = self._work
        if state:
            work.solver(lam).resume(state)
        with ThreadPoolExecutor(1) as reader:
            coming = [reader.submit(work.read, chunk) for chunk in todo[:2]]
            for k, chunk in enumerate(todo):
                coming += [reader.submit(work.read, c) for c in todo[k + 2 : k + 3]]
                yield work.found(lam, chunk, coming.pop(0).result())


class There:
    """The workers of a cluster, by a client of Dask `distributed`; as `Here`."""

    def __init__(self, client: Any, recording: Recording, settings: Settings, size: int):
        self._client, self.in_order = client, settings.in_order
        # Files count by their paths on the workers' disks.
        paths = {name: getattr(settings, name) for name in FILES}
        paths = {name: str(Path(path).absolute()) for name, path in paths.items() if path}
        # An opener's error is the task's; a recording that is pickled opens on arrival.
        self._recording = recording.opener or recording
        self._settings, self._size = replace(settings, **paths), size

    @cached_property
    def _work(self) -> Any:
        # A worker that is killed takes along what it holds: another one makes it again.
        return self._given(Work, self._recording, self._settings, self._size)

    def digest(self) -> str:
        return _result(self._given(_digest, self._recording))

    def ask(self, name: str, *args: Any) -> Any:
        return _result(self._given(_asked, self._work, name, *args))

    def run(
        self, todo: list[int], lam: float, state: dict[str, Any] | None
    ) -> Generator[Found]:
        from distributed import as_completed

        left, running = iter(todo), as_completed([], loop=self._client.loop)

        def give() -> None:
            threads = sum(self._client.nthreads().values())
            most = 1 if self.in_order else 2 * threads + _AHEAD
            for chunk in islice(left, max(0, most - running.count())):
                running.add(self._given(_asked, self._work, "alone", lam, chunk, state))

        try:
            give()
            for future in running:
                found = _result(future)
                state = found.state
                give()
                yield found
        finally:
            with suppress(Exception):  # the scheduler may be gone
                self._client.cancel(list(running.futures))

    def _given(self, task: Callable, *args: Any) -> Any:
        wide = bool(jax.config.jax_enable_x64)  # pyright: ignore
        return self._client.submit(_as_here, wide, task, *args, pure=False)


def _result(future: Any) -> Any:
    """Waits for a task. **Raises:** `ValueError` where the cluster gave the task up."""
    from distributed import KilledWorker
    from distributed.comm.core import CommClosedError

    try:
        return future.result()
    except (KilledWorker, CommClosedError, CancelledError) as error:
        told = " ".join(str(error).split())
        raise ValueError(f"cluster: gave up: {told}; --resume goes on") from None


def _as_here(wide: bool, task: Callable, *args: Any) -> Any:
    with jax.enable_x64(wide), _ONE:
        return task(*args)


def _digest(recording: Any) -> str:
    return _opened(recording).digest()


def _opened(recording: Any) -> Recording:
    return recording if isinstance(recording, Recording) else recording()


def _asked(work: Work, name: str, *args: Any) -> Any:
    return getattr(work, name)(*args)
