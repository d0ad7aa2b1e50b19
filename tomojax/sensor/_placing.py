"""Puts electrodes on a sheet of any outline; checks that they and shapes are on it."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from tomojax._checks import checked, known, require_array, require_shape
from tomojax._custom_types import Numbers
from tomojax._require import check_apart, require, require_whole
from tomojax.kernels.sheet import coverage, local_cells, Skin
from tomojax.sensor._edges import AbstractEdge, skin_on, surface_on_host
from tomojax.sensor._outline import AbstractShape, Scene
from tomojax.sensor._shapes import Bar, Disc, Ellipse, Polygon, Ring

# Places, or what `place_electrodes` takes by name.
Electrodes = Numbers | dict[str, Any]

# Points of a box along each side that a rim is found among.
_RIM = 600

# A shape that reaches further than so many sides of the sheet was not given in metres: of
# a millimetre taken for a metre it would be a thousand. It is no figure of a sensor.
_LARGEST = 10

# Cells along a side of a cut sheet's mesh, at most.
MOST_CELLS = 200

# What `place_electrodes` takes by name.
_NAMES = ("rim", "inset", "grid", "points")


def places_named(
    outline: AbstractEdge, size: Numbers, diameter: Numbers, named: dict[str, Any]
) -> Float[np.ndarray, "M 2"]:
    """`place_electrodes` by names that users give. **Raises:** `ValueError` for others."""
    unknown = [name for name in named if name not in _NAMES]
    require(not unknown, "electrodes", unknown, f"some of {', '.join(_NAMES)}")
    for name in {"inset", "grid"} & named.keys():
        checked(name, named[name], "not negative", ())
    return place_electrodes(outline, size, diameter, **named)


def place_electrodes(
    outline: AbstractEdge,
    size: Numbers,
    diameter: Numbers,
    rim: int = 0,
    inset: float = 0.0,
    grid: float | None = None,
    points: Numbers | None = None,
) -> Float[np.ndarray, "M 2"]:
    """Lists electrodes' places, m: on the rim, then on a grid, then `points`.

    **Arguments:** `rim`: so many, evenly along the outer edge, `inset` m inside it;
    `grid`: a square grid of this pitch, m, about the box's middle, where a disc is whole on
    the sheet and apart from the rim's.
    **Raises:** `ValueError` where nothing is placed.
    """
    require_whole("rim", rim, 0)
    box, across = np.asarray(size, float), float(np.asarray(diameter))
    found = [np.empty((0, 2))]
    if rim:
        found.append(_along_rim(outline, box, rim, inset))
    if grid is not None:
        require(grid > across, "grid", f"{grid:g} m", f"more than a disc, {across:g} m")
        lines = [np.arange(-(s // grid) // 2 - 1, s // grid // 2 + 2) * grid for s in box]
        # Odd or even, whichever has more on the sheet.
        best = np.empty((0, 2))
        for shift in (0.0, grid / 2):
            x, y = (s / 2 + line + shift for s, line in zip(box, lines))
            places = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
            inside = ((places > across / 2) & (places < box - across / 2)).all(1)
            whole = np.asarray(outline.distance(jnp.asarray(places))) < -across / 2
            apart = _nearest(places, np.concatenate(found)) > 1.5 * across
            places = places[inside & whole & apart]
            best = max(best, places, key=len)
        found.append(best)
    if points is not None:
        found.append(np.asarray(checked("points", points, "finite", (None, 2)), float))
    places = np.concatenate(found)
    require(len(places) >= 2, "electrodes", f"{len(places)} on the sheet", "two or more")
    return places


def _nearest(places: np.ndarray, others: np.ndarray) -> np.ndarray:
    apart = np.sqrt(((places[:, None] - others) ** 2).sum(-1))
    return apart.min(1, initial=np.inf)


def _along_rim(
    outline: AbstractEdge, box: np.ndarray, count: int, inset: float
) -> Float[np.ndarray, "n 2"]:
    """Follows the outline around the centre, and splits its length evenly."""
    axes = [np.linspace(0, s, _RIM) for s in box]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    level = np.asarray(outline.distance(jnp.asarray(points)))
    # The outermost crossing of each ray from the middle of what is inside.
    middle = points[level < 0].mean(0)
    angles = np.linspace(0, 2 * np.pi, 4 * _RIM, endpoint=False)
    rays = np.stack([np.cos(angles), np.sin(angles)], -1)
    steps = np.linspace(0, np.hypot(*box), 4 * _RIM)

    def levels(along: np.ndarray) -> np.ndarray:
        at = middle + along[..., None] * rays[:, None]
        off = np.maximum(-at, at - box).max(-1)
        return np.maximum(np.asarray(outline.distance(jnp.asarray(at))), off)

    inside = levels(np.broadcast_to(steps, (len(rays), len(steps)))) < -inset
    last = inside.shape[1] - 1 - np.argmax(inside[:, ::-1], 1)
    low, high = steps[last], steps[np.minimum(last + 1, len(steps) - 1)]
    for _ in range(30):
        half = (low + high) / 2
        within = levels(half[:, None])[:, 0] < -inset
        low, high = np.where(within, half, low), np.where(within, high, half)
    edge = middle + low[:, None] * rays
    closed = np.concatenate([edge, edge[:1]])
    length = np.append(0, np.cumsum(np.sqrt((np.diff(closed, axis=0) ** 2).sum(1))))
    at = length[-1] * np.arange(count) / count
    return np.stack([np.interp(at, length, closed[:, k]) for k in (0, 1)], -1)


def check_skin(sensor: Any) -> None:
    """Refuses electrodes off the sheet or in one another, and a sheet in parts.

    **Raises:** `ValueError`.
    """
    xy, diameter = np.asarray(sensor.electrode_xy, float), float(sensor.electrode_diameter)
    slack = 0.05 * diameter  # an electrode's middle may be on the edge
    level = np.maximum(-xy, xy - np.asarray(sensor.size, float)).max(1)
    if sensor.outline is not None:
        level = np.maximum(level, np.asarray(sensor.outline.distance(sensor.electrode_xy)))
    outside = np.flatnonzero(level > slack)
    require(
        not outside.size,
        "electrode_xy",
        f"electrodes {outside[:5].tolist()} off the sheet, by {level.max():.3g} m",
        "middles on the sheet or on its edge",
    )
    size, shape = np.asarray(sensor.size, float), sensor.divisions
    skin = skin_on(sensor.outline, sensor.surface, shape, size, sensor.dtype)
    places = skin.points(xy) if skin is not None else xy
    check_apart(places, diameter, slack)
    if sensor.outline is None or skin is None:
        return
    part = coverage(skin, shape)
    labelled: Any = scipy.ndimage.label(part.reshape(*shape, 2).max(-1) > 0)
    parts = labelled[0]
    cells = np.clip(
        (xy / np.asarray(sensor.size) * shape).astype(int), 0, np.array(shape) - 1
    )
    near = scipy.ndimage.grey_dilation(parts, 3)
    which = np.where(parts[tuple(cells.T)] > 0, parts[tuple(cells.T)], near[tuple(cells.T)])
    apart = np.flatnonzero(which != which[0])
    require(
        not apart.size,
        "outline",
        f"electrodes {apart[:5].tolist()} on another part than electrode 0",
        "one connected sheet (a mesh of more `divisions` may join thin necks)",
    )


def require_on_sheet(
    size: Array, scene: AbstractShape, outline: AbstractEdge | None = None
) -> None:
    """**Raises:** `ValueError` for a shape of which no part lies on the sheet.

    And for one that is far larger than the sheet: its lengths are no metres. Values under a
    trace pass, and shapes that users write.
    """
    for shape in scene.shapes if isinstance(scene, Scene) else (scene,):
        if isinstance(shape, Scene):
            require_on_sheet(size, shape, outline)
        elif known(size, *jax.tree.leaves((shape, outline))):
            _require_on_sheet(np.asarray(size, float), shape, outline, size.dtype)


def _require_on_sheet(
    size: np.ndarray, shape: AbstractShape, outline: AbstractEdge | None, dtype: Any
) -> None:
    reach, off = 0.0, False
    if isinstance(shape, Polygon):
        vertices = np.asarray(shape.vertices, float)
        name, low, high = "vertices", vertices.min(0), vertices.max(0)
    elif isinstance(shape, Disc | Ellipse | Bar | Ring):
        center, reach = np.asarray(shape.center, float), _reach(shape)
        name, low, high = "center", center - reach, center + reach
        if outline is not None:
            off = float(outline.distance(jnp.asarray(center, dtype))) > reach
    else:
        return
    kind, (x, y) = type(shape).__name__.lower(), (low + high) / 2
    if (low < size).all() and (high > 0).all() and not off:
        told, expected = f"{reach:g} m", "a part of that; lengths are in metres"
        require(reach <= _LARGEST * size.max(), f"reach of the {kind}", told, expected)
        return
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


def check_one_size(diameter: Any) -> None:
    """Raises ValueError for diameters of several sizes, which a sensor does not take."""
    one = "one number, m, of every electrode; `told` has sheets with several sizes"
    shape = np.shape(diameter)
    require(shape == (), "electrode_diameter", f"shape {shape}", one)


def check_conditions(name: str, table: Array, electrodes: int) -> None:
    """Refuses a table of conductances to ground, S. **Raises:** `ValueError`."""
    require_shape(name, table, (None, electrodes))
    require(table.size > 0, name, "none", "at least one")
    require_array(name, table, "not negative")
    if known(table):
        # Less than 1e-12 S is an insulator's, and no path to ground.
        floating = np.flatnonzero(np.asarray(table).sum(1) < 1e-12)
        require(not floating.size, name, f"slots {floating[:5]} ungrounded", "a ground")


def check_mesh(sensor: Any) -> None:
    size, diameter = box_in_space(sensor), float(sensor.electrode_diameter)
    cell = (size / np.array(sensor.divisions)).max()
    enough = np.ceil(size / diameter).astype(int).tolist()
    require(
        cell <= diameter * (1 + 1e-5),
        "divisions",
        f"{sensor.divisions}, cells of {cell:.3g} m",
        f"cells no wider than an electrode, {diameter:g} m: at least {enough}",
    )


def box_in_space(sensor: Any) -> Float[np.ndarray, "2"]:
    """Returns the box's size, m, as long as it is in space where electrodes stretch it."""
    size = np.asarray(sensor.size, float)
    if sensor.surface is None or not known(*jax.tree.leaves(sensor.surface)):
        return size
    return size * stretch(sensor.surface, sensor.electrode_xy, size).max(1)


def stretch(surface: Callable, places: Numbers, size: Numbers) -> Float[np.ndarray, "2 M"]:
    """Computes how long steps along x and y of the chart are in space, at places."""
    at, step = np.asarray(places, float), np.asarray(size, float) / MOST_CELLS
    dtype = jnp.asarray(places).dtype
    skin = Skin(np.zeros(0), surface_on_host(surface, dtype))
    return local_cells(skin, at, step) / step[:, None]
