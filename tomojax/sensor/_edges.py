"""Describes a sheet that is no rectangle: its outline in the box, its surface in space."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from tomojax._checks import checked, known, require
from tomojax._custom_types import Numbers
from tomojax._shown import named, shown
from tomojax.kernels.sheet import nodes, Skin
from tomojax.sensor._outline import checked_center, Density, norm, Points

# Sides of an outline, or nodes of a surface: more are a mistake, and would take minutes.
_MOST = 20_000

# Samples of an outline that gaps are looked for between; and how much farther than across
# it the way along the edge is, past a gap or a neck.
_SAMPLES = 2000
_AROUND = 3.0

# Places that are computed at once, by one program.
_TOGETHER = 4096


class AbstractEdge(eqx.Module):
    """The outline of a sheet: the distance to its edge, m, negative on the sheet.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> class Half(tx.sensor.AbstractEdge):  # of a box of 80 mm
    ...     def distance(self, points):
    ...         return points[..., 0] - 0.04
    >>> sensor = tx.Sensor(
    ...     [0.08, 0.08], [[0.01, 0.02], [0.02, 0.06]], outline=Half(), divisions=(16, 16)
    ... )
    >>> print(f"{1e4 * sensor.area:.1f} cm²")
    32.0 cm²
    """

    @abstractmethod
    def distance(self, points: Points) -> Density:
        """Distance to the edge, m, negative on the sheet."""


class RoundEdge(AbstractEdge):
    """A round sheet: `center` (2,) and `radius`, m.

    **Example:**

    >>> import tomojax as tx
    >>> edge = tx.sensor.RoundEdge([0.05, 0.05], 0.05)
    >>> print(f"{1e3 * float(edge.distance(edge.center)):.0f} mm")
    -50 mm
    """

    center: Float[Array, "2"]
    radius: Float[Array, ""]

    def __init__(self, center: Numbers, radius: Numbers):
        self.center = checked_center(center)
        self.radius = checked("radius", radius, "positive", ())

    def distance(self, points: Points) -> Density:
        return round_distance(points, self.center, self.radius)

    def __repr__(self) -> str:
        return named(self, radius=shown(self.radius, "mm", 1e3))


class PolygonEdge(AbstractEdge):
    """A sheet within a polygon, with holes: vertices in order, either way round, m.

    **Raises:** `ValueError` for an outline that crosses itself, or of fewer than three
    vertices.

    **Example:**

    >>> import tomojax as tx
    >>> square = [[0, 0], [0.08, 0], [0.08, 0.08], [0, 0.08]]
    >>> hole = [[0.03, 0.03], [0.05, 0.03], [0.05, 0.05], [0.03, 0.05]]
    >>> edge = tx.sensor.PolygonEdge(square, holes=[hole])
    >>> bool(edge.distance(edge.start.mean(0)) > 0)  # in the hole
    True
    """

    start: Float[Array, "n 2"]
    end: Float[Array, "n 2"]

    def __init__(self, points: Numbers, holes: list[Numbers] | tuple[Numbers, ...] = ()):
        inner = enumerate(() if holes is None else holes)
        loops = [_loop("points", points)]
        loops += [_loop(f"holes[{k}]", hole) for k, hole in inner]
        self.start = jnp.concatenate(loops)
        self.end = jnp.concatenate([jnp.roll(loop, -1, 0) for loop in loops])
        if known(self.start):
            _check_sides(np.asarray(self.start, float), np.asarray(self.end, float))
            _check_loops([np.asarray(loop, float) for loop in loops])

    def loops(self) -> list[np.ndarray]:
        """Returns the vertices of the outline, then of each hole, m (host)."""
        start, end = np.asarray(self.start), np.asarray(self.end)
        lasts = np.flatnonzero((np.roll(start, -1, 0) != end).any(1))
        return np.split(start, lasts[:-1] + 1)

    def distance(self, points: Points) -> Density:
        return polygon_distance(points, self.start, self.end)

    def narrowest(self, wide: float) -> float:
        """Returns the width of the narrowest gap or neck, at most `wide`, m (host).

        Two places of the edge are its sides if the way between them along the edge is
        longer than two `wide`, and three times as long as across.
        """
        loops, samples = self.loops(), []
        rounds = [np.concatenate([loop, loop[:1]]) for loop in loops]
        ways = [np.hypot(*np.diff(r, axis=0).T).cumsum() for r in rounds]
        total = sum(way[-1] for way in ways)
        for k, (ring, way) in enumerate(zip(rounds, ways)):
            at = np.arange(0, way[-1], max(total / _SAMPLES, wide / 20))
            x, y = (np.interp(at, np.append(0, way), ring[:, c]) for c in (0, 1))
            samples.append(np.stack([x, y, at, np.full_like(at, way[-1]), 0 * at + k]))
        x, y, at, whole, loop = np.concatenate(samples, 1)
        one, other = (
            scipy.spatial.KDTree(np.stack([x, y], 1))
            .query_pairs(wide, output_type="ndarray")
            .T
        )
        across = np.hypot(x[one] - x[other], y[one] - y[other])
        along = np.abs(at[one] - at[other])
        along = np.minimum(along, whole[one] - along)
        sides = along > np.maximum(_AROUND * across, 2 * wide)
        sides |= loop[one] != loop[other]
        return float(across[sides].min(initial=wide))

    def __repr__(self) -> str:
        return named(self, sides=shown(len(self.start)))


def _loop(name: str, points: Numbers) -> Float[Array, "n 2"]:
    loop = checked(name, points, "finite", (None, 2))
    require(3 <= len(loop) <= _MOST, name, f"{len(loop)} vertices", f"3 to {_MOST}")
    if not known(loop):
        return loop
    # A closed ring, as GeoJSON and others have it, and points that are drawn twice.
    corners = np.asarray(loop)
    corners = corners[(corners != np.roll(corners, 1, 0)).any(1)]
    require(len(corners) >= 3, name, f"{len(corners)} vertices apart", "three or more")
    return loop if len(corners) == len(loop) else jnp.asarray(corners)


def _check_loops(loops: list[np.ndarray]) -> None:
    """**Raises:** `ValueError` for a loop around nothing, and a hole not within."""
    for k, (x, y) in enumerate(loop.T for loop in loops):
        area = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
        name = f"holes[{k - 1}]" if k else "points"
        flat = 1e-6 * np.ptp(x) * np.ptp(y)  # by rounding
        require(area > flat, name, f"an area of {area:.3g} m²", "a loop around some")
    for k, hole in enumerate(loops[1:]):
        at = hole + 1e-6 * (hole.mean(0) - hole)  # a corner may be on the edge
        for other, loop in enumerate(loops):
            out = _within(at, loop) != (other == 0)
            if other != k + 1 and out.any():
                x, y = 1e3 * hole[int(np.argmax(out))]
                where = f"in holes[{other - 1}]" if other else "off the sheet"
                told = f"a corner ({x:g}, {y:g}) mm {where}"
                require(False, f"holes[{k}]", told, "a hole of its own within `points`")


def _within(at: np.ndarray, loop: np.ndarray) -> np.ndarray:
    """Tells which places a loop is around, as `polygon_distance` does (host)."""
    (x, y), end = at.T[..., None], np.roll(loop, -1, 0)
    spans = (loop[:, 1] > y) != (end[:, 1] > y)
    rise = np.where(end[:, 1] == loop[:, 1], 1, end[:, 1] - loop[:, 1])
    crossing = loop[:, 0] + (y - loop[:, 1]) / rise * (end[:, 0] - loop[:, 0])
    return (spans & (x < crossing)).sum(-1) % 2 == 1


def _check_sides(start: np.ndarray, end: np.ndarray) -> None:
    """**Raises:** `ValueError` for two sides that cross."""
    sides = len(start)

    def beyond(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
        one, other = b - a, c - a
        return np.sign(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])

    for k in range(sides):
        a, b, c, d = start[k], end[k], start[k + 1 :], end[k + 1 :]
        crosses = beyond(a, b, c) * beyond(a, b, d) < 0
        crosses &= beyond(c, d, a) * beyond(c, d, b) < 0
        if crosses.any():
            x, y = 1e3 * start[k]
            raise ValueError(
                f"points: side {k} from ({x:g}, {y:g}) mm crosses side "
                f"{k + 1 + int(np.argmax(crosses))}; an outline may not cross itself"
            )


def skin_on(
    outline: AbstractEdge | None,
    surface: Callable | None,
    shape: tuple[int, int],
    size: Float[np.ndarray, "2"],
    dtype: Any,
) -> Skin | None:
    """Describes a sheet on a mesh of `shape`, on the host; None for a flat rectangle."""
    if outline is None and surface is None:
        return None
    level = np.full(np.prod(np.array(shape) + 1), -float(size.max()))
    if outline is not None:
        level = in_parts(_distances, outline, nodes(shape, size), dtype)
    return Skin(level, surface_on_host(surface, dtype))


def surface_on_host(surface: Callable | None, dtype: Any) -> Callable | None:
    """Makes a surface that takes and gives NumPy's arrays."""
    if surface is None:
        return None
    return lambda points: in_parts(_places, surface, points, dtype)


