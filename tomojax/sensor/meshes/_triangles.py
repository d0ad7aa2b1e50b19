"""Makes a chart, an outline and a surface of a sheet of triangles (host)."""

from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

from tomojax._require import require
from tomojax.sensor.meshes._grid_surface import gridded, GridSurface, held_solve

# The finest mesh that a sheet is solved on has 80 000 triangles. Unrolling half a million
# takes half a minute and 1 GB.
_MOST = 500_000

# A triangle whose height is this part of its longest side has no area.
_THIN = 1e-7

# A corner is left out where the outline moves by less than this part of the box.
_STRAIGHT = 5e-5

# A chart that stretches lengths so much more in one place than in another leaves too few
# cells of a mesh there. A sphere cut open at 120° from its pole has 4.
_STRETCH = 10.0


class Unrolled(NamedTuple):
    """A sheet of triangles with its chart."""

    vertices: Float[np.ndarray, "n 3"]  # m in space
    triangles: Int[np.ndarray, "k 3"]
    chart: Float[np.ndarray, "n 2"]  # m, from 0 up
    origin: Float[np.ndarray, "2"]  # m, of the chart as it was given
    loops: list[Float[np.ndarray, "c 2"]]  # corners of the outline, then of each hole, m
    surface: GridSurface | None  # None: flat


def unroll(vertices: Any, triangles: Any, uv: Any = None) -> Unrolled:
    """Checks a sheet of triangles; makes its chart, where none is given, and the rest.

    **Raises:** `ValueError` for triangles that are no sheet, and charts that fold.
    """
    places, corners, used = _checked(vertices, triangles)
    loops = _loops(corners)
    flat = uv is None and np.ptp(places[:, 2]) <= 1e-9 * np.ptp(places[:, :2])
    if uv is not None:
        given = _numbers("uv", uv, 2)
        require(
            len(given) == len(vertices), "uv", f"shape {given.shape}", "one for each vertex"
        )
        chart = given[used]
    else:
        chart = places[:, :2] if flat else _conformal(places, corners, loops)
    _check_chart("triangles" if uv is None else "uv", places, corners, chart)
    origin = chart.min(0)
    chart = chart - origin
    # The outer loop is the one that the others are in.
    rims = sorted((chart[loop] for loop in loops), key=lambda rim: -np.ptp(rim, 0).prod())
    rims = [_straightened(rim, _STRAIGHT * chart.max()) for rim in rims]
    surface = None if flat else gridded(places, corners, chart)
    return Unrolled(places, corners, chart, origin, rims, surface)


def _numbers(name: str, values: Any, *columns: int) -> np.ndarray:
    try:
        found = np.asarray(values, float)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: got {type(values).__name__}, expected numbers") from None
    fits = found.ndim == 2 and found.shape[1] in columns
    require(fits, name, f"shape {found.shape}", f"(n, {' or '.join(map(str, columns))}), m")
    require(np.isfinite(found).all(), name, "NaN or infinite", "numbers")
    return found


