"""Climbs the ladder with many frames; fits larger models only to frames that need them."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Integer

from tomojax._programs import Kept, kept
from tomojax._stopping import stop_if_asked
from tomojax.methods.points._found import Fitting, fitting_of
from tomojax.methods.points._ladder import first, Ladder, steps

# Slots of a compiled call.
_CALL = 1024

# Least and most frames of it: of many, those that are done leave the others' place.
_LEAST = 16
_MOST = 128


class Frames(NamedTuple):
    """Frames of a batch, and the method and preparation that fit them."""

    method: Any
    prepared: Any
    voltages: Float[np.ndarray, "n S M"]
    grounds: Integer[np.ndarray, "n S"]
    most: int  # contacts


def call_size(slots: int) -> int:
    """Returns the number of frames of a compiled call."""
    return int(np.clip(_CALL // slots, _LEAST, _MOST))


def each_frame(fit: Callable[..., Any]) -> Kept:
    """Compiles a fit of one frame for all frames of a call.

    `fit` takes the frame as a `Fitting`, the frame's entry of what is given, and static
    arguments.
    """

    def frames(
        method, prepared, voltages, grounds, given: Any, most: int, *static: int
    ) -> Any:
        def one(v: Array, grounds: Array, given: Any) -> Any:
            scene = fitting_of(method, prepared._replace(grounds=grounds), v, most)
            return fit(scene, given, *static)

        # A processor's core gains nothing from frames side by side, and they would wait for
        # the slowest; none is spent on those that fill a call up.
        if jax.default_backend() == "cpu":
            return _one_by_one(one, voltages, grounds, given)
        return jax.vmap(one)(voltages, grounds, given)

    return kept(functools.update_wrapper(frames, fit))


def _one_by_one(one: Callable[..., Any], voltages: Array, *others: Any) -> Any:
    """Runs frames in turn; those of NaN give zeros."""
    example = jax.eval_shape(one, *jax.tree.map(lambda a: a[0], (voltages, *others)))

    def nothing(*_: Any) -> Any:
        return jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), example)

    def each(frame: tuple) -> Any:
        return jax.lax.cond(jnp.isnan(frame[0]).all(), nothing, one, *frame)

    return jax.lax.map(each, (voltages, *others))


def called(
    frames: Frames,
    rows: Int[np.ndarray, " k"],
    program: Kept,
    given: Any = (),
    *static: int,
) -> Any:
    """Runs a program for some frames, in calls of one size; returns NumPy arrays.

    **Arguments:** `given` has an entry for each of `rows`; `static` arguments come last.
    Frames of NaN fill up a call: these frames end at once.
    """
    size = call_size(frames.voltages.shape[1])
    whole: Any = None
    for k in range(0, len(rows), size):
        stop_if_asked()
        part = np.arange(k, min(k + size, len(rows)))
        filled = np.resize(part, size)
        there = (np.arange(size) < len(part))[:, None, None]
        volts = np.where(there, frames.voltages[rows[filled]], np.nan)
        own = jax.tree.map(lambda a, filled=filled: a[filled], given)
        about = frames.method, frames.prepared, volts, frames.grounds[rows[filled]]
        new = program(*about, own, frames.most, *static)
        whole = put(whole, part, new, len(rows))
    return whole


def begun(frames: Frames, program: Kept, given: Any = (), *static: int) -> Any:
    """Lets a program compile that may be `called` later; returns its results' shapes.

    Only the shape of an entry of `given` counts.
    """
    size = call_size(frames.voltages.shape[1])
    empty = lambda a: np.zeros((size, *a.shape[1:]), a.dtype)  # noqa: E731
    volts, grounds = empty(frames.voltages), empty(frames.grounds)
    given = jax.tree.map(empty, given)
    return program.begin(
        frames.method, frames.prepared, volts, grounds, given, frames.most, *static
    )


def put(whole: Any, rows: np.ndarray, new: Any, count: int) -> Any:
    """Writes the results of some frames into `whole`; None makes a new `whole`."""
    if whole is None:
        whole = jax.tree.map(lambda a: np.empty((count, *a.shape[1:]), a.dtype), new)
    for old, values in zip(jax.tree.leaves(whole), jax.tree.leaves(new)):
        old[rows] = np.asarray(values)[: len(rows)]
    return whole


def climbed(frames: Frames, rows: Int[np.ndarray, " k"]) -> Ladder:
    """Climbs the ladder with some frames."""
    rungs = steps(frames.most)
    ladder: Ladder = called(frames, rows, _first)
    high = np.array(ladder.discs.high)
    for number, (due, _) in enumerate(rungs):
        asking = np.flatnonzero(due(ladder))
        if not len(asking):
            continue
        for later in range(number, len(rungs)):
            # After two discs it is a curve's turn, where one leaves more than errors.
            if rungs[later][0](ladder).any() or (later == 1 and high.any()):
                begun(frames, _step, ladder, later)
        part = jax.tree.map(lambda a, asking=asking: a[asking], ladder)
        new = called(frames, rows[asking], _step, part, number)
        put(ladder, asking, new, len(rows))
    return ladder


@each_frame
def _first(scene: Fitting, given: tuple) -> Ladder:
    return first(scene)


@each_frame
def _step(scene: Fitting, ladder: Ladder, number: int) -> Ladder:
    return steps(scene.most)[number][1](scene, ladder=ladder)
