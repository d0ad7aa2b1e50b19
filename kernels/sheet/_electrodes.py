"""Puts disc electrodes at any place on a mesh that need not resolve them.

An electrode is an equipotential disc of radius a. It acts in three ways.

*Feed.* An electrode is fed and read through a Gaussian of width s on the nodes around it.
Outside its source such a feed acts like a disc: a harmonic function's mean over a circle
is its value at the centre. So only the electrode's own resistance depends on s. The
difference to the disc's is known, and is put back as a resistance in series.

*Shunt.* A disc that nothing is connected to still evens out the potential under it. In a
field E the disc answers with the dipole 2πσa²E. If discs cover 5 % of a sheet, the sheet's
resistance falls by 10 %. The dipoles are fed through the Gaussian's slopes. The part of
1/(2πσa²) that their own resistance lacks is put back in series as well.

*Metal.* An object over an electrode touches the metal, not a point of the sheet. So the
part of a contact within the feed's reach goes to the electrode itself (`metal_shares`).
Otherwise a strong contact could drive the spread-out feed beyond the object's voltage.

The weights are smooth in the electrode's place. The sum over a mesh of spacing h repeats
the integral to exp(−2π²s²/h²).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tomojax.kernels.sheet._mesh import (
    cell_sides,
    centroids,
    namespace,
    node_areas,
    nodes,
    Shape,
    Values,
)
from tomojax.kernels.sheet._skin import (
    distances,
    local_cells,
    moves,
    node_parts,
    Skin,
    tangents,
)

# The own resistance of a Gaussian of width s is that of a disc of radius a when
# ln s + ½(2 ln 2 − γ) = ln a, Euler's γ: the mean of −ln|x − x'| over two draws.
_GAUSS = float(2 * np.log(2) - np.euler_gamma) / 2
# The mesh's error of that resistance has (h/s)⁴ this often, see `_own_excess`.
_FOURTH = 0.0011936

# A dipole towards the edge answers this part at least, so that it is solved for.
_FAINT = 0.03

# Below this width, in cells, the sum over nodes no longer repeats the integral (8e-4).
_NARROWEST = 0.65


def _own_excess(width: Values, radius: Values, cell: Float[Values, "2 ..."]) -> Values:
    """Computes 2πσ·(own resistance of a disc − that of the feed on the mesh).

    The result is ln s + ½(2 ln 2 − γ) − ln a − (dx² + dy²)/(64 s²) − 0.0012 (h/s)⁴. The
    terms are the width's difference and the first two terms of the mesh's error. The
    stencil's symbol is k² − (k_x⁴dx² + k_y⁴dy²)/12 + …. So the stencil carries short waves
    too easily and overstates the own resistance by (1/σ)·∫|f̂|²(k_x⁴dx² + k_y⁴dy²)/(12k⁴) +
    ….
    """
    square = cell**2
    mesh = square.sum(0) / (64 * width**2) + _FOURTH * (square**2).mean(0) / width**4
    return namespace(width).log(width / radius) + _GAUSS - mesh


def feed_width(
    radius: Float[Values, ""], shape: Shape, size: Float[Values, "2"]
) -> Float[Values, ""]:
    """Computes the width s (m) of the Gaussian feed: the disc's own, or the mesh's least.

    At the disc's own width `_own_excess` vanishes, by four Newton steps in ln s. So
    `_own_excess` is never below zero. A negative resistance in series would make a strong
    contact over an electrode push current out of the ground. The cells are the chart's.
    """
    xp = namespace(size)
    log_width = xp.log(radius) - _GAUSS
    cell = cell_sides(shape, size)
    square = cell**2
    for _ in range(4):
        width = xp.exp(log_width)
        slope = 1 + square.sum() / (32 * width**2)
        slope = slope + 4 * _FOURTH * (square**2).mean() / width**4
        log_width = log_width - _own_excess(width, radius, cell) / slope
    return xp.maximum(xp.exp(log_width), _NARROWEST * cell.max())


class Feeds(NamedTuple):
    """Electrodes on a mesh of `shape`, and the width s of what they are fed through."""

    places: Float[Values, "M 2"]  # m
    radius: Float[Values, ""]  # m
    width: Float[Values, ""]  # m
    shape: Shape
    size: Float[Values, "2"]  # m
    skin: Skin | None

    @classmethod
    def of(
        cls, places: Values, radius: Values, shape: Shape, size: Values, skin: Skin | None
    ) -> "Feeds":
        return cls(places, radius, feed_width(radius, shape, size), shape, size, skin)

    def near(self, others: Float[Values, "n 2"]) -> Float[Values, "n M"]:
        """Computes the feeds' Gaussians, 1 in their middles."""
        square = distances(self.skin, self.places, others)
        return namespace(square).exp(-square / (2 * self.width**2))

    @property
    def cell(self) -> Float[Values, "2"]:
        return cell_sides(self.shape, self.size)


def feed_weights(feeds: Feeds) -> Float[Values, "nodes M"]:
    """Computes shares of each electrode's current that enter a node; columns sum to 1."""
    mesh, skin = (feeds.shape, feeds.size), feeds.skin
    areas = node_areas(*mesh) if skin is None else node_parts(skin, *mesh)
    weights = feeds.near(nodes(*mesh)) * areas[:, None]
    return weights / weights.sum(0)


def feed_parts(
    places: Float[Values, "M 2"],
    radius: Float[Values, ""],
    shape: Shape,
    size: Float[Values, "2"],
    skin: Skin,
) -> Float[Values, " M"]:
    """Computes the part of each electrode that is on the sheet: 1/2 at a straight edge."""
    feeds = Feeds.of(places, radius, shape, size, skin)
    parts = node_parts(skin, shape, size)
    inside = (parts[:, None] * feeds.near(nodes(shape, size))).sum(0)
    return inside / (2 * np.pi * feeds.width**2)


