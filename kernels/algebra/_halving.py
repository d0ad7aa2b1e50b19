"""Lowers a cost by moves that someone else proposes; a move that fails is halved."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

# The shortest part of a step that is tried.
_SHORTEST = 1 / 32


class Run(NamedTuple):
    """The best w so far, and the step that is tried next."""

    w: Float[Array, "*n"]
    move: Float[Array, "*n"]
    part: Float[Array, ""]  # of the move
    cost: Float[Array, ""]  # with the prior's
    state: Any  # what was evaluated there
    steps: Int[Array, ""]
    ended: Bool[Array, ""]


def descended(
    evaluated: Callable[[Array], tuple[Array, Any]],
    move_from: Callable[[Array, Any], Array],
    start: Array,
    most: int,
    enough: float,
) -> Run:
    """Moves while each move lowers the cost by more than a part; halves a failed move.

    **Arguments:** `evaluated`: cost and state at w; `move_from`: the move from w and state;
    `most` evaluations; `enough`: the gain, as a part of the cost, that ends the descent.
    """

    def step(run: Run) -> Run:
        w = run.w + run.part * run.move
        cost, state = evaluated(w)
        steps = run.steps + 1

        def onward() -> Run:
            ended = run.cost - cost <= enough * cost
            # What would not be tried is not worked out.
            still = ~ended & (steps < most)
            move = lax.cond(still, move_from, lambda w, _: w, w, state)
            return Run(w, move, one, cost, state, steps, ended)

        def shorter() -> Run:
            short = run.part <= _SHORTEST
            return run._replace(part=run.part / 2, steps=steps, ended=short)

        return lax.cond(cost < run.cost, onward, shorter)

    def going(run: Run) -> Array:
        return ~run.ended & (run.steps < most)

    one = jnp.ones((), start.dtype)
    cost, state = jax.eval_shape(evaluated, start)
    nothing = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), state)
    highest = jnp.asarray(jnp.inf, cost.dtype)
    zero, ended = jnp.zeros((), int), jnp.zeros((), bool)
    first = Run(start, jnp.zeros_like(start), one, highest, nothing, zero, ended)
    return lax.while_loop(going, step, first)
