"""Finds sets of ground conditions that make an objective small, and a lower bound.

`relax` finds the best weights and a bound that no set can beat; `greedy` adds one slot
after another; `exchange` swaps slots as long as swaps help.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from tomojax._checks import known, require
from tomojax._require import require_whole
from tomojax.kernels.algebra import least_weights, project_weights

# How sharply a largest figure stands for the maximum, from rough to fine.
_SHARPNESS = 10.0, 100.0, 1000.0

# Steps of each sharpness.
_STEPS = 200

# The gap between value and bound that is small enough, as a part of the value.
_GAP = 1e-4

# The last values that a step must not exceed all of: a nonmonotone search takes the lengths
# of Barzilai and Borwein as they are.
_MEMORY = 5


class Relaxed(NamedTuple):
    """The best weights found, their value, and a bound below all sets' values.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> tells = jnp.array([1.0, 2.0, 3.0, 4.0])  # of each slot
    >>> found = tx.design.relax(lambda w: 1 / (w @ tells)[None], slots=4, n=2)
    >>> print(f"{float(found.value):.3f}, no set is below {float(found.bound):.3f}")
    0.143, no set is below 0.143
    """

    weights: Float[Array, " L"]
    value: Float[Array, ""]
    bound: Float[Array, ""]
    steps: Int[Array, ""]


class _State(NamedTuple):
    weights: Array
    value: Array
    slope: Array
    before: Array  # the last values
    length: Array
    bound: Array
    done: Array
    steps: Array


Figures = Callable[[Float[Array, " L"]], Float[Array, " P"]]


def relax(figures: Figures, slots: int, n: int, worst: bool = False, dtype=None) -> Relaxed:
    """Finds weights 0 ≤ w ≤ 1, Σw = `n` that make the mean (or largest) figure least.

    Spectral projected gradients (Birgin, Martínez, Raydan, SIAM J. Optim. 10, 2000). The
    bound is Σ_k π_k f_k(w) + min_v Σ_k π_k ∇f_k·(v − w) over sets v. The bound holds for
    convex figures f_k and any π: the mean's, or those of a soft maximum.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import numpy as np
    >>> import tomojax as tx
    >>> tells = jnp.array([1.0, 2.0, 3.0, 4.0])  # of each slot
    >>> found = tx.design.relax(lambda w: 1 / (w @ tells)[None], slots=4, n=2)
    >>> print(np.round(np.abs(found.weights), 2))
    [0. 0. 1. 1.]
    """
    start = jnp.full(slots, n / slots, dtype)
    scale = figures(start).max()

    def sharpened(best: Relaxed, sharp: Array) -> tuple[Relaxed, None]:
        def value(w: Array) -> tuple[Array, Array]:
            f = figures(w)
            if not worst:
                return f.mean(), f.mean()
            tilted = sharp * f / scale
            shares = lax.stop_gradient(jax.nn.softmax(tilted))
            return jax.nn.logsumexp(tilted) * scale / sharp, (shares * f).sum()

        return _descend(value, best, n), None

    best = Relaxed(start, scale, jnp.full_like(scale, -jnp.inf), jnp.zeros((), int))
    sharpness = jnp.asarray(_SHARPNESS if worst else (1.0,), scale.dtype)
    best, _ = lax.scan(sharpened, best, sharpness)
    f = figures(best.weights)
    return best._replace(value=f.max() if worst else f.mean())


def _descend(figure: Callable, best: Relaxed, n: int) -> Relaxed:
    """Descends from `best`; `figure` returns a value, and that of the bound's line."""
    count = jnp.asarray(n, best.weights.dtype)
    both = jax.value_and_grad(figure, has_aux=True)

    def bounded(w: Array, slope: Array, linear: Array) -> Array:
        return linear + (slope * (least_weights(slope, n) - w)).sum()

    def step(s: _State) -> _State:
        towards = project_weights(s.weights - s.length * s.slope, count) - s.weights
        fall = (s.slope * towards).sum()

        def too_far(part: Array) -> Array:
            value = figure(s.weights + part * towards)[0]
            enough = value <= s.before.max() + 1e-4 * part * fall
            return ~enough & (part > 1e-6)

        part = lax.while_loop(too_far, lambda p: p / 2, jnp.ones_like(s.value))
        weights = s.weights + part * towards
        (value, linear), slope = both(weights)
        moved, changed = weights - s.weights, slope - s.slope
        curved: Array = (moved * changed).sum()
        length = jnp.where(curved > 0, (moved**2).sum() / curved, 4 * s.length)
        longest = 1e6 / (jnp.abs(slope).max() + 1e-30)
        bound = jnp.maximum(s.bound, bounded(weights, slope, linear))
        before = jnp.concatenate([s.before[1:], value[None]])
        done = (value - bound <= _GAP * jnp.abs(value)) | (jnp.abs(towards).max() < 1e-9)
        length = jnp.clip(length, 1e-9 * longest, longest)
        return _State(weights, value, slope, before, length, bound, done, s.steps + 1)

    (value, linear), slope = both(best.weights)
    first = _State(
        weights=best.weights,
        value=value,
        slope=slope,
        before=jnp.full(_MEMORY, value),
        length=1 / (jnp.abs(slope).max() + 1e-30),
        bound=jnp.maximum(best.bound, bounded(best.weights, slope, linear)),
        done=jnp.array(False),
        steps=best.steps,
    )
    limit = best.steps + _STEPS
    end = lax.while_loop(lambda s: ~s.done & (s.steps < limit), step, first)
    return Relaxed(end.weights, end.value, end.bound, end.steps)


