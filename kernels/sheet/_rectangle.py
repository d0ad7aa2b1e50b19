"""Computes the table of a homogeneous rectangle from its Green's function.

The series is that of `tomojax.kernels.rectangle`. Floating electrodes answer with dipoles,
as in `_electrodes`.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax.linalg import triangular_solve
from jaxtyping import Array, Float

from tomojax.kernels.algebra import matmul
from tomojax.kernels.rectangle import Series, turned
from tomojax.kernels.sheet._mesh import centroids, element_area, Shape
from tomojax.kernels.sheet._slots import centred, Resistances

# Electrodes whose potentials are computed at once: each has 48 terms a place.
_AT_ONCE = 16

# Numbers of the dipoles' field that are held at once.
_LARGE = 1 << 27


@partial(jax.jit, static_argnames="solid")  # also on the host one program
def rectangle_green(
    one: Float[Array, "*#batch 2"],
    other: Float[Array, "*#batch 2"],
    rim: Float[Array, "*#batch"],
    size: Float[Array, "2"],
    solid: bool = False,
) -> Float[Array, "*batch"]:
    """Computes G(x, x') at 1 Ω per square of discs, see `Series.potential`."""
    return _series(one, other, size).potential(rim, solid, _log_product)


@jax.jit
def rectangle_slope(
    one: Float[Array, "*#batch 2"],
    other: Float[Array, "*#batch 2"],
    rim: Float[Array, "*#batch"],
    size: Float[Array, "2"],
) -> Float[Array, "*batch 2"]:
    """Computes ∂G/∂x of `rectangle_green`, 1/m at 1 Ω per square.

    The slope is in closed form. JAX's derivative of `rectangle_green` has more operations,
    and programs with several copies take longer to compile.
    """
    slope = jnp.stack(_series(one, other, size).slope(rim), -1)
    return jnp.stack(turned(size, slope, jnp), -1)


def _series(one: Array, other: Array, size: Array) -> Series:
    sides = jnp.min(size), jnp.max(size)
    return Series(turned(size, one, jnp), turned(size, other, jnp), sides, jnp)


@jax.custom_jvp
def _log_product(factors: Float[Array, "kinds terms 2 *batch"]) -> Float[Array, "*batch"]:
    """Computes ln Πf; its slope Σf'/f compiles many times faster than that of a product."""
    return jnp.log(jnp.prod(factors, (0, 1, 2)))


@_log_product.defjvp
def _(factors: tuple, slopes: tuple) -> tuple[Array, Array]:
    return _log_product(*factors), jnp.sum(slopes[0] / factors[0], (0, 1, 2))


def rectangle_resistances(
    sheet_resistance: Float[Array, ""],
    places: Float[Array, "M 2"],
    radius: Float[Array, ""],
    shape: Shape,
    size: Float[Array, "2"],
    shunt: Float[Array, ""] | None = None,
) -> Resistances:
    """Computes R_ee, R_ek and R_kk (Ω) of a homogeneous rectangle, centred; no mesh error.

    Electrodes are equipotential discs of `radius`. Elements are uniformly fed discs of the
    element's area at its centroid (own term ¼ − ln r: a disc of radius r·e^{−1/4}).
    **Arguments:** `sheet_resistance` Ω per square; `places`, `radius`, `size` m; `shape`
    cells of the grid of elements; `shunt` as in `fem_sheet`.
    """
    elements = centroids(shape, size)
    # The radius of the equipotential disc that stands for an element, m.
    rim = jnp.sqrt(element_area(shape, size) / np.pi) * float(np.exp(-0.25))
    if shunt is None or 2 * len(places) * len(elements) < _LARGE:
        ee, ek, at_elements = rectangle_fields(places, elements, radius, size, shunt)
        taken = (at_elements**2).sum(0)
    else:
        ee, ek, taken = _row_by_row(places, elements, radius, size, shunt, shape[0])
    kk = rectangle_green(elements, elements, rim, size) - taken
    rho = sheet_resistance
    return centred(Resistances(rho * ee, rho * ek, rho * kk))


def _row_by_row(
    places: Array, elements: Array, radius: Array, size: Array, shunt: Array, count: int
) -> tuple[Float[Array, "M M"], Float[Array, "M K"], Float[Array, " K"]]:
    """Computes `rectangle_fields` and what shunts take, for `count` parts of the elements.

    The dipoles' field at all elements at once takes several GB of a large mat.
    """
    at_places, answer = _shunts(places, radius, size, shunt)
    green = jax.vmap(
        lambda place, some: rectangle_green(place, some, radius, size), (0, None)
    )

    def one(some: Array) -> tuple[Array, Array]:
        at = answer(some)
        return green(places, some) - matmul(at_places.T, at), (at**2).sum(0)

    ek, taken = jax.lax.map(one, elements.reshape(count, -1, 2))
    ee = green(places, places) - matmul(at_places.T, at_places)
    return ee, jnp.moveaxis(ek, 0, 1).reshape(len(places), -1), taken.ravel()


def rectangle_fields(
    places: Float[Array, "M 2"],
    others: Float[Array, "P 2"],
    radius: Float[Array, ""],
    size: Float[Array, "2"],
    shunt: Float[Array, ""] | None = None,
) -> tuple[Float[Array, "M M"], Float[Array, "M P"], Float[Array, "D P"]]:
    """Computes potentials of electrodes at each other and at `others`, at 1 Ω per square.

    The third result is L⁻¹·(dipoles' field at `others`), with D = 2M rows, or 0 without
    dipoles. Products of its columns are what the shunts take from the resistance between
    two of `others`.
    """

    def rows(others: Array) -> Array:
        def one(place: Array) -> Array:
            return rectangle_green(place, others, radius, size)

        return jax.lax.map(one, places, batch_size=_AT_ONCE)

    ee, ep = rows(places), rows(others)
    if shunt is None:
        return ee, ep, ep[:0]
    at_places, answer = _shunts(places, radius, size, shunt)
    at_others = answer(others)
    ee = ee - matmul(at_places.T, at_places)
    return ee, ep - matmul(at_places.T, at_others), at_others


def _shunts(
    places: Array, radius: Array, size: Array, shunt: Array
) -> tuple[Array, Callable[[Array], Array]]:
    """Computes L⁻¹·(dipoles' field at electrodes), and makes a function for other places.

    LLᵀ are the dipoles' own resistances.
    """

    def dipole(place: Array, other: Array) -> Array:
        return jax.grad(rectangle_green)(place, other, radius, size, True)

    def each(f: Callable, others: Array) -> Array:
        def one(place: Array) -> Array:
            return jax.vmap(lambda other: f(place, other))(others)

        return jax.lax.map(one, places, batch_size=_AT_ONCE)

    count = 2 * len(places)
    pairs = each(jax.jacfwd(dipole, 1), places)
    own = pairs.transpose(0, 2, 1, 3).reshape(count, count)
    weaker = (1 / shunt - 1) / (2 * np.pi * radius**2)
    chol = jnp.linalg.cholesky(own + weaker * jnp.eye(count, dtype=own.dtype))

    def answer(others: Array) -> Array:
        field = each(dipole, others).transpose(0, 2, 1).reshape(count, -1)
        return triangular_solve(chol, field, left_side=True, lower=True)

    return answer(places), answer
