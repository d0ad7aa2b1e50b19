"""Runs the process that reads containers: `python -m tomojax.files.reader`.

One reader waits for each process that opens files. The reader forks itself for each file: a
file costs some milliseconds, not an interpreter's start. The fork has little memory and
little time for each request. The fork can open nothing else once the file is open.
"""

import json
import os
import signal
import socket
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from tomojax.files import _served, _served_mat, _served_mcap, _served_tdms

_MEMORY = 1 << 30  # bytes of a fork

# Seconds for one request. A file on a disk far away may take long to come, a damaged one
# loops without a pause.
_WORK = 5.0
_WAIT = 30.0  # beside the work

# Of MCAP all messages are read at once: as much more time for each so many bytes.
_EACH = 1 << 24
_LONGEST = 10  # times the usual

KINDS = {
    "hdf5": _served.Hdf5,
    "mat": _served_mat.Mat,
    "mcap": _served_mcap.Mcap,
    "tdms": _served_tdms.Tdms,
}


def main() -> None:
    """Forks for each file that comes through standard input, until this socket closes."""
    # Ctrl-C is for the process that asks; forks that have ended are nobody's.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    # What HDF5 and NumPy import or open when they are first used.
    _warm()
    control = socket.socket(fileno=os.dup(0))
    while True:
        message, numbers, _, _ = socket.recv_fds(control, 1 << 16, 1)
        if not message:
            return
        if os.fork() == 0:
            control.close()
            os.close(0)
            os.open(os.devnull, os.O_RDONLY)
            try:
                serve(Connection(numbers[0]), json.loads(message))
            finally:
                os._exit(0)
        os.close(numbers[0])


def serve(connection: Connection, asked: dict[str, Any]) -> None:
    """Answers requests on one file until the other side has gone."""
    import resource  # Windows has none, nor this process

    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    whole = asked["kind"] == "mcap"
    _limit_time(1 + whole * min(_LONGEST, os.path.getsize(asked["path"]) // _EACH))
    try:
        opened = KINDS[asked["kind"]](asked["path"])
        _open_nothing_else()
        answer: dict[str, Any] = {"about": opened.about()}
    except Exception as error:
        answer, opened = _said(error), None
    connection.send_bytes(json.dumps(answer).encode())
    _limit_time(0)
    while opened is not None:
        try:
            name, start, stop, axis = json.loads(connection.recv_bytes())
        except (EOFError, OSError):
            return
        _limit_time()
        try:
            values = np.ascontiguousarray(opened.read(name, start, stop, axis))
        except Exception as error:
            connection.send_bytes(json.dumps(_said(error)).encode())
        else:
            told = {"shape": list(values.shape), "dtype": values.dtype.str}
            connection.send_bytes(json.dumps(told).encode())
            if values.size:
                connection.send_bytes(values.data.cast("B"))
        _limit_time(0)


def _limit_time(part: int = 1) -> None:
    """Sets a time limit: the system then ends the process, whatever loop runs."""
    signal.setitimer(signal.ITIMER_PROF, part * _WORK)
    signal.setitimer(signal.ITIMER_REAL, min(part, 1) * (_WAIT + part * _WORK))


def _open_nothing_else() -> None:
    """Lets no further file, socket or library be opened: no file number is left free."""
    import resource

    free = os.dup(0)
    os.close(free)
    resource.setrlimit(resource.RLIMIT_NOFILE, (free, free))


def _said(error: Exception) -> dict[str, Any]:
    text = " ".join(str(error).strip("'\"").split())[:200] or type(error).__name__
    if isinstance(error, MemoryError):
        text = f"more than {_MEMORY >> 20} MB for what a file of its size holds"
    # `ModuleNotFoundError` is told by the name of what is not installed.
    missing = getattr(error, "name", None)
    kind = "OSError" if isinstance(error, OSError) else type(error).__name__
    return {"error": text, "kind": kind, "missing": missing}


def _warm() -> None:
    import tempfile

    import h5py

    with tempfile.TemporaryFile() as raw:
        with h5py.File(raw, "w") as file:
            data = file.create_dataset("a", data=[1.0], chunks=(1,), compression="gzip")
            data.attrs["unit"] = "V"
        with h5py.File(raw, "r") as file:
            _served._attributes(file["a"])
            np.asarray(file["a"][..., 0:1])  # pyright: ignore


if __name__ == "__main__":
    main()
