"""Splits the table of potentials at points into a smooth table and fields about electrodes.

`tomojax.kernels.contacts.Near` has the parts.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates, spline_filter

from tomojax.kernels.contacts import fields_about, Near
from tomojax.sensor._sensor import Sensor

# Radius of the circle that tells a field's slope at a disc, in the disc's own radii.
_CIRCLE = 2.0

# Points of it: what a field has beyond a slope does not alias into it.
_POINTS = 24

# The fields' reach, of the least distance of two electrodes.
_REACH = 0.5


def near_of(
    sensor: Sensor,
    rho: float,
    rows: Float[np.ndarray, "M nx ny"],
    every: int,
) -> Near:
    """Takes the fields about electrodes off the table of R_e, Ω.

    The slope at each disc without the disc, E, is what the potential around it tells: u =
    u₀ + E·r(1 − s·a²/r²), s the disc's answer.
    """
    size, xy = np.asarray(sensor.size, float), np.asarray(sensor.electrode_xy, float)
    radius, answer = (
        float(sensor.electrode_diameter) / 2,
        float(np.asarray(sensor.electrode_shunt)),
    )
    apart = np.hypot(*(xy[:, None] - xy).T)
    least = min((apart + np.diag(np.full(len(xy), np.inf))).min(), 2 * size.min())
    reach = max(_REACH * least, 1.01 * radius)
    pull = _pull(rows, xy, _CIRCLE * radius, size) / (1 - answer / _CIRCLE**2)
    smooth = rows[:, ::every, ::every].copy()
    feed, cells = rho / (2 * np.pi), np.array(smooth.shape[1:]) - 1
    for e, place in enumerate(xy):
        low = np.maximum(np.ceil((place - reach) / size * cells).astype(int), 0)
        x, y = (np.arange(a, b) for a, b in zip(low, _end(place + reach, size, cells)))
        at = np.stack(np.meshgrid(x, y, indexing="ij"), -1) / cells * size
        log, dipole = fields_about(radius, reach, at - place)
        rough = answer * radius**2 * np.einsum("xyk,mk->mxy", dipole, pull[e])
        rough[e] += feed * log
        smooth[:, x[:, None], y] -= rough
    numbers = (smooth.transpose(1, 2, 0), xy, pull, feed, radius, reach, answer)
    return Near(*(jnp.asarray(np.asarray(a, sensor.dtype)) for a in numbers))


def _end(at: np.ndarray, size: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Returns the first points of the table beyond a place along each axis."""
    return np.minimum(np.floor(at / size * cells).astype(int), cells) + 1


def _pull(
    rows: Float[np.ndarray, "M nx ny"], xy: np.ndarray, radius: float, size: np.ndarray
) -> Float[np.ndarray, "M M 2"]:
    """Computes −∇R_e by circles about electrodes, Ω/m; 0 where a circle leaves the box."""
    turn = 2 * np.pi * np.arange(_POINTS) / _POINTS
    circle = radius * np.stack([np.cos(turn), np.sin(turn)], 1)
    on = xy[:, None] + circle
    at = on.reshape(-1, 2).T / size[:, None] * (np.array(rows.shape[1:])[:, None] - 1)
    # As the table is, mirrored at its edges.
    smooth = (spline_filter(row, 3, mode="mirror") for row in rows)
    found = [
        map_coordinates(a, at, order=3, mode="mirror", prefilter=False) for a in smooth
    ]
    around = np.stack(found).reshape(len(rows), len(xy), _POINTS)
    slope = 2 / _POINTS / radius**2 * np.einsum("mep,pk->emk", around, circle)
    inside = np.all((on >= 0) & (on <= size), (1, 2))
    return np.where(inside[:, None, None], -slope, 0)
