"""Tests run in float64 with strict promotion; float32 is asked for where it is tested."""

import gc
import os
from pathlib import Path

# Before JAX starts its CPU backend: xdist's workers share the cores, and threads that wait
# for each other in OpenBLAS spin on them.
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# What one process compiles serves the others, workers and commands that tests start, and
# later runs: a folder of the user's, by versions and processor.
if "PYTEST_XDIST_WORKER" not in os.environ:
    from tomojax.cli.compiled import keep_compiled

    keep_compiled("tests", 2 << 30)
    # Plugins import JAX before this file: it has set 1 by now, with which two false
    # alarms for each program fill the pipes of commands that nobody reads yet.
    os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")

import tomojax as tx
from tomojax._programs import forget

# Tracing makes millions of objects that live on: looking through them all again and again
# is a quarter of the tests' time.
gc.freeze()
gc.set_threshold(100_000, 50, 50)

SHARED = Path(__file__).parents[2] / "shared" / "data"


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


@pytest.fixture(autouse=True, scope="module")
def _little_compiled_code():
    """Before a process has as many mappings as Linux allows it (65 530): then it dies.

    A file of tests adds 13 000 at most.
    """
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > 45_000:
        forget()
        jax.clear_caches()
