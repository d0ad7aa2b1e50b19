"""One job of `tomojax frontier`, in a process of its own: a method on one mesh and dtype.

    python -m tomojax._frontier_job SCENES.npz JOB

Prints a JSON row for each pattern, rule for λ, kind of scene, batch size and output. The
process's memory is the job's own, and what a crash takes with it is one job.
"""

import json
import os
import resource
import sys
import time
from collections.abc import Callable, Iterator
from itertools import cycle
from pathlib import Path
from typing import Any, cast, get_args, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Integer

from tomojax import kernels
from tomojax._batch import Batch, Rows
from tomojax._frontier_scenes import KINDS, load_trials, score, Trials
from tomojax._linear import Linear
from tomojax._make_step import make_step
from tomojax._method import AbstractMethod, Frame, method as make_method, pixel_divisions
from tomojax._patterns import AdaptivePattern, AdaptiveScan, exploration, pattern
from tomojax._sensor import Sensor

# Seconds for which a call is repeated, and calls at least and at most.
_SECONDS, _LEAST, _MOST = 0.5, 3, 300

# Contacts looked for; slots of a step before what it says is compared.
_CONTACTS, _WARM = 3, 30

# Frames that λ is chosen from.
_FRAMES = 8


class Job(NamedTuple):
    """What one process measures."""

    method: str
    patterns: tuple[str, ...]
    rules: tuple[str, ...] = ("own",)
    batches: tuple[int, ...] = (1, 256)
    pixels: int = 32
    dtype: str = "float32"
    designed: tuple[int, ...] = ()
    threads: int = 0  # of "rates": cores that it may use; 0 is all
    most: int = 0  # scenes of each kind; 0 is all


def grounds_of(
    sensor: Sensor, name: str, volts: Float[np.ndarray, "n M M"], designed: tuple = ()
) -> Integer[np.ndarray, "n S"]:
    """Electrodes grounded; "corners" explore, "ten" adds *Around* to them."""
    n, corners = len(volts), np.asarray(exploration(sensor))
    if name in ("corner", "corners"):
        return np.tile(corners[: 1 if name == "corner" else 2], (n, 1))
    if name == "designed":
        return np.tile(np.array(designed), (n, 1))
    if name == "ten":
        around = grounds_of(sensor, "around", volts)
        return np.concatenate([np.tile(corners, (n, 1)), around], 1)
    if name in get_args(AdaptivePattern):
        scan = AdaptiveScan(sensor, cast(AdaptivePattern, name))
        explored = jnp.asarray(volts[:, corners], sensor.dtype)
        return np.asarray(jax.jit(jax.vmap(lambda v: scan(v)[0]))(explored))
    # Of the random patterns each scene has its own.
    return np.array([np.asarray(pattern(sensor, name, seed=k)) for k in range(n)])


def repeated(call: Callable[[], Any]) -> tuple[float, np.ndarray]:
    """Seconds of the first call, which compiles, and of those after."""
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
    """Per frame; `spread` is the middle half's width over the median."""
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


