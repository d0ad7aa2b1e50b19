"""Finds places for electrodes that make the image's worst resolution as good as possible.

Images blur contacts in the gaps of uniform grids. Gradients go through the Green's function
of the sheet, the paper's J and Eq. 3 to the electrodes' places.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float

from tomojax._checks import float_array, require, require_positive, require_shape
from tomojax._custom_types import Numbers
from tomojax.kernels.sheet import (
    cell_centres,
    Grounds,
    rectangle_fields,
    rectangle_green,
    Resistances,
    slot_jacobian,
)
from tomojax.sensor import Sensor

# How sharply the largest stands out, from rough to fine.
_SHARPNESS = 20.0, 60.0, 200.0

# Steps of each sharpness.
_STEPS = 40

# λ/σ₁² that images of white noise ask for.
_RELATIVE = 1e-5

# A contact's width in images (σ), of the pitch of a square grid of as many electrodes.
_BLOB = 0.2

# How far from the sensor's own places later searches begin (σ), of that pitch.
_JITTER = 0.075

# The least from an electrode's middle to an edge, and to another middle, in diameters.
_EDGE = 0.6
_APART = 1.4

# What less than that costs.
_COST = 1e2


class ElectrodeDesign(NamedTuple):
    """Electrodes' places, m, and the spread of images at the places asked for, m.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = [[0.02, 0.04], [0.04, 0.04], [0.06, 0.06]]
    >>> found = tx.design.design_electrodes(sensor, places, grid=8, starts=1)
    >>> moved = tx.Sensor(sensor.size, found.electrode_xy, divisions=(16, 16))
    >>> moved.electrode_count, found.spread.shape
    (16, (3,))
    """

    electrode_xy: Float[np.ndarray, "M 2"]
    spread: Float[np.ndarray, " P"]
    spread_before: Float[np.ndarray, " P"]  # of the sensor's own electrodes


def design_electrodes(
    sensor: Sensor,
    places: Numbers | None = None,
    *,
    lam: float | None = None,
    grid: int = 32,
    contact_resistance: float | None = None,
    starts: int = 2,
    seed: int = 0,
) -> ElectrodeDesign:
    """Places the sensor's number of electrodes for the best resolution at the worst place.

    optimistix' BFGS lowers a soft maximum of `image_spread`, sharpened in steps. Electrodes
    stay on the sheet and 1.4 diameters apart.

    **Arguments:** `places` (P, 2), m, tell where resolution counts: by default 24 × 24 over
    the sheet but 1/16 at its edges. `lam` is λ of the images, the same for all electrodes'
    places. The default is 1e-5 of the largest eigenvalue of JᵀJ. `grid` is the number of
    cells along a side. `contact_resistance` is ρ, Ω, that of a square of the sheet by
    default. `starts` counts searches: the first begins at the sensor's own places, further
    searches beside these (a symmetric start ends symmetric).
    **Raises:** `ValueError` for a sheet with a value per element, and wrong arguments.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = [[0.02, 0.04], [0.04, 0.04], [0.06, 0.06]]
    >>> found = tx.design.design_electrodes(sensor, places, grid=8, starts=1)
    >>> found.electrode_xy.shape, bool(found.spread.max() <= found.spread_before.max())
    ((16, 2), True)
    """
    even = sensor.sheet_resistance.ndim == 0
    require(even, "sensor", "a sheet with a value per element", "an even one")
    size = np.asarray(sensor.size, float)
    if places is None:
        parts = [np.linspace(s / 16, s * 15 / 16, 24) for s in size]
        places = np.stack(np.meshgrid(*parts, indexing="ij"), -1).reshape(-1, 2)
    positive = isinstance(starts, int) and starts >= 1
    require(positive, "starts", repr(starts), "a whole number above 0")
    where = float_array("places", places, sensor.dtype)
    require_shape("places", where, (None, 2))
    require(len(where) > 0, "places", "none", "one place at least")
    if lam is None:
        lam = _RELATIVE * image_scale(sensor, grid, contact_resistance)
    require_positive("lam", float_array("lam", lam))
    edge = _EDGE * sensor.electrode_diameter
    low, high = edge, sensor.size - edge

    def at(free: Array) -> Array:
        return low + (high - low) * jax.nn.sigmoid(free)

    image = {"lam": lam, "grid": grid, "contact_resistance": contact_resistance}
    figures = partial(image_spread, sensor, where, **image)

    def value(free: Array, sharp: Array) -> Array:
        xy = at(free)
        f = figures(xy) / scale
        return jax.nn.logsumexp(sharp * f) / sharp + _crowding(sensor, xy)

    before = jax.jit(figures)(sensor.electrode_xy)
    scale, rng = before.max(), np.random.default_rng(seed)
    best = np.asarray(sensor.electrode_xy), np.asarray(before)
    for number in range(starts):
        off = (number > 0) * _JITTER * sensor.mean_pitch * rng.normal(size=best[0].shape)
        part = (sensor.electrode_xy + off - low) / (high - low)
        xy = at(_descended(value, jax.scipy.special.logit(jnp.clip(part, 0.01, 0.99))))
        after = jax.jit(figures)(xy)
        if after.max() < best[1].max():
            best = np.asarray(xy), np.asarray(after)
    return ElectrodeDesign(*best, np.asarray(before))


def _descended(value: Callable, free: Array) -> Array:
    solver = optimistix.BFGS(rtol=1e-4, atol=1e-4)
    for sharp in _SHARPNESS:
        given = free, jnp.asarray(sharp, free.dtype)
        found = optimistix.minimise(value, solver, *given, max_steps=_STEPS, throw=False)
        free = found.value
    return free


def image_spread(
    sensor: Sensor,
    places: Float[Array, "P 2"],
    electrode_xy: Float[Array, "M 2"],
    *,
    lam: float | Float[Array, ""],
    grid: int = 32,
    contact_resistance: float | None = None,
) -> Float[Array, " P"]:
    """Computes √(Σ_k |x − x_k|²p_k²/Σ_k p_k²), m, of images p of contacts at `places` x.

    p = (JᵀJ + λI)⁻¹JᵀJb is the image of a Gaussian b (σ a fifth of the pitch). This is the
    spread of Backus and Gilbert (Phil. Trans. R. Soc. A 266, 1970): σ, if the image is a
    Gaussian. J is Eq. 1's of all ground conditions, on an even sheet with electrodes at
    `electrode_xy`, m. The spread is differentiable in `electrode_xy`.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = jnp.array([[0.02, 0.04], [0.04, 0.04], [0.06, 0.06]], sensor.dtype)
    >>> lam = 1e-5 * tx.design.image_scale(sensor, grid=8)
    >>> xy = sensor.electrode_xy
    >>> spread = tx.design.image_spread(sensor, places, xy, lam=lam, grid=8)
    >>> spread.shape, bool((spread < 0.02).all())  # m
    ((3,), True)
    """
    cells = _cells(sensor, grid)
    apart = ((places[:, None] - cells) ** 2).sum(-1)
    blob = jnp.exp(-apart / (2 * (_BLOB * sensor.mean_pitch) ** 2))
    blob = blob / blob.sum(1, keepdims=True)
    gram = _gram(sensor, electrode_xy, grid, contact_resistance)
    lower = jnp.linalg.cholesky(gram + lam * jnp.eye(len(gram), dtype=gram.dtype))
    image = blob - lam * jax.scipy.linalg.cho_solve((lower, True), blob.T).T
    return jnp.sqrt((apart * image**2).sum(1) / (image**2).sum(1))


def image_scale(
    sensor: Sensor, grid: int = 32, contact_resistance: float | None = None
) -> float:
    """Computes σ₁², the largest eigenvalue of JᵀJ, for the scale of `image_spread`'s λ.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> tx.design.image_scale(sensor, grid=8) > 0
    True
    """
    gram = _gram(sensor, sensor.electrode_xy, grid, contact_resistance)
    return float(jnp.linalg.eigvalsh(gram)[-1])


def _cells(sensor: Sensor, grid: int) -> Float[Array, "K 2"]:
    """Returns the middles of the grid's cells, m."""
    return jnp.asarray(cell_centres((grid, grid)), sensor.dtype) * sensor.size


