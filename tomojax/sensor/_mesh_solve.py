"""Solves a sheet on its mesh on the host: one sparse factor, and nothing to compile.

The tables of `make_field` are host code. `tomojax.kernels.sheet.fem_fields` computes the
same where a program is compiled or differentiated.
"""

import numpy as np
from jaxtyping import Float

from tomojax.kernels.sheet import FemSheet, triangles


class MeshSolve:
    """The factor of a sheet, and the potentials of its electrodes, dipoles answered."""

    def __init__(self, fem: FemSheet, mesh: tuple[int, int]):
        from scipy.linalg import solve_triangular
        from scipy.sparse import coo_array
        from scipy.sparse.linalg import splu

        feeds, dipoles = np.asarray(fem.feeds, float), np.asarray(fem.dipoles, float)
        vertices, n = triangles(mesh), len(feeds)
        entries = vertices.repeat(3, 1).ravel(), np.tile(vertices, 3).ravel()
        # No current at an even potential: float32 has rounded each entry by itself.
        local = np.asarray(fem.local, float)
        local = local - local.sum(2, keepdims=True) * np.eye(3)
        stiffness = coo_array((local.ravel(), entries), shape=(n, n)).tocsc()
        self._free = np.delete(np.arange(n), int(fem.pinned))
        self._factor = splu(
            stiffness[self._free][:, self._free],
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        of_feeds, of_dipoles = self.potentials(feeds), self.potentials(dipoles)
        own = dipoles.T @ of_dipoles + np.diag(np.asarray(fem.dipole_series, float))
        root = np.linalg.cholesky((own + own.T) / 2)
        self._dipoles = solve_triangular(root, dipoles.T, lower=True)
        shunt = self._dipoles @ of_feeds
        answers = solve_triangular(root, of_dipoles.T, lower=True)
        self._at_nodes = of_feeds.T - shunt.T @ answers
        table = self._at_nodes @ feeds
        self._table = (table + table.T) / 2 + np.diag(np.asarray(fem.series, float))

    def potentials(
        self, loads: Float[np.ndarray, "nodes c"]
    ) -> Float[np.ndarray, "nodes c"]:
        """Computes potentials of currents into nodes, V; the pinned node has 0."""
        found = np.zeros(loads.shape)
        found[self._free] = self._factor.solve(np.ascontiguousarray(loads[self._free]))
        return found

    def fields(self) -> tuple[Float[np.ndarray, "M M"], Float[np.ndarray, "M nodes"]]:
        """Computes R_ee' and R_e at the nodes, Ω, centred."""
        return centred(self._table, self._at_nodes)

    def between(self, loads: Float[np.ndarray, "nodes c"]) -> Float[np.ndarray, "c c"]:
        """Computes R_cc' of groups of nodes, Ω, centred as the electrodes' table is."""
        found = self.potentials(loads)
        answers = self._dipoles @ found
        own = loads.T @ found - answers.T @ answers
        column = (self._at_nodes @ loads).mean(0)
        return (own + own.T) / 2 - column[:, None] - column + self._table.mean()


def centred(
    ee: Float[np.ndarray, "M M"], rows: Float[np.ndarray, "M ..."]
) -> tuple[Float[np.ndarray, "M M"], Float[np.ndarray, "M ..."]]:
    """Shifts both so that the mean potential of the electrodes is zero."""
    mean, each = ee.mean(), ee.mean(1)
    rows = rows - each.reshape(-1, *(1,) * (rows.ndim - 1)) - rows.mean(0) + mean
    return ee - each[:, None] - each + mean, rows
