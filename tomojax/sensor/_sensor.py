"""Describes the sensor: a conductive sheet on disc electrodes."""

import operator
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from tomojax._checks import (
    checked,
    float_array,
    known,
    require,
    require_array,
    require_shape,
)
from tomojax._custom_types import Numbers
from tomojax._require import check_electrodes, LONGEST, require_kind
from tomojax._shown import named, shown
from tomojax.kernels.sheet import (
    conditions_of,
    coverage,
    element_areas,
    Grounds,
    nodes,
    Skin,
    Slots,
)
from tomojax.plots import png, sheet
from tomojax.sensor._converter import Converter, NOISE
from tomojax.sensor._edges import (
    AbstractEdge,
    skin_on,
)
from tomojax.sensor._made import Made
from tomojax.sensor._placing import (
    check_conditions,
    check_mesh,
    check_one_size,
    check_skin,
)
from tomojax.sensor.meshes._told import ToldSheet


class Sensor(eqx.Module, Made):
    """A conductive sheet on M electrodes, read with one electrode (or more) grounded.

    **Arguments** (SI):

    - `size`: sides of the sheet along x and y, m; of a sheet with an `outline` or a
      `surface`: of the box that holds it.
    - `electrode_xy` (M, 2): centres of the electrodes, m, from a corner of the sheet.
    - `electrode_diameter`: of every electrode, m.
    - `sheet_resistance`: Ω per square; one value, or one per element (K,) in the order
      of `reshape(nx, ny, 2)`.
    - `ground_resistance` z: Ω, of the path from a grounded electrode to ground; one
      value or one per electrode (M,).
    - `drive_voltage` V0: of the object, V.
    - `electrode_shunt`: how strongly a floating electrode evens out the potential under
      it: 1 for a metal disc in perfect contact, less in poor contact. The paper's 64
      discs of 5 mm lower the sheet's effective resistance by 10 %. None neglects this
      effect, at a third of the cost.
    - `resolution`: of one code of the converter, V; 0 if finer than the noise.
    - `divisions` (nx, ny): cells of the mesh. Each is two of the K = 2·nx·ny elements.
    - `conditions` (L, M): a table of ground conditions, S from each electrode to ground;
      `grounds` are then its rows. None: electrode l alone through z.
    - `outline`: where the sheet ends, an `AbstractEdge` (`Sensor.disc`, `Sensor.polygon`);
      None: it fills the box.
    - `surface`: a function from places (…, 2) to places in space (…, 3), m, of a curved
      sheet (`Sensor.mesh`); None: it is flat.
    - `told`: the sheet's resistances by another code or a measurement, a `ToldSheet`.

    All but `divisions` may be differentiated. `dataclasses.replace` makes a changed
    sensor.

    **Raises:** `ValueError` for electrodes that overlap or leave the sheet, cells wider
    than an electrode, a sheet in parts, and values that are not positive or not numbers.

    **Example:**

    >>> import tomojax as tx
    >>> corners = [[0.02, 0.02], [0.02, 0.06], [0.06, 0.02], [0.06, 0.06]]
    >>> sensor = tx.Sensor([0.08, 0.08], corners, divisions=(16, 16))
    >>> sensor.electrode_count, sensor.element_count
    (4, 512)
    >>> tx.Sensor.grid().electrode_count  # the paper's, 8 × 8
    64
    """

    size: Float[Array, "2"]
    electrode_xy: Float[Array, "M 2"]
    electrode_diameter: Float[Array, ""]
    sheet_resistance: Float[Array, "*elements"]
    ground_resistance: Float[Array, "*electrodes"]
    drive_voltage: Float[Array, ""]
    electrode_shunt: Float[Array, ""] | None
    resolution: Float[Array, ""]
    conditions: Float[Array, "L M"] | None
    outline: AbstractEdge | None
    surface: Callable | None
    told: ToldSheet | None
    divisions: tuple[int, int] = eqx.field(static=True)

    def __init__(
        self,
        size: Numbers,
        electrode_xy: Numbers,
        electrode_diameter: Numbers = 0.005,
        sheet_resistance: Numbers = 10e3,
        ground_resistance: Numbers = 4.0,
        drive_voltage: Numbers = 4.5,
        electrode_shunt: Numbers | None = None,
        divisions: Numbers = (64, 64),
        dtype: Any = None,
        resolution: Numbers = 0.0,
        conditions: Numbers | None = None,
        outline: AbstractEdge | None = None,
        surface: Callable | None = None,
        told: ToldSheet | None = None,
    ):
        xy = self.electrode_xy = float_array("electrode_xy", electrode_xy, dtype)
        # One dtype throughout: the electrodes' places decide.
        given: dict[str, Any] = {
            "size": size,
            "electrode_diameter": electrode_diameter,
            "sheet_resistance": sheet_resistance,
            "ground_resistance": ground_resistance,
            "drive_voltage": drive_voltage,
            "electrode_shunt": electrode_shunt,
            "resolution": resolution,
            "conditions": conditions,
        }
        for name, value in given.items():
            bare = value is None and name in ("electrode_shunt", "conditions")
            array = value if bare else float_array(name, value, xy.dtype)  # pyright: ignore
            setattr(self, name, array)
        for name, value, kind in (
            ("outline", outline, AbstractEdge),
            ("told", told, ToldSheet),
        ):
            if value is not None:
                require_kind(name, value, kind)
        self.outline, self.surface, self.told = (
            jax.tree.map(lambda a: a.astype(xy.dtype) if eqx.is_inexact_array(a) else a, f)
            for f in (outline, surface, told)
        )
        self.divisions = _whole_divisions(divisions)

    def __check_init__(self) -> None:
        require_array("electrode_xy", self.electrode_xy, "finite", (None, 2))
        m = self.electrode_count
        require(m >= 2, "electrode_xy", m, "two")
        check_one_size(self.electrode_diameter)
        for name, rule, *shapes in (
            ("size", "positive", (2,)),
            ("electrode_diameter", "positive", ()),
            ("sheet_resistance", "positive", (), (self.element_count,)),
            ("ground_resistance", "not negative", (), (m,)),
            ("drive_voltage", "finite", ()),
            ("resolution", "not negative", ()),
            ("electrode_shunt", "positive", ()),
        ):
            if (value := getattr(self, name)) is not None:
                require_array(name, value, rule, *shapes)  # pyright: ignore
        if self.told is not None:
            require_shape("told", self.told.electrodes, (m, m))
        if self.conditions is not None:
            check_conditions("conditions", self.conditions, m)
        if self.electrode_shunt is not None and known(self.electrode_shunt):
            shunt = float(self.electrode_shunt)
            require(shunt <= 1, "electrode_shunt", shunt, "1 or less")
        if known(self.size):
            longest = float(np.asarray(self.size).max())
            fits = longest <= LONGEST
            require(fits, "size", f"{longest:g} m", f"{LONGEST:g} m at most, in metres")
        if known(self.size, self.electrode_xy, self.electrode_diameter):
            if self.flat:
                check_electrodes(self.electrode_xy, self.size, self.electrode_diameter)
            elif known(*jax.tree.leaves((self.outline, self.surface))):
                check_skin(self)
            check_mesh(self)

    @property
    def flat(self) -> bool:
        """Tells whether the sheet is a flat rectangle, which has closed forms."""
        return self.outline is None and self.surface is None

    @property
    def even(self) -> bool:
        """Tells whether the sheet is a flat rectangle of one resistance, told by nobody."""
        return self.flat and self.sheet_resistance.ndim == 0 and self.told is None

    @property
    def skin(self) -> Skin | None:
        """Returns what the sheet has beside its box; None of a flat rectangle."""
        if self.flat:
            return None
        places = nodes(self.divisions, self.size)
        level = jnp.full(len(places), -jnp.inf, self.dtype)
        if self.outline is not None:
            level = self.outline.distance(places)
        return Skin(level, self.surface)

    def on_mesh(self, divisions: tuple[int, int], sheet_resistance: Numbers) -> "Sensor":
        """Returns the sensor on another mesh, with that mesh's values of the sheet."""
        value = float_array("sheet_resistance", sheet_resistance, self.dtype)
        moved = eqx.tree_at(lambda s: s.sheet_resistance, self, value)
        return replace(moved, divisions=divisions)

    def parts(self) -> Float[Array, " K"] | None:
        """Returns the part of each element that is on the sheet; None: all of it."""
        skin = self.skin
        if skin is None or self.outline is None:
            return None
        return eqx.filter_jit(coverage)(skin, self.divisions)

    @property
    def area(self) -> float:
        """Returns the sheet's area, m²."""
        if self.flat:
            return float(np.prod(np.asarray(self.size)))
        return float(element_areas(*self._on_host()).sum())

    def _on_host(self) -> tuple[Skin | None, tuple[int, int], np.ndarray]:
        """Returns the sheet's description in NumPy, its mesh and size: no program."""
        size = np.asarray(self.size, float)
        about = self.outline, self.surface, self.divisions, size, self.dtype
        return skin_on(*about), self.divisions, size

    def on_sheet(self, points: Numbers) -> Bool[Array, "*n"]:
        """Tells which points (…, 2), m, are on the sheet."""
        at = checked("points", points, "finite", (None, 2), dtype=self.dtype)
        return _inside(self.size, self.outline, at)

    def in_space(
        self, points: Numbers
    ) -> tuple[Float[Array, "*n 3"], Float[Array, "*n 3"]]:
        """Returns where points (…, 2) of the sheet, m, are in space, m, and unit normals.

        The normal is ∂x × ∂y: the side from which x turns to y anticlockwise. A flat sheet
        lies at z = 0. NaN stays NaN.

        **Example:**

        >>> import tomojax as tx
        >>> place, normal = tx.Sensor.grid().in_space([0.03, 0.05])
        >>> print(place, normal)
        [0.03 0.05 0.  ] [0. 0. 1.]
        """
        at = float_array("points", points, self.dtype)
        require(at.shape[-1:] == (2,), "points", f"shape {at.shape}", "(…, 2)")
        surface = self.surface or (lambda p: jnp.append(p, 0 * p[..., :1], -1))
        along = jnp.eye(2, dtype=at.dtype)
        ways = [
            jax.jvp(surface, (at,), (jnp.broadcast_to(way, at.shape),)) for way in along
        ]
        (place, x), (_, y) = ways
        normal = jnp.cross(x, y)
        return place, normal / jnp.sqrt((normal**2).sum(-1, keepdims=True))

    @property
    def electrode_count(self) -> int:
        """Returns the number of electrodes, M."""
        return self.electrode_xy.shape[0]

    @property
    def element_count(self) -> int:
        """Returns the number of elements, K = 2·nx·ny."""
        return 2 * self.divisions[0] * self.divisions[1]

    @property
    def dtype(self) -> Any:
        """Returns the dtype of this sensor's arrays and of the results from them."""
        return self.electrode_xy.dtype

    @property
    def mean_pitch(self) -> float:
        """Returns the pitch of a square grid with as many electrodes on the sheet, m."""
        area = np.prod(np.asarray(self.size)) if self.flat else self.area
        return float(np.sqrt(area / self.electrode_count))

    def all_grounds(self) -> np.ndarray:
        """Returns each electrode grounded once, in order: the paper's *All*.

        Of a sensor with `conditions`, the number of each.
        """
        return np.arange(self.condition_count)

    @property
    def condition_count(self) -> int:
        """Returns the number of ground conditions, L; M where each is an electrode."""
        table = self.conditions
        return self.electrode_count if table is None else table.shape[0]

    def ground_xy(self) -> Float[Array, "L 2"]:
        """Returns where each condition's current leaves in the mean, m."""
        if self.conditions is None:
            return self.electrode_xy
        share = self.conditions / self.conditions.sum(1, keepdims=True)
        return jnp.matmul(share, self.electrode_xy, precision="highest")

    def slots(self, electrodes: Any) -> Slots:
        """Returns the law of the ground conditions, from R_ee' (Ω): see `Slots`.

        Of an array of NumPy the law has NumPy's, in float64.
        """
        host = isinstance(electrodes, np.ndarray)
        as_told = (lambda a: np.asarray(a, float)) if host else jnp.asarray
        if self.conditions is None:
            return Grounds(electrodes, as_told(self.ground_resistance))
        table: Any = as_told(self.conditions)
        return conditions_of(electrodes, table)

    def __repr__(self) -> str:
        nx, ny = self.divisions
        return named(
            self,
            size=shown(self.size, "mm", 1e3),
            electrodes=shown(getattr(self.electrode_xy, "shape", (None,))[0]),
            electrode_diameter=shown(self.electrode_diameter, "mm", 1e3),
            sheet_resistance=shown(self.sheet_resistance, "Ω/sq"),
            ground_resistance=shown(self.ground_resistance, "Ω"),
            drive_voltage=shown(self.drive_voltage, "V"),
            **({} if self.outline is None else {"outline": repr(self.outline)}),
            **({} if self.surface is None else {"surface": repr(self.surface)}),
            mesh=f"{nx} × {ny}",
            dtype=str(getattr(self.electrode_xy, "dtype", None)),
        )

    def _repr_png_(self) -> bytes | None:
        """A notebook's picture: the sheet and its electrodes."""
        return png(lambda ax: sheet(self, ax))


