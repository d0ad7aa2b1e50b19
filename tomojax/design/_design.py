"""Designs sets of ground conditions; compares them with the best possible and patterns."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, Integer

from tomojax._require import require, require_kind, require_whole
from tomojax._shown import html_table, named, shown
from tomojax.design._search import exchange, greedy, relax, Relaxed
from tomojax.design.objectives._information import AbstractObjective
from tomojax.kernels.algebra import draw_subset, heaviest
from tomojax.paper import AdaptiveScan, pattern, PATTERNS
from tomojax.sensor import Sensor
from tomojax.step import ADAPTIVE

# Further sets that exchanges begin at.
_DRAWN = 4


class Design(NamedTuple):
    """A set of ground conditions, and the values that the search found.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = tx.design.design_places(sensor, count=4)
    >>> objective = tx.design.design_objective(sensor, places, "points", "place")
    >>> found = tx.design.design(objective, slots=2)
    >>> found.value <= found.greedy, found.weights.shape, found.unit
    (True, (16,), 'm')
    """

    grounds: Int[np.ndarray, " n"]  # each adds most to those before it
    value: float  # of the objective
    bound: float  # no set of as many slots is below it; NaN where the objective has none
    weights: Float[np.ndarray, " L"]  # the relaxed problem's
    relaxed: float  # their value
    rounded: float  # the value of the heaviest n of them
    greedy: float  # of one slot after another
    unit: str

    def __repr__(self) -> str:
        return named(self, **dict(self._told()))

    def _repr_html_(self) -> str:
        return html_table(self._told(), title="Design")

    def _told(self) -> list[tuple[str, str]]:
        values = [(n, shown(getattr(self, n), self.unit)) for n in ("value", "bound")]
        return [("grounds", str(self.grounds.tolist())), *values]


def design(objective: AbstractObjective, slots: int = 8) -> Design:
    """Finds the best set of `slots` ground conditions, each once.

    Exchanges improve the relaxed problem's heaviest slots, a greedy search's set, and sets
    drawn by the relaxed weights. The best set is the result. `bound` tells how far from the
    best possible the result can be at most; NaN where the objective is not convex.
    **Raises:** `ValueError` for a number of slots outside 1 to the objective's, and for an
    objective without a finite value.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = tx.design.design_places(sensor, count=4)
    >>> objective = tx.design.design_objective(sensor, places, "points", "place")
    >>> found = tx.design.design(objective, slots=2)
    >>> found.grounds.shape, found.bound <= found.value
    ((2,), True)
    """
    require_kind("objective", objective, AbstractObjective)
    require_whole("slots", slots, 1, objective.slots)
    n = int(slots)
    best, values, relaxed = _search(objective, n)
    least = float(values["best"])
    require(np.isfinite(least), "objective", f"{least} for the best set", "a finite value")
    return Design(
        grounds=_ordered(objective, np.flatnonzero(np.asarray(best) > 0.5)),
        value=least,
        bound=float(relaxed.bound) if objective.convex else float("nan"),
        weights=np.asarray(relaxed.weights),
        relaxed=float(relaxed.value),
        rounded=float(values["rounded"]),
        greedy=float(values["greedy"]),
        unit=objective.unit,
    )


@partial(jax.jit, static_argnums=1)
def _search(
    objective: AbstractObjective, n: int
) -> tuple[Float[Array, " L"], dict[str, Array], Relaxed]:
    """Returns the best set, the values of sets by name, and the relaxed solution."""
    value, count, dtype = objective.value, objective.slots, objective.dtype
    relaxed = relax(objective, count, n, objective.worst, dtype)
    sets = {
        "rounded": heaviest(relaxed.weights, n),
        "greedy": greedy(value, count, n, dtype),
    }
    # Sets drawn by those weights, which count alike where they are no numbers: exchanges
    # end in the best nearby.
    inside = jnp.clip(jnp.nan_to_num(relaxed.weights, nan=n / count), 0.01, 0.99)
    logits = jnp.log(inside / (1 - inside))
    keys = jax.random.split(jax.random.key(0), _DRAWN)
    drawn = jax.vmap(lambda key: draw_subset(key, logits, n))(keys)
    starts = jnp.concatenate([jnp.stack(list(sets.values())), drawn])
    ends = lax.map(lambda chosen: exchange(value, chosen, n, objective.swaps), starts)
    sets["best"] = ends[jnp.nanargmin(lax.map(value, ends))]
    values = lax.map(value, jnp.stack(list(sets.values())))
    return sets["best"], dict(zip(sets, values)), relaxed


def _ordered(objective: AbstractObjective, grounds: np.ndarray) -> Int[np.ndarray, " n"]:
    """Orders grounds: each next ground lowers the objective most."""
    each = jnp.eye(objective.slots, dtype=objective.dtype)
    left, order, weights = grounds.tolist(), [], 0 * each[0]
    while left:
        scores = [float(value_of(objective, weights + each[g])) for g in left]
        order.append(left.pop(int(np.argmin(scores))))
        weights = weights + each[order[-1]]
    return np.array(order, int)


@jax.jit
def value_of(objective: AbstractObjective, weights: Float[Array, " L"]) -> Float[Array, ""]:
    """Rates one set of slots, compiled."""
    return objective.value(weights)


def patterns_beside(
    sensor: Sensor,
    objective: AbstractObjective,
    explored: Float[Array, "P 2 M"],
) -> list[dict[str, Any]]:
    """Rates the paper's nine patterns by the objective: name, slots, value, adaptive.

    Adaptive patterns have their own set for each of the P contacts, from its `explored`
    voltages. Their two exploratory slots are not counted, nor does the paper count them.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = tx.design.design_places(sensor, count=4)
    >>> objective = tx.design.design_objective(sensor, places, "points", "place")
    >>> explored = tx.design.exploratory_voltages(sensor, places)
    >>> rows = tx.design.patterns_beside(sensor, objective, explored)
    >>> [(row["name"], row["slots"]) for row in rows[:3]]
    [('all', 16), ('around', 8), ('cop_line', 8)]
    """
    rows = []
    for name in PATTERNS:
        adaptive = name in ADAPTIVE
        sets = grounds_of_each(sensor, name, explored)
        chosen = np.zeros((len(sets), objective.slots))
        np.put_along_axis(chosen, sets, 1, 1)
        weights = jnp.asarray(chosen, objective.dtype)
        if adaptive:
            figures = each_its_own(objective, weights)
            value = float(figures.max() if objective.worst else figures.mean())
        else:
            value = float(value_of(objective, weights[0]))
        slots = sets.shape[1]
        rows.append({"name": name, "slots": slots, "value": value, "adaptive": adaptive})
    return rows


def grounds_of_each(
    sensor: Sensor, one: str | np.ndarray, explored: Float[Array, "P 2 M"], seed: int = 0
) -> Integer[np.ndarray, "P L"]:
    """Returns the grounds of each contact: a pattern's by its name, or those given."""
    if isinstance(one, str) and one in ADAPTIVE:
        scan = AdaptiveScan(sensor, one)  # pyright: ignore
        return np.asarray(jax.jit(jax.vmap(lambda v: scan(v)[0]))(explored))
    grounds = np.asarray(pattern(sensor, one, seed=seed) if isinstance(one, str) else one)
    return np.broadcast_to(grounds, (len(explored), len(grounds)))


@jax.jit
def each_its_own(
    objective: AbstractObjective, weights: Float[Array, "P L"]
) -> Float[Array, " P"]:
    """Computes figure k under weights k; NaN for an objective with one figure for all."""

    def one(k_and_weights: tuple[Array, Array]) -> Array:
        k, w = k_and_weights
        figures = objective(w)
        return figures[k] if len(figures) == len(weights) else jnp.full((), jnp.nan)

    return lax.map(one, (jnp.arange(len(weights)), weights))
