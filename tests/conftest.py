"""Tests run in float64 with strict promotion; float32 is asked for where it is tested."""

import ctypes
import gc
import os
import signal
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

# Before JAX starts its CPU backend. xdist's workers share the cores, and threads that wait
# for each other in OpenBLAS spin on them. LLVM optimises nothing: of a test's time, most is
# compiling, and programs that run once gain nothing from it. Nor is a module split among
# threads that have one core, nor are loops looked into by XLA: these take a tenth of
# the time of `points`' program, and a third of that of one with many loops. Notebooks and
# the demo run in .ci/run as a user's do.
_QUICK = (
    "--xla_cpu_multi_thread_eigen=false",
    "--xla_cpu_use_fusion_emitters=false",
    "--xla_backend_optimization_level=0",
    "--xla_cpu_parallel_codegen_split_count=1",
    "--xla_disable_hlo_passes=while-loop-invariant-code-motion,simplify-while-loops",
)
os.environ.setdefault("XLA_FLAGS", " ".join(_QUICK))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# A step runs as C only where that is what is tested: a compiler takes seconds for each.
os.environ.setdefault("TOMOJAX_NATIVE", "0")
# What one process compiles serves the others, workers and commands that tests start, and
# later runs: a folder of the user's, by versions and processor.
if "PYTEST_XDIST_WORKER" not in os.environ:
    from tomojax.cli.compiled import keep_compiled

    keep_compiled("tests", 2 << 30)
    # Plugins import JAX before this file: it has set 1 by now, with which two false
    # alarms for each program fill the pipes of commands that nobody reads yet.
    os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"

import jax
import jaxtyping
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
# Programs need not hold where in Python each operation stands.
jax.config.update("jax_traceback_in_locations_limit", 0)

import tomojax as tx
from tomojax._programs import forget

# Tracing makes millions of objects that live on: looking through them all again and again
# is a quarter of the tests' time.
gc.freeze()
gc.set_threshold(100_000, 50, 50)

SHARED = Path(__file__).parents[2] / "shared" / "data"

# A shell has what it runs in the background ignore Ctrl-C, and so would the commands that
# tests start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Bytes that a worker may hold before it drops its programs: three quarters of what the
# largest may take.
_MOST_BYTES = 9 << 28

# Mappings that it may hold. Linux allows a process 65 530 and kills it then; a file of
# tests adds 13 000 at most.
_MOST_MAPPINGS = 45_000


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Seeded by the test's name: a failure comes back, tests do not share draws."""
    return np.random.default_rng(list(request.node.name.encode()))


@pytest.fixture
def shared_data() -> Path:
    if not SHARED.is_dir():
        pytest.skip("the recordings in ../shared/data are not on this machine")
    return SHARED


@pytest.fixture(scope="session")
def paper_sensor() -> tx.Sensor:
    return tx.Sensor.grid()


@pytest.fixture(scope="session")
def small_sensor() -> tx.Sensor:
    """Not square, electrodes off the nodes and irregular; small for dense algebra."""
    xy = np.array(
        [
            [12, 11],
            [33, 14],
            [51, 9],
            [14, 27],
            [30.7, 29.3],
            [52, 31],
            [24, 20],
            [43, 21],
        ]
    )
    return tx.Sensor([0.064, 0.040], xy * 1e-3, divisions=(16, 10))


@pytest.fixture(scope="session")
def round_skin() -> tx.Sensor:
    """A round skin, its rim and its middle read, in float32: a method's table is kept."""
    middle = [[0.05, 0.05], [0.03, 0.03], [0.07, 0.03], [0.03, 0.07], [0.07, 0.07]]
    sensor = tx.Sensor.disc(0.1, {"rim": 11, "points": middle}, dtype=np.float32)
    return replace(sensor, electrode_shunt=1.0)


@pytest.fixture(autouse=True)
def _little_memory():
    """Drops programs and what they hold, where a worker has grown large."""
    yield
    statm = Path("/proc/self/statm")
    if statm.exists():
        held = int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        if held > _MOST_BYTES:
            _drop_programs()


@pytest.fixture(autouse=True, scope="module")
def _few_mappings():
    yield
    maps = Path("/proc/self/maps")  # takes 20 ms to read: not after each test
    if maps.exists() and maps.read_bytes().count(b"\n") > _MOST_MAPPINGS:
        _drop_programs()


def _drop_programs() -> None:
    forget()
    jax.clear_caches()
    gc.collect()
    with suppress(OSError, AttributeError):  # another libc keeps what it has
        ctypes.CDLL(None).malloc_trim(0)


# Where types and shapes are the subject: checks at each call take a sixth of the time.
_CHECKED = "kernels", "properties", "examples"


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    checked = any(name in item.path.parts for name in _CHECKED)
    jaxtyping.config.update("jaxtyping_disable", not checked)


# Files that take a minute or more. What xdist hands to a worker is a file: with these first
# no worker works on one after the others have ended.
_FIRST = (
    "test_sweeps_linear",
    "test_calibrate",
    "test_blocks",
    "test_pure",
    "test_following",
    "test_all",
    "test_step",
    "test_points",
    "test_adapt",
    "test_attacks",
    "test_sweeps_points",
    "test_sweeps_follow",
    "test_sweeps_source",
    "test_sweeps_slow",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    turn = {name: k for k, name in enumerate(_FIRST)}
    items.sort(key=lambda item: turn.get(item.path.stem, len(turn)))


_LEFT_OUT = pytest.StashKey[int]()


def pytest_deselected(items: list[pytest.Item]) -> None:
    if items:
        stash = items[0].config.stash
        stash[_LEFT_OUT] = stash.get(_LEFT_OUT, 0) + sum(
            item.get_closest_marker("long") is not None for item in items
        )


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workeroutput"):
        told = session.config.stash.get(_LEFT_OUT, 0)
        session.config.workeroutput["long"] = told  # pyright: ignore


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node, error) -> None:
    told = getattr(node, "workeroutput", {}).get("long", 0)
    node.config.stash[_LEFT_OUT] = told  # each worker collects all


def pytest_terminal_summary(terminalreporter, config: pytest.Config) -> None:
    left = config.stash.get(_LEFT_OUT, 0)
    if left:
        terminalreporter.write_line(
            f"{left} long tests were left out; `pytest -n 2 -m long` runs them, .ci/run too"
        )