def _whole_divisions(divisions: Any) -> tuple[int, int]:
    try:
        nx, ny = (operator.index(n) for n in divisions)
    except (TypeError, ValueError):
        nx = ny = 0
    require(
        min(nx, ny) >= 2, "divisions", repr(divisions), "two whole numbers of 2 or more"
    )
    return nx, ny


def nominal_noise(sensor: Sensor) -> float:
    """Returns the nominal noise of a reading, V rms.

    The noise is the larger of 10⁻⁴ of the drive and the rounding by the converter's codes:
    `resolution`/√12.

    **Example:**

    >>> import tomojax as tx
    >>> print(f"{1e3 * tx.sensor.nominal_noise(tx.Sensor.grid()):.2f} mV")
    0.45 mV
    """
    # Without a drive there is nothing to see; the noise divides, so that it is not 0.
    noise = NOISE * (abs(float(sensor.drive_voltage)) or 1.0)
    return max(noise, float(sensor.resolution) / np.sqrt(12))


def converter_of(sensor: Sensor) -> Converter:
    """Returns the paper's converter, 16 bits, with a range and a noise that suit the drive.

    **Example:**

    >>> import tomojax as tx
    >>> converter = tx.sensor.converter_of(tx.Sensor.grid(drive_voltage=9.0))
    >>> print(f"{float(converter.full_scale):.0f} V, {float(1e3 * converter.noise):.1f} mV")
    10 V, 0.6 mV
    """
    drive = abs(float(sensor.drive_voltage)) or 1.0
    # Beside it the noise of a reading has zeros and steps.
    return Converter(noise=2 / 3 * NOISE * drive, full_scale=drive / 0.9)


@eqx.filter_jit
def _inside(size: Array, outline: Any, at: Float[Array, "n 2"]) -> Bool[Array, " n"]:
    inside = ((at >= 0) & (at <= size)).all(-1)
    return inside if outline is None else inside & (outline.distance(at) < 0)
