"""Interpolates electrodes' potentials anywhere on the sheet, averaged over discs."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.polynomial.polynomial import polyder

# Radii of the table that one between them is interpolated from.
_NEAREST = 4

# Catmull and Rom's weights of four neighbours: the coefficients of 1, t, t² and t³.
_CATMULL_ROM = np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]) / 2

# Terms of the smooth parts: more are less smooth, fewer end less smoothly.
_TERMS = 3


class Among(NamedTuple):
    """What a sheet's shape adds to the potential between two places, on a grid of both."""

    values: Float[Array, "n n n n"]  # Ω, beside a rectangle that holds the box
    margin: Float[Array, "2"]  # of the rectangle beyond the box, m


class Field(NamedTuple):
    """R_e(x, a): the potential at electrode e per ampere fed into a disc of radius a at x.

    R_e is also the mean over the disc of the potential that an ampere fed into e makes. The
    table covers the sheet from edge to edge, with `values` for each of the A `radii`.
    """

    values: Float[Array, "nx ny A M"]  # Ω
    radii: Float[Array, " A"]  # m
    electrodes: Float[Array, "M M"]  # R_ee', Ω
    size: Float[Array, "2"]  # of the sheet, or of the box that holds it, m
    home: Float[Array, "nx ny 2"] | None = None  # the places that points stand for, m
    among: Among | None = None  # of a sheet that is no flat rectangle


class Near(NamedTuple):
    """R_e at points, in parts: a smooth table, and fields about each of M electrodes.

    A table alone does not follow the bends at a disc's rim. So two known fields are taken
    off: the logarithm about the electrode that feeds, and the dipole of other metal discs.
    """

    smooth: Float[Array, "nx ny M"]  # Ω
    electrodes: Float[Array, "M 2"]  # m
    pull: Float[Array, "M M 2"]  # −∇R_e at electrode e' without its disc, Ω/m
    feed: Float[Array, ""]  # ρ/2π, Ω
    radius: Float[Array, ""]  # of an electrode's disc, m
    reach: Float[Array, ""]  # where the fields about it have faded, m
    answer: Float[Array, ""]  # of a disc's dipole, beside metal's: 0 to 1


def home_of(field: Field, place: Float[Array, "2"]) -> Float[Array, "2"]:
    """Returns the place on the sheet that a place in the box stands for, m."""
    if field.home is None:
        return place
    cells = jnp.asarray(field.home.shape[:2], place.dtype) - 1
    return _linear(field.home, place / field.size * cells)


def margin_of(field: Field) -> Float[Array, "2"] | float:
    """Returns how far the rectangle of the closed form goes beyond the box, m."""
    return 0.0 if field.among is None else field.among.margin


def among_at(
    field: Field, one: Float[Array, "2"], other: Float[Array, "2"]
) -> Float[Array, ""]:
    """Interpolates what the sheet's shape adds to the potential between two places, Ω."""
    assert field.among is not None
    values = field.among.values
    scale = (len(values) - 1) / field.size
    return _linear(_linear(values, one * scale), other * scale)


def _linear(values: Float[Array, "nx ny *n"], at: Float[Array, "2"]) -> Float[Array, "*n"]:
    """Interpolates linearly between four points."""
    last = jnp.asarray(values.shape[:2], at.dtype) - 1
    low = jnp.clip(jnp.floor(at), 0, last - 1)
    part, (i, j) = at - low, low.astype(int)
    near = jax.lax.dynamic_slice(
        values, (i, j, *[0] * (values.ndim - 2)), (2, 2, *values.shape[2:])
    )
    x, y = jnp.stack([1 - part, part], 1)
    return jnp.einsum("i,j,ij...->...", x, y, near, precision="highest")


def field_at(
    field: Field, place: Float[Array, "2"], radius: Float[Array, ""]
) -> Float[Array, " M"]:
    """Interpolates R_e(x, a), Ω, of all electrodes: cubic in x, and in a² by four radii.

    The result is once differentiable in x; slopes by a come from the four radii next to a.
    Radii beyond the table's last radius count as the last. The sheet is mirrored beyond its
    edges.
    """
    low, nodes = radii_about(field, radius)
    part, nearby = nearby_of(field.values, field.size, place, low, _NEAREST)
    along = cubic(part)
    by_size = lagrange(nodes, jnp.minimum(radius, field.radii[-1]) ** 2)
    flat = (along[0][:, None] * along[1]).ravel()
    return jnp.einsum("n,a,nam->m", flat, by_size, nearby, precision="highest")