def greedy(value: Callable, slots: int, n: int, dtype=None) -> Float[Array, " L"]:
    """Builds a set slot by slot, each time with the best slot."""
    each = jnp.eye(slots, dtype=dtype)

    def add(_: Array, chosen: Array) -> Array:
        values: Array = lax.map(lambda one: value(jnp.minimum(chosen + one, 1)), each)
        return chosen + each[jnp.argmin(jnp.where(chosen > 0, jnp.inf, values))]

    return lax.fori_loop(0, n, add, jnp.zeros(slots, dtype))


def exchange(
    value: Callable, chosen: Float[Array, " L"], n: int, tried: int | None = None
) -> Float[Array, " L"]:
    """Swaps one slot for another, each time the best swap, while swaps help.

    `value` gives the figure of weights (L,), such as an objective's `value`; `chosen` has 1
    for each of the `n` slots of the set to begin with, and 0 for the others.
    `tried` limits the swaps looked at each time to those that the slope promises most of.
    (A convex objective's slope tells how much a swap can help at most.)
    """
    slots = len(chosen)
    require_whole("n", n, 1, slots)
    if known(chosen):
        held = int((np.asarray(chosen) > 0).sum())
        require(held == n, "chosen", f"{held} slots above 0", f"n of them, {n}")
    if n == slots:
        return chosen
    pairs = jnp.stack(
        jnp.meshgrid(jnp.arange(n), jnp.arange(slots - n), indexing="ij"), -1
    ).reshape(-1, 2)

    def step(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        chosen, now, _ = state
        order = jnp.argsort(-chosen)
        inside, outside = order[:n], order[n:]
        some = pairs
        if tried is not None:
            slope = jax.grad(value)(chosen)
            gain = slope[outside[pairs[:, 1]]] - slope[inside[pairs[:, 0]]]
            some = pairs[lax.top_k(-gain, min(tried, len(pairs)))[1]]

        def swapped(pair: Array) -> Array:
            return chosen.at[inside[pair[0]]].set(0).at[outside[pair[1]]].set(1)

        values: Array = lax.map(lambda pair: value(swapped(pair)), some)
        best = jnp.argmin(values)
        helps = values[best] < now * (1 - 1e-6)
        return (
            jnp.where(helps, swapped(some[best]), chosen),
            jnp.where(helps, values[best], now),
            helps,
        )

    start = chosen, value(chosen), jnp.array(True)
    return lax.while_loop(lambda s: s[2], step, start)[0]
