"""Chooses ground patterns: the electrodes that a scan grounds, in order."""

from typing import cast, get_args, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tomojax._checks import checked, float_array, known, require, require_shape
from tomojax._custom_types import Numbers
from tomojax.kernels.flags import Flag
from tomojax.kernels.scan import (
    around,
    contact_region,
    contact_regions,
    cop_line,
    electrode_currents,
    nearest_electrodes,
    point,
    Region,
    smallest_pitch,
)
from tomojax.sensor import AbstractEdge, resistances, Sensor

AdaptivePattern = Literal["around", "cop_line", "point"]

# The paper's order, Table I.
PATTERNS: tuple[str, ...] = (
    "all",
    "around",
    "cop_line",
    "point",
    "boundary",
    "v_line",
    "edge",
    "random_16",
    "random_8",
)

# Best by the paper's weighted score of resolution and speed (Fig. 4, from Table I) when
# only resolution counts, only speed, and both alike.
PURPOSES: dict[str, str] = {"spatial": "all", "temporal": "point", "balanced": "around"}

_EACH_AT_MOST = 4  # contacts that "around_each" looks for


def pattern(
    sensor: Sensor,
    name: str,
    voltages: Numbers | None = None,
    *,
    alpha: Numbers = 95.0,
    threshold: Numbers | None = None,
    seed: int = 0,
) -> Int[Array, " L"]:
    """Lists the electrodes that a pattern grounds, for any array of electrodes.

    **Arguments:** `name`:

    - "all"; "boundary": the array's outline, on a sheet with an outline the electrodes next
      to its edge, a hole's too; "edge": electrodes of least x, within half a
      pitch; "v_line": the column nearest to the array's middle in x (a vertical line where
      x is horizontal), half a pitch to each side;
      "random_16", "random_8": so many, drawn with `seed`;
    - of a sensor with `conditions`: those whose current leaves at these places;
    - from exploratory `voltages` (2, M) under the grounds of `exploration`: "around",
      "cop_line", "point" as `AdaptiveScan` gives them, and "around_each": a box around
      each of up to four contacts, every electrode once;
    - a purpose: "spatial" (all), "balanced" (around) or "temporal" (point).

    `alpha` and `threshold` as in `AdaptiveScan`.
    **Raises:** `ValueError` for an unknown name, missing or NaN voltages, α outside
    (0, 100], and a random pattern of more electrodes than there are.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> print(tx.pattern(sensor, "edge"))
    [0 1 2 3]
    >>> touch = tx.Disc([0.03, 0.05], 0.006, 1.0)
    >>> explored = tx.voltages(sensor, touch, tx.paper.exploration(sensor))  # two slots
    >>> tx.pattern(sensor, "around", explored).shape
    (8,)
    """
    names = (*PATTERNS, "around_each", *PURPOSES)
    require(name in names, "name", repr(name), f"one of {', '.join(names)}")
    name = PURPOSES.get(name, name)
    if name not in (*get_args(AdaptivePattern), "around_each"):
        return jnp.asarray(_fixed(sensor, name, seed))
    if voltages is None:
        raise ValueError(f"voltages: got None, expected exploratory voltages for {name!r}")
    each = name == "around_each"
    scan = AdaptiveScan(
        sensor,
        "around" if each else cast(AdaptivePattern, name),
        alpha=alpha,
        threshold=threshold,
    )
    shape, dtype = (2, sensor.electrode_count), sensor.dtype
    explored = checked("voltages", voltages, "finite", shape, dtype=dtype)
    if not each:
        return scan(explored)[0]
    grounds, regions = scan.around_each(explored, _EACH_AT_MOST)
    found = (np.asarray(regions.flags) & Flag.NO_CONTACT) == 0
    # Without any contact, the box around the middle.
    chosen = np.asarray(grounds)[found if found.any() else [0]]
    return jnp.asarray(list(dict.fromkeys(chosen.ravel().tolist())))


def exploration(sensor: Sensor) -> Int[Array, "2"]:
    """Returns two exploratory grounds: opposite corners of the array (the paper's 1, 64).

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> print(tx.paper.exploration(sensor))
    [ 0 15]
    """
    return _corners(sensor.ground_xy())[::3]


