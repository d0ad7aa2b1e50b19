"""Computes the table of electrodes' potentials that `points` looks up.

`make_moves` and `make_waves` tell how the table changes with places and with the sheet.
"""

from collections.abc import Iterator
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from tomojax._require import require, require_memory
from tomojax.kernels.contacts import Among, Field, field_at, Near
from tomojax.kernels.sheet import (
    disc_mean,
    fem_sheet,
    heights,
    rectangle_grid_fields,
    rectangle_slope,
    rectangle_wave_fields,
    smooth_orders,
    triangles,
)
from tomojax.sensor._cut_field import (
    among_sites,
    cut_fields,
    cut_of,
    edge_is_near,
    homes,
    wave_fields,
)
from tomojax.sensor._near_field import near_of
from tomojax.sensor._sensor import Sensor
from tomojax.sensor.meshes._mesh_solve import MeshSolve
from tomojax.sensor.meshes._told import ToldSheet

# Spacing of the radii that potentials are averaged over, of the electrodes' pitch.
_RADII = 0.05

# The largest of these radii, of the pitch.
_LARGEST = 0.65

# Spacing of the table of averages, of the pitch.
_KEPT = 0.1

# Averages are computed on a finer table, whose spacing, of the electrodes' diameter,
# resolves a rim.
_SPACING = 0.2

# Points of the finer table along a side: memory. What it does not resolve then is smaller
# than the least radius.
_MOST = 640

# Cells of the mesh for what a sheet's variation adds, of a diameter.
_MESH = 4

# Electrodes whose averages are computed at once.
_TOGETHER = 16


def make_field(sensor: Sensor) -> Field:
    """Computes the potentials of electrodes in closed form, averaged over discs.

    A sheet with a value per element, an outline or a surface adds the difference of two
    solutions on a mesh, whose errors cancel. Beyond an edge the table is that of the place
    mirrored at the edge: smooth, as no current crosses it. Electrodes even out the
    potential under them (`electrode_shunt`; 1 where the sensor leaves it open: metal
    discs). Without this effect places are off by 1 mm and more.

    **Raises:** `ValueError` for a sheet more than 32 pitches wide.
    """
    return _made(sensor)[0]


def make_fields(sensor: Sensor) -> tuple[Field, Near]:
    """Computes the table of `make_field`, and potentials at points beside electrodes."""
    field, nominal, rho, rows, every = _made(sensor)
    return field, near_of(nominal, rho, rows, every)


