"""A rig in triangles: a second model of a rig, which shares no code with `Network`.

Linear elements lie on an unstructured mesh that resolves the rim of each electrode's face.
A contact is a cloud of points, so that the mesh is made only once for a rig.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from jaxtyping import Float, Integer
from scipy.spatial import Delaunay, KDTree

from bench.rigs._rig import Rig
from bench.rigs._shapes import Touch
from bench.rigs._strokes import Strokes

# Nodes on a rim; the lattice's spacing, of the pitch; its growth away from a rim.
_RIM, _LATTICE, _GROWTH = 36, 1 / 16, 0.2

# Points of a contact, and of a larger one, for each square of a pitch.
_CLOUD, _EACH = 1000, 900

# Nodes closer than this, of the spacing there, are too close.
_CLOSE = 0.6

Grounds = Integer[np.ndarray, " S"]


class Elements:
    """The exact voltages of a rig by linear finite elements.

    **Arguments:** `fine`: how many times finer the mesh is than by default.
    """

    def __init__(self, rig: Rig, fine: float | int = 1.0):
        self.rig, self.drive = rig, float(rig.sensor.drive_voltage)
        self.points, self._face = _nodes(rig, fine)
        self._mesh = Delaunay(self.points)
        corners = self.points[self._mesh.simplices]
        edges = np.roll(corners, -1, 1) - np.roll(corners, 1, 1)  # opposite each corner
        area = abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) / 2
        longest = (edges**2).sum(2).max(1)
        # Three nodes on the border span a triangle of rounding errors.
        sound = area > 1e-6 * longest
        self.triangles = self._mesh.simplices[sound]
        edges, area = edges[sound], area[sound]
        sheet = rig.sheet(corners[sound].mean(1))
        products = np.einsum("tic,tjc->tij", edges, edges)
        local = products / (4 * area * sheet)[:, None, None]
        m = self.electrodes = len(rig.place)
        # The first m unknowns are the electrodes'. A face without a resistance is its
        # electrode's unknown; the other nodes are unknowns of their own.
        merged = (self._face >= 0) & (rig.contact[self._face] == 0)
        own = np.cumsum(~merged) - 1
        self._unknown = np.where(merged, self._face, m + own)
        self.count = m + int((~merged).sum())
        at = self._unknown[self.triangles]
        rows, columns = np.repeat(at, 3, 1), np.tile(at, (1, 3))
        shape = (self.count, self.count)
        stiffness = (local.ravel(), (rows.ravel(), columns.ravel()))
        self.stiffness = sp.csc_array(stiffness, shape) + self._joined_faces(area)

    def _joined_faces(self, area: np.ndarray) -> sp.csc_array:
        """Returns conductances between electrodes and faces with a contact resistance."""
        face = self._face[self.triangles]
        within = (face == face[:, :1]).all(1) & (face[:, 0] >= 0)
        lumped = np.zeros(len(self.points))
        np.add.at(lumped, self.triangles[within], area[within, None] / 3)
        nodes = np.flatnonzero((lumped > 0) & (self.rig.contact[self._face] > 0))
        e = self._face[nodes]
        total = np.bincount(e, lumped[nodes], self.electrodes)
        share = lumped[nodes] / (total[e] * self.rig.contact[e])
        return _links(self._unknown[nodes], e, share, self.count)

    def touched(self, touch: Touch | Strokes, grounds: Grounds) -> Float[np.ndarray, "S M"]:
        """Returns exact voltages, V, under some grounds."""
        return self.scene([touch], grounds)

    def scene(
        self, touches: Sequence[Touch | Strokes], grounds: Grounds
    ) -> Float[np.ndarray, "S M"]:
        """Returns exact voltages, V, of several contacts at once under some grounds."""
        spread = [self._spread(touch) for touch in touches]
        if all(touch.exponent == 1 for touch in touches):
            return self._linear(touches, spread, grounds)
        return self._nonlinear(touches, spread, grounds)

    def _spread(self, touch: Touch | Strokes) -> tuple[np.ndarray, np.ndarray]:
        """Returns the unknowns that a contact feeds, and each one's conductance, S."""
        pitches = np.pi * np.prod(touch.half_axes) / self.rig.sensor.mean_pitch**2
        count = max(_CLOUD, int(_EACH * pitches))
        i = np.arange(count) + 0.5
        radius, turn = np.sqrt(i / count), i * np.pi * (3 - np.sqrt(5))
        round_ = np.stack([radius * np.cos(turn), radius * np.sin(turn)], 1)
        c, s = np.cos(touch.angle), np.sin(touch.angle)
        cloud = touch.xy + round_ * touch.half_axes @ np.array([[c, s], [-s, c]])
        found = self._mesh.find_simplex(cloud)
        cloud, found = cloud[found >= 0], found[found >= 0]
        weights = touch.density(cloud)
        if not weights.sum() > 0:
            raise ValueError(f"xy: got {touch.xy}, expected a contact on the sheet")
        frame = self._mesh.transform[found]
        two = np.einsum("tij,tj->ti", frame[:, :2], cloud - frame[:, 2])
        shares = np.concatenate([two, 1 - two.sum(1, keepdims=True)], 1)
        shares = shares * (touch.conductance * weights / weights.sum())[:, None]
        unknowns = self._unknown[self._mesh.simplices[found]]
        conductance = np.bincount(unknowns.ravel(), shares.ravel(), self.count)
        fed = np.flatnonzero(conductance > 0)
        return fed, conductance[fed]

    def _linear(self, touches, spread, grounds) -> np.ndarray:
        """Solves all grounds by one factor: each contact has a node, joined to the drive.

        A current of 1 A is drawn from each ground while the drive is at 0 V. Without a
        ground, every node is at the drive's voltage.
        """
        n = self.count
        size = n + len(touches)
        matrix = sp.block_diag([self.stiffness, sp.csc_array((len(touches),) * 2)])
        for k, (touch, (fed, g)) in enumerate(zip(touches, spread)):
            if touch.series > 0:
                matrix = matrix + _links(fed, np.full(len(fed), n + k), g, size)
                to_drive = [n + k], [1 / touch.series]
            else:
                to_drive = [*fed, n + k], [*g, 1.0]
            matrix = matrix + _diagonal(*to_drive, size)
        drawn = np.zeros((size, len(grounds)))
        drawn[grounds, np.arange(len(grounds))] = 1
        u = _factor(matrix).solve(drawn)[: self.electrodes].T
        own = u[np.arange(len(grounds)), grounds]
        return self.drive * (1 - u / (self.rig.ground[grounds] + own)[:, None])

    @cached_property
    def _inverse(self) -> spla.SuperLU:
        """The factor of the sheet alone.

        A path from the first electrode carries no current, because currents balance.
        """
        square = float(np.mean(np.asarray(self.rig.sensor.sheet_resistance)))
        return _factor(self.stiffness + _diagonal([0], [1 / square], self.count))

    def _nonlinear(self, touches, spread, grounds) -> np.ndarray:
        """Finds by Newton's method, for each ground, the voltages w from object to sheet.

        The equation is w + (T + series) q(w) = V0. T are the sheet's resistances from the
        fed unknowns to the ground. The currents are q = g w |w/V0|ⁿ⁻¹.
        """
        fed = np.concatenate([f for f, _ in spread])
        g = np.concatenate([c for _, c in spread])
        which = np.repeat(np.arange(len(touches)), [len(f) for f, _ in spread])
        more = np.array([touch.exponent - 1.0 for touch in touches])[which]
        series = np.array([touch.series for touch in touches])[which]
        m = self.electrodes
        loads = np.zeros((self.count, len(fed)))
        loads[fed, np.arange(len(fed))] = 1
        u = self._inverse.solve(loads)
        inner, outer = u[fed], u[:m]
        loads = np.zeros((self.count, len(grounds)))
        loads[grounds, np.arange(len(grounds))] = 1
        u = self._inverse.solve(loads)
        volts = []
        for k, ground in enumerate(grounds):
            own = outer[ground]
            end = u[ground, k] + self.rig.ground[ground]
            table = inner - own - own[:, None] + end
            table = table + np.where(which == which[:, None], series, 0)
            w = _newton(table, g, more, self.drive)
            q = g * w * np.abs(w / self.drive) ** more
            volts.append((outer - own - u[:m, k : k + 1] + end) @ q)
        return np.stack(volts)


