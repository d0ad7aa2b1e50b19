"""Finds λ and sets of slots by gradients through simulated images."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float

from tomojax.design.objectives import ImageError
from tomojax.kernels.algebra import adam, draw_subset, drawn_weights, heaviest

# Sets that are drawn in the end.
_LAST = 64

# Decades of λ on both sides that are tried at first, and steps from the best of them.
_DECADES, _STEPS = 3, 12

# How often a search is gone on with; the least λ, of what is rounded off the slots' sum.
_SCANS, _LEAST = 4, 1e-3


def _in_reach(objective: ImageError) -> ImageError:
    """Clips λ into reach of a descent: images beyond are rounding, or 0."""
    total = jnp.trace(objective.grams.sum(0))
    low = _LEAST * jnp.finfo(objective.dtype).eps * total
    log_lam = jnp.clip(objective.log_lam, jnp.log(low), jnp.log(total))
    return replace(objective, log_lam=log_lam)


class Tuned(NamedTuple):
    """An objective with its best λ and length, and the number of solves."""

    objective: ImageError
    value: Float[Array, ""]
    solves: int  # systems that were solved, one with its gradient counting as two


def tune(objective: ImageError, weights: Float[Array, " L"]) -> Tuned:
    """Finds the λ (and length) of least mean error.

    A few λ, a decade apart, are tried about the objective's own λ. The search moves on
    while the best λ is at an end. BFGS starts from the best λ.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = tx.design.design_places(sensor, count=4)
    >>> scenes = tx.design.simulate_scenes(sensor, places, rigs=1)
    >>> method = tx.method(sensor, "linear", grid=16)
    >>> objective = tx.design.ImageError.of(method, scenes, width=0.008)
    >>> tuned = tx.design.tune(objective, jnp.ones(16))
    >>> bool(tuned.value <= objective.value(jnp.ones(16))), tuned.objective.lam > 0
    (True, True)
    """
    objective = _in_reach(objective)

    def value(parameters: tuple, rest: tuple) -> tuple[Array, Array]:
        log_lam, log_length = parameters
        one, weights = rest
        now = replace(one, log_lam=log_lam, log_length=log_length)
        return now.value(weights), jnp.zeros(())

    apart = jnp.arange(-_DECADES, _DECADES + 1, dtype=objective.dtype)
    middle, length = objective.log_lam, objective.log_length
    rest = objective, weights
    coarse = jax.jit(
        lambda r, some: jax.lax.map(lambda lam: value((lam, length), r)[0], some)
    )
    scans, best = 0, -1
    while scans < _SCANS and best in (-1, 0, len(apart) - 1):
        lams = middle + float(np.log(10)) * apart
        # What is no number is no minimum.
        best = int(jnp.argmin(jnp.nan_to_num(coarse(rest, lams), nan=jnp.inf)))
        middle, scans = lams[best], scans + 1
    solver = optimistix.BFGS(rtol=1e-3, atol=1e-3)
    found = optimistix.minimise(
        value,
        solver,
        (middle, length),
        rest,
        has_aux=True,
        max_steps=_STEPS,
        throw=False,
    )
    log_lam, log_length = found.value
    best = replace(objective, log_lam=log_lam, log_length=log_length)
    solves = scans * len(apart) + 2 * int(found.stats["num_steps"])
    return Tuned(best, best.value(weights), solves)


class Drawn(NamedTuple):
    """The result of `descend_sets`."""

    weights: Float[Array, " L"]
    logits: Float[Array, " L"]
    objective: ImageError


def descend_sets(
    objective: ImageError,
    n: int,
    *,
    steps: int = 200,
    draws: int = 4,
    rate: float = 0.2,
    seed: int = 0,
) -> Drawn:
    """Finds sets of `n` slots and λ together, by gradients through drawn sets.

    Sets come from `subset_marginals`' distribution, gradients by SIMPLE (`drawn_weights`),
    steps by Adam (Kingma and Ba, ICLR 2015). The best of some last sets is the result.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = tx.design.design_places(sensor, count=4)
    >>> scenes = tx.design.simulate_scenes(sensor, places, rigs=1)
    >>> method = tx.method(sensor, "linear", grid=16)
    >>> objective = tx.design.ImageError.of(method, scenes, width=0.008)
    >>> found = tx.design.descend_sets(objective, 2, steps=4, draws=2)
    >>> int(found.weights.sum()), found.weights.shape
    (2, (16,))
    """
    objective = _in_reach(objective)
    logits = jnp.zeros(objective.slots, objective.log_lam.dtype)

    def value(parameters: tuple[Array, Array], keys: Array) -> Array:
        logits, log_lam = parameters
        now = replace(objective, log_lam=log_lam)
        one = lambda key: now.value(drawn_weights(key, logits, n))  # noqa: E731
        return jax.vmap(one)(keys).mean()

    def slope(parameters: tuple[Array, Array], key: Array) -> tuple[Array, Array]:
        return jax.grad(value)(parameters, jax.random.split(key, draws))

    keys = jax.random.split(jax.random.key(seed), steps)
    logits, log_lam = adam(slope, (logits, objective.log_lam), keys, rate)
    now = replace(objective, log_lam=log_lam)
    keys = jax.random.split(jax.random.key(seed), _LAST)
    sets = (
        jax.vmap(lambda key: draw_subset(key, logits, n))(keys)
        .at[0]
        .set(heaviest(logits, n))
    )
    values = jax.jit(lambda o, w: jax.lax.map(o.value, w))(now, sets)
    return Drawn(sets[jnp.argmin(values)], logits, now)
