"""Computes voltages of a skin by P2 elements on an unstructured mesh.

-div(1/rho grad u) = g (V0 - u) on the sheet, insulated edges, metal discs as one unknown
each. The sheet is drawn in a chart; `surface` maps the chart into space, where stiffness,
areas and electrodes' discs are measured (contacts' discs are discs of the chart).
"""

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla
import shapely
import triangle
from scipy.spatial import cKDTree
from scipy.special import gamma
from shapely.geometry import MultiPolygon, Polygon

from bench.skins._interpolate import evaluate, p2

V0, Z = 4.5, 4.0


def _p2_tensor():
    """T[a,b,i,j] = mean over the triangle of dphi_i/dl_a dphi_j/dl_b."""
    q = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6  # degree 2, exact
    d = np.zeros((3, 3, 6))
    for n, (a, b, c) in enumerate(q):
        d[n, 0] = [4 * a - 1, 0, 0, 4 * b, 0, 4 * c]
        d[n, 1] = [0, 4 * b - 1, 0, 4 * a, 4 * c, 0]
        d[n, 2] = [0, 0, 4 * c - 1, 0, 4 * b, 4 * a]
    return np.einsum("nai,nbj->abij", d, d) / 3


_T = _p2_tensor()


def _sub(level):
    """Corners (4^level, 3, 3) of equal sub-triangles in barycentric coordinates."""
    w = np.eye(3)[None]
    for _ in range(level):
        m = (w + np.roll(w, -1, 1)) / 2
        w = np.concatenate(
            [m] + [np.stack([w[:, c], m[:, c], m[:, c - 1]], 1) for c in range(3)]
        )
    return w


_SUB = _sub(3)