def _newton(table: np.ndarray, g: np.ndarray, more: np.ndarray, drive: float) -> np.ndarray:
    """Solves w + table·q(w) = drive; steps are halved until the residual falls."""

    def residual(w: np.ndarray) -> np.ndarray:
        return w + table @ (g * w * np.abs(w / drive) ** more) - drive

    unit = np.eye(len(g))
    w = np.linalg.solve(unit + table * g, np.full(len(g), drive))
    left = residual(w)
    for _ in range(100):
        small = np.maximum(np.abs(w / drive), 1e-9)
        step = np.linalg.solve(unit + table * (g * (1 + more) * small**more), left)
        part = 1.0
        while part > 1e-4 and np.abs(residual(w - part * step)).max() > np.abs(left).max():
            part /= 2
        w = w - part * step
        left = residual(w)
        if np.abs(part * step).max() < 1e-10 * abs(drive):
            return w
    raise RuntimeError("the contact's law: no solution in 100 steps")


def _factor(matrix: sp.sparray) -> spla.SuperLU:
    """Factors a symmetric positive matrix without looking for pivots."""
    options = {"SymmetricMode": True}
    return spla.splu(
        sp.csc_array(matrix), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options
    )


def _diagonal(at: Sequence, values: Sequence, size: int) -> sp.csc_array:
    return sp.csc_array((values, (at, at)), (size, size))


