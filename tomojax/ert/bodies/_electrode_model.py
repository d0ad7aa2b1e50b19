"""Computes voltages between electrodes on a flat body's rim: complete electrode model.

∇·(σ∇u) = 0 inside. Under electrode e, z·σ∂u/∂n = U_e − u: the contact's layer resists by z.
The currents of the electrodes are ∫σ∂u/∂n, and nothing flows elsewhere on the rim. Linear
elements on triangles; one sparse factor serves all electrodes. (Somersalo, Cheney and
Isaacson 1992, eq. 1.7.)
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay

from tomojax._require import require
from tomojax.sensor import PolygonEdge

# Sides of the mesh along the rim, of the spacing inside: current is densest at electrodes'
# ends.
_SIDE = 0.7

# Nodes inside are as far from the rim as this, of the spacing: the rim is then made of
# sides of triangles.
_APART = 0.6

# Triangles whose middle is nearer to the rim, of the spacing, are none.
_SLIVER = 1e-3

# Sides under an electrode, at least.
_UNDER = 3

# An outline's vertex is a node of the mesh where the outline turns by more, rad.
_CORNER = 0.3

# Vertices of the polygon that stands for a disc: its area is 2e-6 less.
_ROUND = 2000


class Transfer(NamedTuple):
    """Potentials for 1 A into each electrode, out of all electrodes in equal parts.

    **Example:**

    >>> import numpy as np
    >>> from tomojax.ert import disc_model
    >>> model = disc_model(radius=0.1, count=8, spacing=0.02)
    >>> model.transfer(np.ones(len(model.areas)), contact=0.01).table.shape
    (8, 8)
    """

    table: Float[np.ndarray, "E E"]  # Ω, of the electrodes
    fields: Float[np.ndarray, "T 2 E"]  # −E in each triangle, V/m


class ElectrodeModel(NamedTuple):
    """A mesh of triangles, and its sides under electrodes. `rim_model` makes one.

    **Example:** the gauge is that the electrodes' potentials add up to nothing.

    >>> import numpy as np
    >>> from tomojax.ert import disc_model
    >>> model = disc_model(radius=0.1, count=8, spacing=0.02)
    >>> ohms = model.transfer(np.ones(len(model.areas)), contact=0.01).table
    >>> bool(abs(ohms.sum(0)).max() < 1e-12), bool(abs(ohms - ohms.T).max() < 1e-12)
    (True, True)
    """

    nodes: Float[np.ndarray, "N 2"]  # m
    triangles: Int[np.ndarray, "T 3"]
    gradients: Float[np.ndarray, "T 3 2"]  # of the nodes' hat functions, 1/m
    areas: Float[np.ndarray, " T"]  # m²
    sides: Int[np.ndarray, "S 2"]  # under electrodes
    under: Int[np.ndarray, " S"]  # the electrode of each
    outline: Float[np.ndarray, "B 2"]  # nodes of the rim, in order

    @property
    def electrode_count(self) -> int:
        return int(self.under.max()) + 1

    def stiffness(self, conductance: Float[np.ndarray, " T"]) -> sparse.csc_matrix:
        """Computes K, S, with K·u = the nodes' currents, of triangles' S per square."""
        weight = (conductance * self.areas)[:, None, None]
        each = weight * self.gradients @ self.gradients.swapaxes(1, 2)
        row, column = np.repeat(self.triangles, 3, 1), np.tile(self.triangles, (1, 3))
        count = len(self.nodes)
        places = (row.ravel(), column.ravel())
        return sparse.csc_matrix((each.ravel(), places), (count, count))

    def transfer(self, conductance: Float[np.ndarray, " T"], contact: float) -> Transfer:
        """Computes the transfer resistances.

        **Arguments:** `conductance`, S per square, of each triangle; `contact`, z, Ω·m.
        """
        count, electrodes = len(self.nodes), self.electrode_count
        (a, b), e = self.sides.T, count + self.under
        long = np.linalg.norm(self.nodes[a] - self.nodes[b], axis=1) / contact
        # ∫(u − U)² along a side, and 1 S from the first electrode to ground: it carries
        # nothing, as all currents add up to nothing.
        terms = [(a, a, 2), (b, b, 2), (a, b, 1), (b, a, 1), (e, e, 6)]
        terms += [(i, j, -3) for i, j in ((a, e), (e, a), (b, e), (e, b))]
        ground = np.array([count])
        row, column = (np.concatenate([t[k] for t in terms] + [ground]) for k in (0, 1))
        value = np.concatenate([t[2] * long / 6 for t in terms] + [np.ones(1)])
        size = count + electrodes
        matrix = sparse.csc_matrix((value, (row, column)), (size, size))
        inside = self.stiffness(conductance)
        inside.resize(size, size)
        factor = sparse.linalg.splu(
            (matrix + inside).tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        currents = np.zeros((size, electrodes))
        currents[count:] = np.eye(electrodes) - 1 / electrodes
        volts = factor.solve(currents)
        fields = self.gradients.swapaxes(1, 2) @ volts[self.triangles]
        table = volts[count:] - volts[count:].mean(0)
        return Transfer(table, fields)

    def slopes(self, fields: Float[np.ndarray, "T 2 E"]) -> Float[np.ndarray, "P T"]:
        """Computes ∂R_ab/∂σ_k = −area_k·∇u_a·∇u_b; pairs a ≤ b as of `np.triu_indices`."""
        a, b = np.triu_indices(fields.shape[2])
        return -(np.einsum("txp,txp->pt", fields[:, :, a], fields[:, :, b]) * self.areas)

    def waves(self, count: int, length: float) -> Float[np.ndarray, "N K"]:
        """Computes a random field's longest waves: eigenfunctions of the Laplacian.

        Weights that are normal make them a Matérn 3/2 field of this length, m. Its mean
        variance is 1.
        """
        mass = np.bincount(self.triangles.ravel(), np.repeat(self.areas / 3, 3))
        unit = self.stiffness(np.ones(len(self.areas)))
        # K and the mass have no common null space: a shift below 0 keeps the factor sound.
        shift, start = -1 / length**2, np.ones(len(mass))
        square, wave = sparse.linalg.eigsh(
            unit, count, sparse.diags(mass), sigma=shift, v0=start
        )
        wave = wave * (3 / length**2 + np.maximum(square, 0)) ** -1.25
        return wave / np.sqrt(np.average((wave**2).sum(1), weights=mass))

    def image(
        self, values: Float[np.ndarray, " N"], x: np.ndarray, y: np.ndarray
    ) -> Float[np.ndarray, "nx ny"]:
        """Interpolates nodes' values at a grid of places, m; NaN beyond the rim."""
        grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
        image = LinearNDInterpolator(self.nodes, values)(grid)
        off = np.asarray(PolygonEdge(self.outline).distance(jnp.asarray(grid))) > 0
        return np.where(off, np.nan, image)


