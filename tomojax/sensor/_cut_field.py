"""Computes the tables of a sheet that is no flat rectangle, on a mesh.

Near an electrode a mesh is off by the same on a rectangle, whose closed form is known. What
it lacks there is put back, so that tables are nearly as good as the rectangle's.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from tomojax.kernels.contacts import Among
from tomojax.kernels.sheet import (
    centroids,
    cosine_waves,
    feed_parts,
    fem_sheet,
    FemSheet,
    heights,
    node_image,
    rectangle_grid_fields,
    Skin,
    stretch,
)
from tomojax.sensor._edges import AbstractEdge, in_parts, PolygonEdge, skin_on
from tomojax.sensor._sensor import Sensor
from tomojax.sensor.meshes._mesh_solve import centred, MeshSolve

# Cells of the mesh, of a diameter; at most so many along a side.
_MESH = 4
_MOST = 200

# The same where an edge crosses an electrode, or a gap is narrower than one. With four
# cells potentials beside half a disc were twice as far off.
_FINE = 8
_FINEST = 300

# With cells of half the side a mesh lacks a quarter as much where the sheet is smooth, and
# less than half at corners that point inwards. So this part of what the finer mesh changes
# is still to come: between 1/3 and 2/3.
_TO_COME = 0.4

# A rectangle that holds the box is so much wider on each side, of the pitch: no electrode
# is on its edge.
_WIDER = 0.5

# Sites along each side between which potentials are tabulated.
_SITES = 24

# Part of a wave that its effect is computed with.
_LITTLE = 0.02

# A chart that stretches lengths by more than this beside an electrode is not like a flat
# sheet there.
_ALIKE = 0.02

_Image = Float[np.ndarray, "n nx ny"]


class Cut(NamedTuple):
    """The sheet on its mesh, and a rectangle around it on a mesh of the same cells."""

    mesh: tuple[int, int]
    skin: Skin
    sheet: FemSheet
    wider: tuple[int, int]
    around: FemSheet
    margin: Float[np.ndarray, "2"]  # m
    parts: Float[np.ndarray, " M"]  # of each electrode that is on the sheet
    alike: Float[np.ndarray, " M"]  # whether the sheet is flat there, 1 or 0


def cut_of(sensor: Sensor, even: Sensor, coarser: int = 1, fine: bool = False) -> Cut:
    """Puts the sheet on a mesh that is finer than its electrodes.

    `coarser`: cells of the mesh beside each other that are one; `fine`: a finer mesh where
    the edge asks for one.
    """
    size, xy = (np.asarray(a, float) for a in (sensor.size, sensor.electrode_xy))
    diameter = float(sensor.electrode_diameter)
    rho = np.asarray(sensor.sheet_resistance, float)
    cells, most = (_FINE, _FINEST) if fine and edge_is_near(sensor) else (_MESH, _MOST)
    wanted = np.ceil(cells * size / diameter * (1 - 1e-5)).astype(int)
    # As fine as the sensor's own where that is finer: narrow gaps ask for it.
    mesh = np.maximum(np.clip(wanted, 8, most), sensor.divisions)
    mesh = -(-mesh // 2) * 2 // coarser
    if rho.ndim:  # on a mesh that divides that of the sheet's values
        divisions = np.array(sensor.divisions)
        finer = np.maximum(1, mesh // divisions)
        mesh = divisions * finer
        rho = rho.reshape(*divisions, 2).repeat(finer[0], 0).repeat(finer[1], 1).ravel()
    rho = np.broadcast_to(rho, 2 * mesh.prod())
    side = size / mesh
    # An even number of cells: the triangles are the same. Coarser cells end there as well.
    blocks = np.ceil(_WIDER * sensor.mean_pitch * coarser / side / 4).astype(int)
    more = 4 // coarser * blocks
    wider, margin = mesh + 2 * more, more * side
    shape, whole = ((int(m[0]), int(m[1])) for m in (mesh, wider))
    skin = skin_on(sensor.outline, sensor.surface, shape, size, sensor.dtype)
    assert skin is not None
    radius, shunt = np.asarray(diameter / 2), np.asarray(sensor.electrode_shunt, float)
    sheet = fem_sheet(1 / rho, xy, radius, shape, size, shunt, skin)
    same = np.full(2 * wider.prod(), 1 / float(even.sheet_resistance))
    around = fem_sheet(same, xy + margin, radius, whole, size + 2 * margin, shunt)
    parts = feed_parts(xy, radius, shape, size, skin)
    alike = stretch(skin, xy, side) < _ALIKE
    return Cut(shape, skin, sheet, whole, around, margin, parts, 1.0 * alike)


def edge_is_near(sensor: Sensor) -> bool:
    """Tells whether an edge crosses an electrode, or gaps are narrower than one."""
    outline, diameter = sensor.outline, sensor.electrode_diameter
    if outline is None:
        return False
    crossed = np.asarray(outline.distance(sensor.electrode_xy)) > -float(diameter) / 2
    if crossed.any() or not isinstance(outline, PolygonEdge):
        return bool(crossed.any())
    return outline.narrowest(float(diameter)) < float(diameter)


def cut_fields(
    sensor: Sensor, even: Sensor, cut: Cut, cells: np.ndarray
) -> tuple[Float[np.ndarray, "M M"], Float[np.ndarray, "M nx ny"]]:
    """Computes R_ee' and R_e at the table's points, Ω; beyond an edge, mirrored.

    Two meshes tell what ever smaller cells would make, of a sheet of one resistance.
    """
    size, xy = np.asarray(sensor.size, float), np.asarray(sensor.electrode_xy, float)
    x, y = (np.linspace(0, s, n + 1) for s, n in zip(size, cells))
    home = homes(sensor, x, y)
    away = (home != np.stack(np.meshgrid(x, y, indexing="ij"), -1)).any(-1)
    margin = cut.margin
    ee, rows, beside = rectangle_grid_fields(
        xy + margin,
        x + margin[0],
        y + margin[1],
        float(sensor.electrode_diameter) / 2,
        size + 2 * margin,
        float(np.asarray(sensor.electrode_shunt)),
        home[away] + margin,
    )
    rows[:, away] = beside
    rho = float(even.sheet_resistance)
    ee, rows = centred(rho * ee, rho * rows)

    def corrected(cut: Cut) -> tuple[np.ndarray, np.ndarray]:
        around = _solved(cut.around, cut.wider, home + cut.margin, size + 2 * cut.margin)
        found_ee, found = _solved(cut.sheet, cut.mesh, home, size)
        # Half a disc at an edge acts as a whole one and its image: as two.
        share = cut.alike / cut.parts
        both = np.sqrt(share[:, None] * share)
        return (
            found_ee + both * (ee - around[0]),
            found + share[:, None, None] * (rows - around[1]),
        )

    fine = coarse = corrected(cut)
    if not sensor.sheet_resistance.ndim:  # values of cells have a finest mesh
        coarse = corrected(cut_of(sensor, even, 2, fine=True))
    ee, rows = (a + _TO_COME * (a - b) for a, b in zip(fine, coarse))
    return (ee + ee.T) / 2, rows


def _solved(
    fem: FemSheet, mesh: tuple[int, int], at: Float[np.ndarray, "*n 2"], size: np.ndarray
) -> tuple[Float[np.ndarray, "M M"], Float[np.ndarray, "M ..."]]:
    """Computes R_ee' and R_e at places, Ω, by finite elements."""
    ee, nodes = MeshSolve(fem, mesh).fields()
    found = _weights(at.reshape(-1, 2), size, mesh) @ nodes.T
    return ee, found.T.reshape(-1, *at.shape[:-1])


