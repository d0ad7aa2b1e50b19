"""A skin by scikit-fem: quadratic elements, complete electrode model.

∇·(σ∇u) = 0. A rim electrode carries ∫(U − u)/z over its arc, an electrode inside the sheet
the same over its disc, and the sheet goes on below the disc.
"""

import numpy as np
import skfem
from scipy import sparse
from scipy.sparse.linalg import splu
from skfem.helpers import dot, grad


class Skin:
    """Voltages of pairs on a disc of radius `across`/2 about (0, 0), or on a square.

    `inner` (n, 2): middles of disc electrodes inside, m, of `diameter`. A disc has `rim`
    electrodes on half of its rim, the first at angle 0, anticlockwise.
    """

    def __init__(
        self, across, rim=0, inner=(), diameter=0.005, round=True, fine=5, resist=100.0
    ):
        if round:
            mesh = skfem.MeshTri.init_circle(fine, smoothed=True).scaled(across / 2)
        else:
            line = np.linspace(0, across, 2 ** (fine + 1) + 1)
            mesh = skfem.MeshTri.init_tensor(line, line)
        inner = np.reshape(inner, (-1, 2))
        for far in (0.9,) if len(inner) else ():  # diameters
            middle = mesh.p[:, mesh.t].mean(1).T
            away = np.linalg.norm(middle[:, None] - inner, axis=-1).min(1)
            mesh = mesh.refined(np.flatnonzero(away < far * diameter))
        self.basis = skfem.Basis(mesh, skfem.ElementTriP2(), intorder=4)
        self.cell = float(
            np.sqrt(np.abs(mesh.p[:, mesh.t[0]] - mesh.p[:, mesh.t[1]]) ** 2).max()
        )
        self.xy = np.empty((0, 2))
        parts = []
        if rim:
            z = resist * np.pi * across / 2 / rim
            sides = mesh.boundary_facets()
            middle = mesh.p[:, mesh.facets[:, sides]].mean(1)
            turn = np.arctan2(middle[1], middle[0]) / (2 * np.pi) * rim
            for e in range(rim):
                apart = (turn - e + rim / 2) % rim - rim / 2
                basis = skfem.FacetBasis(
                    mesh, skfem.ElementTriP2(), facets=sides[abs(apart) < 0.25], intorder=4
                )
                parts.append(contact(basis, self.basis.N, lambda x: 1 + 0 * x[0], z))
            turn = 2 * np.pi * np.arange(rim) / rim
            self.xy = across / 2 * np.stack([np.cos(turn), np.sin(turn)], 1)
        for place in inner:
            z = resist * diameter**2 / 4
            parts.append(
                contact(
                    self.basis,
                    self.basis.N,
                    lambda x, p=place: disc(x, p, diameter / 2, self.cell),
                    z,
                )
            )
        if len(inner):
            self.xy = np.concatenate([self.xy, inner])
        # Matrix of (u, U): ∫σ∇u·∇v + Σ ∫(u − U)(v − V)/z, grounded through 1 S.
        own = sum(one[0] for one in parts)
        column = np.stack([one[1] for one in parts], 1)
        total = np.array([one[2] for one in parts])
        ground = np.zeros((len(parts), len(parts)))
        ground[0, 0] = total[0]
        self.contacts = sparse.bmat(
            [[own, -sparse.csr_matrix(column)], [-column.T, np.diag(total) + ground]]
        ).tocsc()

    def table(self, sheet):
        """Transfer resistances, Ω, of S per square `sheet`(x), up to constants."""

        @skfem.BilinearForm
        def laplace(u, v, w):
            return sheet(w.x) * dot(grad(u), grad(v))

        inside = laplace.assemble(self.basis).tocsc()
        inside.resize(self.contacts.shape)
        m = len(self.xy)
        currents = np.zeros((self.contacts.shape[0], m))
        currents[-m:] = np.eye(m) - 1 / m
        factor = splu(
            (inside + self.contacts).tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        return factor.solve(currents)[-m:]

    def voltages(self, pairs, sheet):
        """Voltages of pairs, V per A, (C, R)."""
        table = self.table(sheet)
        drive = table[:, pairs.inject[:, 0]] - table[:, pairs.inject[:, 1]]
        each = np.arange(pairs.conditions)[:, None]
        return drive[pairs.read[..., 0], each] - drive[pairs.read[..., 1], each]


def disc(x, place, radius, cell):
    """1 within a radius of the place, 0 beyond, over a width of a cell."""
    away = np.hypot(x[0] - place[0], x[1] - place[1])
    return np.clip((radius - away) / cell + 0.5, 0, 1)


def contact(basis, size, part, z):
    """∫uv/z, ∫u/z and ∫1/z over an electrode, for z that resists `z` times a square."""

    @skfem.BilinearForm
    def both(u, v, w):
        return part(w.x) * u * v / z

    @skfem.LinearForm
    def one(v, w):
        return part(w.x) * v / z

    @skfem.Functional
    def all_of(w):
        return part(w.x) / z

    return both.assemble(basis), one.assemble(basis), all_of.assemble(basis)
