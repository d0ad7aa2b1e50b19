"""Computes the Green's function of a homogeneous rectangle: its cosine series, summed.

For −Δ G = ρ(δ − 1/(ab)) with insulated edges the double cosine series is summed over one
index to hyperbolic functions. The hyperbolic functions, expanded in exponentials and summed
over the other index, leave logarithms (θ_j = π(x ∓ x')/a, b ≥ a, q = exp(−2πb/a)):

    G = ρ·{ [b/3 + (y² + y'²)/2b − max(y, y')]/a − (1/4π)·Σ ln(1 − 2r cos θ + r²) }

The sum is over both θ and r ∈ {e^{−π|y−y'|/a}, e^{−π(y+y')/a}, q/…, q/…}·q^j, j = 0, 1, ….
Each j gains a factor of exp(−2π) or better, so six terms reach 1e-16. Sources are discs:
outside a disc the field is that of a point, inside the value is the rim's. Floating
electrodes answer with dipoles, as in `_electrodes`.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax.linalg import triangular_solve
from jaxtyping import Array, Float

from tomojax.kernels.algebra import matmul
from tomojax.kernels.sheet._mesh import centroids, element_area, Shape
from tomojax.kernels.sheet._table import centred, Resistances

_TERMS = 6

# Where among (4, terms) the factor is that vanishes as the places meet.
_VANISHING = np.arange(4 * _TERMS).reshape(4, _TERMS) == 0


def rectangle_green(
    one: Float[Array, "*#batch 2"],
    other: Float[Array, "*#batch 2"],
    rim: Float[Array, "*#batch"],
    size: Float[Array, "2"],
    solid: bool = False,
) -> Float[Array, "*batch"]:
    """Computes G(x, x') at 1 Ω per square; the source is a disc of radius `rim`, m.

    Within the rim the value is the rim's. If `solid`, the value is that of an evenly
    charged disc less its mean: ln a − (1 − d²/a²)/2 for ln d. The slope of this value is
    the field of a disc's dipole, d/a² inside. The dipole's own second slope is 1/(2πa²), as
    it must be.
    """
    turned = size[0] > size[1]
    a, b = jnp.min(size), jnp.max(size)
    x, y = (jnp.where(turned, one[..., 1 - i], one[..., i]) for i in (0, 1))
    x_, y_ = (jnp.where(turned, other[..., 1 - i], other[..., i]) for i in (0, 1))
    # Nearer than rounding tells apart the two are one place: slopes would be noise.
    square = (x - x_) ** 2 + (y - y_) ** 2
    meet = square < jnp.finfo(square.dtype).eps * a**2
    gap, total = jnp.where(meet, 0, jnp.abs(y - y_)), y + y_
    turn = jnp.sin(jnp.pi * (x - x_) / (2 * a)) ** 2
    turn_ = jnp.sin(jnp.pi * (x + x_) / (2 * a)) ** 2
    near, far = jnp.exp(-jnp.pi * gap / a), jnp.exp(-jnp.pi * total / a)
    q = jnp.exp(-2 * jnp.pi * b / a)

    def factor(r: Array, s: Array) -> Array:  # 1 − 2r cos θ + r², s = sin²(θ/2)
        return (1 - r) ** 2 + 4 * r * s

    # e^{−π(2b − y − y')/a} written through the distances to the other edge, since
    # q/far would underflow in float32 on a long sheet.
    far_ = jnp.exp(-jnp.pi * (2 * b - total) / a)
    near_ = jnp.exp(-jnp.pi * (2 * b - gap) / a)
    # (places, 4, terms): as an axis, not unrolled, for the sake of compile time.
    powers = q ** np.arange(_TERMS, dtype=near.dtype)
    sizes = jnp.stack([near, far, far_, near_], -1)[..., None] * powers
    turns, turns_ = turn[..., None, None], turn_[..., None, None]
    factors = factor(sizes, turns_) * jnp.where(_VANISHING, 1, factor(sizes, turns))
    # The one factor that vanishes where the two places meet, as (π d/a)²·ratio.
    vanishing = factor(near, turn)
    ratio = jnp.where(meet, (jnp.pi / a) ** 2, vanishing / jnp.where(meet, 1, square))
    inside = square < rim**2
    within = jnp.log(rim**2) + (square / rim**2 - 1 if solid else 0)
    logs = (
        _log_product(factors)
        + jnp.log(ratio)
        + jnp.where(inside, within, jnp.log(jnp.where(inside, 1, square)))
    )
    mean = b / 3 + (y**2 + y_**2) / (2 * b) - (total + gap) / 2
    return mean / a - logs / (4 * np.pi)


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
    one, other = jnp.broadcast_arrays(one, other)
    turned = size[0] > size[1]
    a, b = jnp.min(size), jnp.max(size)
    x, y = (jnp.where(turned, one[..., 1 - i], one[..., i]) for i in (0, 1))
    x_, y_ = (jnp.where(turned, other[..., 1 - i], other[..., i]) for i in (0, 1))
    square = (x - x_) ** 2 + (y - y_) ** 2
    apart = square >= jnp.finfo(square.dtype).eps * a**2
    forward = jnp.where(apart, jnp.sign(y - y_), 0)
    gap, total = jnp.abs(y - y_), y + y_
    # The four r's first: their exponents, and how those change with y, in π/a.
    exponents = jnp.stack([-gap, -total, total - 2 * b, gap - 2 * b], -1)
    change = jnp.stack([-forward, -jnp.ones_like(y), jnp.ones_like(y), forward], -1)
    powers = jnp.exp(-2 * jnp.pi * b / a) ** np.arange(_TERMS, dtype=square.dtype)
    r = (jnp.exp(jnp.pi * exponents / a)[..., None] * powers)[..., None]
    angle = jnp.pi * jnp.stack([x - x_, x + x_], -1)[..., None, None, :] / a
    s = jnp.sin(angle / 2) ** 2
    factor = (1 - r) ** 2 + 4 * r * s  # (…, 4, terms, 2)
    # The one that vanishes where the places meet is constant there.
    first = _VANISHING[..., None] & (np.arange(2) == 0)
    still = first & ~apart[..., None, None, None]
    inverse = jnp.where(still, 0, 1 / jnp.where(still, 1, factor))
    by_x = (2 * r * jnp.sin(angle) * inverse).sum((-3, -2, -1))
    steep = change[..., None, None] * r * (4 * s - 2 * (1 - r)) * inverse
    logs = jnp.pi / a * jnp.stack([by_x, steep.sum((-3, -2, -1))], -1)
    # Within the rim ln d is left out.
    inside = (apart & (square < rim**2))[..., None]
    between = jnp.stack([x - x_, y - y_], -1)
    logs = logs - jnp.where(
        inside, 2 * between / jnp.where(inside, square[..., None], 1), 0
    )
    mean = jnp.stack([jnp.zeros_like(y), y / b - (1 + forward) / 2], -1) / a
    slope = mean - logs / (4 * np.pi)
    return jnp.where(turned, slope[..., ::-1], slope)


@jax.custom_jvp
def _log_product(factors: Float[Array, "*batch 4 terms"]) -> Float[Array, "*batch"]:
    """Computes ln Πf; its slope Σf'/f compiles many times faster than that of a product."""
    return jnp.log(jnp.prod(factors, (-2, -1)))


@_log_product.defjvp
def _(factors: tuple, slopes: tuple) -> tuple[Array, Array]:
    return _log_product(*factors), jnp.sum(slopes[0] / factors[0], (-2, -1))


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
    rim = element_radius(shape, size)
    ee, ek, at_elements = rectangle_fields(places, elements, radius, size, shunt)
    kk = rectangle_green(elements, elements, rim, size) - (at_elements**2).sum(0)
    rho = sheet_resistance
    return centred(Resistances(rho * ee, rho * ek, rho * kk))


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
    rows = jax.vmap(rectangle_green, (0, None, None, None))
    ee, ep = rows(places, places, radius, size), rows(places, others, radius, size)
    if shunt is None:
        return ee, ep, ep[:0]
    at_places, at_others = _shunts(places, others, radius, size, shunt)
    ee = ee - matmul(at_places.T, at_places)
    return ee, ep - matmul(at_places.T, at_others), at_others


def _shunts(
    places: Array, elements: Array, radius: Array, size: Array, shunt: Array
) -> tuple[Array, Array]:
    """Computes L⁻¹·(dipoles' field at electrodes, elements), LLᵀ their own resistances."""

    def dipole(place: Array, other: Array) -> Array:
        return jax.grad(rectangle_green)(place, other, radius, size, True)

    def each(f: Callable, others: Array) -> Array:
        return jax.vmap(lambda x: jax.vmap(lambda y: f(x, y))(others))(places)

    count = 2 * len(places)
    pairs = each(jax.jacfwd(dipole, 1), places)
    own = pairs.transpose(0, 2, 1, 3).reshape(count, count)
    weaker = (1 / shunt - 1) / (2 * np.pi * radius**2)
    chol = jnp.linalg.cholesky(own + weaker * jnp.eye(count, dtype=own.dtype))

    def answer(others: Array) -> Array:
        field = each(dipole, others).transpose(0, 2, 1).reshape(count, -1)
        return triangular_solve(chol, field, left_side=True, lower=True)

    return answer(places), answer(elements)


def element_radius(shape: Shape, size: Float[Array, "2"]) -> Float[Array, ""]:
    """Computes the radius (m) of the equipotential disc that stands for one element."""
    return jnp.sqrt(element_area(shape, size) / np.pi) * float(np.exp(-0.25))
