"""Keeps files and folders of a session, and removes those of sessions that were killed.

The owner of a file or a folder holds a lock on it. The system releases the lock whenever
the process ends. Any process that gets the lock therefore knows that the owner has ended.
"""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, ExitStack, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: nobody can tell
    fcntl = None


def claim(path: Path) -> int | None:
    """Marks a file or a folder as this process's own; the descriptor holds the mark.

    Returns None where the system has no locks, or where another process has just swept it.
    """
    if fcntl is None:
        return None
    number = os.open(path, os.O_RDONLY)
    with suppress(OSError):
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(number), os.stat(path)):
            return number
    os.close(number)
    return None


def abandoned(path: Path) -> bool:
    """Tells whether the process that claimed a path has ended; False if nobody knows."""
    if fcntl is None:
        return False
    with suppress(OSError), ExitStack() as stack:
        number = os.open(path, os.O_RDONLY)  # a folder, too
        stack.callback(os.close, number)
        # Shared: two that ask at once do not take each other for the owner.
        fcntl.flock(number, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return True
    return False


def sweep(folder: Path, pattern: str) -> None:
    """Removes this user's files and folders that no process owns any more."""
    if fcntl is None:
        return
    for path in folder.glob(pattern):
        with suppress(OSError):
            if path.stat().st_uid != os.getuid() or not abandoned(path):
                continue
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()


@contextmanager
def own_folder(prefix: str) -> Iterator[Path]:
    """Makes a folder for temporary files, and removes folders of killed processes."""
    place = Path(tempfile.gettempdir())
    sweep(place, f"{prefix}*")
    with tempfile.TemporaryDirectory(prefix=prefix) as name:
        own = claim(Path(name))
        try:
            yield Path(name)
        finally:
            if own is not None:
                os.close(own)
