"""Designs tables of ground conditions by place, for a step to look up."""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax._require import require, require_whole
from tomojax.design._search import exchange, greedy, relax
from tomojax.design.objectives._image_error import ImageError
from tomojax.design.objectives._information import AbstractObjective
from tomojax.design.objectives._problem import design_objective
from tomojax.design.objectives._rigs import simulate_scenes
from tomojax.kernels.algebra import heaviest
from tomojax.kernels.sheet import cell_centres
from tomojax.methods import Linear, Source
from tomojax.paper import exploration
from tomojax.sensor import Sensor
from tomojax.step import Lookup

# Swaps that are looked at for each place.
_TRIED = 16

# Places that are computed side by side.
_TOGETHER = 64

# Places of a table.
_SHAPES = {"points": (32, 32), "linear": (24, 24), "source": (16, 16)}

# λ/σ₁² that are tried for each place.
_LAMS = np.logspace(-7.5, -2, 12)

# Pixels along a side of the images that λ is tried on.
_PIXELS = 32

# The width of a contact in those images (σ), of the pitch.
_WIDTH = 0.4

# What a set may be worse by, as a part, to have as many grounds in common with its
# neighbours' as it has.
_SMOOTH = 0.02

# How often all sets are gone through.
_PASSES = 4


class PlaceDesigns(NamedTuple):
    """A set of slots for each of nx × ny places.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> found = tx.design.design_policy(sensor, slots=2, shape=(2, 2), criterion="place")
    >>> found.policy.table.shape, found.value.shape
    ((2, 2, 2), (2, 2))
    >>> bool((found.bound <= found.value).all())
    True
    """

    policy: Lookup
    value: Float[np.ndarray, "nx ny"]  # of the objective
    bound: Float[np.ndarray, "nx ny"]  # NaN where the objective has none


def design_policy(
    sensor: Sensor,
    slots: int = 8,
    method: str = "points",
    shape: tuple[int, int] | None = None,
    **options: Any,
) -> PlaceDesigns:
    """Finds the best `slots` grounds for a contact at each place, as a policy.

    Each place has the relaxed problem's heaviest slots, improved by exchanges. Sets that
    differ from their neighbours' then give way to a set with more in common, 2 % worse at
    most. So little changes at a seam. Designs for images have a λ for each place
    (`place_lambdas`).

    **Arguments:** `method` and `options` are those of `design_objective`. The default
    criterion of "points" and "linear" is "rigs" (errors that slots share count), of a table
    of conditions "place". `shape` of
    the table is (32, 32) by default; (24, 24) of "linear" and (16, 16) of "source", which
    take longer.
    **Raises:** `ValueError` as `design_objective` does, and for a number of slots outside
    1 to the electrodes'.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> found = tx.design.design_policy(sensor, slots=2, shape=(2, 2), criterion="place")
    >>> found.policy.table.shape  # two grounds for each of 2 × 2 places
    (2, 2, 2)
    >>> tx.step.save_policy(found.policy, "table.npz")  # for `make_step` or `tomojax live`
    """
    require_whole("slots", slots, 1, sensor.condition_count)
    whole = method != "points" and options.get("criterion") == "d"
    require(not whole, "criterion", "'d' of an image", "one with a figure for each place")
    nx, ny = shape or _SHAPES.get(method, (16, 16))
    size = np.asarray(sensor.size, float)
    places = cell_centres((nx, ny)) * size
    alone = sensor.conditions is None
    if alone and method != "source" and options.get("noise") is None:
        options.setdefault("criterion", "rigs")
    objective = design_objective(sensor, places, method, **options)
    sets, bound = designs_by_place(objective, int(slots))
    sets, value = _smoothed(objective, sets, (nx, ny))
    # Nearest first: several contacts share the slots, and what is nearest tells most.
    away = np.linalg.norm(np.asarray(sensor.ground_xy()) - places[:, None], axis=-1)
    away = np.where(np.asarray(sets) > 0.5, away, np.inf)
    grounds = np.argsort(away, 1, kind="stable")[:, :slots]
    table = jnp.asarray(grounds.reshape(nx, ny, slots), jnp.int32)
    idle = jnp.resize(exploration(sensor), (slots,)).astype(jnp.int32)
    lams = None
    if method != "points":
        lams = place_lambdas(sensor, method, places, sets, (nx, ny))
    return PlaceDesigns(
        policy=Lookup(table, idle, sensor.size, lams),
        value=np.asarray(value).reshape(nx, ny),
        bound=np.asarray(bound).reshape(nx, ny),
    )


