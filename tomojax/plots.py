"""Pictures of a sheet and of what lies on it, on matplotlib's axes.

Each function draws on `ax`, or on the current axes, and returns them. Places are in mm.
matplotlib is an extra, `tomojax[app]`. The module knows no room: it takes what has the
fields that it draws.
"""

from collections.abc import Callable
from io import BytesIO
from typing import Any

import numpy as np

from tomojax._pictures import draw_outline, show_image, VALUE
from tomojax._require import library, require

__all__ = ["contacts", "grounds", "image", "sheet", "truth"]

_RIM = 0.03  # of the sheet's longer side, beyond its edge
_NUMBERED = 256  # electrodes at most that get their numbers

# Points along the longer side, at which a scene is asked for its outlines.
_POINTS = 400

# Places of contacts of one row get a cross, and of more rows a dot.
_FEW = 8


def sheet(sensor: Any, ax: Any = None, *, numbers: bool = True) -> Any:
    """Draws the sheet's outline and the electrodes with their numbers.

    `sensor`: a `Sensor`, or a recording's `Rig`.

    **Example:**

    >>> import matplotlib.pyplot as plt
    >>> import tomojax as tx
    >>> from tomojax import plots
    >>> _, ax = plt.subplots()
    >>> ax = plots.sheet(tx.Sensor.grid(4, 4, divisions=(16, 16)), ax)
    >>> ax.get_xlabel(), len(ax.texts)
    ('x, mm', 16)
    """
    patches = library("matplotlib.patches", "app")
    ax = _on_sheet(sensor, ax)
    width, height = _size(sensor)
    lines = outline_of(sensor)
    if lines is None:
        box = patches.Rectangle((0, 0), width, height, fill=False, ec="0.3", lw=1.2)
        ax.add_patch(box)
    draw_outline(ax, lines, "0.3")
    radius = 500 * float(sensor.electrode_diameter)
    places = 1e3 * np.asarray(sensor.electrode_xy, float)
    for number, place in enumerate(places):
        ax.add_patch(patches.Circle(place, radius, fc="0.85", ec="0.5", lw=0.6, zorder=1.5))
        if numbers and len(places) <= _NUMBERED:
            # Beside the disc, which is small and may have a mark.
            style = {"size": 7, "color": "0.35", "ha": "left", "va": "bottom"}
            ax.text(*(place + 0.5 * radius), f"{number}", clip_on=True, **style)
    return ax


def image(sensor: Any, image: Any, ax: Any = None, *, unit: str = "", **style: Any) -> Any:
    """Draws an image with a colour bar.

    **Arguments:** `image` (K,) per element of the sensor's mesh, or (nx, ny) pixels over
    the sheet; `unit` is written beside the bar; `style` goes to `imshow`.
    **Raises:** `ValueError` for another shape.

    **Example:**

    >>> import matplotlib.pyplot as plt
    >>> import tomojax as tx
    >>> from tomojax import plots
    >>> _, ax = plt.subplots()
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> volts = tx.voltages(sensor, tx.Disc([0.03, 0.05], 0.006, 1.0), [0, 15])
    >>> result = tx.reconstruct(tx.jacobian(sensor, [0, 15]), volts)
    >>> ax = plots.image(sensor, result.image, ax, unit="V")
    >>> ax.images[0].get_array().shape
    (16, 16)
    """
    pixels = np.asarray(image)
    if pixels.ndim == 1 and hasattr(sensor, "divisions"):
        nx, ny = sensor.divisions
        expected = f"({2 * nx * ny},) elements or (nx, ny) pixels"
        require(pixels.size == 2 * nx * ny, "image", f"shape {pixels.shape}", expected)
        pixels = pixels.reshape(nx, ny, 2).mean(-1)
    require(pixels.ndim == 2, "image", f"shape {pixels.shape}", "(K,), or (nx, ny) pixels")
    ax = _on_sheet(sensor, ax)
    show_image(ax, pixels, sensor.size, unit, **({"cmap": VALUE} | style))
    return ax