def _gram(
    sensor: Sensor, xy: Array, grid: int, contact: float | None
) -> Float[Array, "K K"]:
    """Computes JᵀJ of all ground conditions slot by slot: J itself takes a lot of room."""
    z, rho = sensor.ground_resistance, sensor.sheet_resistance
    through = jnp.asarray(rho.mean() if contact is None else contact, xy.dtype)
    cells = _cells(sensor, grid)
    ee, ek, shunts = rectangle_fields(
        xy, cells, sensor.electrode_diameter / 2, sensor.size, sensor.electrode_shunt
    )
    # A cell is a disc of its area, evenly fed.
    rim = jnp.sqrt(jnp.prod(sensor.size) / len(cells) / np.pi) * float(np.exp(-0.25))
    kk = rectangle_green(cells, cells, rim, sensor.size) - (shunts**2).sum(0)
    table = Resistances(rho * ee, rho * ek, rho * kk)

    @jax.checkpoint
    def one(ground: Array) -> Array:
        j = slot_jacobian(table, Grounds(table.electrodes, z), ground[None], through)[0]
        return jnp.matmul(j.T, j, precision="highest")

    nothing = jnp.zeros((len(cells), len(cells)), xy.dtype)
    add = lambda total, ground: (total + one(ground), None)  # noqa: E731
    return jax.lax.scan(add, nothing, jnp.arange(len(xy)))[0]


def _crowding(sensor: Sensor, xy: Float[Array, "M 2"]) -> Float[Array, ""]:
    """Computes the cost of electrodes too near each other; 0 for electrodes apart."""
    square = ((xy[:, None] - xy) ** 2).sum(-1)
    far = jnp.eye(len(xy), dtype=xy.dtype)
    apart = jnp.sqrt(square + far) / sensor.electrode_diameter
    return _COST * (jnp.clip(_APART - apart, 0) ** 2).sum()