def _below(level):
    """Part of triangles (…, 3) where a linear level is negative."""
    s = np.sort(level, -1)
    a, b, c = s[..., 0], s[..., 1], s[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        one = a * a / ((b - a) * (c - a))
        two = 1 - c * c / ((c - a) * (c - b))
    return np.where(c <= 0, 1, np.where(a >= 0, 0, np.where(b >= 0, one, two)))


def _disc_level(centre, radius):
    return lambda p: np.linalg.norm(p - centre, axis=-1) - radius


class Peer:
    def __init__(
        self,
        outline,
        holes=(),
        electrode_xy=(),
        diameter=0.005,
        rho=10e3,
        surface=None,
        z=Z,
        v0=V0,
        h=1.5e-3,
        rim=48,
        grow=0.25,
        points=(),
    ):
        """`rho`: a number or a function of chart points (n, 2); `rim`: sides of a disc;
        `h`: largest edge; `points`: chart points that the mesh is fine around (an apex)."""
        self.xy = np.asarray(electrode_xy, float)
        self.m, self.v0, self.surface = len(self.xy), v0, surface
        self.z = np.broadcast_to(np.asarray(z, float), (self.m,))
        self.a = diameter / 2
        self.rho = rho if callable(rho) else (lambda p: np.full(len(p), float(rho)))
        self.sheet = Polygon(outline, holes).buffer(0)
        self._mesh(h, rim, grow, points)
        self._assemble()

    # -- mesh ------------------------------------------------------------------------------
    def _to_space(self, p):
        return p if self.surface is None else np.asarray(self.surface(p), float)

    def _disc(self, centre, rim):
        # The polygon whose logarithmic capacity is that of the disc.
        side = (
            self.a
            * 2 ** (1 + 2 / rim)
            * np.sqrt(np.pi)
            * gamma(0.5 + 1 / rim)
            / gamma(1 / rim)
        )
        a = side / (2 * np.sin(np.pi / rim))
        t = 2 * np.pi * (np.arange(rim) + 0.5) / rim
        ray = np.stack([np.cos(t), np.sin(t)], -1)
        if self.surface is None:
            return Polygon(centre + a * ray)
        # Sides of equal length in space, not of equal angles in the chart.
        x0 = self._to_space(centre[None])[0]
        t = 2 * np.pi * np.arange(64 * rim) / (64 * rim)
        ray = np.stack([np.cos(t), np.sin(t)], -1)
        lo, hi = np.zeros(64 * rim), np.full(64 * rim, 5 * a)
        for _ in range(50):
            mid = (lo + hi) / 2
            d = np.linalg.norm(self._to_space(centre + mid[:, None] * ray) - x0, axis=1)
            lo, hi = np.where(d < a, mid, lo), np.where(d < a, hi, mid)
        at = centre + lo[:, None] * ray
        x = self._to_space(at)
        along = np.append(0, np.cumsum(np.linalg.norm(np.roll(x, -1, 0) - x, axis=1)))
        some = np.searchsorted(along, along[-1] * (np.arange(rim) + 0.5) / rim)
        return Polygon(at[np.minimum(some, 64 * rim - 1)])

    def _mesh(self, h, rim, grow, points):
        whole = [self._disc(c, rim) for c in self.xy]
        self.metal = [d.intersection(self.sheet) for d in whole]
        lines = [self.sheet.boundary] + [d.boundary for d in whole]
        # Snap-rounded: vertices on a line are vertices of it, no slivers.
        noded = shapely.unary_union(lines, grid_size=1e-8)
        seg = []
        inside = self.sheet.buffer(1e-7)
        for ln in shapely.get_parts(noded):
            c = np.asarray(ln.coords)
            if not inside.contains(ln):  # the part of a disc that is off the sheet
                continue
            seg.append(np.stack([c[:-1], c[1:]], 1))
        seg = np.concatenate(seg)
        flat = np.round(seg.reshape(-1, 2), 9)
        vert, inv = np.unique(flat, axis=0, return_inverse=True)
        seg = inv.reshape(-1, 2)
        seg = np.unique(np.sort(seg[seg[:, 0] != seg[:, 1]], 1), axis=0)
        pslg = dict(vertices=vert * 1e3, segments=seg)  # mm
        polys = self.sheet.geoms if isinstance(self.sheet, MultiPolygon) else [self.sheet]
        hol = [
            Polygon(r).representative_point().coords[0] for p in polys for r in p.interiors
        ]
        if hol:
            pslg["holes"] = np.array(hol) * 1e3
        mesh = triangle.triangulate(pslg, "pq30a%.4f" % (0.45 * (1e3 * h) ** 2))
        # Fine around rims, re-entrant corners and the points given.
        fine = [np.asarray(d.boundary.coords) for d in self.metal]
        fine = np.concatenate(fine) if fine else np.zeros((0, 2))
        side = 2 * np.pi * self.a / rim
        corner = []
        for p in polys:
            for k, r in enumerate([p.exterior, *p.interiors]):
                c = np.asarray(r.coords)[:-1]
                if (shapely.is_ccw(r)) == (k > 0):
                    c = c[::-1]
                e, f = c - np.roll(c, 1, 0), np.roll(c, -1, 0) - c
                turn = np.arctan2(e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0], (e * f).sum(1))
                corner.append(c[turn < -0.3])
        corner = np.concatenate(corner + [np.asarray(points, float).reshape(-1, 2)])
        for _ in range(3):
            c = mesh["vertices"][mesh["triangles"]].mean(1) * 1e-3
            want = np.full(len(c), h)
            if len(fine):
                want = np.minimum(want, 1.2 * side + grow * cKDTree(fine).query(c)[0])
            if len(corner):
                want = np.minimum(want, 0.05 * h + grow * cKDTree(corner).query(c)[0])
            mesh = triangle.triangulate(
                dict(
                    vertices=mesh["vertices"],
                    triangles=mesh["triangles"],
                    segments=mesh["segments"],
                    triangle_max_area=0.45 * (1e3 * want[:, None]) ** 2,
                    **({"holes": pslg["holes"]} if hol else {}),
                ),
                "prq30a",
            )
        v, t = mesh["vertices"] * 1e-3, mesh["triangles"]
        edges = np.sort(t[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1)
        uniq, inv = np.unique(edges, axis=0, return_inverse=True)
        self.nodes = np.concatenate([v, v[uniq].mean(1)])
        self.tri = np.concatenate([t, len(v) + inv.reshape(-1, 3)], 1)
        centre = v[t].mean(1)
        which = np.full(len(t), -1)
        tree = cKDTree(centre)
        for e, d in enumerate(self.metal):
            near = np.array(tree.query_ball_point(self.xy[e], 6 * self.a))
            which[near[shapely.contains_xy(d, *centre[near].T)]] = e
        self.which = which  # electrode of each triangle or -1
        assert np.isin(np.arange(self.m), which).all(), "an electrode without a triangle"

    # -- equations -------------------------------------------------------------------------
    def _assemble(self):
        n = len(self.nodes)
        dof = np.full(n, -1)
        for e in range(self.m):
            dof[self.tri[self.which == e]] = e
        used = np.zeros(n, bool)
        used[self.tri] = True
        free = (dof < 0) & used
        dof[free] = self.m + np.arange(free.sum())
        self.dof, self.size = dof, self.m + free.sum()
        corners = self._to_space(self.nodes[self.tri[:, :3]].reshape(-1, 2))
        corners = corners.reshape(len(self.tri), 3, -1)
        e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        dot = (e1 * e2).sum(-1)
        self.area = np.sqrt((e1**2).sum(-1) * (e2**2).sum(-1) - dot**2) / 2
        s = np.roll(corners, -1, 1) - np.roll(corners, 1, 1)
        prod = np.einsum("kid,kjd->kij", s, s) / (4 * self.area[:, None, None])
        sigma = 1 / self.rho(self.nodes[self.tri[:, :3]].mean(1))
        on = self.which < 0
        local = sigma[on, None, None] * np.einsum("kab,abij->kij", prod[on], _T)
        self.stiff = self._sum(local, dof[self.tri[on]])

    def _sum(self, local, at):
        i, j = np.broadcast_arrays(at[:, :, None], at[:, None, :])
        return sp.csc_matrix((local.ravel(), (i.ravel(), j.ravel())), (self.size,) * 2)

    @staticmethod
    def _factor(a):
        return sla.splu(
            a.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options=dict(SymmetricMode=True),
        )

    def _fields(self):
        """Potentials (dofs, M), dof of electrode 0 held at 0, per ampere entering e."""
        if not hasattr(self, "_f"):
            lu = self._factor(self.stiff[1:, 1:])
            rhs = np.zeros((self.size - 1, self.m))
            rhs[np.arange(self.m - 1), np.arange(1, self.m)] = 1
            self._f = np.concatenate([np.zeros((1, self.m)), lu.solve(rhs)])
        return self._f

    def _centred(self):
        f = self._fields()
        f = f - f.mean(1, keepdims=True)  # the ampere leaves evenly through all
        return f - f[: self.m].mean(0)  # minus the mean over electrodes

    def r_ee(self):
        """P[i, j]: V between i and j per A from i to j."""
        g = self._fields()[: self.m]
        d = np.diag(g)
        return d[:, None] + d - g - g.T

    def potential(self, points):
        """R_e(x), (M, n)."""
        return evaluate(self.nodes, self.tri, self.nodal(), np.asarray(points, float))

    def nodal(self):
        """R_e at the nodes (N, M)."""
        return self._centred()[np.maximum(self.dof, 0)]

    def contact(self, contacts):
        """Matrix of contacts: (x, y, radius, siemens of a whole flat disc of the chart), or
        (level, siemens per area): a function of chart points, negative where it touches."""
        total = sp.csc_matrix((self.size,) * 2)
        corner = self.nodes[self.tri[:, :3]]
        phi = p2(_SUB.mean(1))
        for one in contacts:
            if callable(one[0]):
                level, per_area = one
            else:
                x, y, r, siemens = one
                level = _disc_level((x, y), r)
                per_area = siemens / (np.pi * r * r)
            mid = corner.mean(1)
            reach = np.linalg.norm(corner - mid[:, None], axis=-1).max(1)
            near = np.flatnonzero(level(mid) < reach)
            w = np.einsum("qcb,kbd->kqcd", _SUB, corner[near])
            part = _below(level(w.reshape(-1, 2)).reshape(w.shape[:-1]))
            g = part * self.area[near, None] / len(_SUB) * per_area
            local = np.einsum("kq,qi,qj->kij", g, phi, phi)
            total = total + self._sum(local, self.dof[self.tri[near]])
        return total

    def voltages(self, discs, grounds):
        """(S, M) V: slot s grounds electrode grounds[s] through z."""
        grounds = np.asarray(grounds, int)
        lu = self._factor(self.stiff + self.contact(discs))
        rhs = np.zeros((self.size, len(grounds)))
        rhs[grounds, np.arange(len(grounds))] = 1
        g = lu.solve(rhs)[: self.m]  # (M, S)
        own = g[grounds, np.arange(len(grounds))]
        return self.v0 * (1 - g / (self.z[grounds] + own)).T


def draw_errors(seed, m, size, rho=10e3, waves=5):
    """Errors of a simulated rig: a dict.

    rho: function of chart points, 3 % rms over the box of `size`, of `waves` random cosines
    of half wave-lengths from the box's longer side down to a third of it; gains: 0.1 % rms
    (M,); move: (M, 2) m, 0.2 mm rms in all; z: 3 to 5 ohm (M,); noise(volts) adds 0.45 mV
    rms and rounds to codes of 0.15 mV.
    """
    r = np.random.default_rng(seed)
    side = float(np.max(size))
    k = np.pi / side * r.uniform(1, 3, waves)
    t, phase, amp = (
        r.uniform(0, 2 * np.pi, waves),
        r.uniform(0, 2 * np.pi, waves),
        r.normal(size=waves),
    )
    k = k[:, None] * np.stack([np.cos(t), np.sin(t)], -1)
    raw = lambda p: np.cos(p @ k.T + phase) @ amp  # noqa: E731
    grid = np.stack(np.meshgrid(*[np.linspace(0, s, 60) for s in size]), -1).reshape(-1, 2)
    mean, std = raw(grid).mean(), raw(grid).std()
    rng = np.random.default_rng(seed + 10**6)
    return dict(
        rho=lambda p: rho * (1 + 0.03 * (raw(p) - mean) / std),
        gains=1 + 1e-3 * r.normal(size=m),
        move=0.2e-3 / np.sqrt(2) * r.normal(size=(m, 2)),
        z=4 + r.uniform(-1, 1, m),
        noise=lambda v: (
            0.15e-3 * np.round((v + 0.45e-3 * rng.normal(size=np.shape(v))) / 0.15e-3)
        ),
    )