def contacts(found: Any, ax: Any = None, **style: Any) -> Any:
    """Draws places of contacts, and two standard deviations where they are known.

    **Arguments:** `found`: `Rows`, `Tracks`, an `Estimate`, or what a step says; `style`
    goes to `plot`.

    **Example:**

    >>> import matplotlib.pyplot as plt
    >>> import tomojax as tx
    >>> from tomojax import plots
    >>> _, ax = plt.subplots()
    >>> rows = tx.methods.empty_rows(1, {"C": 2})
    >>> rows.contact_xy[0, 0] = [0.03, 0.05]  # m
    >>> print(plots.contacts(rows, ax).lines[0].get_xydata().round())  # mm
    [[30. 50.]]
    """
    ax = _axes(ax)
    found = getattr(found, "contacts", found)
    for prefix in ("contact_", ""):
        if hasattr(found, f"{prefix}xy"):
            break
    else:
        raise ValueError(f"found: got {type(found).__name__}, expected rows or contacts")
    xy = np.asarray(getattr(found, f"{prefix}xy"), float)
    here = np.isfinite(xy).all(-1)
    cross = {"marker": "+", "ms": 11, "mew": 2.2}
    told = cross if here.sum() <= _FEW else {"marker": ".", "ms": 4}
    halo = _halo() if here.sum() <= _FEW else None
    told = {"ls": "none", "color": "tab:red", "path_effects": halo} | told | style
    ax.plot(*(1e3 * xy[here].T), **told)
    covariance = getattr(found, f"{prefix}covariance", None)
    if covariance is not None and here.sum() <= _FEW:
        ellipses(ax, xy[here], np.asarray(covariance)[here], ec=told["color"], lw=1.0)
    return ax


def grounds(sensor: Any, grounds: Any, ax: Any = None, **style: Any) -> Any:
    """Marks the electrodes that a pattern grounds with white triangles.

    **Arguments:** `grounds` numbers of electrodes (L,), or conductances to ground (L, M);
    `style` goes to `plot`.
    **Raises:** `ValueError` for numbers that no electrode has.

    **Example:**

    >>> import matplotlib.pyplot as plt
    >>> import tomojax as tx
    >>> from tomojax import plots
    >>> _, ax = plt.subplots()
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> ax = plots.grounds(sensor, tx.pattern(sensor, "edge"), ax)
    >>> print(ax.lines[0].get_xydata()[0].round())  # mm
    [10. 10.]
    """
    given, places = np.asarray(grounds), np.asarray(sensor.electrode_xy, float)
    if given.ndim == 2:
        given = np.flatnonzero((given > 0).any(0))
    whole = given.ndim == 1 and given.dtype.kind in "iu"
    inside = whole and ((given >= 0) & (given < len(places))).all()
    require(inside, "grounds", grounds, f"numbers of electrodes, 0 to {len(places) - 1}")
    ax = _on_sheet(sensor, ax)
    told = {"ls": "none", "marker": "v", "ms": 9, "mfc": "white", "mec": "black"} | style
    ax.plot(*(1e3 * places[given].T), **told)
    return ax


def truth(sensor: Any, scene: Any, ax: Any = None, **style: Any) -> Any:
    """Draws the outlines of a shape, or of each of a scene, in black.

    An outline is where the shape's conductance is half its highest; `style` goes to
    `contour`.

    **Example:**

    >>> import matplotlib.pyplot as plt
    >>> import tomojax as tx
    >>> from tomojax import plots
    >>> _, ax = plt.subplots()
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> ax = plots.truth(sensor, tx.Disc([0.03, 0.05], 0.006, 1.0), ax)
    >>> outline, = ax.collections
    >>> low, high = outline.get_datalim(ax.transData).get_points()
    >>> print(low.round(), high.round())  # mm
    [24. 44.] [36. 56.]
    """
    ax = _on_sheet(sensor, ax)
    x, y, each = _densities(sensor, scene)
    told = {"colors": "black", "linewidths": 1.5} | style
    for density in each:
        if density.max() > 0:
            drawn = ax.contour(x, y, density.T, levels=[density.max() / 2], **told)
            drawn.set(path_effects=_halo())
    return ax