def metal_shares(feeds: Feeds) -> Float[Values, "nodes M"]:
    """Computes the share of a contact at each node that is on metal: 1 within 2 s.

    The share falls to 0 over a cell. The disc of the feed's own resistance has the radius
    1.5 s. A seventh of the feed is still between 1.5 s and 2 s; a contact there was seen to
    drive voltages out of bounds.
    """
    square = distances(feeds.skin, feeds.places, nodes(feeds.shape, feeds.size))
    # Linear in the square of the distance: smooth where node and electrode coincide.
    reach, cell = 2 * feeds.width, feeds.cell.max()
    inside = namespace(square).clip(0.5 + (reach**2 - square) / (2 * reach * cell), 0, 1)
    return inside**2 * (3 - 2 * inside)


def dipole_weights(
    feeds: Feeds, weights: Float[Values, "nodes M"]
) -> Float[Values, "nodes D"]:
    """Computes slopes (1/m) of the feeds' `weights` in x, then y: dipoles of 1 A·m.

    With an outline the two ways are towards the edge, and along it.
    """
    skin, mesh = feeds.skin, (feeds.shape, feeds.size)
    xp, steps = namespace(feeds.places), moves(skin, feeds.places, feeds.cell)
    if skin is not None:
        way = _from_edge(feeds, skin)[1]
        turn = xp.stack([way, xp.stack([-way[:, 1], way[:, 0]], 1)], -1)
        steps = _products(steps, turn)
    steps = _products(tangents(skin, feeds.places, feeds.cell), steps)  # in space
    places, at = feeds.places, nodes(*mesh)
    if skin is not None:
        places, at = skin.points(places), skin.points(at)
    found = []
    for step in xp.moveaxis(steps, -1, 0):
        # The slope of a Gaussian's logarithm, and of what divides it to a sum of 1.
        along = sum(
            (at[:, None, d] - places[:, d]) * step[:, d] for d in range(at.shape[1])
        )
        along = along / feeds.width**2
        found.append(weights * (along - (weights * along).sum(0)))
    return xp.concatenate(found, 1)


def _products(a: Float[Values, "M i j"], b: Float[Values, "M j k"]) -> Values:
    """Multiplies small matrices, in full precision wherever they are."""
    return (a[..., None] * b[:, None]).sum(2)


def series_resistances(
    feeds: Feeds, sheet: Float[Values, " elements"], shunt: Float[Values, ""] | None
) -> tuple[Float[Values, " M"], Float[Values, " D"]]:
    """Computes the resistances that feeds (Ω) and dipoles (Ω/m²) lack to a disc's own.

    Feed: `_own_excess`/(2πσ_e), zero where the mesh resolves the disc. Dipole, answering
    with the part `shunt` of a disc's: 1/(2πσ_e a²·shunt) − [1 + (dx² + dy²)/(32 s²) +
    0.0048 (h/s)⁴]/(8πσ_e s²). Here σ_e is the sheet's conductance under the feed, of what
    is on the sheet: half of it at an edge.
    """
    radius, width, skin = feeds.radius, feeds.width, feeds.skin
    xp = namespace(feeds.places)
    near = feeds.near(centroids(feeds.shape, feeds.size))
    sides = local_cells(skin, feeds.places, feeds.cell)
    whole = near.sum(0)
    if skin is not None:  # what lies beyond the box conducts nothing
        whole = xp.maximum(whole, 4 * np.pi * width**2 / sides.prod(0))
    under = (sheet[:, None] * near).sum(0) / whole
    excess = xp.maximum(_own_excess(width, radius, sides), 0)
    series = excess / (2 * np.pi * under)
    if shunt is None:
        return series, series[:0]
    cell = sides**2 / width**2
    own = (1 + cell.sum(0) / 32 + 4 * _FOURTH * (cell**2).mean(0)) / (4 * width**2)
    lacking = (1 / (shunt * radius**2) - own) / (2 * np.pi) / under
    if skin is None:
        return series, xp.concatenate([lacking, lacking])
    # No current crosses an edge: there an image cancels the dipole that points to it.
    inside = _from_edge(feeds, skin)[0] / radius
    answers = xp.clip(inside, _FAINT, 1)
    less = (1 / answers**2 - 1) / (2 * np.pi * radius**2 * under)
    return series, xp.concatenate([lacking + less, lacking])


def _from_edge(
    feeds: Feeds, skin: Skin
) -> tuple[Float[Values, " M"], Float[Values, "M 2"]]:
    """Computes distances of places from the edge, m in the chart, and the way there."""
    places, width, size = feeds.places, feeds.width, feeds.size
    xp, at = namespace(places), nodes(feeds.shape, size)
    offsets = at[:, None] - places
    level = xp.clip(skin.level, -size.max(), size.max())[:, None]
    near = xp.exp(-(offsets**2).sum(-1) / (2 * width**2))
    near = near / near.sum(0)
    mean = (level * near).sum(0)
    apart = near * (level - mean)
    way = (apart[..., None] * offsets).sum(0)
    length = xp.sqrt((way**2).sum(1, keepdims=True))
    flat = length < 1e-6 * width * width / size.max()
    unit = xp.where(flat, np.array([1.0, 0.0], way.dtype), way / xp.where(flat, 1, length))
    # Where the box ends at the edge, no node is beyond it: the mean is of another place.
    off_centre = (near[..., None] * offsets).sum(0)
    return (unit * off_centre).sum(1) - mean, unit
