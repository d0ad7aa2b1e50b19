"""Finds λ and sets of slots by gradients through an objective."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float

from tomojax._require import require, require_whole
from tomojax.design.objectives._information import AbstractObjective
from tomojax.kernels.algebra import adam, draw_subset, drawn_weights, heaviest

# Sets that are drawn in the end.
_LAST = 64

# Decades of λ on both sides that are tried at first.
_DECADES = 3

# Steps from the best of these.
_STEPS = 12

# How often a search for λ is gone on with.
_SCANS = 4


def _parameters(objective: AbstractObjective) -> list:
    """ln λ, and ln of a length where the objective has one."""
    names = ("log_lam", "log_length")
    some = [getattr(objective, name, None) for name in names]
    return [p for p in some if p is not None]


def _with(objective: AbstractObjective, parameters: list[Array]) -> AbstractObjective:
    return eqx.tree_at(_parameters, objective, parameters)


def _startable(objective: AbstractObjective) -> AbstractObjective:
    """Returns the objective with parameters in reach of a descent."""
    has = isinstance(getattr(objective, "log_lam", None), jax.Array)
    need = "one with ln λ as its field log_lam, a JAX array"
    require(has, "objective", f"{type(objective).__name__} without log_lam", need)
    return objective.in_reach()


class Tuned(NamedTuple):
    """An objective with its best λ and length, and the number of solves."""

    objective: AbstractObjective
    value: Float[Array, ""]
    solves: int  # systems that were solved, one with its gradient counting as two


def tune(objective: AbstractObjective, weights: Float[Array, " L"]) -> Tuned:
    """Finds the λ (and length) that make the objective least for these slots.

    A few λ, a decade apart, are tried about the objective's own λ. The search moves on
    while the best λ is at an end. BFGS starts from the best λ. An objective of your own
    takes part if it has ln λ as its field `log_lam`; a field `log_length` is tuned too.
    **Raises:** `ValueError` for an objective without `log_lam`.

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
    objective = _startable(objective)
    middle, *lengths = _parameters(objective)
    apart = jnp.arange(-_DECADES, _DECADES + 1, dtype=middle.dtype)
    values, scans, best = jnp.full_like(apart, jnp.inf), 0, -1
    while scans < _SCANS and best in (-1, 0, len(apart) - 1):
        lams = middle + float(np.log(10)) * apart
        # What is no number is no minimum.
        values = jnp.nan_to_num(_tried(objective, weights, lams), nan=jnp.inf)
        best = int(jnp.argmin(values))
        middle, scans = lams[best], scans + 1
    # BFGS ends by absolute tolerances: the objective's unit must not matter.
    scale = jnp.maximum(jnp.abs(values[best]), jnp.finfo(values.dtype).tiny)
    solver = optimistix.BFGS(rtol=1e-3, atol=1e-3)
    start, given = [middle, *lengths], (objective, weights, scale)
    found = optimistix.minimise(_value, solver, start, given, max_steps=_STEPS, throw=False)
    tuned = _with(objective, found.value)
    solves = scans * len(apart) + 2 * int(found.stats["num_steps"])
    return Tuned(tuned, tuned.value(weights), solves)


def _value(parameters: list[Array], given: tuple) -> Array:
    objective, weights, scale = given
    return _with(objective, parameters).value(weights) / scale


@eqx.filter_jit
def _tried(objective: AbstractObjective, weights: Array, lams: Array) -> Array:
    lengths = _parameters(objective)[1:]
    return jax.lax.map(lambda lam: _with(objective, [lam, *lengths]).value(weights), lams)


class Drawn(NamedTuple):
    """The result of `descend_sets`."""

    weights: Float[Array, " L"]
    logits: Float[Array, " L"]
    objective: AbstractObjective


def descend_sets(
    objective: AbstractObjective,
    n: int,
    *,
    steps: int = 200,
    draws: int = 4,
    rate: float = 0.2,
    seed: int = 0,
) -> Drawn:
    """Finds sets of `n` slots and λ together, by gradients through drawn sets.

    Sets come from `subset_marginals`' distribution, gradients by SIMPLE (`drawn_weights`),
    steps by Adam (Kingma and Ba, ICLR 2015). The best of some last sets is the result. An
    objective of your own takes part if it has ln λ as its field `log_lam`.
    **Raises:** `ValueError` for an objective without `log_lam`.

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
    require_whole("n", n, 1, objective.slots)
    require_whole("steps", steps)
    require_whole("draws", draws)
    keys = jax.random.split(jax.random.key(seed), steps)
    logits, now = _descended(_startable(objective), keys, n, draws, rate)
    keys = jax.random.split(jax.random.key(seed), _LAST)
    sets = jax.vmap(lambda key: draw_subset(key, logits, n))(keys)
    sets = sets.at[0].set(heaviest(logits, n))
    return Drawn(sets[jnp.argmin(_values(now, sets))], logits, now)


@eqx.filter_jit
def _values(objective: AbstractObjective, sets: Float[Array, "n L"]) -> Float[Array, " n"]:
    return jax.lax.map(objective.value, sets)


@eqx.filter_jit
def _descended(
    objective: AbstractObjective, keys: Array, n: int, draws: int, rate: float
) -> tuple[Array, AbstractObjective]:
    first, *lengths = _parameters(objective)
    logits = jnp.zeros(objective.slots, first.dtype)

    def value(parameters: tuple[Array, Array], keys: Array) -> Array:
        logits, log_lam = parameters
        now = _with(objective, [log_lam, *lengths])
        one = lambda key: now.value(drawn_weights(key, logits, n))  # noqa: E731
        return jax.vmap(one)(keys).mean()

    def slope(parameters: tuple[Array, Array], key: Array) -> tuple[Array, Array]:
        return jax.grad(value)(parameters, jax.random.split(key, draws))

    logits, log_lam = adam(slope, (logits, first), keys, rate)
    return logits, _with(objective, [log_lam, *lengths])