class AdaptiveScan(eqx.Module):
    """The paper's adaptive scan (II.D): from exploratory voltages to the next grounds.

    `scan(voltages)` is compiled code of fixed output size that can run inside a step.

    **Arguments:** `sensor`; `name` "around" (8), "cop_line" (8) or "point" (6); `alpha`
    α: electrodes whose summed voltage is at least α percent of the highest are in contact;
    `threshold`: summed volts below which nothing touches, 1/450 of the drive by default.

    The principal direction is that of `electrode_currents`; the paper takes that of the
    electrodes in contact. On a recorded spanner at 35° the currents give 36°, and the
    electrodes give 18°. Of a sensor with `conditions` the grounds are those whose current
    leaves at the places that the pattern asks for (`Sensor.ground_xy`).

    Without a contact, or with NaN voltages, the scan is that around the array's middle, and
    the region's flags say so.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> scan = tx.paper.AdaptiveScan(sensor, "around")
    >>> touch = tx.Disc([0.03, 0.05], 0.006, 1.0)
    >>> grounds, region = scan(tx.voltages(sensor, touch, tx.paper.exploration(sensor)))
    >>> grounds.shape
    (8,)
    >>> int(region.centre)  # the electrode next to the contact
    6
    """

    electrode_xy: Float[Array, "M 2"]
    ground_xy: Float[Array, "L 2"]  # where each condition's current leaves
    shares: Float[Array, "L M"] | None  # of a condition's conductance, by electrode
    resistances: Float[Array, "M M"]  # R_ee'
    corners: Int[Array, "4"]
    alpha: Float[Array, ""]
    threshold: Float[Array, ""]
    name: AdaptivePattern = eqx.field(static=True)

    def __init__(
        self,
        sensor: Sensor,
        name: AdaptivePattern = "cop_line",
        *,
        alpha: Numbers = 95.0,
        threshold: Numbers | None = None,
    ):
        adaptive = get_args(AdaptivePattern)
        require(name in adaptive, "name", repr(name), f"one of {', '.join(adaptive)}")
        enough = min(sensor.electrode_count, sensor.condition_count) >= 6
        require(enough, "sensor", sensor, "six electrodes and ground conditions or more")
        self.alpha = float_array("alpha", alpha, sensor.dtype)
        require_shape("alpha", self.alpha, ())
        if known(self.alpha):
            percent = float(self.alpha)
            require(0 < percent <= 100, "alpha", percent, "a percentage in (0, 100]")
        if threshold is None:
            threshold = jnp.abs(sensor.drive_voltage) / 450  # some 20 times the noise
        self.threshold = checked("threshold", threshold, "finite", (), dtype=sensor.dtype)
        self.electrode_xy = sensor.electrode_xy
        self.resistances = resistances(sensor).electrodes
        self.ground_xy = sensor.ground_xy()
        self.corners = _corners(self.ground_xy)
        table = sensor.conditions
        self.shares = None if table is None else table / table.sum(1, keepdims=True)
        self.name = name

    @jax.jit
    def __call__(self, voltages: Float[Array, "E M"]) -> tuple[Int[Array, " L"], Region]:
        """Returns ground conditions and the region that they come from."""
        region, pitch = self.region(voltages), smallest_pitch(self.electrode_xy)
        centre = self.electrode_xy[region.centre]
        if self.name == "around":
            return around(region, self.ground_xy, pitch), region
        if self.name == "cop_line":
            return cop_line(region, self.ground_xy, centre, pitch), region
        if self.shares is not None:  # a condition's voltage is its electrodes'
            voltages = jnp.matmul(voltages, self.shares.T, precision="highest")
        return point(voltages, self.corners), region

    def region(self, voltages: Float[Array, "E M"]) -> Region:
        """Finds the centre of contact, electrodes in contact, box, direction, flags."""
        currents = electrode_currents(self.resistances, voltages)
        return contact_region(
            voltages, self.electrode_xy, self.alpha, self.threshold, currents
        )

    @eqx.filter_jit
    def around_each(
        self, voltages: Float[Array, "E M"], count: int
    ) -> tuple[Int[Array, "C 8"], Region]:
        """Returns a box per contact, of up to `count`; absent contacts have NO_CONTACT."""
        currents = electrode_currents(self.resistances, voltages)
        regions = contact_regions(
            voltages, self.electrode_xy, currents, self.threshold, count
        )
        pitch = smallest_pitch(self.electrode_xy)
        box = lambda region: around(region, self.ground_xy, pitch)  # noqa: E731
        return jax.vmap(box)(regions), regions


@jax.jit  # as one program to compile
def _corners(xy: Float[Array, "M 2"]) -> Int[Array, "4"]:
    low, high = xy.min(0), xy.max(0)
    mixed = [low, jnp.stack([low[0], high[1]]), jnp.stack([high[0], low[1]]), high]
    return nearest_electrodes(jnp.stack(mixed), xy)


def _fixed(sensor: Sensor, name: str, seed: int) -> np.ndarray:
    xy = np.asarray(sensor.ground_xy(), float)
    # The usual way to the next electrode: two of a rim and a grid may be nearly in touch.
    places = np.asarray(sensor.electrode_xy, float)
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    pitch = float(np.median(np.sort(apart, 1)[:, 1]))
    near, half = 0.1 * pitch, 0.5 * pitch
    if name == "all":
        return sensor.all_grounds()
    if name == "edge":
        # Half a pitch: both columns of a hexagon grid's side, three of a rim.
        return np.flatnonzero(xy[:, 0] <= xy[:, 0].min() + half * (1 + 1e-3))
    if name == "v_line":
        away = np.abs(xy[:, 0] - (xy[:, 0].min() + xy[:, 0].max()) / 2)
        closest = xy[np.argmin(np.round(away / near)), 0]
        # As for *CoP line*: half-way between two lines is neither.
        return np.flatnonzero(np.abs(xy[:, 0] - closest) <= half * (1 - 1e-3))
    if name == "boundary" and sensor.outline is not None:
        # No other electrode is nearer to the place on the edge that is nearest to it.
        return _along_edge(sensor.outline, sensor.ground_xy(), pitch)
    if name == "boundary":
        # Outermost in some direction: the corners and sides of the convex hull.
        angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
        reach = xy @ np.stack([np.cos(angle), np.sin(angle)])
        return np.flatnonzero((reach >= reach.max(0) - near / 100).any(1))
    count = int(name.removeprefix("random_"))
    m = sensor.condition_count
    require(count <= m, "name", repr(name), f"no more than the {m} electrodes")
    return np.random.default_rng(seed).choice(m, count, replace=False)


def _along_edge(
    outline: AbstractEdge, places: Float[Array, "L 2"], pitch: float
) -> np.ndarray:
    """Lists the electrodes of which no other is nearer to their place on the edge."""
    # Half-way between two edges there is no slope: a little aside there is.
    aside = places + 1e-3 * pitch * jnp.array([0.6, 0.8], places.dtype)
    level, slope = jax.vmap(jax.value_and_grad(outline.distance))(aside)
    edge = np.asarray(aside - level[:, None] * slope, float)
    apart = ((edge[:, None] - np.asarray(places, float)) ** 2).sum(-1)
    return np.flatnonzero(np.diagonal(apart) <= apart.min(1) * (1 + 1e-6) + 1e-12)