def in_parts(
    function: Callable, about: Any, at: Float[np.ndarray, "n 2"], dtype: Any
) -> Float[np.ndarray, "n ..."]:
    """Computes `function(about, points)` of many points by one program (host)."""
    found = []
    for k in range(0, len(at), _TOGETHER):
        some = at[k : k + _TOGETHER]
        given = np.resize(some, (_TOGETHER, 2)).astype(dtype)
        found.append(np.asarray(function(about, given), float)[: len(some)])
    return np.concatenate(found)


@eqx.filter_jit
def _distances(outline: AbstractEdge, at: Float[Array, "n 2"]) -> Float[Array, " n"]:
    return outline.distance(at)


@eqx.filter_jit
def _places(surface: Callable, at: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
    return surface(at)


@jax.jit  # also on the host one program
def round_distance(points: Points, center: Array, radius: Array) -> Density:
    """Computes the distance to a circle, negative inside."""
    return norm(points - center) - radius


@jax.jit
def polygon_distance(points: Points, start: Array, end: Array) -> Density:
    """Computes the signed distance to sides from `start` to `end`, negative inside.

    Inside is where a ray along +x crosses an odd number of sides.
    """
    edge, to = end - start, points[..., None, :] - start
    along = (to * edge).sum(-1) / (edge**2).sum(-1)
    nearest = norm(to - jnp.clip(along, 0, 1)[..., None] * edge).min(-1)
    x, y = points[..., None, 0], points[..., None, 1]
    spans = (start[:, 1] > y) != (end[:, 1] > y)
    rise = jnp.where(edge[:, 1] == 0, 1, edge[:, 1])
    crossing = start[:, 0] + (y - start[:, 1]) / rise * edge[:, 0]
    inside = (spans & (x < crossing)).sum(-1) % 2 == 1
    return jnp.where(inside, -nearest, nearest)
