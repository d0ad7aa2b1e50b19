"""Finds places for electrodes that make the image's worst resolution as good as possible.

Images blur contacts in the gaps of uniform grids. Gradients go through the sheet's
resistances, the paper's J and Eq. 3 to the electrodes' places. An even rectangle has its
resistances in closed form; any other sheet has them on its mesh.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float

from tomojax._checks import checked, require
from tomojax._custom_types import Numbers
from tomojax._require import require_whole
from tomojax.kernels.sheet import (
    cell_centres,
    centroids,
    element_areas,
    rectangle_fields,
    rectangle_green,
    Resistances,
    slot_jacobian,
)
from tomojax.sensor import resistances, Sensor

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

# How strongly the search is pushed off places nearer than that, times the square of what
# is missing in diameters; and the most that a design may be pushed.
_COST = 1e2
_HELD = 0.1

# Pixels that hold less of the sheet than this part of a whole one do not count.
_LEAST = 0.1

# 2π/ρ·(own resistance of an evenly fed disc of an element's area − the element's own).
_ELEMENT = 0.7


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
    stay on the sheet, whole, and 1.4 diameters apart: of any outline, surface and
    resistance, from any places, under any table of conditions.

    **Arguments:** `places` (P, 2), m, tell where resolution counts: by default those of
    24 × 24 over the box that are 1/16 of a side from any edge. `lam` is λ of the images,
    the same for all electrodes' places. The default is 1e-5 of the largest eigenvalue of
    JᵀJ. `grid` is the number of pixels along a side; where the sheet is no even rectangle
    a pixel is whole cells of the sensor's mesh. `contact_resistance` is ρ, Ω, that of a
    square of the sheet by default. `starts` counts searches: the first begins at the
    sensor's own places, further searches beside these (a symmetric start ends symmetric).
    **Raises:** `ValueError` for places off the sheet, and wrong arguments.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = [[0.02, 0.04], [0.04, 0.04], [0.06, 0.06]]
    >>> found = tx.design.design_electrodes(sensor, places, grid=8, starts=1)
    >>> found.electrode_xy.shape, bool(found.spread.max() <= found.spread_before.max())
    ((16, 2), True)
    """
    if places is None:
        places = _everywhere(sensor)
    require_whole("starts", starts)
    where = checked("places", places, "finite", (None, 2), dtype=sensor.dtype)
    require(len(where) > 0, "places", "none", "one place at least")
    off = int((~sensor.on_sheet(where)).sum())
    require(off == 0, "places", f"{off} off the sheet", "places on it")
    if lam is None:
        lam = _RELATIVE * image_scale(sensor, grid, contact_resistance)
    checked("lam", lam, "positive")
    edge = _EDGE * sensor.electrode_diameter
    low, high = edge, sensor.size - edge

    def at(free: Array) -> Array:
        return low + (high - low) * jax.nn.sigmoid(free)

    image = {"lam": lam, "grid": grid, "contact_resistance": contact_resistance}
    figures = partial(image_spread, sensor, where, **image)

    def value(free: Array, sharp: Array) -> Array:
        xy = at(free)
        f = figures(xy) / scale
        return jax.nn.logsumexp(sharp * f) / sharp + _cost(sensor, xy)

    before = jax.jit(figures)(sensor.electrode_xy)
    scale, rng = before.max(), np.random.default_rng(seed)
    best = np.asarray(sensor.electrode_xy), np.asarray(before)
    for number in range(starts):
        off = (number > 0) * _JITTER * sensor.mean_pitch * rng.normal(size=best[0].shape)
        part = (sensor.electrode_xy + off - low) / (high - low)
        xy = at(_descended(value, jax.scipy.special.logit(jnp.clip(part, 0.01, 0.99))))
        after = jax.jit(figures)(xy)
        if after.max() < best[1].max() and _cost(sensor, xy) < _HELD:
            best = np.asarray(xy), np.asarray(after)
    return ElectrodeDesign(*best, np.asarray(before))


def _descended(value: Callable, free: Array) -> Array:
    solver = optimistix.BFGS(rtol=1e-4, atol=1e-4)
    for sharp in _SHARPNESS:
        given = free, jnp.asarray(sharp, free.dtype)
        found = optimistix.minimise(value, solver, *given, max_steps=_STEPS, throw=False)
        free = found.value
    return free


def _everywhere(sensor: Sensor) -> np.ndarray:
    """Lists 24 × 24 places over the box, those 1/16 of a side and more from any edge."""
    size = np.asarray(sensor.size, float)
    parts = [np.linspace(s / 16, s * 15 / 16, 24) for s in size]
    places = np.stack(np.meshgrid(*parts, indexing="ij"), -1).reshape(-1, 2)
    if sensor.outline is None:
        return places
    level = sensor.outline.distance(jnp.asarray(places, sensor.dtype))
    return places[np.asarray(level) < -size.min() / 16]


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
    Gaussian. J is Eq. 1's of all ground conditions, with electrodes at `electrode_xy`, m.
    The spread is differentiable in `electrode_xy`.

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
    with jax.ensure_compile_time_eval():  # the sensor is known, whoever traces
        pixels, pitch = _pixels(sensor, grid), sensor.mean_pitch
    apart = ((places[:, None] - pixels.middles) ** 2).sum(-1)
    blob = jnp.exp(-apart / (2 * (_BLOB * pitch) ** 2))
    blob = blob / blob.sum(1, keepdims=True)
    gram = _gram(sensor, electrode_xy, pixels, contact_resistance)
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
    pixels = _pixels(sensor, grid)
    gram = _gram(sensor, sensor.electrode_xy, pixels, contact_resistance)
    return float(jnp.linalg.eigvalsh(gram)[-1])


