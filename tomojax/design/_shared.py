"""Designs slots that ground several electrodes at once, for two contacts that are close.

The unknowns are conductances γ (S) to ground, slots × electrodes. The exact model is
differentiable in γ. Each γ begins between open and closed and ends as a switch.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax._checks import float_array, require, require_finite, require_shape
from tomojax._custom_types import Numbers
from tomojax.design._design import design
from tomojax.design.objectives._information import PlaceInformation
from tomojax.design.objectives._problem import place_prior
from tomojax.kernels.algebra import adam, matmul
from tomojax.kernels.contacts import (
    green_of,
    Noise,
    Sheet,
    slot_weights,
    solve_small,
    tangents,
    weighed,
)
from tomojax.methods import noise_of, sheet_of
from tomojax.sensor import Sensor

# γ of a switch that is open, of one that is closed.
_OPEN = 1e-5

# Steps of Adam and their size, from half open to switches; and how far from their start
# the grounds of the best single ones are (as logits).
_STEPS, _RATE, _LEAN = 240, 0.15, 2.0


class Pairs(NamedTuple):
    """Pairs of contacts on a sheet, in the model of `points`."""

    sheet: Sheet
    noise: Noise
    places: Float[Array, "P 2 2"]  # m
    resistance: Float[Array, ""]  # of a contact, Ω


class SharedDesign(NamedTuple):
    """Conductances to ground, and the best set of single grounds that was found.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> pairs = [[[0.035, 0.04], [0.045, 0.04]]]  # two contacts, 10 mm apart
    >>> found = tx.design.design_shared(sensor, pairs, slots=2, steps=4)
    >>> found.grounds.shape, found.to_ground.shape  # single ones; S, of each electrode
    ((2,), (2, 16))
    """

    to_ground: Float[np.ndarray, "L M"]  # S: 0 or 1/z
    value: float  # standard deviation of the contacts' distance, mean over pairs, m
    relaxed: float  # before the switches were closed or opened
    grounds: np.ndarray  # single ones
    single: float  # their value


def pairs_of(sensor: Sensor, places: Numbers, conductance: float = 1e-4) -> Pairs:
    """Makes pairs of contacts at `places` (P, 2, 2), m, each contact of `conductance` S.

    **Raises:** `ValueError` for places of another shape, or places that are not finite.
    """
    where = float_array("places", places, sensor.dtype)
    require_shape("places", where, (None, 2, 2))
    require(len(where) > 0, "places", "none", "one pair at least")
    require_finite("places", where)
    resistance = jnp.asarray(1 / conductance, sensor.dtype)
    return Pairs(sheet_of(sensor), noise_of(sensor), where, resistance)


def closed(sensor: Sensor) -> Float[Array, ""]:
    """Returns γ of a closed switch, S: 1/z, 1000 at most."""
    z = jnp.mean(sensor.ground_resistance)
    return 1 / jnp.maximum(z, 1e-3)


def shared_map(
    pairs: Pairs, places: Float[Array, "C 2"], to_ground: Float[Array, " M"]
) -> tuple[Float[Array, "C 4 M"], Float[Array, "C C"]]:
    """Computes contacts' voltages per ampere with derivatives, and the loop, all in Ω.

    Derivatives are by place (per unit) and size. (I + R_eeΓ)x = 1, (I + R_eeΓ)Y = R_e(x): T
    = x·m + Y, as in `kernels.shared_slot_map`. The loop is from contact to contact.
    """
    sheet, ee = pairs.sheet, pairs.sheet.field.electrodes
    size, count = jnp.zeros((), places.dtype), len(places)
    raw = jax.vmap(tangents, (None, 0, None))(sheet, places, size)
    rows = raw.reshape(4 * count, -1)
    system = jnp.eye(len(ee), dtype=ee.dtype) + ee * to_ground
    right = jnp.concatenate([jnp.ones_like(ee[:, :1]), rows.T], 1)
    solution = jnp.linalg.solve(system, right)
    x, y = solution[:, :1], solution[:, 1:]
    through = matmul(solution.T, to_ground)
    enters = jnp.asarray(np.tile([1.0, 0, 0, 0], count), ee.dtype)
    mean = (enters - through[1:]) / through[0]
    t = (x * mean + y).T.reshape(count, 4, -1)
    radius = jnp.broadcast_to(sheet.size, (count,))
    among = jax.vmap(green_of(sheet, places, radius))(places)
    back = matmul(raw[:, 0] * to_ground, t[:, 0].T)
    return t, among - back + mean[::4]


def shared_columns(
    pairs: Pairs, places: Float[Array, "C 2"], to_ground: Float[Array, " M"]
) -> Float[Array, "C 4 M"]:
    """Computes `shared_map`'s voltages, V, for the currents that the contacts draw."""
    t, loop = shared_map(pairs, places, to_ground)
    loop = loop + pairs.resistance * jnp.eye(len(loop), dtype=loop.dtype)
    drive = jnp.broadcast_to(pairs.sheet.drive_voltage, (len(loop), 1)).astype(loop.dtype)
    return solve_small(loop, drive)[:, :, None] * t


