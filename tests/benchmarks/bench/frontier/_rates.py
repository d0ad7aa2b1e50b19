"""Two more jobs of `tomojax frontier`: images a second, and a robot's day of frames.

Images a second stand beside the machine's bound. The bound of a batch of images is the
longer of two times. One is its multiplications at the rate of a large matrix product. The
other is its bytes at the rate of a large copy. Both rates are measured here.
"""

import os
import time
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bench.frontier._measure import grounds_of, Job, repeated
from bench.frontier._scenes import score, Trials
from tomojax.methods import Batch, Linear, method as make_method, Source
from tomojax.sensor import nominal_noise, Sensor

_LARGE, _WIDE = 1 << 25, 2048  # numbers of a copy, a side of a product

_CHECKED = 64  # images of a batch that are compared

# Of 100 frames: 70 % nothing, 20 % one contact, 8 % two or three, 2 % large.
DAY = {"one": 20, "two": 6, "three": 2, "large": 2}
_NOTHING = 70


def rate_rows(job: Job, sensor: Sensor, trials: Trials) -> Iterator[dict[str, Any]]:
    """Yields rates of images of frames with one pattern; all work stays on the device."""
    copy, product = machine(job.dtype)
    for method in ("linear", "source"):
        model = make_method(sensor, method, job.pixels)
        assert isinstance(model, Linear | Source)
        for name in job.patterns:
            grounds = grounds_of(sensor, name, trials.volts[:1])[0]
            good = np.ones((len(grounds), model.electrode_count), bool)
            prepared = model.prepare(grounds, good, model.choose_lambda([]))
            for batch in job.batches:
                volts = np.resize(trials.volts[:, grounds], (batch, *good.shape))
                v = jnp.asarray(volts, job.dtype)
                error = _error(model, prepared, v)
                first, spent = repeated(
                    lambda m=model, p=prepared, v=v: jax.block_until_ready(_images(m, p, v))
                )
                rank, pixels = _sizes(model, prepared), job.pixels**2
                inputs = good.size
                work = 2 * batch * (inputs * rank + rank * pixels) / product
                size = jnp.dtype(job.dtype).itemsize
                each = batch * (inputs + pixels) + rank * (inputs + pixels)
                moved = size * each / copy
                median = float(np.median(spent))
                yield {
                    "scene": "rate",
                    "method": method,
                    "pattern": name,
                    "slots": len(grounds),
                    "pixels": job.pixels,
                    "threads": job.threads or len(os.sched_getaffinity(0)),
                    "batch": batch,
                    "frames_per_s": batch / median,
                    "bound_frames_per_s": batch / max(work, moved),
                    "bound": "multiplications" if work > moved else "bytes",
                    "part_of_bound": max(work, moved) / median,
                    "first_s": first,
                    "error": error,
                    "copy_gb_per_s": copy / 1e9,
                    "product_gflop_per_s": product / 1e9,
                }


def machine(dtype: str) -> tuple[float, float]:
    """Measures bytes a second of a copy (read and written), flops a second of a product."""
    large = jnp.ones(_LARGE, dtype)
    copy = jax.jit(lambda a: a + 1)
    _, spent = repeated(lambda: jax.block_until_ready(copy(large)))
    bytes_moved = 2 * large.nbytes
    wide = jnp.ones((_WIDE, _WIDE), dtype)
    product = jax.jit(lambda a: jnp.matmul(a, a, precision="highest"))
    _, taken = repeated(lambda: jax.block_until_ready(product(wide)))
    # The best: a bound is what the machine can do, not what it does with others on it.
    return bytes_moved / float(spent.min()), 2 * _WIDE**3 / float(taken.min())


@eqx.filter_jit
def _images(model: Linear | Source, prepared: Any, volts: jax.Array) -> jax.Array:
    if isinstance(model, Source):
        return jax.vmap(lambda v: model.smooth_image(prepared, v))(volts)
    return jax.vmap(lambda v: model.image(prepared, v)[0])(volts)


def _error(model: Linear | Source, prepared: Any, volts: jax.Array) -> float:
    """Returns the error of some images beside NumPy's in float64, of the highest value."""
    some = np.asarray(volts[:_CHECKED], float).reshape(min(len(volts), _CHECKED), -1)
    if isinstance(model, Source):
        operator, basis = prepared.imaging, model.smoothed
    else:
        operator, basis = prepared.operator, model.basis[: prepared.operator.shape[1]]
    exact = some @ np.asarray(operator, float) @ np.asarray(basis, float)
    found = np.asarray(_images(model, prepared, volts), float)[: len(some)]
    off = np.abs(found.reshape(exact.shape) - exact).max()
    return float(off / np.abs(exact).max())


def _sizes(model: Linear | Source, prepared: Any) -> int:
    """Returns the number of rows of the basis through which the voltages go."""
    operator = prepared.imaging if isinstance(model, Source) else prepared.operator
    return operator.shape[1]


def day_rows(job: Job, sensor: Sensor, trials: Trials) -> Iterator[dict[str, Any]]:
    """Yields rows of a mix of scenes, mostly empty: `auto`, and its largest rung alone."""
    rng = np.random.default_rng(0)
    chosen = {
        kind: rng.choice(np.flatnonzero(trials.kind == kind), count)
        for kind, count in DAY.items()
    }
    for name in job.patterns:
        at = np.concatenate(list(chosen.values()))
        grounds = grounds_of(sensor, name, trials.volts[at])
        volts = np.take_along_axis(trials.volts[at], grounds[..., None], 1)
        empty = nominal_noise(sensor) * rng.normal(size=(_NOTHING, *volts.shape[1:]))
        volts = np.concatenate([volts, empty]).astype(job.dtype)
        grounds = np.concatenate(
            [grounds, np.resize(grounds, (_NOTHING, grounds.shape[1]))]
        )
        for method in ("auto", "shape"):
            jax.clear_caches()
            model = make_method(sensor, method, job.pixels)
            batch = Batch(model, model.choose_lambda([]), 3)
            rows, spent = batch(volts, grounds), []
            for _ in range(2):
                begin = time.perf_counter()
                batch(volts, grounds)
                spent.append(time.perf_counter() - begin)
            start, figures = 0, {}
            for kind, some in chosen.items():
                end = start + len(some)
                told = rows.take(slice(start, end))
                figures[kind] = score(told, trials.of(some), np.asarray(sensor.size))
                start = end
            false = int((rows.contact_count[start:] > 0).sum())
            yield {
                "scene": "day",
                "method": method,
                "pattern": name,
                "slots": grounds.shape[1],
                "frames": len(volts),
                "mean_us": 1e6 * float(np.median(spent)) / len(volts),
                "contacts_where_nothing_is": false,
                "kinds": figures,
                "rungs": np.bincount(rows.rung, minlength=5).tolist(),
            }