def wave_fields(
    sensor: Sensor, cut: Cut, x: np.ndarray, y: np.ndarray, orders: np.ndarray
) -> tuple[Float[np.ndarray, "q M M"], Float[np.ndarray, "q M nx ny"]]:
    """Computes what a unit of each wave of the sheet adds to R_ee' and R_e, Ω.

    The results are differences between sheets with a little of the wave.
    """
    size, home = np.asarray(sensor.size, float), homes(sensor, x, y)
    places = centroids(cut.mesh, sensor.size)
    scale = jnp.asarray(heights(orders)[:, None], sensor.dtype)
    waves = scale * cosine_waves(places, sensor.size, orders)
    found = []
    for wave in waves:
        sides = [
            cut.sheet._replace(local=cut.sheet.local / (1 + part * wave)[:, None, None])
            for part in (_LITTLE, -_LITTLE)
        ]
        one, other = (_solved(fem, cut.mesh, home, size) for fem in sides)
        found.append([(a - b) / (2 * _LITTLE) for a, b in zip(one, other)])
    ee, rows = zip(*found)
    return np.stack(ee), np.stack(rows)


def among_sites(sensor: Sensor, cut: Cut) -> Among:
    """Computes what the sheet's shape adds to potentials between sites, Ω.

    That is beside the rectangle around it, whose closed form is known.
    """
    size = np.asarray(sensor.size, float)
    x, y = (np.linspace(0, s, _SITES) for s in size)
    home = homes(sensor, x, y).reshape(-1, 2)

    def shared(fem: FemSheet, mesh: tuple[int, int], at: np.ndarray, box: np.ndarray):
        return MeshSolve(fem, mesh).between(_weights(at, box, mesh).toarray().T)

    found = shared(cut.sheet, cut.mesh, home, size)
    wide = size + 2 * cut.margin
    found = found - shared(cut.around, cut.wider, home + cut.margin, wide)
    values = found.reshape(_SITES, _SITES, _SITES, _SITES)
    return Among(*(jnp.asarray(a, sensor.dtype) for a in (values, cut.margin)))


