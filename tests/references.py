"""Independent answers to compare with: dense NumPy and scikit-fem, nothing of ours
but the mesh's numbering and the electrodes' feeds, which are inputs to the problem."""

import jax
import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
import skfem
from skfem.helpers import dot, grad

import tomojax as tx
from tomojax.kernels.sheet import nodes as mesh_nodes, triangles


def skfem_stiffness(sheet, shape, size):
    """Sparse P1 stiffness of a sheet (S per square and element)."""
    nodes = np.asarray(mesh_nodes(shape, size), float)
    mesh = skfem.MeshTri(nodes.T.copy(), triangles(shape).T.copy(), sort_t=False)
    basis = skfem.Basis(mesh, skfem.ElementTriP1())
    per_point = np.broadcast_to(np.asarray(sheet)[:, None], basis.dx.shape)

    @skfem.BilinearForm
    def form(u, v, w):
        return w["sheet"] * dot(grad(u), grad(v))

    return form.assemble(basis, sheet=per_point).tocsc()


def _conductance(sensor):
    return np.broadcast_to(1 / np.asarray(sensor.sheet_resistance), sensor.element_count)


def skfem_table(sensor, fem):
    """Centred R_ee, R_ek, R_kk of a `FemSheet` by scikit-fem and a sparse LU."""
    shape = sensor.divisions
    k = skfem_stiffness(_conductance(sensor), shape, sensor.size)
    feeds, dipoles = np.asarray(fem.feeds, float), np.asarray(fem.dipoles, float)
    loads = element_functionals(shape).T
    # Another gauge than ours: the first node at 0 V instead of the last.
    lu = spla.splu(k[1:, 1:])
    solve = lambda b: np.vstack([np.zeros(b.shape[1]), lu.solve(b[1:])])  # noqa: E731
    x, y = solve(feeds), solve(loads)
    ee = feeds.T @ x + np.diag(np.asarray(fem.series, float))
    ek = feeds.T @ y
    kk = np.einsum("nk,nk->k", loads, y)
    if dipoles.shape[1]:
        own = dipoles.T @ solve(dipoles) + np.diag(np.asarray(fem.dipole_series, float))
        at_feeds, at_loads = dipoles.T @ x, dipoles.T @ y
        ee = ee - at_feeds.T @ np.linalg.solve(own, at_feeds)
        ek = ek - at_feeds.T @ np.linalg.solve(own, at_loads)
        kk = kk - (at_loads * np.linalg.solve(own, at_loads)).sum(0)
    row, column, mean = ee.mean(0), ek.mean(0), ee.mean()
    return (
        ee - row[:, None] - row + mean,
        ek - row[:, None] - column + mean,
        kk - 2 * column + mean,
    )


def element_functionals(shape):
    """b_k as the rows of a dense (K, nodes) matrix."""
    vertices = triangles(shape)
    rows = np.zeros((len(vertices), vertices.max() + 1))
    rows[np.arange(len(vertices))[:, None], vertices] = 1 / 3
    return rows