@partial(jax.jit, static_argnums=1)
def designs_by_place(
    objective: AbstractObjective, n: int
) -> tuple[Float[Array, "P L"], Float[Array, " P"]]:
    """Finds the best set of n slots for each place alone, and each place's bound."""
    slots, dtype = objective.slots, objective.dtype
    count = jax.eval_shape(objective, jnp.ones(slots, dtype)).shape[0]

    def one(k: Array) -> tuple[Array, Array]:
        alone = objective.alone(k)
        if not objective.convex:
            start = greedy(alone.value, slots, n, dtype)
            unknown = jnp.full((), jnp.nan, dtype)
            return exchange(alone.value, start, n, objective.swaps), unknown
        best = relax(alone, slots, n, dtype=dtype)
        start = heaviest(best.weights, n)
        return exchange(alone.value, start, n, _TRIED), best.bound

    return jax.lax.map(one, jnp.arange(count), batch_size=min(_TOGETHER, count))


def _smoothed(
    objective: AbstractObjective, sets: Float[Array, "P L"], shape: tuple[int, int]
) -> tuple[Array, Array]:
    """Returns sets that have more in common with their neighbours', and their values."""
    places, n = jnp.arange(len(sets)), sets[0].sum()

    def values(sets: Array) -> Array:
        one = lambda k, w: objective.alone(k).value(w)  # noqa: E731
        return jax.lax.map(lambda x: one(*x), (places, sets), batch_size=_TOGETHER)

    def beside(sets: Array) -> Array:
        """Returns neighbours' sets (4, P, L); at an edge the place's own."""
        grid = jnp.pad(sets.reshape(*shape, -1), ((1, 1), (1, 1), (0, 0)), mode="edge")
        shifted = grid[2:, 1:-1], grid[:-2, 1:-1], grid[1:-1, 2:], grid[1:-1, :-2]
        return jnp.stack([part.reshape(sets.shape) for part in shifted])

    @jax.jit
    def one_pass(sets: Array, least: Array) -> Array:
        around = beside(sets)
        options = jnp.concatenate([sets[None], around])
        worse = jax.lax.map(values, options) / least - 1
        alien = 1 - (options[:, None] * around[None]).sum(-1).mean(1) / n
        best = jnp.argmin(worse + _SMOOTH * alien, 0)
        return options[best, places]

    least = jax.jit(values)(sets)
    for _ in range(_PASSES):
        sets = one_pass(sets, least)
    return sets, jax.jit(values)(sets)


def place_lambdas(
    sensor: Sensor,
    method: str,
    places: np.ndarray,
    sets: Float[Array, "P L"],
    shape: tuple[int, int],
) -> Float[Array, "nx ny"]:
    """Finds λ/σ₁² of the least image error at each place and its neighbours, under its set.

    The contacts are simulated on rigs that are not nominal. Contacts for "linear" hold the
    sheet at V0; contacts for "source" are soft.
    """
    radius, conductance = (0.002, 1.0) if method == "linear" else (0.006, 1e-4)
    scenes = simulate_scenes(
        sensor, places, radius=radius, conductance=conductance, rigs=min(8, len(places))
    )
    model = (Linear if method == "linear" else Source).of(sensor, (_PIXELS, _PIXELS))
    objective = ImageError.of(model, scenes, _WIDTH * sensor.mean_pitch)
    # Numbers of each place and its neighbours, in blocks of 3 × 3.
    grid = np.pad(np.arange(len(places)).reshape(shape), 1, mode="edge")
    nearby = np.lib.stride_tricks.sliding_window_view(grid, (3, 3)).reshape(-1, 9)
    lams = jnp.asarray(_LAMS, sensor.dtype)

    @jax.jit
    def each(objective: ImageError, sets: Array, nearby: Array) -> Array:
        def one(x: tuple[Array, Array]) -> Array:
            weights, some = x
            here = objective.alone(some)

            def error(lam: Array) -> Array:
                log_lam = jnp.log(lam * model.scale())
                return replace(here, log_lam=log_lam).value(weights)

            return lams[jnp.argmin(jax.lax.map(error, lams))]

        return jax.lax.map(one, (sets, nearby))

    return each(objective, sets, jnp.asarray(nearby)).reshape(shape)
