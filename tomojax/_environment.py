"""Names the device, the machine and the versions that made a result, or compiled one.

What was compiled is kept in the user's cache folder, by these names.
"""

import hashlib
import os
import platform
import sys
from contextlib import suppress
from functools import cache
from importlib import metadata
from itertools import takewhile
from pathlib import Path

version = cache(metadata.version)  # reads a file of long text each time

# The lines of /proc/cpuinfo that name the processor and its features, on x86 and ARM.
_PROCESSOR = ("model name", "flags", "CPU implementer", "CPU part", "Features")


def environment() -> dict[str, str]:
    """Returns device, machine and versions, for the JSON files."""
    import jax  # half a second, which a command that writes no JSON need not spend

    packages = ("tomojax", "jax", "jaxlib", "equinox", "numpy")
    return {
        "device": str(jax.devices()[0].device_kind),
        "machine": platform.machine(),
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }


def cache_folder(kind: str) -> Path | None:
    """Names the folder after the versions and the processor; None where JAX crashes."""
    versions = {name: version(name) for name in ("jax", "jaxlib", "tomojax")}
    if sys.platform == "darwin" and versions["jaxlib"].startswith(("0.8.", "0.9.")):
        return None  # on macOS they run out of stack as they load a large program
    made_with = "\n".join([*map(" ".join, versions.items()), *_processor()])
    key = hashlib.sha256(made_with.encode()).hexdigest()[:12]
    home = os.environ.get("XDG_CACHE_HOME", "")
    cache = Path(home) if os.path.isabs(home) else Path.home() / ".cache"
    return cache / "tomojax" / f"{kind}-{key}"


def _processor() -> list[str]:
    """Lists the processor's name and features, and the number of cores.

    A program would crash on a processor without a feature that XLA compiled it for. XLA
    also splits loops among the cores: a program compiled on one core stays on one core.
    """
    cores = os.cpu_count()
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    told = [platform.machine(), platform.processor(), f"{cores} cores"]
    with suppress(OSError), open("/proc/cpuinfo") as file:
        first = takewhile(str.strip, file)  # up to the blank line after the first core
        told += [line for line in first if line.split("\t")[0] in _PROCESSOR]
    return told


def drop_oldest(cache: Path, kind: str, limit: int) -> None:
    """Removes the programs that were used longest ago, until the rest is under `limit`."""
    found = []
    for path in cache.glob(f"{kind}-*/**/*"):
        with suppress(OSError):  # another command may have removed the file
            if path.is_dir():
                continue
            about = path.stat()
            found.append((max(about.st_atime, about.st_mtime), about.st_size, path))
    size = sum(size for _, size, _ in found)
    for _, bytes_there, path in sorted(found):
        if size <= limit:
            break
        with suppress(OSError):
            path.unlink()
        size -= bytes_there
