"""Contacts drawn by strokes: letters, digits, hands, rings, tools, of any turn and size."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

# Points of a side of the raster that a shape's area is told by.
_RASTER = 400

Line = list[tuple[Any, Any]]


@dataclass(frozen=True)
class Strokes:
    """Lines with a width each; `series` and `exponent` as of `Touch`."""

    lines: tuple[Float[np.ndarray, "n 2"], ...]  # m; a line of one point is a disc
    widths: tuple[float, ...]  # m
    per_area: float | int  # S/m² under the strokes that press most
    presses: tuple[float, ...] = ()  # how much each stroke has of that; all, by default
    soft: float = 0.0  # the part of a stroke's half width over which pressure falls to 0
    series: float = 0.0  # Ω
    exponent: float = 1.0
    angle: float = 0.0

    @property
    def xy(self) -> Float[np.ndarray, "2"]:
        """The middle of the box around the lines, m."""
        low, high = self._box()
        return (low + high) / 2

    @property
    def half_axes(self) -> tuple[float, float]:
        """Half axes of a circle that holds the lines, m."""
        low, high = self._box()
        reach = float(np.hypot(*(high - low))) / 2
        return reach, reach

    def _box(self) -> tuple[np.ndarray, np.ndarray]:
        ends = [(line.min(0) - w / 2, line.max(0) + w / 2) for line, w in self._each()]
        low, high = zip(*ends)
        return np.min(low, 0), np.max(high, 0)

    def _each(self):
        return zip(self.lines, self.widths, strict=True)

    def depths(self, points: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, "s p"]:
        """Returns depths of points in strokes, of their half widths; negative outside."""
        return np.stack(
            [1 - _distance(points, line) / (width / 2) for line, width in self._each()]
        )

    def density(self, points: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, " p"]:
        """Returns the conductance per area, of the highest; 0 outside."""
        depth = self.depths(points)
        part = (depth > 0).astype(float)
        if self.soft > 0:
            part = np.clip(depth / self.soft, 0, 1)
        presses = self.presses or (1.0,) * len(self.lines)
        return (np.array(presses)[:, None] * part).max(0)

    def inside(self, points: Float[np.ndarray, "p 2"]) -> Bool[np.ndarray, " p"]:
        """Returns which points are touched."""
        return np.asarray((self.depths(points) > 0).any(0))

    @property
    def conductance(self) -> float:
        """The total conductance, S, if all lines are on the sheet."""
        low, high = self._box()
        part = (np.arange(_RASTER) + 0.5) / _RASTER
        x, y = (a + (b - a) * part for a, b in zip(low, high))
        points = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
        blocks = np.array_split(points, 20)
        mean = np.concatenate([self.density(b) for b in blocks]).mean()
        return float(self.per_area * mean * np.prod(high - low))

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        """The middle of the box around the lines, m."""
        return self.xy


def _distance(points: np.ndarray, line: np.ndarray) -> Float[np.ndarray, " p"]:
    """Returns the distance of points to a line of straight pieces."""
    if len(line) == 1:
        return np.hypot(*(points - line[0]).T)
    least = np.full(len(points), np.inf)
    for a, b in zip(line[:-1], line[1:]):
        along = b - a
        part = ((points - a) @ along) / max(float(along @ along), 1e-30)
        foot = a + np.clip(part, 0, 1)[:, None] * along
        least = np.minimum(least, np.hypot(*(points - foot).T))
    return least


_Number = float | int


def _arc(
    x: _Number, y: _Number, r: _Number, start: _Number, end: _Number, ry: _Number = 0
) -> Line:
    """Returns part of a circle, or of an ellipse of height `ry`; angles in degrees."""
    turn = np.radians(np.linspace(start, end, 25))
    rise = ry or r
    return [(x + r * c, y + rise * s) for c, s in zip(np.cos(turn), np.sin(turn))]


# Centre lines, of the height between the ends of strokes: y from −0.5 to 0.5.
GLYPHS: dict[str, list[Line]] = {
    "0": [_arc(0, 0, 0.3, 0, 360, 0.5)],
    "1": [[(-0.15, 0.3), (0.05, 0.5), (0.05, -0.5)]],
    "2": [[*_arc(0, 0.2, 0.3, 170, -30), (-0.3, -0.5), (0.3, -0.5)]],
    "3": [_arc(0, 0.25, 0.25, 140, -90) + _arc(0, -0.25, 0.25, 90, -140)],
    "4": [[(0.15, -0.5), (0.15, 0.5), (-0.3, -0.2), (0.35, -0.2)]],
    "5": [[(0.28, 0.5), (-0.25, 0.5), (-0.25, 0.05), *_arc(0, -0.17, 0.32, 135, -145)]],
    "6": [[(0.2, 0.5), *_arc(0, -0.2, 0.3, 140, 500)]],
    "7": [[(-0.3, 0.5), (0.3, 0.5), (-0.1, -0.5)]],
    "8": [_arc(0, 0.25, 0.22, -90, 270), _arc(0, -0.23, 0.27, 90, 450)],
    "9": [[(-0.2, -0.5), *_arc(0, 0.2, 0.3, -40, 320)]],
    "A": [[(-0.35, -0.5), (0, 0.5), (0.35, -0.5)], [(-0.2, -0.1), (0.2, -0.1)]],
    "C": [_arc(0, 0, 0.35, 50, 310, 0.5)],
    "E": [[(0.3, 0.5), (-0.3, 0.5), (-0.3, -0.5), (0.3, -0.5)], [(-0.3, 0), (0.2, 0)]],
    "F": [[(0.3, 0.5), (-0.3, 0.5), (-0.3, -0.5)], [(-0.3, 0), (0.2, 0)]],
    "H": [[(-0.3, 0.5), (-0.3, -0.5)], [(0.3, 0.5), (0.3, -0.5)], [(-0.3, 0), (0.3, 0)]],
    "L": [[(-0.3, 0.5), (-0.3, -0.5), (0.3, -0.5)]],
    "S": [_arc(0, 0.25, 0.25, 30, 270) + _arc(0, -0.25, 0.25, 90, -150)],
    "T": [[(-0.35, 0.5), (0.35, 0.5)], [(0, 0.5), (0, -0.5)]],
    "U": [[(-0.3, 0.5), (-0.3, -0.2), *_arc(0, -0.2, 0.3, 180, 360), (0.3, 0.5)]],
    "Y": [[(-0.35, 0.5), (0, 0), (0.35, 0.5)], [(0, 0), (0, -0.5)]],
}

# The same of things, with the width of each stroke of their height.
THINGS: dict[str, tuple[list[Line], list[float]]] = {
    "hand": (
        [
            [(-0.12, -0.3), (0.12, -0.3)],
            [(-0.28, -0.1), (-0.42, 0.28)],
            [(-0.1, -0.1), (-0.14, 0.44)],
            [(0.1, -0.1), (0.14, 0.43)],
            [(0.28, -0.1), (0.4, 0.3)],
            [(0.28, -0.36), (0.54, -0.06)],
        ],
        [0.46, 0.13, 0.13, 0.13, 0.12, 0.14],
    ),
    "spanner": (
        [
            [(0, -0.42), (0, 0.24)],
            [*_arc(0, 0.36, 0.12, 140, 400)],
            [*_arc(0, -0.42, 0.06, 0, 360)],
        ],
        [0.12, 0.09, 0.08],
    ),
    "chair": ([_arc(0, 0, 0.38, 0, 360)], [0.24]),
    "cup": ([_arc(0, 0, 0.45, 0, 360)], [0.1]),
    "cable": ([[(x, 0.22 * np.sin(9 * x)) for x in np.linspace(-0.5, 0.5, 21)]], [0.1]),
    "frame": (
        [[(-0.4, -0.4), (0.4, -0.4), (0.4, 0.4), (-0.4, 0.4), (-0.4, -0.4), (0.4, -0.4)]],
        [0.2],
    ),
    "two": ([[(-0.3, -0.35), (-0.3, 0.35)], [(0.25, 0.1)]], [0.26, 0.36]),
    "foot": ([[(0, -0.36), (0.02, 0.05)], [(0.02, 0.22), (-0.04, 0.3)]], [0.24, 0.34]),
}


def draw_strokes(
    name: str,
    middle: Float[np.ndarray, "2"],
    height: float | int,
    turn: float | int,
    per_area: float | int,
    width: float | None = None,
    **laws: float,
) -> Strokes:
    """Draws a glyph or a thing of that height, m, turned by `turn`, rad, about its middle.

    **Arguments:** `width` of a glyph's strokes, m; `laws`: `soft`, `series` and `exponent`
    of `Strokes`; `per_area` S/m².
    """
    if name in GLYPHS:
        if width is None:
            raise ValueError(f"width: got None, expected the strokes' width of {name!r}, m")
        lines, widths, scale = GLYPHS[name], None, height - width
    else:
        (lines, widths), scale = THINGS[name], height
    c, s = np.cos(turn), np.sin(turn)
    turned = np.array([[c, s], [-s, c]])
    placed = tuple(middle + scale * np.array(line) @ turned for line in lines)
    each = (width,) * len(lines) if widths is None else tuple(height * w for w in widths)
    return Strokes(placed, each, per_area, **laws)  # pyright: ignore
