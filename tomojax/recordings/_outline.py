"""Describes a recording's sheet, and its ground conditions; loads no JAX by itself."""

from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from tomojax._require import require

if TYPE_CHECKING:
    import tomojax.sensor

# Corners that a round outline is drawn with.
_CORNERS = 180

# More are a mistake.
_MOST = 20_000
_MOST_PLACES = 1 << 22  # of a surface


@dataclass(frozen=True)
class Outline:
    """A sheet that is no flat rectangle, in its box: its outline, and its places in space.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.disc(0.1, {"rim": 8, "points": [[0.05, 0.05]]})
    >>> rig = tx.recordings.Rig.of(sensor)
    >>> rig.outline.kind, rig.outline.diameter.__round__(3), rig.sensor().electrode_count
    ('disc', 0.1, 9)
    """

    kind: str  # "rectangle", "disc" or "polygon"
    diameter: float = 0.0  # of a disc, m
    loops: tuple[Float[np.ndarray, "n 2"], ...] = ()  # a polygon's corners, then holes', m
    surface: Float[np.ndarray, "nx ny 3"] | None = None  # a curved sheet's places, m

    @classmethod
    def of(cls, sensor: "tomojax.sensor.Sensor") -> "Outline | None":
        """Returns a sensor's; None of a flat rectangle. **Raises:** `ValueError`."""
        from tomojax.sensor import GridSurface, PolygonEdge, RoundEdge

        edge, surface = sensor.outline, None
        if sensor.flat:
            return None
        if sensor.surface is not None:
            surface = np.asarray(GridSurface.of(sensor.surface, sensor.size).places, float)
        if edge is None:
            return cls("rectangle", surface=surface)
        if isinstance(edge, PolygonEdge):
            return cls("polygon", loops=tuple(edge.loops()), surface=surface)
        centred = isinstance(edge, RoundEdge) and bool(
            np.allclose(np.asarray(edge.center), np.asarray(sensor.size) / 2)
        )
        kind = type(edge).__name__
        require(centred, "outline", kind, "a disc in its box's middle, or a polygon")
        return cls("disc", 2 * float(edge.radius), surface=surface)  # pyright: ignore

    @classmethod
    def read(cls, told: Any, dataset: Any) -> "Outline | None":
        """Reads attributes and datasets of a file, recording version 2."""
        kind = told.get("outline", "rectangle")
        kind = kind.decode(errors="replace") if isinstance(kind, bytes) else str(kind)
        surface = dataset("surface")
        surface = None if surface is None else _places(surface)
        if kind == "rectangle":
            return None if surface is None else cls(kind, surface=surface)
        if kind == "disc":
            across = np.squeeze(np.asarray(told.get("diameter", np.nan), float))
            fine = across.shape == () and bool(0 < across < np.inf)
            require(fine, "diameter", told.get("diameter"), "m, above 0")
            return cls("disc", float(across), surface=surface)
        known = "'rectangle', 'disc' or 'polygon'"
        require(kind == "polygon", "outline", repr(kind[:40]), known)
        loops = [_corners("outline_xy", dataset("outline_xy"), 2)]
        holes = dataset("holes")
        if holes is not None and len(holes):
            each = _corners("holes", holes, 3)
            loops += [each[each[:, 0] == k, 1:] for k in np.unique(each[:, 0])]
        return cls("polygon", loops=tuple(loops), surface=surface)

    def attributes(self) -> dict[str, Any]:
        """Returns a file's attributes."""
        across = {"diameter": self.diameter} if self.diameter else {}
        return {"outline": self.kind} | across

    def datasets(self) -> dict[str, np.ndarray]:
        """Returns a file's datasets: places, corners, and rows of [hole, x, y]."""
        found = {} if self.surface is None else {"surface": self.surface}
        if not self.loops:
            return found
        numbered = [
            np.column_stack([np.full(len(hole), k), hole])
            for k, hole in enumerate(self.loops[1:])
        ]
        found["outline_xy"] = self.loops[0]
        return found | ({"holes": np.concatenate(numbered)} if numbered else {})

    def sheet(self, size: Any) -> dict[str, Any]:
        """Makes the outline and the surface of a `Sensor` in a box of `size`, m."""
        from tomojax.sensor import GridSurface, PolygonEdge, RoundEdge

        surface = None if self.surface is None else GridSurface(self.surface, size)
        edge = None
        if self.kind == "disc":
            edge = RoundEdge(np.asarray(size) / 2, self.diameter / 2)
        if self.kind == "polygon":
            edge = PolygonEdge(self.loops[0], list(self.loops[1:]))
        return {"outline": edge, "surface": surface}

    def lines(self, size: Any) -> list[Float[np.ndarray, "n 2"]]:
        """Returns closed lines to draw, m."""
        if self.kind == "disc":
            angle = np.linspace(0, 2 * np.pi, _CORNERS, endpoint=False)
            ring = np.stack([np.cos(angle), np.sin(angle)], 1)
            return [np.asarray(size, float) / 2 + self.diameter / 2 * ring]
        return list(self.loops)


def _corners(name: str, values: Any, columns: int) -> np.ndarray:
    require(values is not None, name, "none", "it, as the outline is a polygon")
    corners = np.asarray(values, float)
    fine = corners.ndim == 2 and corners.shape[1] == columns and 3 <= len(corners) <= _MOST
    require(fine, name, f"shape {corners.shape}", f"(3 to {_MOST}, {columns})")
    require(bool(np.isfinite(corners).all()), name, "NaN or infinite", "numbers")
    return corners


def _places(values: Any) -> np.ndarray:
    name, places = "surface", np.asarray(values, float)
    fits = places.ndim == 3 and places.shape[2] == 3 and min(places.shape[:2]) > 1
    expected = f"(nx, ny, 3), {_MOST_PLACES} numbers at most"
    fits = fits and places.size <= _MOST_PLACES
    require(fits, name, f"shape {places.shape}", expected)
    require(bool(np.isfinite(places).all()), name, "NaN or infinite", "numbers")
    return places


def check_table(table: Any, electrodes: int) -> Float[np.ndarray, "C M"]:
    """Checks a recording's conductances to ground, S. **Raises:** `ValueError`.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> tx.recordings.check_table([[0.25, 0.0], [0.0, 0.25]], 2).shape
    (2, 2)
    """
    name, values = "conditions/to_ground", np.asarray(table, float)
    fits = values.ndim == 2 and values.shape[1] == electrodes and 0 < len(values) < 1 << 16
    require(fits, name, f"shape {values.shape}", f"(conditions, {electrodes})")
    fine = bool((np.isfinite(values) & (values >= 0)).all() and (values.sum(1) > 0).all())
    require(fine, name, "conductances below 0, or no ground", "S, a ground in each row")
    return values
