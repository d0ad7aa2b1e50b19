"""Joins several processes on one results file by `jax.distributed`.

The file's own marks tell the chunks done. The processes need no word of each other to go
on, and a killed process may come back.
"""

import socket
from pathlib import Path
from time import monotonic, sleep

from tomojax._require import require
from tomojax.results._file import chunks_done, nothing_left, partial_path

# Hosts of a cluster do not start at the same time.
_PATIENCE = 300.0

# Until those that were killed are given up, s without a chunk done: as long as one that
# comes back takes to start and to compile on a machine that does something else.
_FAREWELL = 30.0


def join(
    coordinator: str | None,
    processes: int | None,
    process: int | None,
    *,
    out: Path,
    resume: bool,
) -> tuple[int, int]:
    """Returns (this process, their number), for `reconstruct_recording`; (0, 1) alone.

    **Raises:** `ValueError` where one of three options is missing, or nobody answers.
    """
    given = {"coordinator": coordinator, "processes": processes, "process": process}
    if all(value is None for value in given.values()):
        return 0, 1
    for name, value in given.items():
        require(value is not None, f"--{name}", "none", "it beside the other two")
    assert coordinator is not None and processes is not None and process is not None
    require(processes > 0, "--processes", processes, "1 or more")
    inside = 0 <= process < processes
    require(inside, "--process", process, f"0 to {processes - 1}")
    host, colon, port = coordinator.rpartition(":")
    require(colon and port.isdigit(), "--coordinator", repr(coordinator), "HOST:PORT")
    _left(out, process).unlink(missing_ok=True)
    # A process that comes back may find all done, and nobody to join.
    if resume and nothing_left(out):
        if process and _listens(host, int(port)):  # process 0 waits for it
            _left(out, process).touch()
        return process, processes
    if process and not _answers(host, int(port), out if resume else None):
        return process, processes
    import jax

    # One that was killed may come back while the others go on.
    jax.config.update("jax_enable_recoverability", True)
    try:
        jax.distributed.initialize(coordinator, processes, process)
    except (RuntimeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"--coordinator: {coordinator}: {reason}") from None
    return process, processes


def leave(share: tuple[int, int], out: Path) -> None:
    """Leaves the group, process 0 last: JAX aborts a process that finds process 0 gone."""
    import jax

    if not jax.distributed.is_initialized():  # alone, or nothing was left to do
        return
    others = [_left(out, k) for k in range(1, share[1])]
    if share[0]:
        jax.distributed.shutdown()
        _left(out, share[0]).touch()
        return
    done, end = chunks_done(out), monotonic() + _FAREWELL
    while not all(path.exists() for path in others) and monotonic() < end:
        sleep(0.1)
        if chunks_done(out) != done:
            done, end = chunks_done(out), monotonic() + _FAREWELL
    jax.distributed.shutdown()
    for path in others:
        path.unlink(missing_ok=True)


def _left(out: Path, process: int) -> Path:
    return partial_path(out, f".left{process}")


def _answers(host: str, port: int, out: Path | None) -> bool:
    """Tells whether process 0 is there; False once the file is finished."""
    end = monotonic() + _PATIENCE
    while monotonic() < end:
        if out and nothing_left(out):
            return False
        if _listens(host, port):
            return True
        sleep(0.2)
    raise ValueError(
        f"--coordinator: nobody answers at {host}:{port}; start --process 0 there"
    )


def _listens(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), 2.0).close()
        return True
    except OSError:
        return False
