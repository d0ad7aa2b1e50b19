"""Makes sensors: of a grid, within an outline, of a mesh, of a file."""

from pathlib import Path
from typing import Any, TYPE_CHECKING, TypeVar

import jax.numpy as jnp
import numpy as np

from tomojax._checks import checked, known, require
from tomojax._custom_types import Numbers
from tomojax._require import require_whole
from tomojax.sensor._edges import AbstractEdge, PolygonEdge, RoundEdge
from tomojax.sensor._placing import (
    check_one_size,
    Electrodes,
    MOST_CELLS,
    places_named,
    stretch,
)
from tomojax.sensor.meshes._mesh_file import read_triangles
from tomojax.sensor.meshes._triangles import chart_places, unroll

# Cells of a cut sheet's mesh, of an electrode's diameter.
_CELLS = 3


_Sensor = TypeVar("_Sensor", bound="Made")


class Made:
    """The ways to make a sensor, beside its own arguments."""

    if TYPE_CHECKING:  # a sensor's

        def __init__(self, size: Numbers, electrode_xy: Numbers, **others: Any): ...

    @classmethod
    def grid(
        cls: type[_Sensor],
        rows: int = 8,
        columns: int = 8,
        pitch: Numbers = 0.020,
        margin: Numbers = 0.010,
        **others: Any,
    ) -> _Sensor:
        """Makes a sensor of rows along x and columns along y, e = row·columns + column.

        **Arguments:** `pitch` between electrodes and `margin` from outer electrodes to
        the edge, m, one value or (x, y); `others` as in `Sensor`. The defaults are the
        paper's sensor: 8 × 8 electrodes on 160 mm × 160 mm.
        """
        for name, count in (("rows", rows), ("columns", columns)):
            require_whole(name, count)
        dtype = others.get("dtype")
        both = (
            checked(name, value, "positive", (), (2,), dtype=dtype)
            for name, value in (("pitch", pitch), ("margin", margin))
        )
        # In NumPy where they are known: of JAX each operation would be a program.
        step, rim = (np.asarray(a) if known(a) else a for a in both)
        count = np.array([rows, columns])
        index = np.indices((rows, columns)).reshape(2, -1).T
        xy = rim + step * index.astype(step.dtype)
        size = 2 * rim + step * (count - 1).astype(step.dtype)
        return cls(others.pop("size", size), xy, **others)

    @classmethod
    def disc(
        cls: type[_Sensor], diameter: Numbers, electrodes: Electrodes, **others: Any
    ) -> _Sensor:
        """Makes a round sensor of a `diameter`, m.

        `electrodes`: places (M, 2), m, or a dict. Its `rim` puts so many along the outer
        edge, `inset` m inside it; `grid` lays a square grid of that pitch, m; `points` adds
        places. Electrodes are numbered in this order.

        **Example:**

        >>> import tomojax as tx
        >>> sensor = tx.Sensor.disc(0.1, {"rim": 16, "grid": 0.03})
        >>> sensor.electrode_count, bool(sensor.on_sheet([[0.001, 0.001]]).any())
        (25, False)
        """
        across = checked("diameter", diameter, "positive", ())
        size = jnp.broadcast_to(across, 2)
        return cls.cut(size, RoundEdge(size / 2, across / 2), electrodes, **others)

    @classmethod
    def polygon(
        cls: type[_Sensor],
        points: Numbers,
        electrodes: Electrodes,
        holes: list[Numbers] | tuple[Numbers, ...] = (),
        **others: Any,
    ) -> _Sensor:
        """Makes a sensor within a polygon, with holes; vertices from 0 up, m.

        `electrodes` as in `disc`; the box ends at the highest x and y.

        **Example:**

        >>> import tomojax as tx
        >>> letter = [[0, 0], [0.1, 0], [0.1, 0.05], [0.05, 0.05], [0.05, 0.1], [0, 0.1]]
        >>> sensor = tx.Sensor.polygon(letter, {"grid": 0.02})
        >>> sensor.electrode_count, f"{1e4 * sensor.area:.0f} cm²"
        (16, '75 cm²')
        """
        edge = PolygonEdge(points, holes)
        low = float(np.asarray(edge.start).min()) if known(edge.start) else 0.0
        require(low >= 0, "points", f"{low:g} m", "x and y of 0 or above")
        return cls.cut(edge.start.max(0), edge, electrodes, **others)

    @classmethod
    def cut(
        cls: type[_Sensor],
        size: Numbers,
        outline: AbstractEdge,
        electrodes: Electrodes,
        **others: Any,
    ) -> _Sensor:
        """Makes a sensor of any `outline` in a box of `size`; a mesh that suits both."""
        size, diameter = checked("size", size, "positive", (2,)), _diameter(others)
        if isinstance(electrodes, dict):
            electrodes = places_named(outline, size, diameter, electrodes)
        if "divisions" not in others:
            least = float(np.asarray(diameter))
            if isinstance(outline, PolygonEdge) and known(outline.start):
                least = outline.narrowest(least)  # as many cells across a gap
            finest = np.asarray(size, float) / least
            if others.get("surface") is not None:
                finest = finest * stretch(others["surface"], electrodes, size).max(1)
            cells = np.ceil(_CELLS * finest * (1 - 1e-5)).astype(int)
            coarsest = float(np.max(size)) / MOST_CELLS
            require(
                least >= min(coarsest, float(np.asarray(diameter))),
                "outline",
                f"a gap or a neck {least:.2g} m wide",
                f"{coarsest:.2g} m, a cell, or `divisions` of your own: it may close",
            )
            others["divisions"] = tuple(np.clip(cells, 8, MOST_CELLS).tolist())
        return cls(size, electrodes, outline=outline, **others)

    @classmethod
    def mesh(
        cls: type[_Sensor],
        vertices: Numbers,
        triangles: Numbers,
        electrodes: Electrodes,
        uv: Numbers | None = None,
        **others: Any,
    ) -> _Sensor:
        """Makes a sensor of a sheet of triangles, flat or curved, with holes or without.

        **Arguments:** `vertices` (n, 2) or (n, 3), m; `triangles` (k, 3), numbers of
        vertices, all the same way round; `electrodes`: places in space (M, 3), m, within a
        radius of the mesh, or places in the chart (M, 2), or what `place_electrodes` takes,
        by name; `uv` (n, 2), m: a chart, of about the sheet's area. By default a flat mesh
        is its own chart. A curved mesh is unrolled with the least loss of angles, and its
        area is kept. The sensor's box begins at the chart's lowest x and y.
        **Raises:** `ValueError` for triangles that are no sheet with an edge, and charts
        that fold.

        **Example:**

        >>> import numpy as np
        >>> import tomojax as tx
        >>> across = np.linspace(0, np.pi, 25)
        >>> angle, y = np.meshgrid(across, np.linspace(0, 0.1, 11), indexing="ij")
        >>> arch = np.stack([0.04 * np.cos(angle), y, 0.04 * np.sin(angle)], -1)
        >>> a = np.arange(24 * 11).reshape(24, 11)[:, :-1].ravel()
        >>> two = [[a, a + 1, a + 11], [a + 1, a + 12, a + 11]]
        >>> triangles = np.concatenate([np.stack(one, 1) for one in two])
        >>> sensor = tx.Sensor.mesh(arch.reshape(-1, 3), triangles, {"grid": 0.02})
        >>> sensor.electrode_count, f"{1e4 * sensor.area:.0f} cm²"
        (35, '125 cm²')
        """
        sheet = unroll(vertices, triangles, uv)
        diameter = float(_diameter(others))
        named = isinstance(electrodes, dict)
        points = electrodes.get("points") if named else electrodes
        if points is not None:
            points = chart_places(sheet, points, diameter / 2)
            electrodes = electrodes | {"points": points} if named else points
        edge = PolygonEdge(sheet.loops[0], tuple(sheet.loops[1:]))
        box, surface = sheet.chart.max(0), sheet.surface
        return cls.cut(box, edge, electrodes, surface=surface, **others)

    @classmethod
    def from_file(
        cls: type[_Sensor],
        path: str | Path,
        electrodes: Electrodes,
        scale: float = 1e-3,
        **others: Any,
    ) -> _Sensor:
        """Makes a sensor of a mesh in a file: .stl, .obj, .ply, .msh, …, as `mesh` does.

        `scale`: m per unit of the file; the default is for mm, which STL files mostly have.
        meshio reads the file: `pip install 'tomojax[mesh]'`.

        **Example:**

        >>> import meshio
        >>> import tomojax as tx
        >>> corners = [[0, 0, 0], [80, 0, 0], [80, 80, 0], [0, 80, 0]]
        >>> plate = meshio.Mesh(corners, [("triangle", [[0, 1, 2], [0, 2, 3]])])
        >>> plate.write("plate.stl")
        >>> tx.Sensor.from_file("plate.stl", {"grid": 0.02}).electrode_count
        16
        """
        return cls.mesh(*read_triangles(Path(path), scale), electrodes, **others)


def _diameter(others: dict[str, Any]) -> Any:
    """Returns the electrodes' diameter, m, checked: outlines are looked at by it."""
    diameter = others.get("electrode_diameter", 0.005)
    check_one_size(diameter)
    return np.asarray(checked("electrode_diameter", diameter, "positive", ()))