def _links(a: np.ndarray, b: np.ndarray, g: np.ndarray, size: int) -> sp.csc_array:
    """Returns the matrix of conductances g between unknowns a and b."""
    rows, columns = np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a])
    return sp.csc_array((np.concatenate([g, g, -g, -g]), (rows, columns)), (size, size))


def _nodes(rig: Rig, fine: float | int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the mesh's nodes (n, 2), m, and the face that each node is in, or -1.

    Rings lie around each face, ever wider apart, up to a lattice's spacing. The lattice
    fills the sheet where no ring is. Nodes on the border follow.
    """
    size = np.asarray(rig.sensor.size, float)
    rng = np.random.default_rng(0)
    coarse = _LATTICE * rig.sensor.mean_pitch / fine
    growth = _GROWTH / fine
    on_rim = max(8, round(_RIM * fine))
    rim = 2 * np.pi * rig.radius / on_rim

    def away(points: np.ndarray) -> np.ndarray:
        return np.hypot(*(points[:, None] - rig.place).transpose(2, 0, 1)) - rig.radius

    def spacing(points: np.ndarray) -> np.ndarray:
        return np.minimum(coarse, (rim + growth * np.abs(away(points))).min(1))

    rims, rings = [], []
    for e, (place, radius) in enumerate(zip(rig.place, rig.radius)):
        turned = rng.uniform(0, 2 * np.pi)
        rims.append(_circle(place, radius, on_rim, turned))
        wide = min(rim[e], coarse)
        inner = np.linspace(radius, 0, max(2, round(radius / wide)) + 1)[1:]
        outer, at = [], radius
        while wide < coarse:
            at += 0.87 * wide
            wide = rim[e] + growth * (at - radius)
            outer.append(at)
        for r in [*inner, *outer]:
            local = min(rim[e] + growth * abs(r - radius), coarse)
            n = max(1, round(2 * np.pi * r / local))
            ring = _circle(place, r, n, rng.uniform(0, 2 * np.pi))
            rings.append(ring[away(ring).argmin(1) == e])
    border = [np.array([[0, 0], size, [size[0], 0], [0, size[1]]])]
    for axis, end in np.ndindex(2, 2):
        line = np.zeros((4000, 2))
        line[:, axis] = np.linspace(0, size[axis], len(line))
        line[:, 1 - axis] = end * size[1 - axis]
        density = 1 / spacing(line)
        steps = np.concatenate([[0], ((density[1:] + density[:-1]) / 2).cumsum()])
        some = np.linspace(0, steps[-1], int(np.ceil(steps[-1] * size[axis] / 3999)) + 1)
        side = np.zeros((len(some), 2))
        side[:, axis] = np.interp(some, steps, line[:, axis])
        side[:, 1 - axis] = end * size[1 - axis]
        border.append(side[1:-1])
    x, y = (np.arange(-1, length / coarse * 1.2 + 2) for length in size)
    x, y = (v.ravel() for v in np.meshgrid(x, y))
    lattice = coarse * np.stack([x + y % 2 / 2, np.sqrt(0.75) * y], 1)
    lattice = lattice + 0.1 * coarse * rng.uniform(-1, 1, lattice.shape)
    lattice = lattice[(rim + growth * np.abs(away(lattice))).min(1) > coarse]
    rims = np.clip(np.concatenate(rims), 0, size)
    inner = np.concatenate([*rings, lattice])
    near = np.minimum(inner, size - inner).min(1)
    inner = inner[near > 0.4 * spacing(inner)]
    points = np.concatenate([border[0], rims, *border[1:], inner])
    points = points[_apart(points, _CLOSE * spacing(points))]
    face = away(points)
    nearest = face.argmin(1)
    inside = face[np.arange(len(points)), nearest] <= 1e-9 * rig.radius[nearest]
    return points, np.where(inside, nearest, -1)


def _circle(place: np.ndarray, radius: float, n: int, turned: float) -> np.ndarray:
    turn = turned + 2 * np.pi * np.arange(n) / n
    return place + radius * np.stack([np.cos(turn), np.sin(turn)], 1)


def _apart(points: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Returns which points stay, such that none is too close to an earlier point."""
    pairs = KDTree(points).query_pairs(least.max(), output_type="ndarray")
    a, b = np.sort(pairs, 1).T
    close = np.hypot(*(points[a] - points[b]).T) < np.minimum(least[a], least[b])
    a, b = a[close], b[close]
    stay = np.ones(len(points), bool)
    order = np.lexsort((b, a))
    for i, j in zip(a[order], b[order]):
        if stay[i]:
            stay[j] = False
    return stay
