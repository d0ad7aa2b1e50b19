"""Independent answers to compare with: dense NumPy and scikit-fem, nothing of ours
but the mesh's numbering and the electrodes' feeds, which are inputs to the problem."""

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
import skfem
from skfem.helpers import dot, grad

import tomojax as tx
from tomojax.kernels import _mesh


def skfem_stiffness(sheet, shape, size):
    """Sparse P1 stiffness of a sheet (S per square and element)."""
    nodes = np.asarray(_mesh.nodes(shape, size), float)
    mesh = skfem.MeshTri(nodes.T.copy(), _mesh.triangles(shape).T.copy(), sort_t=False)
    basis = skfem.Basis(mesh, skfem.ElementTriP1())
    per_point = np.broadcast_to(np.asarray(sheet)[:, None], basis.dx.shape)

    @skfem.BilinearForm
    def form(u, v, w):
        return w["sheet"] * dot(grad(u), grad(v))

    return form.assemble(basis, sheet=per_point).tocsc()


def skfem_table(fem, shape):
    """Centred R_ee, R_ek, R_kk of a `FemSheet` by scikit-fem and a sparse LU."""
    k = skfem_stiffness(fem.sheet, shape, fem.size)
    feeds, series = np.asarray(fem.feeds, float), np.asarray(fem.series, float)
    loads = element_functionals(shape).T
    # Another gauge than ours: the first node at 0 V instead of the last.
    lu = spla.splu(k[1:, 1:])
    solve = lambda b: np.vstack([np.zeros(b.shape[1]), lu.solve(b[1:])])  # noqa: E731
    x, y = solve(feeds), solve(loads)
    ee = feeds.T @ x + np.diag(series)
    ek = feeds.T @ y
    kk = np.einsum("nk,nk->k", loads, y)
    row, column, mean = ee.mean(0), ek.mean(0), ee.mean()
    return (
        ee - row[:, None] - row + mean,
        ek - row[:, None] - column + mean,
        kk - 2 * column + mean,
    )


def element_functionals(shape):
    """b_k as the rows of a dense (K, nodes) matrix."""
    vertices = _mesh.triangles(shape)
    rows = np.zeros((len(vertices), vertices.max() + 1))
    rows[np.arange(len(vertices))[:, None], vertices] = 1 / 3
    return rows


def network_voltages(sensor: tx.Sensor, g, to_ground=None, ground=None):
    """Electrode voltages and element potentials of the whole network, one dense solve.

    Unknowns: every node's potential u, every electrode's potential v and current j
    into its ground. K u + Σ g b(bᵀu − V0) + P j = 0; v = Pᵀu − δ j; and for each
    electrode j = γ v, or v = z j at `ground` and j = 0 elsewhere.
    """
    from tomojax._forward import _fem

    fem, shape = _fem(sensor), sensor.divisions
    k = skfem_stiffness(fem.sheet, shape, fem.size).toarray()
    b, p = element_functionals(shape), np.asarray(fem.feeds)
    n, m = p.shape
    v0 = float(sensor.drive_voltage)
    z = np.broadcast_to(sensor.ground_resistance, m)
    matrix = np.zeros((n + 2 * m, n + 2 * m))
    matrix[:n, :n] = k + b.T @ (np.asarray(g)[:, None] * b)
    matrix[:n, n + m :] = p
    matrix[n : n + m, :n] = p.T
    matrix[n : n + m, n : n + m] = -np.eye(m)
    matrix[n : n + m, n + m :] = -np.diag(np.asarray(fem.series))
    for e in range(m):
        row = n + m + e
        if to_ground is not None:
            matrix[row, [n + e, row]] = to_ground[e], -1
        elif e == ground:
            matrix[row, [n + e, row]] = 1, -z[e]
        else:
            matrix[row, row] = 1
    rhs = np.zeros(n + 2 * m)
    rhs[:n] = b.T @ np.asarray(g) * v0
    solution = np.linalg.solve(matrix, rhs)
    return solution[n : n + m], b @ solution[:n]


def sparse_loaded_voltages(k, b, feeds, series, g, v0, z):
    """Exact voltages for all grounds with scikit-fem's matrix and one sparse LU.

    A = K + Σ g b bᵀ, S = PᵀA⁻¹P + δ: V_i^l = V0·(1 − S_il/(z + S_ll)) off the ground.
    """
    lu = spla.splu((k + b.T @ sp.diags(g) @ b).tocsc())
    s = feeds.T @ lu.solve(feeds)
    own = np.diag(s) + series
    v = v0 * (1 - s / (z + own)[:, None])
    np.fill_diagonal(v, v0 * z / (z + own))
    return v
