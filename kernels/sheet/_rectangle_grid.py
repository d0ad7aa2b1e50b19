"""Computes `rectangle_fields` on a grid of points, in NumPy: nothing to compile, float64.

The series is that of `tomojax.kernels.rectangle`. Its three r that may reach 1 stay
logarithms. All other r are at most e^{−π}. There −ln(1 − 2r cos θ + r²) = 2·Σ rⁿ cos(nθ)/n
ends after a dozen terms. Each term is a product of a function of x and one of y.
"""

import numpy as np
import scipy
from jaxtyping import Float

from tomojax.kernels.rectangle import Series

# Kinds of r that may reach 1, without a power of q.
_LARGE = 3

# rⁿ of r = e^{−π} is below the rounding of float64 from here.
_TERMS = np.arange(1, 13)

# Numbers of a block of points times dipoles: 64 MB.
_BLOCK = 1 << 23

# A dipole moves this part of an electrode's radius each way to give its field's slope.
_STEP = 1e-3

_Points = Float[np.ndarray, "..."]


def rectangle_grid_fields(
    places: Float[np.ndarray, "M 2"],
    x: Float[np.ndarray, " nx"],
    y: Float[np.ndarray, " ny"],
    radius: float,
    size: Float[np.ndarray, "2"],
    shunt: float | None = None,
    beside: Float[np.ndarray, "P 2"] | None = None,
) -> tuple[
    Float[np.ndarray, "M M"], Float[np.ndarray, "M nx ny"], Float[np.ndarray, "M P"]
]:
    """Computes potentials of electrodes at each other, at (x, y) and at places `beside`.

    The sheet has 1 Ω per square. Without places `beside` their part is empty.
    """
    beside = np.empty((0, 2)) if beside is None else beside
    turned = bool(size[0] > size[1])
    if turned:  # the shorter side along x, as in `_rectangle`
        ee, ep, more = rectangle_grid_fields(
            places[:, ::-1], y, x, radius, size[::-1], shunt, beside[:, ::-1]
        )
        return ee, ep.transpose(0, 2, 1), more
    sheet = float(size[0]), float(size[1]), radius

    def fields(x: _Points, y: _Points) -> _Points:
        """Returns (M, 3, …): the potentials, and those of both dipoles."""
        return np.stack([_fields(place, x, y, *sheet) for place in places])

    at_places = fields(places[:, 0], places[:, 1])
    ee = at_places[:, 0]
    count, answer = 2 * len(places), np.zeros((0, len(places)))
    if shunt is not None:
        step = _STEP * radius
        slopes = [
            fields(*(places + move).T)[:, 1:] - fields(*(places - move).T)[:, 1:]
            for move in step * np.eye(2)
        ]
        pairs = np.stack(slopes, -1) / (2 * step)  # (M, 2, M, 2)
        own = pairs.reshape(count, count)
        weaker = (1 / shunt - 1) / (2 * np.pi * radius**2)
        chol = scipy.linalg.cholesky((own + own.T) / 2 + weaker * np.eye(count), lower=True)
        answer = scipy.linalg.solve_triangular(
            chol, at_places[:, 1:].reshape(count, -1), lower=True
        )
        ee = ee - answer.T @ answer
        # What the dipoles take from the field at a point is linear in their field there.
        answer = scipy.linalg.solve_triangular(chol, answer, lower=True, trans=1)

    def rows(x: _Points, y: _Points) -> _Points:
        there = fields(x, y)
        if shunt is None:
            return there[:, 0]
        dipoles = there[:, 1:].reshape(count, -1)
        return there[:, 0] - (answer.T @ dipoles).reshape(there[:, 0].shape)

    lines = max(1, _BLOCK // (count * len(y)))
    ep = np.empty((len(places), len(x), len(y)))
    for k in range(0, len(x), lines):
        ep[:, k : k + lines] = rows(x[k : k + lines, None], y[None])
    more = np.empty((len(places), len(beside)))
    for k in range(0, len(beside), _BLOCK // count):
        more[:, k : k + _BLOCK // count] = rows(*beside[k : k + _BLOCK // count].T)
    return ee, ep, more


def _fields(
    place: Float[np.ndarray, "2"], x: _Points, y: _Points, a: float, b: float, rim: float
) -> _Points:
    """Computes (3, …): G of a disc of radius `rim`, and of its dipoles along x and y.

    `x` and `y` broadcast with each other. Within the rim G is the rim's, and a dipole's
    field is that of a solid disc.
    """
    large = Series((place[0], place[1]), (x, y), (a, b), np, _LARGE, terms=1)
    logs, by_x, by_y = _rest(place, x, y, a, b)
    slopes = large.slope(rim, solid=True, rest=(by_x, by_y))
    return np.stack([large.potential(rim, rest=logs), *slopes])


def _rest(
    place: Float[np.ndarray, "2"], x: _Points, y: _Points, a: float, b: float
) -> _Points:
    """Computes (3, …): the summed logarithms of all smaller r, and slopes by the place."""
    n = _TERMS.reshape(-1, *[1] * max(x.ndim, y.ndim))
    k, (px, py) = np.pi / a, place
    gap, total, side = np.abs(py - y), py + y, np.sign(py - y)
    near, far = np.exp(-n * k * gap), np.exp(-n * k * total)
    far_, near_ = np.exp(-n * k * (2 * b - total)), np.exp(-n * k * (2 * b - gap))
    # Σ q^{jn}, j = 1, 2, …: what further images add to each.
    more = 1 / np.expm1(2 * np.pi * n * b / a)
    sizes = near_ + (near + far + far_ + near_) * more
    grow = n * k * (side * near_ + (side * (near_ - near) - far + far_) * more)
    waves, along = np.cos(n * k * px), 4 / n * np.cos(n * k * x)
    by_x = -n * k * np.sin(n * k * px)
    same = x.ndim == 1  # points one by one: no product of a row and a column
    sums = "n...,n...->..." if same else "nxo,noy->xy"
    parts = (waves * sizes, by_x * sizes, waves * grow)
    return -np.stack([np.einsum(sums, along, part, optimize=not same) for part in parts])
