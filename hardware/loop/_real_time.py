"""Settings of a process for short latencies."""

import argparse
import ctypes
import gc
import os
import signal
from contextlib import contextmanager, ExitStack, suppress
from pathlib import Path

# One function of the whole step, where a step is else some hundred tasks: see `Step`.
_FLAGS = (
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000",
    "--xla_cpu_experimental_ynn_fusion_type=",
)

# Of Linux's sys/mman.h: pages there now and later, each from its first use on.
_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4


@contextmanager
def real_time(priority: int = 50):
    """Sets this process up for steps of short latency; yields the settings it was allowed.

    Enter this context before JAX computes anything: JAX reads most settings when it begins.
    The process stays on one core, without tasks of other threads and without garbage
    collection. Each step is compiled into one function. If the system allows, the process
    runs under SCHED_FIFO with that `priority`, and the pages that it uses are locked: they
    stay in memory.
    """
    import jax  # processes beside the loop start without

    with ExitStack() as undo:
        before = os.environ.get("XLA_FLAGS", "")
        undo.callback(os.environ.update, XLA_FLAGS=before)
        os.environ["XLA_FLAGS"] = " ".join((before, *_FLAGS)).strip()
        undo.callback(jax.config.update, "jax_cpu_enable_async_dispatch", True)
        jax.config.update("jax_cpu_enable_async_dispatch", False)
        undo.callback(gc.unfreeze)
        undo.callback(gc.enable)
        gc.collect()
        gc.freeze()
        gc.disable()
        done = ["one function", "no other threads", "no garbage collection"]
        if hasattr(os, "sched_getaffinity"):
            cores = os.sched_getaffinity(0)
            undo.callback(os.sched_setaffinity, 0, cores)
            os.sched_setaffinity(0, {_quietest(cores)})
            done.append("one core")
            with suppress(PermissionError, AttributeError):  # not allowed, or not there
                scheduler, asked = os.sched_getscheduler(0), os.sched_getparam(0)
                first = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
                os.sched_setscheduler(0, first, os.sched_param(priority))
                undo.callback(os.sched_setscheduler, 0, scheduler, asked)
                done.append("SCHED_FIFO")
        if _lock_memory():
            undo.callback(ctypes.CDLL(None).munlockall)
            done.append("locked memory")
        yield done


def _lock_memory() -> bool:
    """Keeps the pages that the process uses in memory, also those to come.

    Where the system limits such memory, nothing is locked: later pages would be refused.
    """
    try:
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
        free = limit == resource.RLIM_INFINITY or os.geteuid() == 0
        return free and ctypes.CDLL(None).mlockall(_CURRENT | _FUTURE | _ON_FAULT) == 0
    except (ImportError, AttributeError):  # not this system's
        return False


def _quietest(cores: set[int]) -> int:
    """Returns the core that devices interrupted least: 99.9 % were 8 % shorter there."""
    try:
        names, *lines = Path("/proc/interrupts").read_text().splitlines()
    except OSError:
        return max(cores)
    told = [line.split() for line in lines]
    columns = {int(name.removeprefix("CPU")): k for k, name in enumerate(names.split(), 1)}
    devices = [row for row in told if row[0].rstrip(":").isdigit()]
    often = {core: sum(int(row[columns[core]]) for row in devices) for core in cores}
    return min(cores, key=lambda core: (often[core], -core))


def begun(about: str | None, *names: str, nice: int = 0) -> argparse.Namespace:
    """Begins a process beside the loop: reads its words, and lets it give way to the loop.

    Ctrl-C is the loop's: the ring says when the loop is done. The process may use any core,
    `nice` steps behind others. A name with dashes is an option, with a word or without.
    A word @PATH is what that file holds.
    """
    parser = argparse.ArgumentParser(description=about, fromfile_prefix_chars="@")
    for name in names:
        if name.startswith("-"):
            parser.add_argument(name, nargs="?", const="yes")
        else:
            parser.add_argument(name)
    given = parser.parse_args()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
    if hasattr(os, "nice"):  # not on Windows
        os.nice(nice)
    return given