def ellipses(axes, xy: np.ndarray, covariance: np.ndarray, most: int = 40, **style) -> None:
    """Draws two standard deviations about some of the places (m, m²: xx, yy, xy)."""
    from matplotlib.patches import Ellipse

    known = np.flatnonzero(np.isfinite(covariance).all(-1))
    for k in known[:: max(1, -(-len(known) // most))]:
        a, b, c = 1e6 * covariance[k].astype(float)
        sides, turn = np.linalg.eigh([[a, c], [c, b]])
        narrow, wide = 4 * np.sqrt(np.maximum(sides, 0))
        angle = np.degrees(np.arctan2(turn[1, 1], turn[0, 1]))
        style = {"fill": False, "ec": "k", "lw": 0.5} | style
        at = tuple(1e3 * xy[k])
        axes.add_patch(Ellipse(at, wide, narrow, angle=angle, **style))


def png(draw: Callable[[Any], Any], size: tuple[float, float] = (4.2, 4.0)) -> bytes | None:
    """Returns a picture that `draw` makes on its axes; None without matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        return None
    figure = Figure(figsize=size, dpi=90, layout="constrained")
    draw(figure.add_subplot())
    out = BytesIO()
    FigureCanvasAgg(figure).print_png(out)
    return out.getvalue()


def _axes(ax: Any) -> Any:
    return library("matplotlib.pyplot", "app").gca() if ax is None else ax


def _on_sheet(sensor: Any, ax: Any) -> Any:
    ax = _axes(ax)
    sides = _size(sensor)
    rim = _RIM * max(sides)
    ax.set(xlim=(-rim, sides[0] + rim), ylim=(-rim, sides[1] + rim))
    ax.set(xlabel="x, mm", ylabel="y, mm", aspect="equal")
    return ax


def outline_of(sensor: Any) -> list[np.ndarray] | None:
    """Returns closed lines around a sheet that does not fill its box, m; else None."""
    edge = getattr(sensor, "outline", None)
    if edge is None:
        return None
    if hasattr(edge, "lines"):
        return edge.lines(sensor.size)
    size = np.asarray(sensor.size, float)
    x, y = (np.linspace(0, side, _POINTS) for side in size)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
    level = np.asarray(edge.distance(points.astype(np.float32)))
    # What ends at the box is closed there.
    level = np.pad(level, 1, constant_values=float(np.abs(level).max()) * 1e-6)
    x, y = (np.concatenate([v[:1], v, v[-1:]]) for v in (x, y))
    made = library("contourpy", "app").contour_generator(x, y, level.T)
    return made.lines(0.0)


def _size(sensor: Any) -> tuple[float, float]:
    width, height = (1e3 * float(side) for side in sensor.size)
    return width, height


def _densities(sensor: Any, scene: Any) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Returns x and y, mm, and there the conductance per area of each shape."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp

    size = np.asarray(sensor.size, float)
    step = size.max() / _POINTS
    x, y = (np.arange(-1, int(side / step) + 2) * step for side in size)
    points = jnp.asarray(np.stack(np.meshgrid(x, y, indexing="ij"), -1))
    given = tuple(jnp.asarray(a, points.dtype) for a in (step, size))
    alike = lambda a: a.astype(points.dtype) if eqx.is_inexact_array(a) else a  # noqa: E731
    shapes, each = [scene], []
    while shapes:
        shape = shapes.pop(0)
        if hasattr(shape, "shapes"):
            shapes = [*shape.shapes, *shapes]
        else:
            shape = jax.tree.map(alike, shape)
            each.append(np.asarray(shape.density(points, *given)))
    return 1e3 * x, 1e3 * y, each


def _halo() -> list[Any]:
    """Returns a white rim, which shows lines on every colour of an image."""
    effects = library("matplotlib.patheffects", "app")
    return [effects.withStroke(linewidth=3.5, foreground="white")]
