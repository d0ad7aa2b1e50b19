"""Estimates one frame as a function of the sensor, which may be differentiated."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from tomojax._custom_types import Numbers
from tomojax._require import require
from tomojax.methods._contract import Estimate
from tomojax.methods._names import method
from tomojax.methods.points import Points
from tomojax.sensor import Sensor


def estimate(
    sensor: Sensor,
    voltages: Float[Array, "S M"],
    grounds: Numbers,
    name: str = "points",
    *,
    contacts: int = 1,
    grid: int | None = None,
) -> Estimate:
    """Estimates the contacts of one frame; differentiable in the sensor and the voltages.

    The fit follows its optimum's own rule. A method's tables are made on the host: their
    slopes by the sensor are differences of two tables, along the tangent (`jax.jvp`), or
    along each number that is differentiated (`jax.grad`, two tables each). The sensor must
    be known: `jax.jit` around it raises JAX's error for that.

    **Arguments:** `voltages` (S, M), V; `grounds` (S,); `name` and `grid` as in `method`.
    **Raises:** `ValueError` as `method`, and where a method's tables change their sizes
    within the step of a difference.

    **Example:**

    >>> import jax
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> touch, grounds = tx.Disc([0.03, 0.05], 0.006, 1.0), [0, 15]
    >>> volts = tx.voltages(sensor, touch, grounds)
    >>> found = tx.methods.estimate(sensor, volts, grounds, grid=16)
    >>> print((1e3 * found.contacts.xy[0]).round())
    [30. 50.]
    """
    model, prepared = _ready(sensor, np.asarray(grounds), voltages.shape, name, grid)
    return _estimated(model, prepared, voltages, contacts)


_estimated = eqx.filter_jit(lambda model, *given: model.estimate(*given))


@eqx.filter_custom_jvp
def _ready(sensor: Sensor, grounds: Any, shape: tuple, name: str, grid: int | None) -> Any:
    """Makes the method and its preparation for slots, all arrays of JAX."""
    model = method(sensor, name, grid)
    if isinstance(model, Points):
        model = replace(model, exact=True)
    good = np.ones(shape, bool)
    prepared = model.prepare(np.asarray(grounds), good, model.choose_lambda([]))
    return jax.tree.map(jnp.asarray, (model, prepared))


@_ready.def_jvp
def _(primals: tuple, tangents: tuple) -> tuple[Any, Any]:
    sensor, *given = primals
    made = _ready(sensor, *given)
    leaves, tree = jax.tree.flatten(tangents[0])
    values = jax.tree.leaves(_beside(sensor, tangents[0]))
    if not any(isinstance(leaf, Tracer) for leaf in leaves):
        return made, _difference(made, sensor, tangents[0], given)
    total: Any = None
    for which, value in enumerate(values):
        for number in range(value.size):
            unit = np.zeros(value.size)
            unit[number] = 1
            along = [jnp.zeros_like(v) for v in values]
            along[which] = jnp.asarray(unit.reshape(value.shape), value.dtype)
            part = leaves[which].reshape(-1)[number]
            slope = _difference(made, sensor, jax.tree.unflatten(tree, along), given)
            slope = jax.tree.map(lambda s, part=part: s * part, slope)
            total = slope if total is None else jax.tree.map(jnp.add, total, slope)
    return made, total


def _beside(sensor: Sensor, tangent: Any) -> Any:
    """Returns the sensor's arrays that have a tangent."""
    found = lambda t, a: None if t is None else a  # noqa: E731
    return jax.tree.map(found, tangent, sensor, is_leaf=lambda t: t is None)


def _difference(made: Any, sensor: Sensor, tangent: Any, given: list) -> Any:
    """Computes the tables' slopes along a tangent, by central differences."""
    values, ways = (jax.tree.leaves(t) for t in (_beside(sensor, tangent), tangent))
    parts = [float(abs(w).max() / max(abs(v).max(), 1e-30)) for v, w in zip(values, ways)]
    # The cube root balances a difference's rounding and its own error.
    step = float(jnp.finfo(values[0].dtype).eps) ** (1 / 3) / (max(parts) or 1.0)

    def at(side: float) -> Any:
        add = lambda t, a: a if t is None else a + side * step * t  # noqa: E731
        moved = jax.tree.map(add, tangent, sensor, is_leaf=lambda t: t is None)
        return _ready(moved, *given)

    one, other = at(1.0), at(-1.0)
    shapes = [jax.tree.map(jnp.shape, tree) for tree in (one, made, other)]
    alike = shapes[0] == shapes[1] == shapes[2]
    require(alike, "sensor", "tables of other sizes a step aside", "a sensor beside it")

    def slope(a: Array, b: Array) -> Array | None:
        return (a - b) / (2 * step) if eqx.is_inexact_array(a) else None

    return jax.tree.map(slope, one, other)