def pair_information(
    pairs: Pairs, places: Float[Array, "C 2"], to_ground: Float[Array, " M"]
) -> Float[Array, "n n"]:
    """Computes JᵀN⁻¹J of places and sizes, 3 a contact; the slot's currents are free."""
    columns = shared_columns(pairs, places, to_ground)
    m = columns.shape[-1]
    weights = slot_weights(pairs.noise, columns[:, 0].sum(0), jnp.ones(m, bool))
    free, moves = columns[:, 0], columns[:, 1:].reshape(-1, m)
    seen = weighed(weights, moves)
    across = matmul(seen, free.T)
    among = matmul(weighed(weights, free), free.T)
    told = matmul(seen, moves.T)
    return told - matmul(across, solve_small(among, across.T))


def pair_objective(pairs: Pairs, to_ground: Float[Array, "L M"]) -> PlaceInformation:
    """Makes slots' objective for such γ: the standard deviation of each pair's distance."""
    each = jax.vmap(jax.vmap(pair_information, (None, None, 0)), (None, 0, None))
    prior = jnp.kron(jnp.eye(2, dtype=to_ground.dtype), place_prior(pairs.sheet.unit))
    apart = pairs.places[:, 1] - pairs.places[:, 0]
    apart = apart / jnp.linalg.norm(apart, axis=1, keepdims=True)
    none = jnp.zeros_like(apart[:, :1])
    directions = jnp.concatenate([-apart, none, apart, none], 1)[:, :, None]
    told = each(pairs, pairs.places, to_ground)
    return PlaceInformation("place", told, prior, pairs.sheet.unit, directions)


def design_shared(
    sensor: Sensor,
    places: Numbers,
    slots: int = 8,
    *,
    conductance: float = 1e-4,
    steps: int = _STEPS,
) -> SharedDesign:
    """Designs all electrodes' conductances to ground, slot by slot, for contacts' distance.

    Adam (Kingma and Ba, ICLR 2015) moves ln γ between an open and a closed switch's. One
    start is the best set of single grounds, blurred; the other is drawn about half open. A
    growing cost drives each switch open or closed. The final switches are rated, not γ.
    Single grounds are the design where they are better.
    **Raises:** `ValueError` for wrong places and a number of slots outside 1 to M.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> pairs = [[[0.035, 0.04], [0.045, 0.04]]]  # two contacts, 10 mm apart
    >>> found = tx.design.design_shared(sensor, pairs, slots=2, steps=4)
    >>> found.to_ground.shape  # S, of each slot's electrodes
    (2, 16)
    >>> found.value <= found.single  # m; or the best single grounds are the design
    True
    """
    pairs = pairs_of(sensor, places, conductance)
    m, most = sensor.electrode_count, closed(sensor)
    single = jax.jit(pair_objective)(pairs, most * jnp.eye(m, dtype=sensor.dtype))
    best = design(single, slots)
    lean = np.full((slots, m), -_LEAN)
    lean[np.arange(slots), best.grounds] = _LEAN
    rng = np.random.default_rng(0)
    starts = lean, rng.normal(0, 1, (slots, m))

    @jax.jit
    def rated(to_ground: Array) -> Array:
        ones = jnp.ones(slots, sensor.dtype)
        return pair_objective(pairs, to_ground).value(ones)

    def value(free: Array, cost: Array) -> Array:
        part = jax.nn.sigmoid(free)
        between = (part * (1 - part)).sum(1).mean()
        return jnp.log(rated(gamma(part, most))) + cost * between

    # Nothing in the first third; then more and more.
    turns = jnp.arange(1, steps + 1, dtype=sensor.dtype)
    costs = jnp.clip(1.5 * turns / steps - 0.5, 0) ** 2
    alone = np.zeros((slots, m))
    alone[np.arange(slots), best.grounds] = float(most)
    found = [(best.value, best.value, alone)]
    for start in starts:
        free = adam(jax.grad(value), jnp.asarray(start, sensor.dtype), costs, _RATE)
        part = jax.nn.sigmoid(free)
        # A slot without any ground floats: its most closed switch is closed.
        switches = (part > 0.5) | (part == part.max(1, keepdims=True))
        to_ground = jnp.where(switches, most, 0)
        value_ = float(rated(to_ground))
        found.append((value_, float(rated(gamma(part, most))), np.asarray(to_ground)))
    reached, relaxed, to_ground = min(found, key=lambda f: f[0])
    return SharedDesign(to_ground, reached, relaxed, best.grounds, best.value)


def gamma(part: Float[Array, "L M"], most: Float[Array, ""]) -> Float[Array, "L M"]:
    """Computes γ, S, from `part` (0 open, 1 closed): ln γ is linear in `part`."""
    return most * jnp.asarray(_OPEN, part.dtype) ** (1 - part)