class _Pixels(NamedTuple):
    """Pixels of an image of the sheet, and the elements of the mesh that they are of."""

    middles: Float[Array, "K 2"]  # m
    radius: Float[Array, " K"]  # of a disc of a pixel's area, m
    number: np.ndarray  # of each element's pixel; K for elements that do not count
    area: Float[Array, " elements"]  # of each element on the sheet, m²

    def mean(self, values: Float[Array, " elements *n"]) -> Float[Array, " K *n"]:
        """Averages elements' values over pixels, by area."""
        count = len(self.middles)

        def total(each: Array) -> Array:
            return jax.ops.segment_sum(each, self.number, count + 1)[:count]

        weighed = (values.T * self.area).T
        return (total(weighed).T / total(self.area)).T


def _pixels(sensor: Sensor, grid: int) -> _Pixels:
    if sensor.even:
        middles = jnp.asarray(cell_centres((grid, grid)), sensor.dtype) * sensor.size
        radius = jnp.sqrt(jnp.prod(sensor.size) / len(middles) / np.pi)
        each = jnp.broadcast_to(radius, (len(middles),))
        return _Pixels(middles, each, np.empty(0, int), each[:0])
    shape, size = np.array(sensor.divisions), np.asarray(sensor.size, float)
    every = np.maximum(1, np.round(shape / grid)).astype(int)
    at = np.asarray(centroids(sensor.divisions, sensor.size), float)
    index = (at / size * shape).astype(int) // every
    number = np.ravel_multi_index(tuple(index.T), tuple(-(-shape // every)))
    area = np.asarray(element_areas(sensor.skin, sensor.divisions, sensor.size), float)
    whole = np.bincount(number, area)
    counts = whole > _LEAST * whole.max()
    number = np.where(counts, np.cumsum(counts) - 1, counts.sum())[number]
    as_told = lambda a: jnp.asarray(a, sensor.dtype)  # noqa: E731
    radius = as_told(np.sqrt(whole[counts] / np.pi))
    found = _Pixels(jnp.zeros((len(radius), 2)), radius, number, as_told(area))
    return found._replace(middles=found.mean(as_told(at)))


def _table(sensor: Sensor, xy: Array, pixels: _Pixels) -> Resistances:
    """Computes resistances among electrodes at `xy` and pixels, each an evenly fed disc."""
    rho = sensor.sheet_resistance
    if sensor.even:
        rim, middles = pixels.radius * float(np.exp(-0.25)), pixels.middles
        ee, ek, shunts = rectangle_fields(
            xy, middles, sensor.electrode_diameter / 2, sensor.size, sensor.electrode_shunt
        )
        kk = rectangle_green(middles, middles, rim, sensor.size) - (shunts**2).sum(0)
        return Resistances(rho * ee, rho * ek, rho * kk)
    ee, ek, kk = resistances(eqx.tree_at(lambda s: s.electrode_xy, sensor, xy))
    element = jnp.mean(pixels.area, where=pixels.area > 0)
    wider = jnp.log(pixels.radius / jnp.sqrt(element / np.pi)) - _ELEMENT
    local = pixels.mean(jnp.broadcast_to(rho, kk.shape)) / (2 * np.pi)
    return Resistances(ee, pixels.mean(ek.T).T, pixels.mean(kk) - local * wider)


def _gram(
    sensor: Sensor, xy: Array, pixels: _Pixels, contact: float | None
) -> Float[Array, "K K"]:
    """Computes JᵀJ of all ground conditions slot by slot: J itself takes a lot of room."""
    through = sensor.sheet_resistance.mean() if contact is None else contact
    through = jnp.asarray(through, xy.dtype)
    table = _table(sensor, xy, pixels)
    slots = sensor.slots(table.electrodes)

    @jax.checkpoint
    def one(which: Array) -> Array:
        j = slot_jacobian(table, slots, which[None], through)[0]
        return jnp.matmul(j.T, j, precision="highest")

    count = len(table.own)
    nothing = jnp.zeros((count, count), xy.dtype)
    add = lambda total, which: (total + one(which), None)  # noqa: E731
    return jax.lax.scan(add, nothing, jnp.arange(sensor.condition_count))[0]


def _cost(sensor: Sensor, xy: Float[Array, "M 2"]) -> Float[Array, ""]:
    """Computes the cost of electrodes too near each other or the edge; 0 for others."""
    diameter = sensor.electrode_diameter
    at = xy if sensor.surface is None else sensor.surface(xy)
    square = ((at[:, None] - at) ** 2).sum(-1)
    apart = jnp.sqrt(square + jnp.eye(len(xy), dtype=xy.dtype)) / diameter
    cost = (jnp.clip(_APART - apart, 0) ** 2).sum()
    if sensor.outline is not None:
        inside = -sensor.outline.distance(xy) / diameter
        cost = cost + (jnp.clip(_EDGE - inside, 0) ** 2).sum()
    return _COST * cost