def _checked(vertices: Any, triangles: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns used vertices in space, triangles of these, and which vertices they were."""
    places, corners = _numbers("vertices", vertices, 2, 3), np.asarray(triangles)
    fits = corners.ndim == 2 and corners.shape[1] == 3 and corners.dtype.kind in "iu"
    got = f"shape {corners.shape} of {corners.dtype}"
    require(fits, "triangles", got, "(k, 3) numbers of vertices")
    most = f"1 to {_MOST}; a coarser mesh is enough"
    require(0 < len(corners) <= _MOST, "triangles", f"{len(corners)}", most)
    low, high = int(corners.min()), int(corners.max())
    inside = low >= 0 and high < len(places)
    require(inside, "triangles", f"vertices {low} to {high}", f"0 to {len(places) - 1}")
    used, corners = np.unique(corners, return_inverse=True)
    corners = corners.reshape(-1, 3)
    places = np.pad(places[used], ((0, 0), (0, 3 - places.shape[1])))
    sides = places[np.roll(corners, -1, 1)] - places[corners]
    least = _THIN * (sides**2).sum(2).max(1)
    thin = np.flatnonzero(2 * _areas(places, corners) <= least)
    expected = "triangles with an area"
    require(not thin.size, "triangles", f"{thin[:5].tolist()} without an area", expected)
    return places, corners, used


def _areas(places: np.ndarray, triangles: np.ndarray) -> Float[np.ndarray, " k"]:
    """Computes areas; in a plane with a sign, above 0 for corners anticlockwise."""
    one, other = (places[triangles[:, k]] - places[triangles[:, 0]] for k in (1, 2))
    if places.shape[1] == 2:
        return (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2
    return np.sqrt((np.cross(one, other) ** 2).sum(1)) / 2


def _loops(triangles: np.ndarray) -> list[np.ndarray]:
    """Lists the vertices around the sheet, and around each hole.

    **Raises:** `ValueError` for triangles that are no sheet, or one without an edge.
    """
    n, name = int(triangles.max()) + 1, "triangles"
    ways = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    sides = np.sort(ways, 1) @ [n, 1]
    _, first, which, count = np.unique(sides, True, True, True)
    most = count.argmax()
    a, b = ways[first[most]]
    told = f"{count[most]} at the edge from vertex {a} to {b}"
    require(count[most] <= 2, name, told, "at most two at an edge")
    ways_once = len(np.unique(ways @ [n, 1])) == len(ways)
    expected = "corners of all triangles in the same order, seen from one side"
    require(ways_once, name, "two neighbours that are turned", expected)
    links = scipy.sparse.coo_array((np.ones(len(ways)), ways.T), shape=(n, n))
    parts = scipy.sparse.csgraph.connected_components(links, directed=False)[0]
    require(parts == 1, name, f"{parts} parts that are not connected", "one sheet")
    rim = ways[count[which] == 1]
    cut = "a sheet with an edge: cut it open along a line, with vertices on either side"
    require(len(rim), name, "a closed surface", cut)
    pinched = len(np.unique(rim[:, 0])) < len(rim)
    require(not pinched, name, "parts that hang together by a vertex", "one sheet")
    loops, after = [], dict(rim.tolist())
    while after:
        loop = list(after.popitem())
        while loop[-1] in after:
            loop.append(after.pop(loop[-1]))
        loops.append(np.array(loop[:-1]))
    plane = n - len(count) + len(triangles) + len(loops) == 2
    require(plane, name, "a surface with handles", cut)
    return loops


def _conformal(
    places: np.ndarray, triangles: np.ndarray, loops: list[np.ndarray]
) -> Float[np.ndarray, "n 2"]:
    """Unrolls a sheet with the least loss of angles, and its whole area kept.

    Each triangle asks for Σ W_j U_j = 0, where U are its corners in the chart as complex
    numbers, and W_j its sides opposite to them in its own plane over the root of its area
    (Lévy et al. 2002, LSCM). Two vertices far apart on the edge are held.
    """
    corners = places[triangles]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    long = np.sqrt((one**2).sum(1))
    high = 2 * _areas(places, triangles) / long
    plane = np.stack([0j * long, long + 0j, (one * other).sum(1) / long + 1j * high], 1)
    weights = np.roll(plane, -2, 1) - np.roll(plane, -1, 1)
    weights /= np.sqrt(long * high)[:, None]
    rows = np.arange(len(triangles)).repeat(3)
    matrix = scipy.sparse.csr_array((weights.ravel(), (rows, triangles.ravel())))
    loss = (matrix.conj().T @ matrix).tocsc()
    rim = max(loops, key=len)
    held = rim[((places[rim] - places[rim].mean(0)) ** 2).sum(1).argmax()]
    apart = ((places[rim] - places[held]) ** 2).sum(1)
    chart = np.zeros(len(places), complex)
    chart[rim[apart.argmax()]] = np.sqrt(apart.max())
    free = np.ones(len(places), bool)
    free[[held, rim[apart.argmax()]]] = False
    chart[free] = held_solve(loss, free, chart)
    # The box with the least area around it, the longer side along x.
    hull = chart[scipy.spatial.ConvexHull(chart.view(float).reshape(-1, 2)).vertices]
    turns = np.exp(-1j * np.angle(np.roll(hull, -1) - hull))
    boxes = np.stack([np.ptp(f(turns[:, None] * hull), 1) for f in (np.real, np.imag)])
    best = boxes.prod(0).argmin()
    chart = chart * turns[best] * (1 if boxes[0, best] >= boxes[1, best] else 1j)
    found = chart.view(float).reshape(-1, 2)
    area = np.abs(_areas(found, triangles)).sum()
    return found * np.sqrt(_areas(places, triangles).sum() / area)


def _check_chart(
    name: str, places: np.ndarray, triangles: np.ndarray, chart: np.ndarray
) -> None:
    """**Raises:** `ValueError` for a chart that folds, or is of another size."""
    area, flat = _areas(places, triangles), _areas(chart, triangles)
    mend = "cut the sheet along a line, or give `uv`"
    turned = min((flat <= 0).sum(), (flat >= 0).sum())
    told = f"a chart that folds at {turned} triangles"
    require(turned == 0, name, told, f"a chart without folds: {mend}")
    ratio = np.sqrt(np.abs(flat).sum() / area.sum())
    told = f"a chart of {np.abs(flat).sum():.3g} m²"
    near = 0.5 < ratio < 2
    require(near, name, told, f"about the sheet's area, {area.sum():.3g} m²")
    scale = np.sqrt(np.abs(flat) / area)
    order = np.argsort(scale)
    share = np.cumsum(area[order]) / area.sum()
    low, high = np.interp([0.05, 0.95], share, scale[order])
    told = f"a chart that stretches some parts {high / low:.0f} times as much as others"
    require(high < _STRETCH * low, name, told, f"{_STRETCH:g} times at most: {mend}")


def _straightened(loop: np.ndarray, off: float) -> Float[np.ndarray, "n 2"]:
    """Leaves out corners of a closed line that are less than `off` from what stays."""
    loop = np.roll(loop, -((loop - loop.mean(0)) ** 2).sum(1).argmax(), 0)
    keep, closed = np.zeros(len(loop), bool), np.concatenate([loop, loop[:1]])
    far = int(((loop - loop[0]) ** 2).sum(1).argmax())
    keep[[0, far]] = True
    todo = [(0, far), (far, len(loop))]
    while todo:
        a, b = todo.pop()
        if b - a < 2:
            continue
        way, to = closed[b] - closed[a], closed[a + 1 : b] - closed[a]
        along = np.clip(to @ way / (way @ way), 0, 1)
        gap = ((to - along[:, None] * way) ** 2).sum(1)
        k = int(gap.argmax())
        if gap[k] > off**2:
            keep[a + 1 + k] = True
            todo += [(a, a + 1 + k), (a + 1 + k, b)]
    return loop[keep]


def chart_places(sheet: Unrolled, points: Any, reach: float) -> Float[np.ndarray, "M 2"]:
    """Returns places in the chart, m from 0 up: of places in it, or nearest in space.

    **Raises:** `ValueError` for places in space further than `reach` from the sheet.
    """
    given = _numbers("electrodes", points, 2, 3)
    if given.shape[1] == 2:
        return given - sheet.origin
    corners = sheet.vertices[sheet.triangles]
    middles = corners.mean(1)
    radii = np.sqrt(((corners - middles[:, None]) ** 2).sum(2)).max(1)
    found, apart = np.zeros((len(given), 2)), np.zeros(len(given))
    for k, place in enumerate(given):
        away = np.sqrt(((middles - place) ** 2).sum(1))
        near = np.flatnonzero(away - radii <= away.min())
        shares = _nearest(corners[near], place)
        gap = ((np.einsum("sck,skd->scd", shares, corners[near]) - place) ** 2).sum(2)
        one, way = np.unravel_index(gap.argmin(), gap.shape)
        found[k] = shares[one, way] @ sheet.chart[sheet.triangles[near[one]]]
        apart[k] = np.sqrt(gap.min())
    worst = int(apart.argmax())
    told = f"electrode {worst} {apart[worst]:.3g} m from the mesh"
    require(apart[worst] <= reach, "electrodes", told, f"{reach:g} m, a radius, at most")
    return found


def _nearest(
    corners: Float[np.ndarray, "s 3 3"], place: np.ndarray
) -> Float[np.ndarray, "s 4 3"]:
    """Computes shares of the corners at the points nearest to a place.

    Of each triangle's three sides, and of its inside, where there is one.
    """
    shares = np.zeros((len(corners), 4, 3))
    for k in range(3):
        start, to = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        along = np.clip(((place - start) * to).sum(1) / (to**2).sum(1), 0, 1)
        shares[:, k, k], shares[:, k, (k + 1) % 3] = 1 - along, along
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    to = place - corners[:, 0]
    aa, ab, bb = (one**2).sum(1), (one * other).sum(1), (other**2).sum(1)
    a, b, whole = (one * to).sum(1), (other * to).sum(1), aa * bb - ab**2
    v, w = (bb * a - ab * b) / whole, (aa * b - ab * a) / whole
    within = np.stack([1 - v - w, v, w], 1)
    inside = (within >= 0).all(1, keepdims=True)
    shares[:, 3] = np.where(inside, within, shares[:, 0])
    return shares
