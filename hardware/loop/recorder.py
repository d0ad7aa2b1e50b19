"""The recorder: a separate process that writes a ring's slots into recordings.

The recorder may be killed at any time. It writes HDF5 in SWMR mode and flushes several
times a second. It notes flushed slots in the ring, so that a next recorder goes on from
there in a new file.
"""
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# (h5py does not say whether a name is a group or a dataset)

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from itertools import chain, count
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tomojax.hardware.loop._real_time import begun
from tomojax.hardware.loop._ring import MARK, SlotRing
from tomojax.recordings import write_attributes

_EVERY = 0.25  # s between flushes
_AGAIN = 1.0  # s until a recorder that died is started again
_CHUNK = 2048  # rows of a chunk of the file
_MOST = 1 << 14  # rows at once, so that a late recorder flushes as it goes


class File:
    """One recording in the making: a scan is one slot."""

    def __init__(self, path: Path, told: dict[str, Any], electrodes: int):
        # It gets its name with its first rows: no file of that name is without.
        self.path, self._new = path, path.with_name(path.name + ".new")
        self.rows = self._lost = 0
        self._named = False
        # What is measured is its owner's alone.
        os.close(os.open(self._new, os.O_CREAT | os.O_WRONLY, 0o600))
        self._file = h5py.File(self._new, "w", libver="latest")
        write_attributes(self._file, told)
        make, m = self._file.create_dataset, electrodes
        packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
        v = make(
            "v", (0, 1, m), "i2", maxshape=(None, 1, m), chunks=(_CHUNK, 1, m), **packed
        )
        ground = make("ground", (0, 1), "u1", maxshape=(None, 1), chunks=(_CHUNK, 1))
        # Written last: a row whose time reads as this is not whole, and readers leave it.
        t0 = make("t0", (0,), "f8", maxshape=(None,), chunks=(_CHUNK,), fillvalue=np.nan)
        self._gaps = make("gaps", (0, 2), "i8", maxshape=(None, 2), chunks=(256, 2))
        self._fields = {"codes": v, "ground": ground, "time": t0}
        some = {"shape": (0,), "maxshape": (None,), "chunks": (64,)}
        self._marks = make("marks", dtype=f"S{MARK}", **some)
        self._marks_t = make("marks_t", dtype="f8", **some)
        # A row that a reader meets half made is no number.
        some = {"maxshape": (None, 2), "chunks": (256, 2), "fillvalue": np.nan}
        self._host = make("host_time", (0, 2), "f8", **some)
        self._file.swmr_mode = True

    def append(self, rows: np.ndarray, lost: np.ndarray, now: float) -> None:
        """Writes a ring's rows, each with the `lost` slots before it, and flushes them.

        `now` is the host's time, Unix s: two rigs on one host have one clock so.
        """
        before = np.flatnonzero(lost)
        if len(before):
            gone = lost[before]
            numbers = self.rows + before + self._lost + np.cumsum(gone) - gone
            self._grow(self._gaps, np.stack([numbers, gone], 1))
            self._lost += int(gone.sum())
        n = len(rows)
        shapes = {"codes": (n, 1, -1), "ground": (n, 1), "time": (n,)}
        for name, dataset in self._fields.items():
            self._grow(dataset, rows[name].reshape(shapes[name]))
        self._grow(self._host, np.array([[rows["time"][-1], now]]))
        if not self._named:
            # Windows renames no open file: there it is PATH.new until its end.
            with suppress(PermissionError):
                self._new.rename(self.path)
                self._named = True
        self.rows += n

    def mark(self, marks: list[tuple[float, bytes]]) -> None:
        """Writes moments (s of the rig's clock) with their texts, and flushes them."""
        # Readers take as many as there are times.
        self._grow(self._marks, np.array([text for _, text in marks], f"S{MARK}"))
        self._grow(self._marks_t, np.array([t for t, _ in marks], float))

    @staticmethod
    def _grow(dataset: h5py.Dataset, new: np.ndarray) -> None:
        start = dataset.shape[0]
        dataset.resize(start + len(new), 0)
        dataset[start:] = new
        dataset.flush()

    def close(self) -> None:
        self._file.close()
        if self.rows and not self._named:
            self._new.rename(self.path)
            self._named = True


