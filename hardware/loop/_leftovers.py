"""What a session keeps outside its own memory, and what one that was killed has left.

The owner of a file or a folder holds a lock on it. The system lets go of that when the
process ends, however it ends: so whoever gets the lock knows that nobody owns it.
"""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: nobody can tell
    fcntl = None


def claim(path: Path) -> int | None:
    """Marks a file or a folder as this process's own; the descriptor holds the mark.

    None where the system has no locks, or where another process has swept it just now.
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
    """Whether the process that claimed it has ended; False where nobody can tell."""
    if fcntl is None:
        return False
    try:
        number = os.open(path, os.O_RDONLY)
    except OSError:
        return False
    try:
        # Shared: two that ask at once do not take each other for the owner.
        fcntl.flock(number, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return True
    except OSError:
        return False
    finally:
        os.close(number)


def sweep(folder: Path, pattern: str) -> None:
    """Removes what nobody owns any more, of one's own."""
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
    """A folder for temporary files; those of processes that were killed are removed."""
    place = Path(tempfile.gettempdir())
    sweep(place, f"{prefix}*")
    with tempfile.TemporaryDirectory(prefix=prefix) as name:
        own = claim(Path(name))
        try:
            yield Path(name)
        finally:
            if own is not None:
                os.close(own)
