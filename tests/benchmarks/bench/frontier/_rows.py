"""Rows of our own methods: each frame by a method of the ladder, or slot by slot."""

import time
from collections.abc import Iterator
from itertools import cycle
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bench.frontier._measure import grounds_of, Job, kinds_of, repeated, timing
from bench.frontier._scenes import score, Trials
from tomojax.methods import (
    AbstractMethod,
    Batch,
    Frame,
    method as make_method,
    Part,
    pixel_divisions,
    Rows,
)
from tomojax.sensor import Sensor
from tomojax.step import make_step, Output

# Contacts looked for; slots of a step before what it says is compared.
_CONTACTS, _WARM = 3, 30

# Frames that λ is chosen from.
_FRAMES = 8


def method_rows(job: Job, sensor: Sensor, trials: Trials) -> Iterator[dict[str, Any]]:
    """Yields rows of a method of the ladder."""
    model = make_method(sensor, job.method, job.pixels)
    size = np.asarray(sensor.size)
    mesh = pixel_divisions(sensor, (job.pixels, job.pixels), model.cells_per_diameter)
    for name in job.patterns:
        grounds = grounds_of(sensor, name, trials.volts)
        volts = np.take_along_axis(trials.volts, grounds[..., None], 1)
        volts = volts.astype(job.dtype)
        frames = [Frame(v, g, np.isfinite(v)) for v, g in zip(volts, grounds)]
        lam = float(model.choose_lambda(frames[:: max(1, len(frames) // _FRAMES)]))
        found, firsts = {}, {}
        for kind, at in kinds_of(trials):
            begin = time.perf_counter()
            found[kind] = Batch(model, lam, _CONTACTS)(volts[at], grounds[at])
            firsts[kind] = time.perf_counter() - begin
        common = {
            "method": job.method,
            "pattern": name,
            "slots": grounds.shape[1],
            "lam_rule": "own",
            "lam": lam,
            "pixels": job.pixels,
            "elements": 2 * mesh[0] * mesh[1],
        }
        scores = {
            kind: score(found[kind], trials.of(at), size) | _rungs(model, found[kind])
            for kind, at in kinds_of(trials)
        }
        for kind, times in _times(job, model, lam, trials, volts, grounds):
            if kind:  # compiled by then: the first that were fitted took that time
                times["first_s"] = firsts[kind]
            for one in [kind] if kind else scores:
                yield {"scene": one, **common, **times, **scores[one]}


def _rungs(model: AbstractMethod, rows: Rows) -> dict[str, list[int]]:
    """Counts the frames that each rung explained, if a method chooses rungs."""
    if not model.tells_rung:
        return {}
    return {"rungs": np.bincount(rows.rung, minlength=5).tolist()}


def _times(
    job: Job,
    model: AbstractMethod,
    lam: float,
    trials: Trials,
    volts: np.ndarray,
    grounds: np.ndarray,
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yields times of each kind of scene, or of none if a frame always takes the same."""
    fits = model.any_grounds
    for kind, at in kinds_of(trials) if fits else [("", np.arange(1))]:
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

                def taken(count=batch, turn=turn) -> tuple[np.ndarray, np.ndarray]:
                    some = [next(turn) for _ in range(count)]
                    return volts[some], grounds[some]

                # Frames lie ready, as the peers' do, where their time is all the same.
                same = None if fits else taken()

                def call(images=images, ready=prepared, same=same, taken=taken) -> None:
                    v, under = same or taken()
                    v = jnp.asarray(v)
                    out = model.block(ready, Part(v, under), _CONTACTS, images)
                    [np.asarray(a) for a in out if a is not None]

                if fits:
                    call()  # compiles what any of the scenes asks for
                told = timing(*repeated(call), batch)
                output = "image" if images else "contacts"
                yield kind, {"output": output, "prepare_ms": spent, **told}


def follow_rows(job: Job, sensor: Sensor, trials: Trials) -> Iterator[dict[str, Any]]:
    """Yields rows of the step that follows contacts, grounded as its policy asks."""
    for name in job.patterns:
        step = make_step(sensor, "follow", name, contacts=_CONTACTS)
        volts = trials.volts.astype(job.dtype)
        for kind, at in kinds_of(trials):
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


def rows_of_steps(outs: list[Output]) -> Rows:
    """Turns outputs of a step into rows as a batch has them, without images."""
    told = jax.tree.map(lambda *values: np.array(values), *outs)
    none = np.zeros(len(outs), np.uint8)
    return Rows.of(told.contacts, residual=told.residual, flags=told.flags, rung=none)
