"""Computes potentials on an even sheet between electrodes: NumPy, float64, uncompiled.

The Green's function is that of `tomojax.kernels.rectangle`. A slot's voltages beside a
source at x and a ground at y are V = I·(G(·, x) − G(·, y)) + C. The contact's and the
ground's resistances change I and C alone. A sheet of another outline has the Green's
function of a rectangle around it, and a smooth table of what its edge adds.

Electrodes may be in an order of a grid, of a symmetry, or of a plug.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Integer

from tomojax.kernels.rectangle import Series, turned
from tomojax.recordings import Rig

# Electrodes this near to a contact lie under it, perhaps; pitches.
UNDER = 0.65

# Terms of the series: each brings a factor of exp(−2π·long/short) at least.
_TERMS = 3

# Places whose potentials are computed at once: memory.
_TOGETHER = 256

# Places that a contact is looked for at, of the pitch; and how near to the edge.
_STEP = 0.25
_EDGE = 0.1

# Places nearer than this are one, of the electrodes' diameter.
_POINT = 0.05

# Step of a slope of what an edge adds, of the table's grid.
_SLOPE = 0.25


class Plane:
    """The sheet of a rig: its electrodes, places for contacts, and potentials of both."""

    def __init__(self, rig: Rig):
        self.xy = np.asarray(rig.electrode_xy, float)
        self.size = np.asarray(rig.size, float)
        self.count = len(self.xy)
        self.diameter = float(rig.electrode_diameter)
        self.outline, area, self._among = rig.outline, float(np.prod(self.size)), None
        self._margin = np.zeros(2)
        if rig.outline is not None:
            # SciPy and JAX, which a rectangle does without.
            from scipy.ndimage import spline_filter

            from tomojax.sensor import make_among

            sensor = replace(rig, sheet_resistance=1.0).sensor()
            self._on_sheet, area = sensor.on_sheet, sensor.area
            among = make_among(sensor)
            self._margin = np.asarray(among.margin, float)
            # Of cubic splines, so that slopes are smooth.
            self._among = spline_filter(np.asarray(among.values, float), mode="nearest")
        self.pitch = float(np.sqrt(area / self.count))
        # Discs in good contact even out the sheet under them (Maxwell, in two dimensions).
        covered = self.count * np.pi / 4 * self.diameter**2 / area
        self.least_shunt = float((1 - covered) / (1 + covered))
        self._least = _POINT * self.diameter

    def _series(self, one: np.ndarray, other: np.ndarray) -> Series:
        box = self.size + 2 * self._margin
        first, second = (turned(box, at + self._margin, np) for at in (one, other))
        sides = float(box.min()), float(box.max())
        return Series(first, second, sides, np, terms=_TERMS)

    def green(
        self, one: np.ndarray, other: np.ndarray, series: Series | None = None
    ) -> np.ndarray:
        """Computes G of two places (…, 2), at 1 Ω per square."""
        series = series or self._series(one, other)
        return series.potential(self._least) + self._more(one, other)

    def _more(self, one: np.ndarray, other: np.ndarray) -> np.ndarray | float:
        """Computes what the sheet's edge adds to the potential, at 1 Ω per square."""
        if self._among is None:
            return 0.0
        from scipy.ndimage import map_coordinates

        cells = np.array(self._among.shape[:2]) - 1
        given = {"prefilter": False, "mode": "nearest"}
        if other is self.xy:  # two axes fewer
            index = np.moveaxis((one / self.size * cells)[..., 0, :], -1, 0)
            each = [map_coordinates(table, index, **given) for table in self._at_electrodes]
            return np.stack(each, -1)
        at = np.concatenate(np.broadcast_arrays(one, other), -1) / np.tile(self.size, 2)
        index = np.moveaxis(at * np.tile(cells, 2), -1, 0)
        return map_coordinates(self._among, index, **given)

    @cached_property
    def _at_electrodes(self) -> list[np.ndarray]:
        """Computes the splines of what the edge adds at each electrode."""
        from scipy.ndimage import spline_filter

        assert self._among is not None
        axes = [np.linspace(0, s, n) for s, n in zip(self.size, self._among.shape)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
        return [spline_filter(self._more(grid, at), mode="nearest") for at in self.xy]

    def slope(
        self, one: np.ndarray, other: np.ndarray, series: Series | None = None
    ) -> np.ndarray:
        """Computes ∂G/∂x of `green` as the first place moves, (2, …), 1/m."""
        by = (series or self._series(one, other)).slope(self._least)
        box = self.size + 2 * self._margin
        slopes = np.stack(by[::-1] if box[0] > box[1] else by)
        if self._among is None:
            return slopes
        step = np.diag(_SLOPE * self.size / (np.array(self._among.shape[:2]) - 1))
        return slopes + np.stack(
            [
                (self._more(one + by, other) - self._more(one - by, other)) / (2 * by.sum())
                for by in step
            ]
        )

    def from_electrodes(self, places: Float[np.ndarray, "n 2"]) -> np.ndarray:
        """Computes potentials at the electrodes of sources at places, (n, M)."""
        return _in_parts(lambda some: self.green(some, self.xy), places)

    @cached_property
    def places(self) -> Float[np.ndarray, "K 2"]:
        """Lists the places at which contacts are looked for."""
        step, edge = _STEP * self.pitch, _EDGE * self.pitch
        axes = [np.linspace(edge, s - edge, round((s - 2 * edge) / step) + 1)
                for s in self.size]  # fmt: skip
        every = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
        return every if self.outline is None else every[np.asarray(self._on_sheet(every))]

    @cached_property
    def fields(self) -> Float[np.ndarray, "K M"]:
        """Computes potentials at the electrodes of sources at `places`."""
        return self.from_electrodes(self.places)

    @cached_property
    def searched(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Computes what a search needs, (M, K): electrodes off a place, G, its square."""
        far = (self.distance(self.places) > UNDER).astype(float).T
        fared = far * self.fields.T
        return far, fared, fared * self.fields.T

    @cached_property
    def between(self) -> Float[np.ndarray, "M M"]:
        """Computes potentials of electrodes at electrodes; a disc's own at its rim."""
        rim = np.array([self.diameter / 2, 0.0])
        table = self.green(self.xy[:, None], self.xy[None])
        right = self.xy + rim
        inside = right[:, 0] < self.size[0]
        if self.outline is not None:
            inside = np.asarray(self._on_sheet(right))
        inward = np.where(inside, 1, -1)[:, None] * rim
        np.fill_diagonal(table, self.green(self.xy, self.xy + inward))
        return table

    def distance(self, places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n M"]:
        """Computes distances from places to the electrodes, in pitches."""
        return np.hypot(*(places[:, None] - self.xy).transpose(2, 0, 1)) / self.pitch

    def with_slopes(self, places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3 n M"]:
        """Computes `from_electrodes`, and ∂G/∂x of it as a place moves, 1/m."""

        def both(some: np.ndarray) -> np.ndarray:
            given = some, self.xy, self._series(some, self.xy)
            return np.concatenate([self.green(*given)[None], self.slope(*given)])

        return _in_parts(both, places)

    def slopes(self, places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "2 n M"]:
        """Computes ∂G/∂x of `from_electrodes` as an electrode moves, 1/m."""
        return _in_parts(lambda some: self.slope(self.xy, some), places)


def _in_parts(
    compute: Callable[[np.ndarray], np.ndarray], places: Float[np.ndarray, "n 2"]
) -> np.ndarray:
    """Joins (…, n, M) of places (n, 1, 2), of which `compute` gets some at a time."""
    parts = np.array_split(places[:, None], max(1, -(-len(places) // _TOGETHER)))
    return np.concatenate([compute(some) for some in parts], -2)


# Electrodes in one row or column are in line to this part of a pitch.
_LINE = 0.25


def lattice(plane: Plane) -> tuple[int, int] | None:
    """Returns rows and columns, if electrodes lie on a grid ordered as `Sensor.grid`."""
    m = plane.count
    for columns in range(1, m + 1):
        if m % columns:
            continue
        rows = m // columns
        at = plane.xy.reshape(rows, columns, 2)
        slack = _LINE * plane.pitch
        off = max(np.ptp(at[..., 0], 1).max(), np.ptp(at[..., 1], 0).max())
        steps = np.append(np.diff(at[:, 0, 0]), np.diff(at[0, :, 1]))
        if off < slack and (steps > slack).all():
            return rows, columns
    return None


def symmetries(plane: Plane) -> dict[str, Integer[np.ndarray, " M"]]:
    """Lists symmetries: the electrode at each electrode's image, where all have one.

    The symmetries are images of the sheet onto itself, by name, `identity` first.
    """
    (a, b), (x, y) = plane.size, plane.xy.T
    images = {
        "identity": (x, y),
        "mirrored along x": (a - x, y),
        "mirrored along y": (x, b - y),
        "turned by 180°": (a - x, b - y),
    }
    if abs(a - b) < 1e-3 * max(a, b):
        images |= {
            "mirrored, x and y exchanged": (y, x),
            "turned by 90°": (a - y, x),
            "turned by −90°": (y, a - x),
            "mirrored at the other diagonal": (a - y, a - x),
        }
    found = {}
    for name, image in images.items():
        apart = np.hypot(*(np.stack(image, 1)[:, None] - plane.xy).transpose(2, 0, 1))
        nearest = apart.argmin(1)
        whole = len(np.unique(nearest)) == plane.count
        if whole and apart.min(1).max() < _LINE * plane.pitch:
            found[name] = nearest
    return found


def starts(plane: Plane) -> dict[str, Integer[np.ndarray, " M"]]:
    """Lists orders of channels to begin with: as stated, and those of a plug or a loop."""
    m = np.arange(plane.count)
    found = {"as told": m, "one on": np.roll(m, -1), "one back": np.roll(m, 1)}
    grid = lattice(plane)
    if grid is not None:
        index = m.reshape(grid)
        found["rows for columns"] = index.T.ravel()
        found["columns for rows"] = m.reshape(grid[::-1]).T.ravel()
        for name, first in (("every second row reversed", 1), ("first row reversed", 0)):
            winding = index.copy()
            winding[first::2] = winding[first::2, ::-1]
            found[name] = winding.ravel()
    return found