def radii_about(
    field: Field, radius: Float[Array, ""]
) -> tuple[Int[Array, ""], Float[Array, " a"]]:
    """Finds the first of the table's radii to interpolate from, and squares of all four.

    Beside an electrode R bends where a disc's rim crosses the electrode. A polynomial
    through radii that are far away is off by a third of a millimetre there.
    """
    last = len(field.radii) - _NEAREST
    low = jnp.clip((field.radii < radius).sum() - _NEAREST // 2, 0, last)
    return low, jax.lax.dynamic_slice(field.radii, (low,), (_NEAREST,)) ** 2


def rows_at(
    field: Field,
    place: Float[Array, "2"],
    radius: Float[Array, ""],
    moment: Float[Array, "2"],
) -> Float[Array, "8 M"]:
    """Computes R_e of a contact that may be longer than wide, and derivatives, row by row.

    The first row is R + ½m₁(R_xx − R_yy) + m₂R_xy. Five rows are derivatives by x, y,
    radius and both moments. The last two rows are the derivatives by radius of the rows by
    x and y. `moment`: (xx − yy)/2 and xy of the current's second moments about its centre,
    m². The sum xx + yy shows only beside electrodes, because R is harmonic.
    """
    low, nodes = radii_about(field, radius)
    part, nearby = nearby_of(field.values, field.size, place, low, _NEAREST)
    cells = jnp.asarray(field.values.shape[:2], place.dtype) - 1
    per = (cells / field.size)[:, None]  # of cells, 1/m
    # Derivatives of each order, in x and in y.
    orders = jnp.stack([cubic(part, order) * per**order for order in range(4)])
    x, y = orders[:, 0], orders[:, 1]

    def both(i: int, j: int) -> Float[Array, "4 4"]:
        return x[i][:, None] * y[j]

    m, n = moment[0] / 2, moment[1]
    unlike, mixed = both(2, 0) - both(0, 2), both(1, 1)
    value = both(0, 0) + m * unlike + n * mixed
    by_x = both(1, 0) + m * (both(3, 0) - both(1, 2)) + n * both(2, 1)
    by_y = both(0, 1) + m * (both(2, 1) - both(0, 3)) + n * both(1, 2)
    radius = jnp.minimum(radius, field.radii[-1])
    sizes, by_radius = lagrange_and_slope(nodes, radius**2)
    weights = jnp.stack([value, by_x, by_y, value, unlike / 2, mixed, by_x, by_y])
    by_radius = by_radius * 2 * radius
    across = jnp.stack([sizes] * 3 + [by_radius] + [sizes] * 2 + [by_radius] * 2)
    weights = (weights.reshape(8, 16, 1) * across[:, None]).reshape(8, -1)
    flat = nearby.reshape(weights.shape[1], -1)
    return jnp.matmul(weights, flat, precision="highest")


def thin_of(field: Field, radius: Float[Array, ""]) -> Float[Array, "nx ny M"]:
    """Interpolates the table at one radius; narrower contacts have the same values."""
    low, nodes = radii_about(field, radius)
    near = jax.lax.dynamic_slice_in_dim(field.values, low, _NEAREST, 2)
    by_size = lagrange(nodes, radius**2)
    return jnp.einsum("a,xyam->xym", by_size, near, precision="highest")


def thin_rows_at(
    thin: Float[Array, "nx ny M"], size: Float[Array, "2"], place: Float[Array, "2"]
) -> Float[Array, "3 M"]:
    """Interpolates R_e of one radius's table, and derivatives by x and y, row by row."""
    part, nearby = nearby_of(thin[:, :, None], size, place, jnp.zeros((), int), 1)
    per = ((jnp.asarray(thin.shape[:2], place.dtype) - 1) / size)[:, None]
    along, slope = cubic(part), cubic(part, 1) * per
    x, y = jnp.stack([along[0], slope[0], along[0]]), jnp.stack([along[1]] * 2 + [slope[1]])
    weights = (x[:, :, None] * y[:, None]).reshape(3, 16)
    return jnp.matmul(weights, nearby[:, 0], precision="highest")


def nearby_of(
    values: Float[Array, "nx ny A M"],
    size: Float[Array, "2"],
    place: Float[Array, "2"],
    low: Int[Array, ""],
    count: int,
) -> tuple[Float[Array, "2"], Float[Array, "16 a M"]]:
    """Finds the place within its cell, and the table's sixteen points around it.

    Each point comes with `count` radii, from `low` on.
    """
    nx, ny, _, m = values.shape
    cells = jnp.array([nx - 1, ny - 1], place.dtype)
    at = place / size * cells
    corner = jnp.clip(jnp.floor(at), 0, cells - 1)
    steps = jnp.arange(-1, 3)
    i = mirrored(corner[0].astype(int) + steps, nx - 1)
    j = mirrored(corner[1].astype(int) + steps, ny - 1)

    # A slice of each point: with its radii one by one it takes longer.
    def cut(i: Array, j: Array) -> Float[Array, "a M"]:
        return jax.lax.dynamic_slice(values, (i, j, low, 0), (1, 1, count, m))[0, 0]

    rows = jax.vmap(jax.vmap(cut, (None, 0)), (0, None))(i, j)
    return at - corner, rows.reshape(16, count, m)


def mirrored(index: Array, last: int) -> Array:
    index = jnp.abs(index)
    return jnp.where(index > last, 2 * last - index, index)


def cubic(part: Float[Array, "2"], order: int = 0) -> Float[Array, "2 4"]:
    """Returns Catmull and Rom's weights of four neighbours; or derivatives by `part`."""
    found = jnp.zeros((len(part), 4), part.dtype)
    for row in polyder(_CATMULL_ROM, order)[::-1]:
        found = found * part[:, None] + jnp.asarray(row, part.dtype)
    return found


def lagrange(nodes: Float[Array, " A"], at: Float[Array, ""]) -> Float[Array, " A"]:
    """Returns weights of the polynomial through values at `nodes`."""
    own = jnp.eye(len(nodes), dtype=bool)
    above = jnp.where(own, 1, at - nodes[None])
    below = jnp.where(own, 1, nodes[:, None] - nodes[None])
    return jnp.prod(above / below, axis=1)


def lagrange_and_slope(
    nodes: Float[Array, " A"], at: Float[Array, ""]
) -> tuple[Float[Array, " A"], Float[Array, " A"]]:
    """Returns the weights of `lagrange`, and their derivatives by `at`."""
    own = jnp.eye(len(nodes), dtype=bool)
    below = jnp.where(own, 1, nodes[:, None] - nodes)
    ratio = jnp.where(own, 1, (at - nodes) / below)
    # Of each node without one more: products over the last axis.
    without = jnp.prod(jnp.where(own, 1, ratio[:, None, :]), -1)
    return jnp.prod(ratio, 1), jnp.where(own, 0, without / below).sum(1)


def fields_about(
    radius: Any, reach: Any, away: Float[Any, "*n 2"]
) -> tuple[Float[Any, "*n"], Float[Any, "*n 2"]]:
    """Computes the rough parts of −ln r and of r/r² (1/m) away from a disc's centre.

    Within the disc r counts as its radius. A table has the smooth parts: the series of
    −ln r and 1/r² in 1 − r²/R², R the reach, cut off. So the rough parts end at R. The
    functions take arrays of NumPy and of JAX.
    """
    xp: Any = np if isinstance(away, np.ndarray) else jnp
    square = (away**2).sum(-1) / reach**2
    far, less = xp.maximum(square, (radius / reach) ** 2), xp.maximum(1 - square, 0)
    log, inverse, power = -xp.log(far), 1 / far - 1, less
    for k in range(1, _TERMS + 1):
        log, inverse, power = log - power / k, inverse - power, power * less
    log, inverse = (xp.where(square < 1, a, 0) for a in (log / 2, inverse))
    return log, away * inverse[..., None] / reach**2


def rows_near(
    near: Near,
    size: Float[Array, "2"],
    at: Float[Array, "n 2"],
    each: Float[Array, "p 2"],
) -> Float[Array, "n 3 M"]:
    """Computes R_e (Ω) of n small patches, and slopes by x and y, row by row.

    `each` has a patch's points about its middle: what is rough is averaged over these. At
    most one electrode is within reach of a point.
    """
    square = ((at[:, None] - near.electrodes) ** 2).sum(-1)
    own = jnp.argmin(square, 1).astype(jnp.int32)
    away = (at - near.electrodes[own])[:, None] + each

    def rough(shift: Float[Array, "2"]) -> tuple[Array, Array]:
        log, dipole = fields_about(near.radius, near.reach, away + shift)
        return log.mean(1), dipole.mean(1)

    none, unit = jnp.zeros_like(size), jnp.eye(2, dtype=size.dtype)
    turned = jax.vmap(lambda by: jax.jvp(rough, (none,), (by,)), out_axes=(None, 0))
    now, slopes = turned(unit)
    log, dipole = (jnp.concatenate([a[None], b]) for a, b in zip(now, slopes))
    rows = jax.vmap(thin_rows_at, (None, None, 0))(near.smooth, size, at)
    feeds = jnp.arange(len(near.electrodes), dtype=own.dtype) == own[:, None]
    rows = rows + jnp.where(feeds[:, None], near.feed * log.T[..., None], 0)
    polarised = near.answer * near.radius**2 * dipole
    return rows + jnp.einsum("nmk,jnk->njm", near.pull[own], polarised, precision="highest")