def disc_model(
    radius: float, count: int, spacing: float, cover: float = 0.5, first: float = 0.0
) -> ElectrodeModel:
    """Makes the model of a disc about (0, 0).

    **Arguments:** `count` electrodes, even, anticlockwise from the angle `first`, rad, on
    the part `cover` of the rim; `radius` and `spacing` of the mesh, m.

    **Example:**

    >>> from tomojax.ert import disc_model
    >>> model = disc_model(radius=0.1, count=8, spacing=0.02)
    >>> print(f"{1e4 * model.areas.sum():.0f} cm²")
    313 cm²
    """
    require(0 < cover < 1, "cover", cover, "a part of the rim between 0 and 1")
    turn = first + 2 * np.pi * np.arange(_ROUND) / _ROUND
    outline = radius * np.stack([np.cos(turn), np.sin(turn)], 1)
    pitch = _ROUND * 2 * radius * np.sin(np.pi / _ROUND) / count
    middle = pitch * np.arange(count)[:, None]
    return rim_model(outline, middle + pitch * cover / 2 * np.array([-1, 1]), spacing)


def rim_model(
    outline: Float[np.ndarray, "n 2"], spans: Float[np.ndarray, "E 2"], spacing: float
) -> ElectrodeModel:
    """Makes the model of a body of any outline without holes.

    **Arguments:** vertices of the `outline`, m, in order; `spans`: where each electrode
    begins and ends, m along the outline from its first vertex; `spacing` of the mesh, m.
    **Raises:** `ValueError` for electrodes that overlap, or a mesh too coarse for the
    outline.

    **Example:**

    >>> import numpy as np
    >>> from tomojax.ert import rim_model
    >>> square = np.array([[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]])
    >>> model = rim_model(square, 0.1 * np.arange(4)[:, None] + [0.04, 0.06], 0.01)
    >>> print(model.electrode_count, round(model.areas.sum(), 6))
    4 0.01
    """
    ring = np.concatenate([outline, outline[:1]])
    along = np.r_[0, np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1))]
    around = along[-1]
    ends = np.asarray(spans, float)
    order = np.argsort(ends[:, 0])
    gaps = np.roll(ends[order, 0], -1) - ends[order, 1]
    gaps[-1] += around
    apart = bool((ends[:, 1] > ends[:, 0]).all() and (gaps > 0).all())
    require(
        apart, "spans", "electrodes that overlap or have no length", "gaps between them"
    )
    places, owner = _rim_places(ring, along, ends % around, spacing)
    rim = np.stack([np.interp(places, along, ring[:, k]) for k in (0, 1)], 1)
    nodes = np.concatenate([rim, _inside(rim, spacing)])
    triangles = Delaunay(nodes).simplices.astype(np.int64)
    middle = jnp.asarray(nodes[triangles].mean(1))
    # Slivers of nodes on one straight line of the rim lie on the line.
    inside = np.asarray(PolygonEdge(rim).distance(middle)) < -_SLIVER * spacing
    triangles = triangles[inside]
    corner = nodes[triangles]
    across = np.roll(corner, -1, 1) - np.roll(corner, 1, 1)  # the side opposite each corner
    (ax, ay), (bx, by) = across[:, 0].T, across[:, 1].T
    double = ax * by - ay * bx
    normal = np.stack([-across[..., 1], across[..., 0]], -1)
    sides = np.stack([np.arange(len(rim)), (np.arange(len(rim)) + 1) % len(rim)], 1)
    pairs = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2))
    there = set(map(tuple, pairs)) >= set(map(tuple, np.sort(sides)))
    require(there, "spacing", f"{spacing:g} m", "finer: the outline has narrower parts")
    return ElectrodeModel(
        nodes=nodes,
        triangles=triangles,
        gradients=normal / double[:, None, None],
        areas=np.abs(double) / 2,
        sides=sides[owner >= 0],
        under=owner[owner >= 0],
        outline=rim,
    )


