"""Solves a sheet on its mesh on the host, block by block: nothing to compile.

The tables of `make_field` are host code. `tomojax.kernels.sheet.fem_fields` computes the
same where a program is compiled or differentiated.
"""

import numpy as np
from jaxtyping import Float

from tomojax.kernels.sheet import block_shape, FemSheet, triangles


class MeshSolve:
    """The factor of a sheet, and the potentials of its electrodes, dipoles answered.

    A block is a line of the mesh, which neighbours two others. With A = LLᵀ the blocks of
    L are L_i L_iᵀ = D_i − C_{i−1}C_{i−1}ᵀ and C_i = E_i L_i⁻ᵀ.
    """

    def __init__(self, fem: FemSheet, mesh: tuple[int, int]):
        self._pinned, (count, b) = int(fem.pinned), block_shape(mesh)
        vertices = triangles(mesh)
        row, column = vertices.repeat(3, 1).ravel(), np.tile(vertices, 3).ravel()
        # No current at an even potential: float32 has rounded each entry by itself.
        local = np.asarray(fem.local, float)
        local = (local - local.sum(2, keepdims=True) * np.eye(3)).ravel()
        free = (row != self._pinned) & (column != self._pinned)
        own, below = np.zeros((count, b, b)), np.zeros((count, b, b))
        for blocks, apart in ((own, 0), (below, 1)):
            some = free & (row // b == column // b + apart)
            at = column[some] // b, row[some] % b, column[some] % b
            np.add.at(blocks, at, local[some])
        own[self._pinned // b, self._pinned % b, self._pinned % b] = own.max()
        self._inverses, self._links = np.zeros_like(own), below
        left = np.zeros((b, b))
        for i in range(count):
            self._inverses[i] = np.linalg.inv(np.linalg.cholesky(own[i] - left))
            self._links[i] = below[i] @ self._inverses[i].T
            left = self._links[i] @ self._links[i].T
        feeds, dipoles = np.asarray(fem.feeds, float), np.asarray(fem.dipoles, float)
        of_feeds, of_dipoles = self.potentials(feeds), self.potentials(dipoles)
        own = dipoles.T @ of_dipoles + np.diag(np.asarray(fem.dipole_series, float))
        answer = np.linalg.inv(np.linalg.cholesky((own + own.T) / 2))
        self._dipoles = answer @ dipoles.T
        self._at_nodes = of_feeds.T - (self._dipoles @ of_feeds).T @ answer @ of_dipoles.T
        table = self._at_nodes @ feeds
        self._table = (table + table.T) / 2 + np.diag(np.asarray(fem.series, float))

    def potentials(
        self, loads: Float[np.ndarray, "nodes c"]
    ) -> Float[np.ndarray, "nodes c"]:
        """Computes potentials of currents into nodes, V; the pinned node has 0."""
        found = loads.copy()
        found[self._pinned] = 0
        lines, last = found.reshape(*self._inverses.shape[:2], -1), len(self._inverses) - 1
        for i in range(last + 1):
            before = self._links[i - 1] @ lines[i - 1] if i else 0
            lines[i] = self._inverses[i] @ (lines[i] - before)
        for i in range(last, -1, -1):
            after = self._links[i].T @ lines[i + 1] if i < last else 0
            lines[i] = self._inverses[i].T @ (lines[i] - after)
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
