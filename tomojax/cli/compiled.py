"""Keeps the programs that commands compile, in the user's cache folder; counts them."""

import os
import re
import sys
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

from tomojax._environment import cache_folder, drop_oldest
from tomojax._whole import ours

# Bytes of all folders together; programs and tables of `points` for one sensor take 40 MB.
# JAX's own limit (jax_compilation_cache_max_size) needs the package `filelock`, and
# reads the times of all files again for each program that it writes.
LIMIT = 512 << 20

# What JAX reports of each program.
_LOWERED = "/jax/core/compile/jaxpr_to_mlir_module_duration"
_COMPILED = "/jax/core/compile/backend_compile_duration"
_FOUND = "/jax/compilation_cache/cache_retrieval_time_sec"

# A program that takes this long to lower, s, is worth a word while it compiles.
_LONG = 0.1

# Programs with a line of their own in the table.
_LINES = 12


def keep_compiled(kind: str = "compiled", limit: int = LIMIT) -> None:
    """Makes JAX, which nobody has imported yet, keep programs for later commands.

    `kind` begins the folder's name; folders of one kind hold `limit` bytes at most.

    The settings are environment variables, so that all processes of a command share them.
    If the user has set JAX_COMPILATION_CACHE_DIR, this function changes nothing. A folder
    that cannot be made or written stops no command: programs are then not kept. A folder
    that others own or can write is not used, which one line says.
    """
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    # RuntimeError: the user has no home folder.
    with suppress(OSError, RuntimeError):
        folder = cache_folder(kind)
        if folder is None:
            return
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not ours(folder):  # JAX would run what lies there
            told = "others own it or can write it; programs are not kept"
            print(f"tomojax: {folder}: {told}", file=sys.stderr)
            return
        if not os.access(folder, os.W_OK):
            return
        drop_oldest(folder.parent, kind, limit)
        _drop_when_cut_short(folder)
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
        os.environ["TOMOJAX_PROGRAMS"] = str(folder)  # see `tomojax._programs`
        # By default JAX leaves out what compiles in under a second: nearly all programs.
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        # XLA prints two false alarms for each program that it loads: jax#36294, and
        # jax#38445 on processors with AVX-512. JAX raises real errors in Python as well.
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")


def _drop_when_cut_short(folder: Path) -> None:
    """Removes a program that JAX cannot read, so that JAX compiles the program anew.

    JAX writes in place, and never over a file that exists (jax/_src/lru_cache.py). A
    command that was killed while writing would give all later commands a warning.
    """
    show = warnings.showwarning

    def heard(message: Any, *others: Any, **more: Any) -> None:
        found = re.search(r"reading persistent .* entry for '(\w+)'", str(message))
        if found is None:
            show(message, *others, **more)
            return
        for path in folder.glob(f"{found[1]}-*"):
            with suppress(OSError):
                path.unlink()

    warnings.showwarning = heard


@dataclass
class Compiling:
    """Counts programs and adds up seconds, by the name of the compiled function."""

    seconds: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    programs: Counter[str] = field(default_factory=Counter)
    kept: int = 0  # programs that JAX's cache had
    begun: float = field(default_factory=perf_counter)

    def table(self) -> str:
        """Writes the programs that took longest, and the sum of all."""
        lines = [
            f"{perf_counter() - self.begun:.1f} s in all; {self.programs.total()} "
            f"programs compiled in {sum(self.seconds.values()):.1f} s, {self.kept} of them "
            f"kept from before"
        ]
        for name in sorted(self.seconds, key=self.seconds.__getitem__, reverse=True):
            lines.append(f"{self.seconds[name]:8.2f} s {self.programs[name]:4d}  {name}")
        return "\n".join(lines[: 1 + _LINES])


@contextmanager
def compiling(
    say: Callable[[str], None] = lambda text: None,
    begun: Callable[[], None] = lambda: None,
) -> Iterator[Compiling]:
    """Counts what is compiled until the end; calls `say` before each long program.

    `begun` is called once, before the first program of any length.
    """
    import jax

    told = Compiling()

    def listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
        name = str(kwargs.get("fun_name", "?"))
        name = name.removeprefix("jit(").removesuffix(")").strip("_")
        if event == _FOUND:
            told.kept += 1
        elif event == _LOWERED:
            if not told.seconds:
                begun()
            told.seconds[name] += duration_secs
            if duration_secs > _LONG:
                say(f"compiling program {told.programs.total() + 1}: {name}")
        elif event == _COMPILED:
            told.seconds[name] += duration_secs
            told.programs[name] += 1

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield told
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
        say("")
