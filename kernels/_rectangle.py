"""The Green's function of a homogeneous rectangle: its cosine series, summed.

For −Δ G = ρ(δ − 1/(ab)) with insulated edges the double cosine series is summed over
one index to hyperbolic functions, those are expanded in exponentials and summed over
the other index, which leaves logarithms (θ_j = π(x ∓ x')/a, b ≥ a, q = exp(−2πb/a)):

    G = ρ·{ [b/3 + (y² + y'²)/2b − max(y, y')]/a − (1/4π)·Σ ln(1 − 2r cos θ + r²) }

over both θ and r ∈ {e^{−π|y−y'|/a}, e^{−π(y+y')/a}, q/…, q/…}·q^j, j = 0, 1, …: each j
gains a factor of exp(−2π) or better, so six terms reach 1e-16. Sources are discs:
outside a disc the field is that of a point, inside it is the rim's.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax.kernels._mesh import centroids, element_area, Shape
from tomojax.kernels._table import centred, Resistances

_TERMS = 6


def rectangle_green(
    one: Float[Array, "*#batch 2"],
    other: Float[Array, "*#batch 2"],
    rim: Float[Array, "*#batch"],
    size: Float[Array, "2"],
) -> Float[Array, "*batch"]:
    """G(x, x') at 1 Ω per square; below the distance `rim` (m) the value at the rim."""
    turned = size[0] > size[1]
    a, b = jnp.min(size), jnp.max(size)
    x, y = (jnp.where(turned, one[..., 1 - i], one[..., i]) for i in (0, 1))
    x_, y_ = (jnp.where(turned, other[..., 1 - i], other[..., i]) for i in (0, 1))
    gap, total = jnp.abs(y - y_), y + y_
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
    product = factor(near, turn_)
    for j in range(_TERMS):
        for k, r in enumerate((near, far, far_, near_)):
            if j or k:
                product = product * factor(r * q**j, turn)
            if j or k:
                product = product * factor(r * q**j, turn_)
    # The one factor that vanishes where the two places meet, as (π d/a)²·ratio.
    square = (x - x_) ** 2 + (y - y_) ** 2
    meet = square == 0
    vanishing = factor(near, turn)
    ratio = jnp.where(meet, (jnp.pi / a) ** 2, vanishing / jnp.where(meet, 1, square))
    logs = jnp.log(product * ratio) + jnp.log(jnp.maximum(square, rim**2))
    mean = b / 3 + (y**2 + y_**2) / (2 * b) - (total + gap) / 2
    return mean / a - logs / (4 * np.pi)


def rectangle_resistances(
    sheet_resistance: Float[Array, ""],
    places: Float[Array, "M 2"],
    radius: Float[Array, ""],
    shape: Shape,
    size: Float[Array, "2"],
) -> Resistances:
    """R_ee, R_ek and R_kk (Ω) of a homogeneous rectangle, centred; no mesh error.

    Electrodes are equipotential discs of `radius`, elements uniformly fed discs of the
    element's area at its centroid (own term ¼ − ln r: a disc of radius r·e^{−1/4}).
    **Arguments:** `sheet_resistance` Ω per square; `places`, `radius`, `size` m;
    `shape` cells of the grid of elements.
    """
    elements = centroids(shape, size)
    rows = jax.vmap(rectangle_green, (0, None, None, None))
    own = element_radius(shape, size)
    return centred(
        Resistances(
            sheet_resistance * rows(places, places, radius, size),
            sheet_resistance * rows(places, elements, radius, size),
            sheet_resistance * rectangle_green(elements, elements, own, size),
        )
    )


def element_radius(shape: Shape, size: Float[Array, "2"]) -> Float[Array, ""]:
    """Radius (m) of the equipotential disc that stands for one element of the grid."""
    return jnp.sqrt(element_area(shape, size) / np.pi) * float(np.exp(-0.25))
