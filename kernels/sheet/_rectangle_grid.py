"""Computes `rectangle_fields` on a grid of points, in NumPy: nothing to compile, float64.

The series is that of `_rectangle`. Its three r that may reach 1 stay logarithms. All other
r are at most e^{−π}. There −ln(1 − 2r cos θ + r²) = 2·Σ rⁿ cos(nθ)/n ends after a dozen
terms. Each term is a product of a function of x and one of y.
"""

import numpy as np
from jaxtyping import Float
from scipy.linalg import cholesky, solve_triangular

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
) -> tuple[Float[np.ndarray, "M M"], Float[np.ndarray, "M nx ny"]]:
    """Computes potentials of electrodes at each other and at (x, y), at 1 Ω per square."""
    turned = bool(size[0] > size[1])
    if turned:  # the shorter side along x, as in `_rectangle`
        ee, ep = rectangle_grid_fields(places[:, ::-1], y, x, radius, size[::-1], shunt)
        return ee, ep.transpose(0, 2, 1)
    sheet = float(size[0]), float(size[1]), radius

    def fields(x: _Points, y: _Points) -> _Points:
        """Returns (M, 3, …): the potentials, and those of both dipoles."""
        return np.stack([_fields(place, x, y, *sheet) for place in places])

    at_places = fields(places[:, 0], places[:, 1])
    ee = at_places[:, 0]
    step = _STEP * radius
    slopes = [
        fields(places[:, 0] + step * i, places[:, 1] + step * (1 - i))[:, 1:]
        - fields(places[:, 0] - step * i, places[:, 1] - step * (1 - i))[:, 1:]
        for i in (1, 0)
    ]
    count = 2 * len(places)
    chol, answer = np.zeros((0, 0)), np.zeros((0, len(places)))
    if shunt is not None:
        pairs = np.stack(slopes, -1) / (2 * step)  # (M, 2, M, 2)
        own = pairs.reshape(count, count)
        weaker = (1 / shunt - 1) / (2 * np.pi * radius**2)
        chol = cholesky((own + own.T) / 2 + weaker * np.eye(count), lower=True)
        answer = solve_triangular(chol, at_places[:, 1:].reshape(count, -1), lower=True)
        ee = ee - answer.T @ answer
        # What the dipoles take from the field at a point is linear in their field there.
        answer = solve_triangular(chol, answer, lower=True, trans=1)
    ep = np.empty((len(places), len(x), len(y)))
    lines = max(1, _BLOCK // (count * len(y)))
    for start in range(0, len(x), lines):
        some = slice(start, start + lines)
        there = fields(x[some, None], y[None])
        ep[:, some] = there[:, 0]
        if shunt is not None:
            dipoles = there[:, 1:].reshape(count, -1)
            ep[:, some] -= (answer.T @ dipoles).reshape(ep[:, some].shape)
    return ee, ep


def _fields(
    place: Float[np.ndarray, "2"], x: _Points, y: _Points, a: float, b: float, rim: float
) -> _Points:
    """Computes (3, …): G of a disc of radius `rim`, and of its dipoles along x and y.

    `x` and `y` broadcast with each other. See `rectangle_green`: within the rim G is the
    rim's, and a dipole's field is that of a solid disc.
    """
    k, (px, py) = np.pi / a, place
    gap, total, side = _apart(py, y, a)
    square = (px - x) ** 2 + gap**2
    turns = [np.sin(k * (px + sign * x) / 2) ** 2 for sign in (-1, 1)]
    bends = [2 * k * np.sin(k * (px + sign * x)) for sign in (-1, 1)]  # 4 ds/dpx
    # r, 1 − r, and by how much ln r grows with py.
    rates = (-k * gap, -k * side), (-k * total, -k), (-k * (2 * b - total), k)
    product, by_x, by_y = 1.0, 0.0, 0.0
    for number, (log_r, rate) in enumerate(rates):
        r, less = np.exp(log_r), -np.expm1(log_r)
        for turn, bend in zip(turns, bends):
            factor = less**2 + 4 * r * turn
            if number == 0 and turn is turns[0]:
                # The one that vanishes where the places meet, as (π d/a)²·ratio.
                meet = square < np.finfo(float).eps * a**2
                safe = np.where(meet, 1, square)
                inside = square < rim**2
                own = np.where(meet, k**2, factor / safe)
                factor = np.where(meet, 1, factor)
                within = 2 / rim**2 - np.where(meet, 0, 2 / safe)
                by_x = np.where(inside, (px - x) * within, 0)
                by_y = np.where(inside, side * gap * within, 0)
                product = own * np.where(inside, rim**2, square)
                bend = np.where(meet, 0, bend)
            else:
                product = product * factor
            slope = r / factor
            by_x = by_x + slope * bend
            by_y = by_y + slope * rate * (4 * turn - 2 * less)
    rest = _rest(place, x, y, a, b)
    mean = b / 3 + (py**2 + y**2) / (2 * b) - (total + gap) / 2
    mean_by_y = py / b - (1 + side) / 2
    return np.stack(
        [
            mean / a - (np.log(product) + rest[0]) / (4 * np.pi),
            -(by_x + rest[1]) / (4 * np.pi),
            mean_by_y / a - (by_y + rest[2]) / (4 * np.pi),
        ]
    )


def _apart(py: float, y: _Points, a: float) -> tuple[_Points, _Points, _Points]:
    """Returns |py − y|, py + y, and the sign of py − y: 0 in one row, without a kink."""
    gap = np.abs(py - y)
    row = gap < np.sqrt(np.finfo(float).eps) * a  # what rounding leaves of none
    return np.where(row, 0, gap), py + y, np.where(row, 0, np.sign(py - y))


def _rest(
    place: Float[np.ndarray, "2"], x: _Points, y: _Points, a: float, b: float
) -> _Points:
    """Computes (3, …): the summed logarithms of all smaller r, and slopes by the place."""
    n = _TERMS.reshape(-1, *[1] * max(x.ndim, y.ndim))
    k, (px, py) = np.pi / a, place
    gap, total, side = _apart(py, y, a)
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
