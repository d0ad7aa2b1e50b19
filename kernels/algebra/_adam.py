"""Descends a cost by slopes that are drawn at random, or change, from step to step."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

# How much of the mean slope is kept from step to step.
_MEAN = 0.9

# How much of the slope's mean square is kept from step to step.
_SQUARE = 0.99


def adam(slope: Callable[[Any, Any], Any], start: Any, given: Any, rate: float) -> Any:
    """Descends from `start` by Adam (Kingma and Ba, ICLR 2015), compiled.

    **Arguments:** `slope`: a function of the parameters and of a step's entry of `given`
    (the leading axis of `given` has one entry a step); `rate` the length of a step.
    **Returns:** parameters after the last step.
    """

    def step(state: tuple, some: Any) -> tuple[tuple, None]:
        parameters, mean, square, k = state
        new = slope(parameters, some)
        mean = jax.tree.map(lambda m, s: _MEAN * m + (1 - _MEAN) * s, mean, new)
        square = jax.tree.map(lambda q, s: _SQUARE * q + (1 - _SQUARE) * s**2, square, new)

        def moved(p: Array, m: Array, q: Array) -> Array:
            length = jnp.sqrt(q / (1 - _SQUARE**k)) + 1e-12
            return p - rate * (m / (1 - _MEAN**k)) / length

        return (jax.tree.map(moved, parameters, mean, square), mean, square, k + 1), None

    nothing = jax.tree.map(jnp.zeros_like, start)
    first = start, nothing, nothing, jnp.ones((), jnp.result_type(*jax.tree.leaves(start)))
    return jax.jit(lambda f, g: jax.lax.scan(step, f, g)[0][0])(first, given)
