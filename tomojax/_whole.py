"""Writes files whole or not at all, and lets one run at a time write a file."""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: nobody is kept from a file
    fcntl = None

# What is being written: a process that ends at once removes these.
_unfinished: set[Path] = set()


@contextmanager
def whole(path: Path | str) -> Iterator[Path]:
    """Gives a temporary name to write to; at the end the file takes the name `path`.

    A pipe or a device, such as /dev/stdout, is written directly. A symbolic link stays: the
    file that the link points to is replaced.

    **Raises:** `OSError` that names `path`; then no written part is left.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        yield path
        return
    target = Path(os.path.realpath(path))
    # The suffix stays last: by it pictures know their format.
    part = target.with_name(f".{target.stem}.{os.getpid()}.partial{target.suffix}")
    _unfinished.add(part)
    try:
        yield part
        with part.open("rb+") as file:
            os.fsync(file.fileno())
        os.replace(part, target)
    except OSError as error:
        raise OSError(f"{path}: {reason(error)}") from None
    finally:
        remove(part)
        _unfinished.discard(part)


def ours(folder: Path | str) -> bool:
    """Tells whether nobody else can write a folder: what lies there runs as code.

    The rule is ssh's: the owner is this user or root, and neither group nor others may
    write. Systems without such owners have folders of the user's own.
    """
    try:
        about = os.stat(folder)
    except OSError:
        return True  # nothing lies there
    if not hasattr(os, "geteuid"):
        return True
    return about.st_uid in (os.geteuid(), 0) and not about.st_mode & 0o022


def write_text(path: Path | str, text: str) -> None:
    """Writes a text file, whole or not at all."""
    with whole(path) as part:
        part.write_text(text)


def reason(error: BaseException) -> str:
    """Returns the system's message in one line: HDF5 wraps the message in two."""
    found = re.search(r"error message = '([^']+)'", str(error))
    text = found[1] if found else getattr(error, "strerror", None) or str(error)
    return " ".join(text.split())


def remove_unfinished() -> None:
    """Removes the files that this process is writing; for a process that ends now."""
    for part in list(_unfinished):
        remove(part)


def remove(part: Path) -> None:
    """Removes a file; a file or folder that is missing is no error."""
    with suppress(OSError):
        part.unlink()


@contextmanager
def held(path: Path) -> Iterator[None]:
    """Holds the lock file `path`; the system releases the file when the process ends.

    A disk without locks keeps nobody out.

    **Raises:** `ValueError` where another run holds the file.
    """
    file = _taken(path)
    if file is not None:
        _unfinished.add(path)
    try:
        yield
    finally:
        _unfinished.discard(path)
        if file is not None:
            remove(path)
            os.close(file)


def refuse_held(path: Path) -> None:
    """Raises ValueError where another run holds the lock file `path`."""
    if path.exists():
        with held(path):
            pass


def _taken(path: Path) -> int | None:
    while fcntl is not None:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            out = path.name.removesuffix(".partial.lock")
            raise ValueError(
                f"{path.with_name(out)}: another run is writing it; wait for it, or stop it"
            ) from None
        except OSError:
            os.close(file)
            return None
        # Its holder may have removed it meanwhile, and another one made it anew.
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file), os.stat(path)):
                return file
        os.close(file)
    return None
