"""Disc electrodes on a mesh that need not resolve them, at any place.

An electrode of radius a is fed and read through a Gaussian of width s on the nodes
around it. Outside its source a symmetric feed acts like a disc (the mean of a harmonic
function over a circle is its value at the centre), so only the electrode's own
resistance depends on s, and there the difference to an equipotential disc is known:
it is put back as a resistance in series. The weights are smooth in the electrode's
place, and the sum over a mesh of spacing h repeats the integral to exp(−2π²s²/h²).
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax.kernels._mesh import cell_sides, centroids, node_areas, nodes, Shape

# The own resistance of a Gaussian of width s is that of a disc of radius a when
# ln s + ½(2 ln 2 − γ) = ln a, Euler's γ: the mean of −ln|x − x'| over two draws.
_GAUSS = float(2 * np.log(2) - np.euler_gamma) / 2
# Below this width, in cells, the sum over nodes no longer repeats the integral (8e-4).
_NARROWEST = 0.65


def feed_width(
    radius: Float[Array, ""], shape: Shape, size: Float[Array, "2"]
) -> Float[Array, ""]:
    """Width s (m) of the Gaussian feed: the disc's own, or what the mesh carries."""
    cell = cell_sides(shape, size).max()
    return jnp.maximum(radius * float(np.exp(-_GAUSS)), _NARROWEST * cell)


def feed_weights(
    places: Float[Array, "M 2"],
    width: Float[Array, ""],
    shape: Shape,
    size: Float[Array, "2"],
) -> Float[Array, "nodes M"]:
    """Shares of each electrode's current that enter at each node; columns sum to 1."""
    square = ((nodes(shape, size)[:, None] - places[None]) ** 2).sum(-1)
    weights = jnp.exp(-square / (2 * width**2)) * node_areas(shape, size)[:, None]
    return weights / weights.sum(0)


def series_resistance(
    sheet: Float[Array, " elements"],
    places: Float[Array, "M 2"],
    radius: Float[Array, ""],
    shape: Shape,
    size: Float[Array, "2"],
) -> Float[Array, " M"]:
    """What the Gaussian feed on this mesh lacks (Ω) to a disc's own resistance.

    (1/2πσ_e)·[ln s + ½(2 ln 2 − γ) − ln a − (dx² + dy²)/(64 s²) − 0.0012 (h/s)⁴]:
    the width's difference, and the first two terms of the mesh's error. The stencil's
    symbol is k² − (k_x⁴dx² + k_y⁴dy²)/12 + …, so it carries short waves too easily
    and overstates the own resistance by (1/σ)·∫|f̂|²(k_x⁴dx² + k_y⁴dy²)/(12k⁴) + ….
    σ_e is the sheet's conductance under the feed.
    """
    width = feed_width(radius, shape, size)
    cell = cell_sides(shape, size)
    own = jnp.log(width / radius) + _GAUSS
    mesh = (cell**2).sum() / (64 * width**2)
    mesh_4 = 0.0011936 * (cell**4).mean() / width**4
    square = ((centroids(shape, size)[:, None] - places[None]) ** 2).sum(-1)
    near = jnp.exp(-square / (2 * width**2))
    under = jnp.matmul(sheet, near, precision="highest") / near.sum(0)
    return (own - mesh - mesh_4) / (2 * np.pi * under)