def method_rows(job: Job, sensor: Sensor, trials: Trials) -> Iterator[dict[str, Any]]:
    """Rows of a method of the ladder."""
    model = make_method(sensor, job.method, job.pixels)
    size = np.asarray(sensor.size)
    mesh = pixel_divisions(sensor, (job.pixels, job.pixels), model.cells_per_diameter)
    for name in job.patterns:
        grounds = grounds_of(sensor, name, trials.volts, job.designed)
        volts = np.take_along_axis(trials.volts, grounds[..., None], 1)
        volts = volts.astype(job.dtype)
        frames = [Frame(v, g, np.isfinite(v)) for v, g in zip(volts, grounds)]
        frames = frames[:: max(1, len(frames) // _FRAMES)]
        for rule in job.rules:
            lam = chosen_lambda(model, rule, frames)
            found, firsts = {}, {}
            for kind, at in _kinds(trials):
                begin = time.perf_counter()
                found[kind] = Batch(model, lam, _CONTACTS)(volts[at], grounds[at])
                firsts[kind] = time.perf_counter() - begin
            common = {
                "method": job.method,
                "pattern": name,
                "slots": grounds.shape[1],
                "lam_rule": rule,
                "lam": lam,
                "pixels": job.pixels,
                "elements": 2 * mesh[0] * mesh[1],
            }
            scores = {
                kind: score(found[kind], trials.of(at), size) | _rungs(model, found[kind])
                for kind, at in _kinds(trials)
            }
            for kind, times in _times(job, model, lam, trials, volts, grounds):
                if kind:  # compiled by then: the first that were fitted took that time
                    times["first_s"] = firsts[kind]
                for one in [kind] if kind else scores:
                    yield {"scene": one, **common, **times, **scores[one]}


def _kinds(trials: Trials) -> Iterator[tuple[str, np.ndarray]]:
    for kind in KINDS:
        yield kind, np.flatnonzero(trials.kind == kind)


def _rungs(model: AbstractMethod, rows: Rows) -> dict[str, list[int]]:
    """How many frames each rung of the ladder explained, where a method chooses."""
    if not model.tells_rung:
        return {}
    return {"rungs": np.bincount(rows.rung, minlength=4).tolist()}


def _times(
    job: Job,
    model: AbstractMethod,
    lam: float,
    trials: Trials,
    volts: np.ndarray,
    grounds: np.ndarray,
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Of each kind of scene; of no kind where a frame's time does not depend on it."""
    fits = model.any_grounds
    for kind, at in _kinds(trials) if fits else [("", np.arange(1))]:
        good = np.ones(volts.shape[1:], bool)
        begin = time.perf_counter()
        prepared = model.prepare(grounds[at[0]], good, lam)
        jax.block_until_ready(prepared)
        spent = 1e3 * (time.perf_counter() - begin)
        for batch in job.batches:
            for images in (True, False):
                if fits and not images:
                    continue  # an image costs next to nothing beside the fit
                turn = cycle(at)

                def call(count=batch, turn=turn, images=images, ready=prepared) -> None:
                    some = [next(turn) for _ in range(count)]
                    v, under = jnp.asarray(volts[some]), grounds[some]
                    out = model.block(ready, v, under, _CONTACTS, images)
                    [np.asarray(a) for a in out if a is not None]

                if fits:
                    call()  # compiles what any of the scenes asks for
                told = timing(*repeated(call), batch)
                output = "image" if images else "contacts"
                yield kind, {"output": output, "prepare_ms": spent, **told}


def chosen_lambda(model: AbstractMethod, rule: str, frames: list[Frame]) -> float:
    """λ for a recording by one of the rules; "own" is what the method takes."""
    if rule == "own":
        return float(model.choose_lambda(frames))
    assert isinstance(model, Linear)
    chosen = []
    for frame in frames:
        spectrum = kernels.spectrum(model.factors[frame.grounds])
        grid = kernels.lambda_grid(spectrum)
        noise = jnp.asarray(0.01 * np.sqrt(np.mean(frame.voltages**2)), grid.dtype)
        v = jnp.asarray(frame.voltages)
        scores = kernels.lambda_scores(spectrum, v, grid, rule, noise)  # pyright: ignore
        chosen.append(float(kernels.choose_lambda(grid, scores)))
    return float(np.exp(np.nanmedian(np.log(chosen))))


def follow_rows(job: Job, sensor: Sensor, trials: Trials) -> Iterator[dict[str, Any]]:
    """Of the step that follows contacts, each slot grounded as its policy asks."""
    for name in job.patterns:
        step = make_step(sensor, "follow", name, contacts=_CONTACTS)
        volts = trials.volts.astype(job.dtype)
        for kind, at in _kinds(trials):
            outs, spent = [], []
            for k in at:
                state, ground, out = step.state, 0, None
                for _ in range(_WARM):
                    v, begin = volts[k, ground], time.perf_counter()
                    state, out = step(state, v, ground)
                    ground = int(out.ground)
                    np.asarray(out.contacts.xy)
                    spent.append(time.perf_counter() - begin)
                outs.append(jax.tree.map(np.asarray, out))
            rows = rows_of_steps(outs)
            yield {
                "scene": kind,
                "method": "follow",
                "pattern": name,
                "slots": 1,
                "lam_rule": "own",
                "lam": None,
                "pixels": 0,
                "elements": 0,
                "output": "contacts",
                "prepare_ms": 0.0,
                **timing(spent[0], np.array(spent[_WARM:]), 1),
                **score(rows, trials.of(at), np.asarray(sensor.size)),
            }


def rows_of_steps(outs: list[Any]) -> Rows:
    """Of outputs of a step, as a batch has them; without images."""
    fields = zip(*(out.contacts for out in outs))
    count, xy, radius, angle, current, conductance, covariance = map(np.array, fields)
    residual, flags = (
        np.array([getattr(o, n) for o in outs]) for n in ("residual", "flags")
    )
    none = np.zeros(len(outs), np.uint8)
    shape = count, xy, radius, angle, current, conductance, covariance
    return Rows(*shape, residual, flags, none, None, None)


def peak_mb() -> float:
    """The process's own peak: on Linux getrusage may carry the parent's over."""
    status = Path("/proc/self/status")
    if not status.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    line = next(x for x in status.read_text().splitlines() if x.startswith("VmHWM"))
    return int(line.split()[1]) / 1024


def main() -> None:
    path = Path(sys.argv[1])
    words: dict[str, Any] = json.loads(sys.argv[2])
    told: dict[str, Any] = {
        k: tuple(v) if isinstance(v, list) else v for k, v in words.items()
    }
    job = Job(**told)
    if job.threads:  # before JAX makes its threads
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: job.threads])
    sensor, trials = load_trials(path, job.dtype)
    if job.most:
        trials = trials.of(np.concatenate([at[: job.most] for _, at in _kinds(trials)]))
    if job.method == "follow":
        rows = follow_rows(job, sensor, trials)
    elif job.method == "peers":
        from tomojax._frontier_peers import peer_rows

        rows = peer_rows(job, sensor, trials)
    elif job.method in ("rates", "day"):
        from tomojax import _frontier_rates

        kinds = {"rates": _frontier_rates.rate_rows, "day": _frontier_rates.day_rows}
        rows = kinds[job.method](job, sensor, trials)
    else:
        rows = method_rows(job, sensor, trials)
    made = list(rows)
    common = {"dtype": job.dtype, "device": str(jax.devices()[0].device_kind)}
    for row in made:
        print(json.dumps({**common, "peer": False, **row, "memory_mb": peak_mb()}))


if __name__ == "__main__":
    main()
