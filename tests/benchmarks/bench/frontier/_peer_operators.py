"""The peers: code that a user would write with NumPy, SciPy, scikit-fem and pyEIT.

One table of resistances comes from scikit-fem (P1 elements) and SciPy's LU. Each electrode
is the node at its place. A node of a mesh of spacing h acts like a disc of radius 0.2 h.
The logarithm of the two radii corrects the electrode's own resistance.

Three peers make images from voltages with that table. One is the paper's Eq. 3 by NumPy.
Another is pyEIT's JAC solver with the same Jacobian. The last is sLORETA by NumPy. Each
peer computes its operator once, in float64, for a ground set and λ. The operator is applied
in the frames' dtype.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse.linalg as spla
from jaxtyping import Float, Integer

from tomojax.sensor import Sensor

# Mesh cells along a side at least; a node's radius, of the mesh's spacing; pixels up to
# which pyEIT takes part, because it inverts a matrix of as many rows for each λ.
_FINE, _NODE = 64, 0.2
PYEIT_MOST = 2000

# What stands for a pixel: points of it, as parts of its side, that are averaged.
_POINTS = {"centre": (0.5,), "mean": (0.125, 0.375, 0.625, 0.875)}

Images = Callable[[Float[np.ndarray, "n SM"]], Float[np.ndarray, "n K"]]


class Table(NamedTuple):
    """Resistances between M electrodes and K pixels, ohms."""

    ee: Float[np.ndarray, "M M"]
    ek: Float[np.ndarray, "M K"]
    own: Float[np.ndarray, " K"]
    series: float  # z, of the ground path

    def transfer(self, slot: int) -> Float[np.ndarray, "M K"]:
        """Returns T^l_ik = R_ik − R_lk − R_il + R_ll + z, for the grounded l = `slot`."""
        offset = self.ee[slot, slot] + self.series - self.ee[:, [slot]]
        return self.ek - self.ek[slot] + offset


def peer_table(sensor: Sensor, pixels: int, stands: str = "centre") -> Table:
    """Returns the table of `pixels` by `pixels`, each by its "centre" or its "mean"."""
    import skfem
    from skfem.models.poisson import laplace

    size = np.asarray(sensor.size, float)
    places = np.asarray(sensor.electrode_xy, float)
    cells = pixels * -(-_FINE // pixels)
    sheet = float(np.mean(np.asarray(sensor.sheet_resistance)))
    lines = [np.linspace(0, side, cells + 1) for side in size]
    basis = skfem.Basis(skfem.MeshTri.init_tensor(*lines), skfem.ElementTriP1())
    stiffness = laplace.assemble(basis).tocsc() / sheet
    inside = _POINTS[stands]
    points = [pixel_places(pixels, size, (a, b)) for a in inside for b in inside]
    means: Any = sum(basis.probes(p.T.copy()) for p in points) / len(points)
    nodes: Any = basis.mesh.p
    feeds = np.zeros((len(places), nodes.shape[1]))
    at = ((nodes.T[:, None] - places) ** 2).sum(-1).argmin(0)
    feeds[np.arange(len(places)), at] = 1
    reads = np.concatenate([feeds, means.toarray()])
    lu = spla.splu(stiffness[1:, 1:])  # pyright: ignore
    potentials = np.zeros(reads.shape[::-1])
    potentials[1:] = lu.solve(reads.T[1:].copy())
    m = len(places)
    table = reads[:m] @ potentials
    radius = float(sensor.electrode_diameter) / 2
    spacing = float(np.sqrt(np.prod(size / cells)))
    node = sheet / (2 * np.pi) * np.log(_NODE * spacing / radius)
    return Table(
        table[:, :m] + node * np.eye(m),
        table[:, m:],
        (reads[m:].T * potentials[:, m:]).sum(0),
        float(sensor.ground_resistance),
    )


def pixel_places(
    pixels: int, size: Float[np.ndarray, "2"], inside: tuple[float, float] = (0.5, 0.5)
) -> Float[np.ndarray, "K 2"]:
    """Returns a point of each pixel, m; by default its centre."""
    axes = [side * (np.arange(pixels) + part) / pixels for side, part in zip(size, inside)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)


def paper_jacobian(
    table: Table,
) -> tuple[Float[np.ndarray, "M M K"], Float[np.ndarray, "M K"]]:
    """Returns J(0) of the paper's Eq. 1 for every ground, and the loops' resistance, ohms.

    J^l_ik = T^l_ik / (R_kk + R_ll − 2R_lk + z).
    """
    own = table.own + table.ee.diagonal()[:, None]
    # A pixel on a grounded disc has no loop of its own: its resistance stays above 0.
    loops = np.maximum(own - 2 * table.ek, 0) + table.series
    maps = np.stack([table.transfer(ground) for ground in range(len(table.ee))])
    return maps / loops[:, None], loops


class Peer(NamedTuple):
    """One way to images. `prepare(grounds, λ/σ₁², dtype)` gives the map from frames."""

    name: str
    products: int  # matrix products that a frame goes through
    stands: str  # what stands for a pixel
    prepare: Callable[[Integer[np.ndarray, " S"], float, str], Images]
    # Currents, A, from images under a ground set. They weigh the parts of one contact.
    currents: Callable[[np.ndarray, np.ndarray], np.ndarray]


def peers_of(sensor: Sensor, pixels: int) -> Iterator[list[Peer]]:
    """Yields all peers, each with both points that may stand for a pixel."""
    made = []
    for stands in _POINTS:
        table = peer_table(sensor, pixels, stands)
        jac, loops = paper_jacobian(table)

        def of_phi(images: np.ndarray, grounds: np.ndarray, loops=loops) -> np.ndarray:
            return images / loops[grounds].mean(0)

        def of_source(images: np.ndarray, grounds: np.ndarray) -> np.ndarray:
            return images

        some = [
            Peer("scikit-fem + NumPy", 1, stands, _equation_3(jac), of_phi),
            Peer("NumPy sLORETA", 1, stands, _sloreta(table, False), of_source),
            Peer("NumPy sLORETA", 2, stands, _sloreta(table, True), of_source),
        ]
        if pixels**2 <= PYEIT_MOST:
            some.append(Peer("pyEIT", 1, stands, _pyeit(sensor, jac), of_phi))
        made.append(some)
    yield from (list(variants) for variants in zip(*made))


def _applied(*operators: np.ndarray, dtype: str) -> Images:
    """Multiplies frames by one operator after the other."""
    cast = [np.ascontiguousarray(operator, dtype) for operator in operators]

    def images(frames: np.ndarray) -> np.ndarray:
        for operator in cast:
            frames = frames @ operator
        return frames

    return images


def _equation_3(jac: np.ndarray) -> Callable[..., Images]:
    """Solves Eq. 3 in the smaller form: Jᵀ(JJᵀ + λI)⁻¹ or (JᵀJ + λI)⁻¹Jᵀ."""

    def prepare(grounds: np.ndarray, relative: float, dtype: str) -> Images:
        rows = jac[grounds].reshape(-1, jac.shape[-1])
        wide = len(rows) <= rows.shape[1]
        gram = rows @ rows.T if wide else rows.T @ rows
        damped = gram + relative * _largest(gram) * np.eye(len(gram))
        operator = np.linalg.solve(damped, rows if wide else rows.T)
        return _applied(operator if wide else operator.T, dtype=dtype)

    return prepare


def _largest(gram: np.ndarray) -> float:
    """Returns the largest eigenvalue."""
    start = np.ones(len(gram))
    found: Any = spla.eigsh(gram, 1, v0=start, return_eigenvectors=False)
    return float(found[0])


def _sloreta(table: Table, two: bool) -> Callable[..., Images]:
    """Averages T^lᵀ(T^lT^lᵀ + λI)⁻¹ over the slots, scaled as sLORETA does.

    Each pixel's row is divided by the root of the resolution matrix's diagonal, and the
    whole is one matrix. If `two`, the roots are of the slots' mean. Two matrices, whose
    inner size is the table's rank M, then make the image. They need fewer multiplications
    from two slots on.
    """
    m = len(table.ee)

    def prepare(grounds: np.ndarray, relative: float, dtype: str) -> Images:
        operators, seen = [], []
        for ground in grounds:
            rows = table.transfer(int(ground))
            gram = rows @ rows.T
            damped = gram + relative * _largest(gram) * np.eye(m)
            operators.append(np.linalg.solve(damped, rows) / len(grounds))
            seen.append(len(grounds) * (operators[-1] * rows).sum(0))
        if not two:
            scaled = [o / np.sqrt(d) for o, d in zip(operators, seen)]
            return _applied(np.concatenate(scaled), dtype=dtype)
        # Rows of all T lie in the span of R's differences and of a constant.
        stack = np.concatenate([table.ek - table.ek.mean(0), np.ones_like(table.ek[:1])])
        _, s, span = np.linalg.svd(stack, full_matrices=False)
        span = span[s > 1e-10 * s[0]]
        first = np.concatenate(operators) @ span.T
        return _applied(first, span / np.sqrt(np.mean(seen, 0)), dtype=dtype)

    return prepare


def _pyeit(sensor: Sensor, jac: np.ndarray) -> Callable[..., Images]:
    """Runs pyEIT's JAC solver with our Jacobian; pyEIT's own mesh is not used."""
    from pyeit.eit.jac import JAC
    from pyeit.eit.protocol import PyEITProtocol
    from pyeit.mesh import PyEITMesh

    size = np.asarray(sensor.size, float)
    corners = np.array([[0, 0], [size[0], 0], size, [0, size[1]]])
    halves = np.array([[0, 1, 2], [0, 2, 3]])
    mesh = PyEITMesh(node=corners, element=halves, perm=1e-4, el_pos=np.arange(2))
    protocol = PyEITProtocol(np.array([[1, 0]]), np.array([[[1, 0]]]), np.ones(1, bool))
    solver = JAC(mesh, protocol)
    solver.is_ready = True  # its own setup is of a conductivity's Jacobian

    def prepare(grounds: np.ndarray, relative: float, dtype: str) -> Images:
        # Its sign is of a conductivity's change. Its λ multiplies √diag(JᵀJ).
        rows = jac[grounds].reshape(-1, jac.shape[-1])
        zero, diagonal = np.zeros(len(rows), dtype), np.sqrt((rows**2).sum(0)).mean()
        small = rows @ rows.T if len(rows) <= rows.shape[1] else rows.T @ rows
        lam = relative * _largest(small) / diagonal
        matrix = solver._compute_h(-rows, 0.5, lam, "kotre").astype(dtype)

        def images(frames: np.ndarray) -> np.ndarray:
            solver.H = matrix
            return solver.solve(frames, zero, normalize=False).T

        return images

    return prepare


def read_peak(images: np.ndarray, pixels: int, size: np.ndarray) -> np.ndarray:
    """Reads places (n, 2) of the highest pixels, refined along each axis by a parabola."""
    highest, frame = images.argmax(1), np.arange(len(images))
    places = np.empty((len(images), 2))
    for axis, (at, step) in enumerate(zip(np.divmod(highest, pixels), (pixels, 1))):
        inner = np.clip(at, 1, pixels - 2)  # at the edge, the parabola inside it
        middle = highest + (inner - at) * step
        low, high = (images[frame, middle + side * step] for side in (-1, 1))
        bend = low - 2 * images[frame, middle] + high
        shift = np.where(bend < 0, (low - high) / np.where(bend < 0, 2 * bend, 1), 0)
        places[:, axis] = (inner + np.clip(shift, -1.5, 1.5) + 0.5) / pixels
    return np.clip(places, 0, 1) * size


def read_half(images: np.ndarray, pixels: int, size: np.ndarray) -> np.ndarray:
    """Reads places (n, 2) of the mean above half the maximum, m: the paper's reading."""
    above = np.maximum(images - images.max(1, keepdims=True) / 2, 0)
    centres = pixel_places(pixels, size)
    weights = np.column_stack([centres, np.ones(len(centres))]).astype(images.dtype)
    sums = above @ weights
    return sums[:, :2] / np.maximum(sums[:, 2:], np.finfo(images.dtype).tiny)
