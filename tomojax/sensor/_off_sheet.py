"""Shapes that lie off the sheet: most often lengths that were meant in millimetres."""

import jax
import numpy as np
from jaxtyping import Array

from tomojax._checks import known
from tomojax.sensor._outline import AbstractShape
from tomojax.sensor._scene import Scene
from tomojax.sensor._shapes import Bar, Disc, Ellipse, Polygon, Ring


def require_on_sheet(size: Array, scene: AbstractShape) -> None:
    """**Raises:** `ValueError` for a shape of which no part lies on the sheet.

    Values under a trace pass, and shapes that users write.
    """
    for shape in scene.shapes if isinstance(scene, Scene) else (scene,):
        if isinstance(shape, Scene):
            require_on_sheet(size, shape)
        elif known(size, *jax.tree.leaves(shape)):
            _require_on_sheet(np.asarray(size, float), shape)


def _require_on_sheet(size: np.ndarray, shape: AbstractShape) -> None:
    if isinstance(shape, Polygon):
        vertices = np.asarray(shape.vertices, float)
        name, low, high = "vertices", vertices.min(0), vertices.max(0)
    elif isinstance(shape, Disc | Ellipse | Bar | Ring):
        center, reach = np.asarray(shape.center, float), _reach(shape)
        name, low, high = "center", center - reach, center + reach
    else:
        return
    if (low < size).all() and (high > 0).all():
        return
    kind, (x, y) = type(shape).__name__.lower(), (low + high) / 2
    raise ValueError(
        f"{name}: the {kind} lies off the sheet of {size[0]:g} m × {size[1]:g} m at "
        f"[{x:g}, {y:g}] m; lengths are in metres"
    )


def _reach(shape: Disc | Ellipse | Bar | Ring) -> float:
    """Returns the radius of a circle around the shape, m."""
    if isinstance(shape, Disc):
        return float(shape.radius)
    if isinstance(shape, Ellipse):
        return float(shape.semi_axes.max())
    if isinstance(shape, Bar):
        return float(np.hypot(shape.length, shape.width)) / 2
    return float(shape.outer)
