"""Descends by Levenberg and Marquardt's method on normal equations that the model adds up.

The method serves models that compute their own slopes: only a few numbers pass from step to
step, never the residuals. One loop serves all starts of all frames and contains the model
once, because each copy of the model takes seconds to compile. Finished frames leave the
loop.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool, Float, Int

from tomojax.kernels.algebra._blocktri import solve_positive
from tomojax.kernels.algebra._where_needed import tree_where

# Damping of the first step, as a part of the diagonal.
_DAMPING = 1e-3
# Its change after a step that was taken,
_LESS = 1 / 8
# and after a step that was not.
_MORE = 8.0
# The least damping.
_LEAST = 1e-4
# A descent that needs more damping than this has nothing to gain.
_HOPELESS = 1e3

# The curvature is learned from steps that are shorter than this part of the longest step.
_NEAR = 0.35

# The descent ends once each parameter's step is shorter than this,
_SMALL = 3e-3
# or once the equations promise to lower χ² by less than this.
_LITTLE = 1e-3

# A start is given up while its cost is far above `below`: by more than this many times what
# the last step promised to gain. Many steps along a valley each gain little, so that one
# step's promise alone would end the descent too early.
_REACH = 30.0
# Only a step with less damping than this is asked: a damped step promises too little.
_REACHING = 0.1
# A start has taken as many steps before it can be given up.
_TRIED = 2

# A step is taken that raises χ² by no more than this. Where slopes are not exact, they
# vanish a little beside the lowest cost.
_SLACK = 0.01

# Steps of a turn, between which frames that are done leave.
_TURN = 3


class Normal(NamedTuple):
    """The cost of a model at its parameters, with its gradient and curvature."""

    cost: Float[Array, ""]
    matrix: Float[Array, "P P"]  # JᵀWJ
    gradient: Float[Array, " P"]  # JᵀWr, r = model − measured


class Limits(NamedTuple):
    """The highest value and the longest step of each parameter."""

    highest: Float[Array, " P"]
    longest: Float[Array, " P"]


class _Descent(NamedTuple):
    """The run from the present start, and the best result of the earlier starts."""

    parameters: Float[Array, " P"]
    normal: Normal
    bent: Float[Array, "P P"]  # what its matrix leaves out of the curvature
    damping: Float[Array, ""]
    steps: Int[Array, ""]
    start: Int[Array, ""]  # which; as many as there are: the best goes on
    best: Float[Array, " P"]
    lowest: Float[Array, ""]
    ended: Bool[Array, ""]


def descend(
    model: Callable[..., Normal],
    starts: Float[Array, "n P"],
    limits: Limits,
    few: int,
    most: int,
    together: int,
    below: Float[Array, ""] | float,
    enough: Float[Array, ""] | float,
    *given: Any,
) -> tuple[Float[Array, " P"], Float[Array, ""]]:
    """Finds the parameters of the lowest cost, and that cost.

    **Arguments:** `model`: from parameters of about unit size, and `given`, to `Normal`;
    `model` closes over no array. Each start has `few` steps. The best start goes on for
    `most` steps, until nothing is gained, or until costs `below` are out of reach. A start
    that reaches a cost less than `enough` within `few` steps is taken for the best: no
    other start is tried. A start of NaN is skipped; a first start of NaN means no descent.
    Under `vmap`, `together` frames are worked on at once.
    """
    n, count = starts.shape

    def begun(start: Array) -> _Descent:
        inf = jnp.full((), jnp.inf, starts.dtype)
        first = Normal(inf, jnp.eye(count, dtype=starts.dtype), 0 * start)
        none = jnp.zeros((), jnp.int32)
        # One start alone is the best.
        alone = ~jnp.isfinite(starts[1:]).any()
        number = jnp.where(alone, none + n, none)
        damping = jnp.full((), _DAMPING, starts.dtype)
        bent = 0 * first.matrix
        lost = ~jnp.isfinite(start).all()
        return _Descent(start, first, bent, damping, none, number, start, inf, lost)

    def turn(
        run: _Descent,
        starts: Array,
        limits: Limits,
        below: Array,
        enough: Array,
        *given: Any,
    ) -> _Descent:
        def once(_, run: _Descent) -> _Descent:
            stepped = _step(model, run, limits, below, given)
            stepped = _onward(stepped, starts, few, most, enough)
            return tree_where(run.ended, run, stepped)

        return lax.fori_loop(0, _TURN, once, run)

    bounds = (jnp.asarray(a, starts.dtype) for a in (below, enough))
    run = _compacting(turn, together)(begun(starts[0]), starts, limits, *bounds, *given)
    return run.parameters, run.normal.cost


@partial(jax.jit, static_argnums=0)
def _step(
    model: Callable, run: _Descent, limits: Limits, below: Array, given: tuple
) -> _Descent:
    matrix, gradient = run.normal.matrix, run.normal.gradient
    # What is at its highest and would be higher stays.
    free = (run.parameters < limits.highest) | (gradient > 0)
    unit = jnp.eye(len(free), dtype=matrix.dtype)
    own = run.damping * jnp.diagonal(matrix)
    both = jnp.stack([matrix + run.bent, matrix]) + own * unit
    both: Array = jnp.where(free[:, None] & free, both, unit)
    right = jnp.where(free, gradient, 0)
    moves = solve_positive(both, jnp.stack([right, right])[..., None])[..., 0]
    # Uphill: what is left out was no better than nothing.
    move = jnp.where(right @ moves[0] > 0, moves[0], moves[1])
    move = jnp.clip(move, -limits.longest, limits.longest)
    trial = jnp.minimum(run.parameters - move, limits.highest)
    move = run.parameters - trial
    new = model(trial, *given)
    better = new.cost < run.normal.cost + _SLACK
    damping = jnp.maximum(run.damping * jnp.where(better, _LESS, _MORE), _LEAST)
    promised = jnp.abs(gradient @ move)
    little = (jnp.abs(move).max() < _SMALL) | (promised < _LITTLE)
    # The first evaluation is that of the start itself: there is no cost before it.
    known = jnp.isfinite(run.normal.cost)
    nowhere = ~known & ~jnp.isfinite(new.cost)
    whole = better & (damping < _REACHING) & (run.steps >= _TRIED)
    beyond = whole & (new.cost - below > _REACH * promised)
    ended = (known & (better & little | beyond)) | (damping > _HOPELESS) | nowhere
    change = new.gradient - gradient
    near = known & (jnp.abs(move) < _NEAR * limits.longest).all()
    bent = jnp.where(near, _secant(run.bent, matrix, -move, change), run.bent)
    before = run.parameters, run.normal
    trial, new = tree_where(better, (trial, new), before)
    damping = jnp.where(known, damping, run.damping)
    return run._replace(
        parameters=trial,
        normal=new,
        bent=bent,
        damping=damping,
        steps=run.steps + 1,
        ended=ended,
    )


def _secant(
    bent: Float[Array, "P P"],
    matrix: Float[Array, "P P"],
    move: Float[Array, " P"],
    change: Float[Array, " P"],
) -> Float[Array, "P P"]:
    """Updates the part of the curvature that JᵀWJ leaves out (symmetric, of rank one).

    The update follows from how the gradient changed. If parameters are hardly
    distinguishable, this part is as large as JᵀWJ, and steps without this part swing.
    """
    missing = change - jnp.matmul(matrix + bent, move, precision="highest")
    along = missing @ move
    enough = 1e-3 * jnp.sqrt((missing @ missing) * (move @ move))
    sound = jnp.abs(along) > enough
    safe = jnp.where(sound, along, 1)
    return bent + jnp.where(sound, missing[:, None] * missing / safe, 0)


@partial(jax.jit, static_argnums=(2, 3))
def _onward(run: _Descent, starts: Array, few: int, most: int, enough: Array) -> _Descent:
    """Moves from a finished start to the next start, and from the last to the best.

    A start whose cost is good enough goes on as it is.
    """
    n = len(starts)
    last = run.start >= n
    over = run.ended | (run.steps >= jnp.where(last, most, few))
    good = over & ~last & (run.normal.cost < enough)
    better = over & ~last & (run.normal.cost < run.lowest)
    best = jnp.where(better, run.parameters, run.best)
    lowest = jnp.where(better, run.normal.cost, run.lowest)
    again = over & ~last & ~good
    number = jnp.where(again, run.start + 1, jnp.where(good, n, run.start))
    start = jnp.where(number < n, starts[jnp.minimum(number, n - 1)], best)
    inf, unit = jnp.full_like(lowest, jnp.inf), jnp.eye(len(start), dtype=start.dtype)
    fresh = run._replace(
        parameters=start,
        normal=Normal(inf, unit, 0 * start),
        bent=0 * unit,
        damping=jnp.full_like(run.damping, _DAMPING),
        steps=jnp.zeros_like(run.steps),
    )
    run = tree_where(again, fresh, run)
    ended = over & last | good & run.ended
    return run._replace(start=number, best=best, lowest=lowest, ended=ended)


def _compacting(turn: Callable[..., _Descent], together: int) -> Callable[..., _Descent]:
    """Repeats turns until all frames have ended; each has `together` unfinished frames."""

    @custom_vmap
    def run(state, *given):
        return lax.while_loop(lambda s: ~s.ended, lambda s: turn(s, *given), state)

    @run.def_vmap
    def _(size, batched, state, *given):
        axes = jax.tree.map(lambda one: 0 if one else None, tuple(batched[1:]))
        state = jax.tree.map(
            lambda a, one: a if one else jnp.broadcast_to(a, (size, *a.shape)),
            state,
            batched[0],
        )
        n = min(together, size)

        def some(state: _Descent) -> _Descent:
            # Those that have done least go first: all are worked on in turn.
            done = state.start * 1_000 + state.steps
            done = jnp.where(state.ended, jnp.iinfo(done.dtype).max, done)
            these = jnp.argsort(done, stable=True)[:n]
            part = jax.tree.map(lambda a: a[these], state)
            of = jax.tree.map(
                lambda a, one: a[these] if one else a, given, tuple(batched[1:])
            )
            new = jax.vmap(turn, (0, *axes), axis_size=n)(part, *of)
            return jax.tree.map(lambda a, b: a.at[these].set(b), state, new)

        found = lax.while_loop(lambda s: ~s.ended.all(), some, state)
        return found, jax.tree.map(lambda _: True, found)

    return run
