"""Splits the table of potentials at points into a smooth table and fields about electrodes.

`tomojax.kernels.contacts.Near` has the parts.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates

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
    radius, answer = float(sensor.electrode_diameter) / 2, float(sensor.electrode_shunt)
    apart = np.hypot(*(xy[:, None] - xy).transpose(2, 0, 1)) + np.diag(
        np.full(len(xy), np.inf)
    )
    reach = max(_REACH * min(apart.min(), 2 * size.min()), 1.01 * radius)
    feed = rho / (2 * np.pi)
    axes = [np.linspace(0, s, n) for s, n in zip(size, rows.shape[1:])]
    smooth = rows.copy()
    pull = np.zeros((len(xy), len(xy), 2))
    turn = 2 * np.pi * np.arange(_POINTS) / _POINTS
    circle = _CIRCLE * radius * np.stack([np.cos(turn), np.sin(turn)], 1)
    for e, place in enumerate(xy):
        inner = [np.flatnonzero(np.abs(x - p) <= reach) for x, p in zip(axes, place)]
        grid = np.stack(np.meshgrid(*(x[i] for x, i in zip(axes, inner)), indexing="ij"), -1)
        log, dipole = fields_about(np.float64(radius), np.float64(reach), grid - place)
        on = place + circle
        if ((on >= 0) & (on <= size)).all():
            at = (on / size * (np.array(rows.shape[1:]) - 1)).T
            around = np.stack([map_coordinates(row, at, order=3, mode="mirror") for row in rows])
            slope = 2 / _POINTS * around @ circle / (_CIRCLE * radius) ** 2
            pull[e] = -slope / (1 - answer / _CIRCLE**2)
        window = np.ix_(range(len(xy)), *inner)
        part = answer * radius**2 * np.einsum("xyk,mk->mxy", dipole, pull[e])
        part[e] += feed * log
        smooth[window] -= part
    dtype = sensor.dtype
    values = smooth[:, ::every, ::every].transpose(1, 2, 0)
    numbers = (values, xy, pull, feed, radius, reach, answer)
    return Near(*(jnp.asarray(a, dtype) for a in numbers))
