"""Chooses the grounds of every job of `tomojax frontier`, and times calls."""

import time
from collections.abc import Callable, Iterator
from typing import Any, cast, get_args, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Integer

from bench.frontier._scenes import KINDS, Trials
from tomojax.paper import AdaptivePattern, AdaptiveScan, exploration, pattern
from tomojax.sensor import Sensor

# Seconds for which a call is repeated, and calls at least and at most.
_SECONDS, _LEAST, _MOST = 0.2, 3, 300


class Job(NamedTuple):
    """One process's job: the method, and the settings to measure."""

    method: str
    patterns: tuple[str, ...]
    batches: tuple[int, ...] = (1, 256)
    pixels: int = 32
    dtype: str = "float32"
    most: int = 0  # scenes of each kind; 0 is all


def grounds_of(
    sensor: Sensor, name: str, volts: Float[np.ndarray, "n M M"]
) -> Integer[np.ndarray, "n S"]:
    """Returns the grounded electrodes of each frame; "corners" are those that explore."""
    n, corners = len(volts), np.asarray(exploration(sensor))
    if name in ("corner", "corners"):
        return np.tile(corners[: 1 if name == "corner" else 2], (n, 1))
    if name in get_args(AdaptivePattern):
        scan = AdaptiveScan(sensor, cast(AdaptivePattern, name))
        explored = jnp.asarray(volts[:, corners], sensor.dtype)
        return np.asarray(jax.jit(jax.vmap(lambda v: scan(v)[0]))(explored))
    # Of the random patterns each scene has its own.
    return np.array([np.asarray(pattern(sensor, name, seed=k)) for k in range(n)])


def repeated(call: Callable[[], Any]) -> tuple[float, np.ndarray]:
    """Times a call, s: returns the first call, which compiles, and the later calls."""
    begin = time.perf_counter()
    call()
    first, spent = time.perf_counter() - begin, []
    start = time.perf_counter()
    while len(spent) < _LEAST or time.perf_counter() - start < _SECONDS:
        begin = time.perf_counter()
        call()
        spent.append(time.perf_counter() - begin)
        if len(spent) == _MOST:
            break
    return first, np.array(spent)


def timing(first: float, spent: np.ndarray, frames: int) -> dict[str, Any]:
    """Returns times per frame; `spread` is the middle half's width over the median."""
    each = 1e6 * spent / frames
    low, middle, high = np.quantile(each, [0.25, 0.5, 0.75])
    return {
        "batch": frames,
        "p50_us": float(middle),
        "p99_us": float(np.quantile(each, 0.99)),
        "spread": float((high - low) / middle),
        "frames_per_s": 1e6 / float(middle),
        "first_s": first,
    }


def kinds_of(trials: Trials) -> Iterator[tuple[str, np.ndarray]]:
    """Yields each kind of scene, and which of the trials are of that kind."""
    for kind in KINDS:
        yield kind, np.flatnonzero(trials.kind == kind)