def _made(sensor: Sensor) -> tuple[Field, Sensor, float, np.ndarray, int]:
    """Computes `make_field`, and what `near_of` takes."""
    told = sensor.told
    sensor, even, cells, every = parts_of(sensor)
    finer, kept = (int(np.prod(n + 1)) for n in (cells, cells // every))
    point = np.dtype(sensor.dtype).itemsize * len(averaged_radii(sensor))
    count = sensor.electrode_count
    require_memory(count * (8 * finer + point * kept), f"tables of {count} electrodes")
    if sensor.flat:
        ee, rows = even_fields(even, cells, np.asarray(sensor.electrode_xy, float))
        if sensor.sheet_resistance.ndim:
            more_ee, more = _variation(sensor, even, cells)
            ee, rows = ee + more_ee, rows + more
        ee, rows = _told(told, ee, rows)
        field = averaged_field(sensor, ee, rows, every)
        return field, sensor, float(even.sheet_resistance), rows, every
    cut = cut_of(sensor, even, fine=True)
    ee, rows = _told(told, *cut_fields(sensor, even, cut, cells))
    field = averaged_field(sensor, ee, rows, every)
    x, y = (np.linspace(0, float(s), n // every + 1) for s, n in zip(sensor.size, cells))
    home = jnp.asarray(homes(sensor, x, y), sensor.dtype)
    # What the shape adds between sites is smoother than the electrodes' own potentials.
    plain = cut_of(sensor, even) if edge_is_near(sensor) else cut
    field = field._replace(home=home, among=among_sites(sensor, plain))
    return field, sensor, float(even.sheet_resistance), rows, every


def make_among(sensor: Sensor) -> Among:
    """Makes the part of `make_field` that a cut or curved sheet adds to a rectangle."""
    sensor, even, *_ = parts_of(sensor)
    return among_sites(sensor, cut_of(sensor, even))


def _told(
    told: ToldSheet | None, ee: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Puts what another code or a measurement tells in the place of nominal resistances."""
    if told is None:
        return ee, rows
    dtype = told.electrodes.dtype
    more_ee, more = told.beside(jnp.asarray(ee, dtype), jnp.asarray(rows, dtype))
    return ee + np.asarray(more_ee), rows + np.asarray(more)


def parts_of(sensor: Sensor) -> tuple[Sensor, Sensor, np.ndarray, int]:
    """Returns the nominal sensor, an even one, the finer table's cells, their stride."""
    # Metal discs where the sensor leaves it open.
    shunt = 1.0 if sensor.electrode_shunt is None else sensor.electrode_shunt
    sensor = replace(sensor, electrode_shunt=shunt, told=None)
    rho = float(np.exp(np.log(np.asarray(sensor.sheet_resistance, float)).mean()))
    diameter, size = float(sensor.electrode_diameter), np.asarray(sensor.size, float)
    step = _KEPT * sensor.mean_pitch
    kept = np.ceil(size / step * (1 - 1e-5)).astype(int)
    wide = f"at most {_MOST // 2 * _KEPT:g} pitches (the method source takes more)"
    require(2 * kept.max() <= _MOST, "size", np.round(size, 4).tolist(), wide)
    resolving = int(np.ceil(step / (_SPACING * diameter) * (1 - 1e-5)))
    every = int(np.clip(resolving, 2, _MOST // kept.max()))
    return sensor, replace(sensor, sheet_resistance=rho), every * kept, every


def even_fields(
    even: Sensor, cells: np.ndarray, places: Float[np.ndarray, "M 2"]
) -> tuple[Float[np.ndarray, "M M"], Float[np.ndarray, "M nx ny"]]:
    """Computes R_ee' and R_e at the table's points, Ω, of an even sheet."""
    size, radius = np.asarray(even.size, float), float(even.electrode_diameter) / 2
    x, y = (np.linspace(0, s, n + 1) for s, n in zip(size, cells))
    shunt = float(np.asarray(even.electrode_shunt))
    ee, rows, _ = rectangle_grid_fields(places, x, y, radius, size, shunt)
    rho = float(even.sheet_resistance)
    return rho * ee, rho * rows


def averaged_radii(sensor: Sensor) -> Float[np.ndarray, " A"]:
    """Returns the radii of the table, m."""
    count = round(_LARGEST / _RADII)
    return _RADII * sensor.mean_pitch * np.arange(1, count + 1)


def averaged_field(sensor: Sensor, ee: np.ndarray, rows: np.ndarray, every: int) -> Field:
    """Turns the table of R_e at points into a table over discs of several radii."""
    size = np.asarray(sensor.size, float)
    radii, dtype = averaged_radii(sensor), sensor.dtype
    nx, ny = (1 + (n - 1) // every for n in rows.shape[1:])
    values = _aligned((nx, ny, len(radii), len(rows)), dtype)
    # A few electrodes at a time: the finer table is large.
    for some in np.array_split(np.arange(len(rows)), -(-len(rows) // _TOGETHER)):
        for k, averaged in enumerate(disc_averages(rows[some], size, radii)):
            values[:, :, k, some] = averaged[:, ::every, ::every].transpose(1, 2, 0)
    return Field(
        jnp.asarray(values, dtype),
        jnp.asarray(radii, dtype),
        jnp.asarray(ee, dtype),
        sensor.size,
    )


def _aligned(shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """Makes an array that begins where JAX takes it without a copy: the table is large."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    held = np.empty(size + 64, np.uint8)
    begin = -held.ctypes.data % 64
    return held[begin : begin + size].view(dtype).reshape(shape)


def _variation(
    sensor: Sensor, even: Sensor, cells: np.ndarray
) -> tuple[Float[np.ndarray, "M M"], Float[np.ndarray, "M nx ny"]]:
    """Computes what a sheet's variation adds to R_ee' and to the table of R_e, Ω."""
    diameter, size = float(sensor.electrode_diameter), np.asarray(sensor.size, float)
    divisions = np.array(sensor.divisions)
    finer = np.ceil(_MESH * size / diameter / divisions).astype(int)
    values = np.asarray(sensor.sheet_resistance, float).reshape(*divisions, 2)
    values = values.repeat(finer[0], 0).repeat(finer[1], 1).ravel()
    mesh = int(divisions[0] * finer[0]), int(divisions[1] * finer[1])
    xy, shunt = (
        np.asarray(a, float) for a in (sensor.electrode_xy, sensor.electrode_shunt)
    )

    def solved(rho: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        fem = fem_sheet(1 / rho, xy, np.asarray(diameter / 2), mesh, size, shunt)
        ee, nodes = MeshSolve(fem, mesh).fields()
        return ee, nodes[:, triangles(mesh)].mean(-1)

    one, other = solved(values), solved(np.full_like(values, float(even.sheet_resistance)))
    ee, ek = (a - b for a, b in zip(one, other))
    # From the cells' middles to the table's points, which mirror at the same edges.
    middles = ek.reshape(-1, *mesh, 2).mean(-1)
    waves = np.asarray(scipy.fft.dctn(middles, 2, axes=(1, 2), norm="forward"))
    padded = np.zeros((len(ee), *(np.maximum(cells, mesh) + 1)))
    padded[:, : mesh[0], : mesh[1]] = waves
    padded = padded[:, : cells[0] + 1, : cells[1] + 1]
    return ee, np.asarray(scipy.fft.dctn(padded, 1, axes=(1, 2)))


def disc_averages(
    values: Float[np.ndarray, "*batch nx ny"], size: np.ndarray, radii: np.ndarray
) -> Iterator[Float[np.ndarray, "*batch nx ny"]]:
    """Yields means of a table, mirrored at its edges, over discs around its points."""
    k = [np.pi * np.arange(n) / side for n, side in zip(values.shape[-2:], size)]
    length = np.hypot(*np.meshgrid(*k, indexing="ij"))
    waves = scipy.fft.dctn(values, 1, axes=(-2, -1))
    for a in radii:
        yield np.asarray(scipy.fft.idctn(waves * disc_mean(length * a), 1, axes=(-2, -1)))


# An electrode's step that gives the slopes by its place, of its diameter.
_MOVE = 1e-3

# The same where potentials are solved on a mesh, whose rounding is larger.
_FAR = 0.04

# Half periods in a pitch that waves are followed to.
_FOLLOWED = 8

# Which of the table's radii the waves' potentials are averaged over: they hardly depend on
# it.
_RADIUS = 3


def make_moves(sensor: Sensor) -> tuple[Float[Array, "2 nx ny A M"], Float[Array, "2 M M"]]:
    """Computes slopes of `make_field`'s tables as electrodes move along x and y, Ω/m.

    The slopes are R_e(x, a) and R_ee' by the place of electrode e; R_ee changes by twice
    its entry. The sheet is even, with its resistance as electrodes lower it. The effect of
    each electrode, as metal, on the others' potentials is left out.
    """
    sensor, even, cells, every = parts_of(sensor)
    places, step = np.asarray(sensor.electrode_xy, float), _MOVE * _diameter(even)
    if not sensor.flat:
        return _cut_moves(sensor)
    size, rho = np.asarray(sensor.size, float), _effective(even)
    x, y = (np.linspace(0, s, n + 1) for s, n in zip(size, cells))
    values = []
    for unit in np.eye(2):
        (ee, one, _), (_, other, _) = (
            rectangle_grid_fields(
                places + side * step * unit, x, y, _diameter(even) / 2, size
            )
            for side in (1, -1)
        )
        slope = rho * (one - other) / (2 * step)
        values.append(averaged_field(sensor, ee, slope, every).values)
    at, radius = jnp.asarray(places, sensor.dtype), sensor.electrode_diameter / 2
    slope = rho * rectangle_slope(at[:, None], at, radius, sensor.size)
    return jnp.stack(values), jnp.moveaxis(slope, -1, 0).astype(sensor.dtype)


def _cut_moves(sensor: Sensor) -> tuple[Float[Array, "2 nx ny A M"], Float[Array, "2 M M"]]:
    """Computes `make_moves` on a mesh: all electrodes move at once."""
    step, xy = _FAR * _diameter(sensor), sensor.electrode_xy
    values, among = [], []
    for unit in np.eye(2):
        moved = [
            make_field(eqx.tree_at(lambda s: s.electrode_xy, sensor, xy + by)).values
            for by in jnp.asarray(step * np.stack([unit, -unit]), sensor.dtype)
        ]
        slope = (moved[0] - moved[1]) / (2 * step)
        values.append(slope)
        field = make_field(sensor)._replace(values=slope)
        at = jax.vmap(field_at, (None, 0, None))(field, xy, field.radii[0])
        among.append(at.T)
    return jnp.stack(values), jnp.stack(among)


def _diameter(sensor: Sensor) -> float:
    return float(sensor.electrode_diameter)


def _effective(even: Sensor) -> float:
    """Computes the sheet's resistance as metal discs lower it, Ω per square (Maxwell)."""
    covered = even.electrode_count * np.pi * _diameter(even) ** 2 / 4
    covered = covered / float(np.prod(even.size)) * float(np.asarray(even.electrode_shunt))
    return float(even.sheet_resistance) * (1 - covered) / (1 + covered)


def make_waves(
    sensor: Sensor, most: int
) -> tuple[Float[Array, "q nx ny M"], Float[Array, "q M M"]]:
    """Computes what a unit of each wave of the sheet adds to the table and to R_ee', Ω.

    The results are of first order, for the waves of `Calibration` with up to `most` half
    periods. Electrodes that even the sheet out, as metal discs, lower its resistance, and
    so the addition by a wave.
    """
    sensor, even, cells, every = parts_of(sensor)
    size = np.asarray(sensor.size, float)
    x, y = (np.linspace(0, s, n // every + 1) for s, n in zip(size, cells))
    if not sensor.flat:
        of_waves = sensor, cut_of(sensor, even), x, y, smooth_orders(most)
        ee, rows = (jnp.asarray(a, sensor.dtype) for a in wave_fields(*of_waves))
        return jnp.moveaxis(rows, 1, -1), ee
    followed = int(np.ceil(_FOLLOWED * size.max() / sensor.mean_pitch))
    orders, places = smooth_orders(most), np.asarray(sensor.electrode_xy, float)
    radius = averaged_radii(sensor)[_RADIUS]
    given = places, x, y, _diameter(even) / 2, size, orders, followed, radius
    ee, rows = rectangle_wave_fields(*given)
    scale = _effective(even) * heights(orders)
    values = scale[:, None, None, None] * np.moveaxis(rows, 1, -1)
    ee = scale[:, None, None] * ee
    return jnp.asarray(values, sensor.dtype), jnp.asarray(ee, sensor.dtype)