def _rim_places(
    ring: np.ndarray, along: np.ndarray, ends: np.ndarray, spacing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Places nodes along the rim; tells the electrode over the side after each, or −1."""
    side = np.diff(ring, axis=0)
    heading = np.arctan2(side[:, 1], side[:, 0])
    turn = (heading - np.roll(heading, 1) + np.pi) % (2 * np.pi) - np.pi
    fixed = np.unique(np.concatenate([ends.ravel(), along[:-1][np.abs(turn) > _CORNER]]))
    places, owner = [], []
    for start, end in zip(fixed, np.append(fixed[1:], fixed[0] + along[-1])):
        middle = (start + end) / 2 % along[-1]
        over = (middle - ends[:, 0]) % along[-1] < (ends[:, 1] - ends[:, 0]) % along[-1]
        parts = max(_UNDER if over.any() else 1, round((end - start) / (_SIDE * spacing)))
        places.append((start + (end - start) * np.arange(parts) / parts) % along[-1])
        owner += [int(np.argmax(over)) if over.any() else -1] * parts
    return np.concatenate(places), np.array(owner)


def _inside(rim: np.ndarray, spacing: float) -> Float[np.ndarray, "n 2"]:
    """Lays a lattice of equal triangles over the inside."""
    low, high = rim.min(0), rim.max(0)
    rows = np.arange(low[1], high[1], spacing * np.sqrt(3) / 2)
    x = np.arange(low[0], high[0] + spacing, spacing)
    lattice = np.stack(np.meshgrid(x, rows), -1)
    lattice[1::2, :, 0] -= spacing / 2
    lattice = lattice.reshape(-1, 2)
    distance = np.asarray(PolygonEdge(rim).distance(jnp.asarray(lattice)))
    return lattice[distance < -_APART * spacing]
