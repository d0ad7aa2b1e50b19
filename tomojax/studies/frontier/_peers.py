"""What a lab would write without this package, measured beside it: pyEIT, scikit-fem.

J of the paper's Eq. 1 by scikit-fem (P1 elements on the paper's 4 mm mesh, electrodes as
single nodes) and SciPy's LU; φ of Eq. 3 as one product with a matrix that is computed
once for a ground set: by NumPy, and by pyEIT's JAC solver with the same J. λ is the one of
six that puts single contacts nearest to where they are: the peers' is chosen in hindsight.
"""

import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse.linalg as spla

from tomojax.kernels.images import Contacts, read_contacts
from tomojax.kernels.sheet import nodes as mesh_nodes, triangles
from tomojax.methods import Rows
from tomojax.sensor import Sensor
from tomojax.studies.frontier._measure import grounds_of, Job, repeated, timing
from tomojax.studies.frontier._scenes import KINDS, score, Trials

_CELLS, _CONTACTS = 40, 3
_RELATIVE = tuple(10.0 ** np.arange(-6, 0))


def paper_jacobian(sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """J(0) (M grounds, M, K) by scikit-fem, and the loops' resistance (M, K).

    J^l_ik = (R_ik − R_lk − R_il + R_ll + z) / (R_kk + R_ll − 2R_lk + z).
    """
    import skfem
    from skfem.models.poisson import laplace

    shape = (_CELLS, _CELLS)
    points = np.asarray(mesh_nodes(shape, sensor.size), float)
    corners = triangles(shape)
    mesh = skfem.MeshTri(points.T.copy(), corners.T.copy(), sort_t=False)
    stiffness = laplace.assemble(skfem.Basis(mesh, skfem.ElementTriP1())).tocsc()
    stiffness = stiffness / float(sensor.sheet_resistance)
    places = np.asarray(sensor.electrode_xy, float)
    at = ((points[:, None] - places) ** 2).sum(-1).argmin(0)
    lu = spla.splu(stiffness[1:, 1:])  # pyright: ignore
    potentials = np.zeros((len(points),) * 2)
    potentials[1:, 1:] = lu.solve(np.eye(len(points) - 1))
    of_elements = potentials[:, corners].mean(-1)
    own = of_elements[corners].mean(1).diagonal()
    ee, ek, z = potentials[np.ix_(at, at)], of_elements[at], float(sensor.ground_resistance)
    loops = own + ee.diagonal()[:, None] - 2 * ek + z
    offset = (ee.diagonal() + z)[:, None] - ee
    return (ek[None] - ek[:, None] + offset[:, :, None]) / loops[:, None], loops


def peer_rows(job: Job, sensor: Sensor, trials: Trials) -> Iterator[dict[str, Any]]:
    """Rows of both peers for each pattern; contacts are read off their images as `linear`
    reads its own, which is not in their time."""
    jac, loops = paper_jacobian(sensor)
    for name in job.patterns:
        grounds = grounds_of(sensor, name, trials.volts)
        volts = np.take_along_axis(trials.volts, grounds[..., None], 1).astype(float)
        volts = volts.reshape(len(volts), -1)
        fixed = bool((grounds == grounds[0]).all())
        for peer, prepare in (("scikit-fem + NumPy", _numpy), ("pyEIT", _pyeit(sensor))):
            if peer == "pyEIT" and not fixed:
                continue  # seconds for each new ground set
            found = {}
            for relative in _RELATIVE:
                images = np.empty((len(volts), jac.shape[-1]))
                for own in np.unique(grounds, axis=0):
                    rows = jac[own].reshape(-1, jac.shape[-1])
                    solve = prepare(rows, relative)
                    same = (grounds == own).all(1)
                    images[same] = solve(volts[same])
                rows = _read(images, loops[grounds].mean(1), sensor)
                found[relative] = _scores(rows, trials, sensor)

            def error(relative: float, found=found) -> float:
                value = found[relative]["one"]["place_median_mm"]
                return np.inf if value is None else value

            best = min(_RELATIVE, key=error)
            begin = time.perf_counter()
            solve = prepare(jac[grounds[0]].reshape(-1, jac.shape[-1]), best)
            ready = 1e3 * (time.perf_counter() - begin)
            for batch in job.batches:
                frames = np.resize(volts, (batch, volts.shape[1]))
                times = timing(*repeated(lambda s=solve, f=frames: s(f)), batch)
                for kind in KINDS:
                    yield {
                        "scene": kind,
                        "method": peer,
                        "peer": True,
                        "pattern": name,
                        "slots": grounds.shape[1],
                        "lam_rule": "best in hindsight",
                        "lam": best,
                        "pixels": _CELLS,
                        "elements": 2 * _CELLS**2,
                        "output": "image",
                        "prepare_ms": ready,
                        **times,
                        **found[best][kind],
                        "dtype": "float64",
                        "device": "cpu",
                    }


def _numpy(rows: np.ndarray, relative: float) -> Callable[[np.ndarray], np.ndarray]:
    """Eq. 3 in the form that is smaller: Jᵀ(JJᵀ + λI)⁻¹."""
    gram = rows @ rows.T
    lam = relative * _largest(gram)
    operator = np.linalg.solve(gram + lam * np.eye(len(gram)), rows)
    return lambda volts: volts @ operator


def _largest(gram: np.ndarray) -> float:
    """Its largest eigenvalue."""
    start = np.ones(len(gram))
    found: Any = spla.eigsh(gram, 1, v0=start, return_eigenvectors=False)
    return float(found[0])


def _pyeit(sensor: Sensor) -> Callable[..., Callable[[np.ndarray], np.ndarray]]:
    from pyeit.eit.jac import JAC
    from pyeit.eit.protocol import PyEITProtocol
    from pyeit.mesh import PyEITMesh

    shape = (_CELLS, _CELLS)
    points = np.asarray(mesh_nodes(shape, sensor.size), float)
    corners = np.asarray(triangles(shape))
    a, b, c = np.moveaxis(points[corners], 1, 0)
    turned = np.linalg.det(np.stack([b - a, c - a], 1)) < 0
    corners = np.where(turned[:, None], corners[:, [0, 2, 1]], corners)
    places = np.asarray(sensor.electrode_xy, float)
    at = ((points[:, None] - places) ** 2).sum(-1).argmin(0)
    mesh = PyEITMesh(node=points, element=corners, perm=1e-4, el_pos=at)
    m = len(places)
    pair, reads = np.array([[1, 0]]), np.array([[[e, 0] for e in range(m)]])
    solver = JAC(mesh, PyEITProtocol(pair, reads, np.ones(m, bool)))
    solver.is_ready = True  # its own setup is of a conductivity's Jacobian

    def prepare(rows: np.ndarray, relative: float) -> Callable[[np.ndarray], np.ndarray]:
        # Its sign is of a conductivity's change. Its λ multiplies √diag(JᵀJ).
        zero, diagonal = np.zeros(len(rows)), np.sqrt((rows**2).sum(0)).mean()
        lam = relative * _largest(rows @ rows.T) / diagonal
        matrix = solver._compute_h(-rows, 0.5, lam, "kotre")

        def solve(volts: np.ndarray) -> np.ndarray:
            solver.H = matrix
            return solver.solve(volts, zero, normalize=False).T

        return solve

    return prepare


def _read(images: np.ndarray, loops: np.ndarray, sensor: Sensor) -> Rows:
    """Above half the maximum, as the paper reads its images."""
    n, shape = len(images), (_CELLS, _CELLS)
    cell = jnp.asarray(sensor.size / _CELLS, jnp.float32)

    @jax.jit
    def read(image: jax.Array, current: jax.Array) -> Contacts:
        return read_contacts(image, current, cell, _CONTACTS, 0.5, False)

    pixels = images.reshape(n, *shape, 2).mean(-1)
    currents = (images / loops).reshape(n, *shape, 2).mean(-1)
    both = (jnp.asarray(a, jnp.float32) for a in (pixels, currents))
    return Rows.of(
        jax.tree.map(np.asarray, jax.vmap(read)(*both)),
        residual=np.zeros(n),
        flags=np.zeros(n, np.uint32),
        rung=np.zeros(n, np.uint8),
        image=pixels,
    )


def _scores(rows: Rows, trials: Trials, sensor: Sensor) -> dict[str, dict]:
    found = {}
    for kind in KINDS:
        at = np.flatnonzero(trials.kind == kind)
        found[kind] = score(rows.take(at), trials.of(at), np.asarray(sensor.size))
    return found