def homes(
    sensor: Sensor, x: Float[np.ndarray, " nx"], y: Float[np.ndarray, " ny"]
) -> Float[np.ndarray, "nx ny 2"]:
    """Returns the places that a grid's points stand for: beyond an edge, mirrored."""
    points = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
    if sensor.outline is None:
        return points
    outline, size = sensor.outline, np.asarray(sensor.size, float)

    def level_at(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = in_parts(_levels, outline, at, sensor.dtype)
        return found[:, 0], found[:, 1:]

    flat = points.reshape(-1, 2)
    level, way = level_at(flat)
    out = np.flatnonzero(level > 0)
    at = flat[out] - 2 * level[out, None] * way[out]
    # Where that is beyond another edge: to the nearest edge.
    least = 1e-3 * sensor.mean_pitch
    for _ in range(3):
        again, way = level_at(at)
        off = (again > 0) | (at < 0).any(1) | (at > size).any(1)
        step = np.maximum(again, 0) + least
        at = np.clip(np.where(off[:, None], at - step[:, None] * way, at), 0, size)
    found = flat.copy()
    found[out] = at
    return found.reshape(points.shape)


def _weights(
    at: Float[np.ndarray, "n 2"], size: np.ndarray, mesh: tuple[int, int]
) -> "scipy.sparse.csr_array":
    """Computes weights (n, nodes) of the four nodes around each place: linear."""
    cells = np.array(mesh)
    index = at / size * cells
    low = np.clip(np.floor(index), 0, cells - 1).astype(int)
    part = index - low
    numbers = node_image(np.arange((cells + 1).prod()), mesh)
    columns, weights = [], []
    for i in (0, 1):
        for j in (0, 1):
            columns.append(numbers[low[:, 0] + i, low[:, 1] + j])
            weights.append(np.abs(1 - i - part[:, 0]) * np.abs(1 - j - part[:, 1]))
    rows = np.tile(np.arange(len(at)), 4)
    entries = np.concatenate(weights), (rows, np.concatenate(columns))
    return scipy.sparse.csr_array(entries, shape=(len(at), numbers.size))


@eqx.filter_jit
def _levels(outline: AbstractEdge, at: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
    """Computes distances to the edge, m, and their slopes."""
    level, slope = jax.vmap(jax.value_and_grad(outline.distance))(at)
    return jnp.concatenate([level[:, None], slope], 1)