def free_path(path: Path) -> Path:
    """Returns `path`, or the first of path-1, path-2, … that does not exist."""
    others = (path.with_name(f"{path.stem}-{k}{path.suffix}") for k in count(1))
    return next(found for found in chain([path], others) if not found.exists())


def write(ring: SlotRing, path: Path, told: dict[str, Any], file_seconds: float) -> None:
    """Writes slots until the ring's writer is done and all slots are on the disk."""
    file, began = None, 0.0
    while True:
        done, row = ring.done, int(ring.head["recorded"])
        rows, row, gone = ring.since(row, _MOST)
        host = time.time()
        ring.head["dropped"] += gone
        if len(rows):
            now = time.monotonic()
            if file is None or now - began > file_seconds:
                if file is not None:
                    file.close()
                file, began = File(free_path(path), told, ring.electrodes), now
            numbers = rows["number"]
            file.append(rows, np.diff(numbers, prepend=ring.head["number"] - 1) - 1, host)
            ring.head["number"][...] = numbers[-1] + 1
        ring.head["recorded"][...] = row
        marks = ring.unrecorded_marks()
        if marks and file is not None:
            file.mark(marks)
            ring.head["marked"] += len(marks)
        if len(rows) < _MOST:
            if done:
                break
            time.sleep(_EVERY)
    if file is not None:
        file.close()
    if not ring.head["done"]:
        ring.remove()  # its owner was killed, and this was the last who needs it


class Recorder:
    """Starts the process, and another if that one dies; `look` at times, then `close`."""

    def __init__(
        self, ring: SlotRing, path: Path, told: dict[str, Any], file_seconds: float = 3600.0
    ):
        self.path, self.deaths, self._died = path, 0, 0.0
        self._ring = ring
        words = [str(ring.path), str(path), ring.beside(told), str(file_seconds)]
        self._command = [sys.executable, "-m", "tomojax.hardware.loop.recorder", *words]
        self.process = self._started()

    def _started(self) -> subprocess.Popen:
        return subprocess.Popen(self._command, start_new_session=True)

    def look(self) -> None:
        """Starts a new process, a second after the last one died."""
        if self.process.poll() is None:
            return
        now = time.monotonic()
        if not self._died:
            self.deaths, self._died = self.deaths + 1, now
        if now - self._died > _AGAIN:
            self._died = 0.0
            self.process = self._started()

    def stop(self) -> None:
        """Ends the process at once."""
        self.process.kill()
        self.process.wait()

    def close(self, timeout: float = 60.0) -> None:
        """Ends the ring, and waits until all its slots are on the disk.

        **Raises:** `OSError` if slots cannot be written, for example to a full disk.
        """
        self._ring.head["done"][...] = 1  # nobody else need know how
        end = time.monotonic() + timeout
        while self.process.poll() != 0:
            self.look()
            if time.monotonic() > end:
                self.stop()
                left = int(self._ring.head["rows"]) - int(self._ring.head["recorded"])
                raise OSError(f"{self.path}: {left} slots could not be written")
            time.sleep(0.02)


def main() -> None:
    given = begun(__doc__, "ring", "path", "told", "file_seconds")
    # A file that grows beyond a limit is an error to be met, not a death.
    if hasattr(signal, "SIGXFSZ"):
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    ring, path = SlotRing(given.ring), Path(given.path)
    try:
        write(ring, path, json.loads(given.told), float(given.file_seconds))
    except (OSError, RuntimeError) as error:  # h5py raises either
        reason = str(error).partition(" (")[0]
        print(f"tomojax: recorder: {reason}; a new file is tried", file=sys.stderr)
        # Without HDF5's own end, which would write again.
        os._exit(3)


if __name__ == "__main__":
    main()
