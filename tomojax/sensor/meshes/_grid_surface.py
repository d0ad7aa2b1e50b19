"""Places of a curved sheet in space, between those of a grid over its box."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float, Int

from tomojax._checks import checked
from tomojax._custom_types import Numbers
from tomojax._shown import named, shown
from tomojax.kernels.contacts import cubic

# Sheets are solved on meshes of at most so many cells along a side.
_CELLS = 200

# Triangles that are put on a grid at once: memory.
_TOGETHER = 20_000


class GridSurface(eqx.Module):
    """A `surface` that interpolates places on a grid from edge to edge of a box.

    **Arguments:** `places` (nx, ny, 3), m, of evenly spaced points; `size` (2,) of the box,
    m. Catmull and Rom's cubics run through the places: the sheet has a normal everywhere.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import numpy as np
    >>> import tomojax as tx
    >>> x, y = np.meshgrid(np.linspace(0, 0.1, 5), np.linspace(0, 0.08, 5), indexing="ij")
    >>> slope = tx.sensor.GridSurface(np.stack([x, y, 0.5 * x], -1), [0.1, 0.08])
    >>> print(f"{float(slope(jnp.array([0.06, 0.01]))[2]):.3f} m high")
    0.030 m high
    """

    places: Float[Array, "nx ny 3"]
    size: Float[Array, "2"]

    def __init__(self, places: Numbers, size: Numbers):
        self.places = checked("surface", places, "finite", (None, None, 3))
        self.size = checked("size", size, "positive", (2,), dtype=self.places.dtype)

    @classmethod
    def of(cls, surface: Callable, size: Numbers) -> "GridSurface":
        """Makes one of any surface over a box of `size`, m."""
        if isinstance(surface, cls):
            return surface
        at = [np.linspace(0, s, n) for s, n in zip(np.asarray(size), _counts(size))]
        return cls(surface(jnp.stack(jnp.meshgrid(*at, indexing="ij"), -1)), size)

    @jax.jit
    def __call__(self, points: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
        # Straight on beyond the box's edges.
        wider = jnp.pad(
            self.places, ((1, 1), (1, 1), (0, 0)), "reflect", reflect_type="odd"
        )
        cells = jnp.asarray(self.places.shape[:2], self.size.dtype) - 1

        def one(point: Float[Array, "2"]) -> Float[Array, "3"]:
            at = point / self.size * cells
            low = jnp.clip(jnp.floor(at), 0, cells - 1)
            i, j = low.astype(int)
            near = jax.lax.dynamic_slice(wider, (i, j, 0), (4, 4, 3))
            x, y = cubic(at - low)
            return jnp.einsum("i,j,ijd->d", x, y, near, precision="highest")

        flat = jax.vmap(one)(points.reshape(-1, 2))
        return flat.reshape(*points.shape[:-1], 3)

    def __repr__(self) -> str:
        nx, ny = self.places.shape[:2]
        return named(self, points=f"{nx} × {ny}", size=shown(self.size, "mm", 1e3))


def _runs(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lists the whole numbers from `first` to `last` of each run, and whose they are."""
    first, last = np.ceil(first - 1e-6).astype(int), np.floor(last + 1e-6).astype(int)
    count = np.maximum(last - first + 1, 0)
    whose = np.arange(len(count)).repeat(count)
    return whose, np.arange(len(whose)) + (first + count - np.cumsum(count))[whose]


def _counts(size: Any) -> Int[np.ndarray, "2"]:
    """Counts a grid's points along x and y."""
    part = np.asarray(size, float) / np.max(np.asarray(size, float))
    return 1 + np.maximum(np.ceil(_CELLS * part - 1e-6), 8).astype(int)


def gridded(places: np.ndarray, triangles: np.ndarray, chart: np.ndarray) -> GridSurface:
    """Puts a sheet on a grid over its box: on the triangles, and straight on beyond."""
    size = chart.max(0)
    shape = _counts(size)
    nx, ny = shape - 1
    grid, known = np.zeros((*shape, 3)), np.zeros(shape, bool)
    scaled = chart / size * [nx, ny]
    for some in np.array_split(triangles, -(-len(triangles) // _TOGETHER)):
        # Lines along y that cross each triangle, and from where to where they do.
        corners = scaled[some]
        x = corners[..., 0]
        whose, i = _runs(x.min(1), x.max(1))
        a, b = corners[whose], np.roll(corners, -1, 1)[whose]
        rise = b[..., 0] - a[..., 0]
        part = (i[:, None] - a[..., 0]) / np.where(rise == 0, 1, rise)
        off = (rise == 0) | (np.abs(part - 0.5) > 0.5 + 1e-6)
        y = a[..., 1] + part * (b - a)[..., 1]
        low, high = np.where(off, np.inf, y).min(1), np.where(off, -np.inf, y).max(1)
        crossed = low <= high
        which, j = _runs(low[crossed], high[crossed])
        whose, i = whose[crossed][which], i[crossed][which]
        inside = (i <= nx) & (j <= ny)
        whose, i, j = whose[inside], i[inside], j[inside]
        # Each point between the triangle's corners.
        at, (p, q, r) = np.stack([i, j], 1), np.moveaxis(corners[whose], 1, 0)
        one, other, to = (q - p).T, (r - p).T, (at - p).T
        whole = one[0] * other[1] - one[1] * other[0]
        v = (to[0] * other[1] - to[1] * other[0]) / whole
        w = (one[0] * to[1] - one[1] * to[0]) / whole
        shares = np.stack([1 - v - w, v, w], 1)
        grid[i, j] = (shares[:, :, None] * places[some[whose]]).sum(1)
        known[i, j] = True
    return GridSurface(_extended(grid, known), size)


def _extended(
    grid: Float[np.ndarray, "nx ny 3"], known: np.ndarray
) -> Float[np.ndarray, "nx ny 3"]:
    """Fills in what is not known, bent as little as can be: slopes go on."""
    if known.all():
        return grid

    def differences(n: int, row: list[float]) -> Any:
        return scipy.sparse.diags_array(
            row, offsets=range(len(row)), shape=(n - len(row) + 1, n)
        )  # pyright: ignore

    nx, ny = known.shape
    slope, bend = [-1.0, 1.0], [1.0, -2.0, 1.0]
    twist = scipy.sparse.kron(differences(nx, slope), differences(ny, slope))
    rows = [
        scipy.sparse.kron(differences(nx, bend), scipy.sparse.eye_array(ny)),
        scipy.sparse.kron(scipy.sparse.eye_array(nx), differences(ny, bend)),
        np.sqrt(2) * twist,
    ]
    bends = scipy.sparse.vstack(rows).tocsr()
    free = ~known.ravel()
    values = grid.reshape(-1, 3).copy()
    values[free] = held_solve((bends.T @ bends).tocsr(), free, values)
    return values.reshape(grid.shape)


def held_solve(matrix: Any, free: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Minimises a sum of squares by what is free, the rest being held."""
    some = matrix[free]
    given = -(some[:, ~free] @ values[~free])
    symmetric: Any = {"SymmetricMode": True}
    factor = scipy.sparse.linalg.splu(
        some[:, free].tocsc(), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric
    )
    return factor.solve(given)