def network_voltages(
    sensor: tx.Sensor,
    sites=None,
    to_ground=None,
    ground=None,
    element=None,
    injected=None,
):
    """Voltages of electrodes and of sites in the whole network, by one dense solve.

    Contact: `sites` (S on nodes, then on electrodes), or `element` = (k, g) through
    one resistor to an element's mean, or `injected` currents (A per element).
    Unknowns: potentials u of nodes and v of electrodes, currents i from the sheet into
    each electrode, dipoles d. K u + contact + P i + D d = 0; v = Pᵀu − δ i;
    Dᵀu = δ_d d; and i + c(V0 − v) is γ v, or v/z at `ground` and 0 elsewhere.
    """
    from tomojax.sensor import sheet_on_mesh

    fem, shape = jax.jit(sheet_on_mesh)(sensor), sensor.divisions
    k = skfem_stiffness(_conductance(sensor), shape, sensor.size).toarray()
    b, p, dipole = (
        element_functionals(shape),
        np.asarray(fem.feeds),
        np.asarray(fem.dipoles),
    )
    (n, m), d = p.shape, dipole.shape[1]
    v0 = float(sensor.drive_voltage)
    z = np.broadcast_to(sensor.ground_resistance, m)
    g = np.zeros(n + m) if sites is None else np.asarray(sites)
    contact, source = np.diag(g[:n]), v0 * g[:n]
    if element is not None:
        at, conductance = element
        contact = contact + conductance * np.outer(b[at], b[at])
        source = source + conductance * v0 * b[at]
    if injected is not None:
        source = source + b.T @ injected
    size = n + 2 * m + d
    u, v, i, dd = np.split(np.arange(size), [n, n + m, n + 2 * m])
    matrix, rhs = np.zeros((size, size)), np.zeros(size)
    matrix[np.ix_(u, u)] = k + contact
    matrix[np.ix_(u, i)], matrix[np.ix_(u, dd)] = p, dipole
    rhs[u] = source
    balance = slice(n + m, n + 2 * m)
    matrix[np.ix_(v, u)], matrix[np.ix_(v, v)] = p.T, -np.eye(m)
    matrix[np.ix_(v, i)] = -np.diag(np.asarray(fem.series))
    matrix[np.ix_(dd, u)] = dipole.T
    matrix[np.ix_(dd, dd)] = -np.diag(np.asarray(fem.dipole_series))
    into = np.eye(m)  # what flows into the metal leaves through its ground
    gamma = np.zeros(m) if to_ground is None else np.asarray(to_ground)
    matrix[balance, n + m : n + 2 * m] = into
    matrix[np.ix_(i, v)] = -np.diag(g[n:] + gamma)
    rhs[i] = -v0 * g[n:]
    if ground is not None:  # times z, so that z = 0 is allowed
        matrix[i[ground]] *= z[ground]
        matrix[i[ground], v[ground]] -= 1
        rhs[i[ground]] *= z[ground]
    # Siemens, ohms and Ω/m² in one matrix: refined in extended precision, so that what
    # is compared is our rounding and not this solve's.
    solution = np.linalg.solve(matrix, rhs)
    wide = matrix.astype(np.longdouble)
    for _ in range(3):
        left = np.asarray(rhs - wide @ solution.astype(np.longdouble), float)
        solution = solution + np.linalg.solve(matrix, left)
    return solution[v], solution[np.concatenate([u, v])]


def slot_map(table, grounds, ground_resistance):
    """T of slots with one electrode grounded through z."""
    from tomojax.kernels.sheet import Grounds

    return Grounds(table.electrodes, ground_resistance).maps(table.elements, grounds)


def ground_currents(contact, slots, grounds, drive_voltage):
    """The current through each ground: I^l = V0·p / [p(z + Q_ll) + f_l²], A."""
    p, f = contact.conductance, contact.shortfall[grounds]
    total = slots.resistance + contact.resistance[grounds, grounds]
    return drive_voltage * p / (p * total + f**2)


# SuperLU for symmetric matrices: pivots stay on the diagonal, its ordering is of A + Aᵀ.
SYMMETRIC = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "options": {"SymmetricMode": True},
}


def sparse_loaded_voltages(k, feeds, series, g, v0, z, symmetric=False):
    """Exact voltages for all grounds with scikit-fem's matrix and one sparse LU.

    A = K + diag(g), S = PᵀA⁻¹P + δ: V_i^l = V0·(1 − S_il/(z + S_ll)) off the ground.
    """
    lu = spla.splu((k + sp.diags(g)).tocsc(), **(SYMMETRIC if symmetric else {}))
    s = feeds.T @ lu.solve(feeds)
    own = np.diag(s) + series
    v = v0 * (1 - s / (z + own)[:, None])
    np.fill_diagonal(v, v0 * z / (z + own))
    return v


def counterclockwise(nodes: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Vertices in the order that pyEIT asks for."""
    a, b, c = np.moveaxis(nodes[vertices], 1, 0)
    turned = np.linalg.det(np.stack([b - a, c - a], 1)) < 0
    return np.where(turned[:, None], vertices[:, [0, 2, 1]], vertices)
