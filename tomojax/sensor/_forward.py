"""Turns a sensor and a scene into resistances, Jacobians and voltages."""

from collections.abc import Callable
from dataclasses import replace
from typing import cast, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tomojax._checks import checked, float_array, known, require, require_indices
from tomojax._custom_types import Numbers
from tomojax._programs import kept
from tomojax._require import require_kind
from tomojax.kernels.sheet import (
    conditions_of,
    ContactReduction,
    element_area,
    element_areas,
    fem_contact,
    fem_resistances,
    fem_sheet,
    FemSheet,
    ground_voltages,
    rectangle_resistances,
    Resistances,
    site_conductance,
    slot_jacobian,
    Slots,
    subpoints,
)
from tomojax.sensor._converter import Converter
from tomojax.sensor._outline import AbstractShape
from tomojax.sensor._placing import check_conditions, require_on_sheet
from tomojax.sensor._sensor import Sensor

Route = Literal["fem", "series"]
Contact = AbstractShape | Numbers | Callable[[Array], AbstractShape]

# Each element is sampled at 4^2 points: a cell's side is resolved to an eighth.
_LEVEL = 2


def resistances(sensor: Sensor, route: Route = "fem") -> Resistances:
    """Computes the transfer resistances R_ee (M, M), R_ek (M, K), R_kk (K,), Ω.

    `route` "fem" solves on the sensor's mesh, for any sheet. "series" sums the cosine
    series of a homogeneous sheet, with no mesh error. An element in "fem" is
    (1/3, 1/3, 1/3) on three vertices, which acts like a disc about twice as wide as the
    true triangle's. An element in "series" is a disc of the element's area. So R_kk differs
    by about 0.7·(sheet resistance)/2π; all else agrees to the mesh's error.

    **Raises:** `ValueError` for "series" on a sheet with a value per element.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> table = tx.sensor.resistances(sensor)
    >>> table.electrodes.shape, table.elements.shape, table.own.shape
    ((16, 16), (16, 512), (512,))
    >>> bool(abs(table.electrodes - table.electrodes.T).max() < 1.0)  # reciprocity
    True
    """
    require(route in ("fem", "series"), "route", repr(route), "'fem' or 'series'")
    if route == "series":
        shape = sensor.sheet_resistance.shape
        require(shape == (), "sheet_resistance", f"shape {shape}", "one value for 'series'")
        require(sensor.even, "route", repr(route), "'fem' for a sheet that is no rectangle")
    return compiled_resistances(sensor, route)


@kept
def compiled_resistances(sensor: Sensor, route: Route) -> Resistances:
    if route == "series":
        return rectangle_resistances(
            sensor.sheet_resistance,
            sensor.electrode_xy,
            sensor.electrode_diameter / 2,
            sensor.divisions,
            sensor.size,
            sensor.electrode_shunt,
        )
    nominal = replace(sensor, told=None)
    table = fem_resistances(sheet_on_mesh(nominal), sensor.divisions)
    part = sensor.parts()
    if part is not None:
        # Off the sheet, and in slivers at its edge, it is of no sheet and without bound.
        most = jnp.max(table.own, where=part > 0.5, initial=0)
        table = table._replace(own=jnp.minimum(table.own, most))
    if sensor.told is None:
        return table
    cells = table.elements.reshape(-1, *sensor.divisions, 2)
    ee, more = sensor.told.beside(table.electrodes, cells.mean(-1), 0.5)
    elements = (cells + more[..., None]).reshape(table.elements.shape)
    return Resistances(table.electrodes + ee, elements, table.own)


def sheet_on_mesh(sensor: Sensor) -> FemSheet:
    """Puts the sheet and its electrodes on the sensor's mesh.

    **Raises:** `ValueError` for a `ToldSheet`: no mesh has its resistances.

    **Example:**

    >>> import jax
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> sheet = jax.jit(tx.sensor.sheet_on_mesh)(sensor)
    >>> sheet.local.shape, sheet.feeds.shape  # (K, 3, 3) S and (nodes, M)
    ((512, 3, 3), (289, 16))
    """
    what = "'linear', 'source', 'points' or 'auto', which ask for no more than is told"
    require(sensor.told is None, "told", "resistances of electrodes alone", what)
    return fem_sheet(
        1 / jnp.broadcast_to(sensor.sheet_resistance, (sensor.element_count,)),
        sensor.electrode_xy,
        sensor.electrode_diameter / 2,
        sensor.divisions,
        sensor.size,
        sensor.electrode_shunt,
        sensor.skin,
    )


def ground_set(
    sensor: Sensor, grounds: Numbers | None
) -> Int[Array, " L"] | Float[Array, "L M"]:
    """Checks `grounds`: electrode numbers (L,), or conductances to ground (L, M), S.

    None stands for every electrode once, in order.

    **Raises:** `ValueError` for an empty set, numbers out of range, negative or NaN
    conductances, or a shape that does not fit.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> print(tx.sensor.ground_set(sensor, [0, 15]))
    [ 0 15]
    >>> tx.sensor.ground_set(sensor, None).shape  # every electrode once
    (16,)
    >>> tx.sensor.ground_set(sensor, [16])
    Traceback (most recent call last):
        ...
    ValueError: grounds: got 16 to 16, expected 0 to 15
    """
    require_kind("sensor", sensor, Sensor)
    if grounds is None:
        return jnp.asarray(sensor.all_grounds())
    array = grounds if not known(grounds) else np.asarray(grounds)
    if known(array):
        numbers = np.asarray(array).dtype.kind in "iuf"
        numbers &= np.asarray(array).dtype.kind != "f" or np.ndim(array) == 2
        wanted = "whole numbers of electrodes, or a table of conductances"
        require(numbers, "grounds", repr(grounds), wanted)
    if jnp.issubdtype(jnp.result_type(array), jnp.integer):
        array = jnp.asarray(array)
        require_indices("grounds", array, sensor.condition_count)
        return array
    array = float_array("grounds", grounds, sensor.dtype)
    check_conditions("grounds", array, sensor.electrode_count)
    return array


def jacobian(
    sensor: Sensor,
    grounds: Numbers | None = None,
    contact_resistance: Numbers = 0.0,
    route: Route = "fem",
) -> Float[Array, "L M K"]:
    """Computes J^l_ik(ρ): volts at electrode i per volt of an object on element k alone.

    J^l_ik(ρ) = T^l_ik / (ρ + R_kk + R_ll − 2R_lk + z). The paper's Eq. 1 has ρ = 0, a
    potential imposed at element k. A fixed current is ρ·J(ρ) → T for ρ → ∞.

    **Arguments:** `grounds` as in `ground_set`; `contact_resistance` ρ in Ω, one value
    or one per element; `route` as in `resistances`.
    **Returns:** (L, M, K). An element that coincides with the grounded electrode at
    ρ = z = 0, where the formula is 0/0, gives 0. An element over an electrode is read as
    the mean of its vertices too. So a small ρ makes J leave [0, 1] within two feed widths
    of the grounded electrode (5 mm on the default sensor). A contact on the metal would
    not: `voltages` puts such contacts on the metal.
    **Raises:** `ValueError` as `ground_set`, and for a negative or NaN ρ.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> tx.jacobian(sensor, [0, 15]).shape  # slots, electrodes, elements
    (2, 16, 512)
    >>> soft = tx.jacobian(sensor, [0, 15], 2e5)  # behind 200 kΩ
    >>> bool(soft.max() < 0.5)
    True
    """
    rho, shapes = contact_resistance, ((), (sensor.element_count,))
    rho = checked("contact_resistance", rho, "not negative", *shapes, dtype=sensor.dtype)
    slots = ground_set(sensor, grounds)
    return _jacobian(sensor, slots, rho, resistances(sensor, route))


@eqx.filter_jit
def _jacobian(
    sensor: Sensor, grounds: Array, rho: Array, table: Resistances
) -> Float[Array, "L M K"]:
    slots, which = law_of(sensor, grounds, table.electrodes)
    found, part = slot_jacobian(table, slots, which, rho), sensor.parts()
    return found if part is None else jnp.where(part > 0, found, 0)


def law_of(
    sensor: Sensor, grounds: Array, electrodes: Array
) -> tuple[Slots, Int[Array, " L"]]:
    """Returns the law of slots and their numbers in it, for grounds as `ground_set` has."""
    if grounds.ndim == 2:
        return conditions_of(electrodes, grounds), jnp.arange(len(grounds))
    return sensor.slots(electrodes), grounds


def contact_conductance(sensor: Sensor, scene: AbstractShape) -> Float[Array, " K"]:
    """Computes a scene's conductance (S) on each element: S/m² at 16 points, times area.

    **Raises:** `ValueError` for a shape of which no part lies on the sheet.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> siemens = tx.sensor.contact_conductance(sensor, tx.Disc([0.03, 0.05], 0.006, 0.5))
    >>> siemens.shape
    (512,)
    >>> print(f"{1e6 * float(siemens.sum()):.0f} µS")  # 0.5 S/m² on π·(6 mm)²
    57 µS
    """
    require_on_sheet(sensor.size, scene, sensor.outline)
    return _contact_conductance(sensor, scene)


@eqx.filter_jit
def _contact_conductance(sensor: Sensor, scene: AbstractShape) -> Float[Array, " K"]:
    points = subpoints(sensor.divisions, sensor.size, _LEVEL)
    blur = jnp.sqrt(element_area(sensor.divisions, sensor.size) / points.shape[1])
    area = element_areas(sensor.skin, sensor.divisions, sensor.size)
    cast = lambda a: a.astype(sensor.dtype) if eqx.is_inexact_array(a) else a  # noqa: E731
    density = jax.tree.map(cast, scene).density(points, blur, sensor.size)
    return density.mean(1) * area


def voltages(
    sensor: Sensor,
    scene: Contact,
    grounds: Numbers | None = None,
    *,
    times: Numbers | None = None,
    converter: Converter | None = None,
    key: Array | None = None,
) -> Float[Array, "L M"]:
    """Computes voltages (V) of all M electrodes under each ground condition, exactly.

    The solve is of the loaded sheet. Currents g(V0 − u) enter wherever the object touches,
    at the mesh's nodes, and at the metal of electrodes. One factorisation serves every
    ground condition. Voltages are between 0 and V0, as long as electrodes are small beside
    their distance to the edge. A disc one diameter from the edge was seen to read −1 %. A
    contact that conducts far better than the sheet holds all nodes that it touches. A disc
    of 2 mm and 1 S acted like one larger by about an element (`simulate_scenes` does not).

    **Arguments:**

    - `scene`: a shape or `Scene`, or conductances (K,) in S per element. If `times` are
      given: a function of time that returns a shape, such as `sensor.Moving`.
    - `grounds`: electrode numbers (L,), or conductances to ground (L, M) in S for
      several or partial grounds (the sensor's `ground_resistance` is then not used).
      None stands for every electrode once. Of a sensor with `conditions`, their numbers.
    - `times` (L,): when each slot is read, s; each slot then has a scene of its own.
    - `converter`: noise and quantisation; a converter with noise needs a `key`.

    **Returns:** (L, M). **Raises:** `ValueError` that names the argument; also for a shape
    that lies off the sheet (lengths are in metres).

    **Example:**

    >>> import jax
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> touch = tx.Disc([0.03, 0.05], 0.006, 1.0)
    >>> volts = tx.voltages(sensor, touch, [0, 15])  # two slots
    >>> print(volts.argmax(1))  # the electrode next to the contact, in both
    [6 6]
    >>> key = jax.random.key(0)
    >>> read = tx.voltages(sensor, touch, [0, 15], converter=tx.Converter(), key=key)
    >>> bool(0 < abs(read - volts).max() < 3e-3)  # its noise
    True
    """
    slots, dtype = ground_set(sensor, grounds), sensor.dtype
    if times is not None:
        when = checked("times", times, "finite", (len(slots),), dtype=dtype)
        kind = type(scene).__name__
        require(callable(scene), "scene", kind, "a function of time with times")
        exact = _moving_voltages(sensor, cast(Callable, scene), slots, when)
    elif isinstance(scene, AbstractShape):
        exact = exact_voltages(sensor, contact_conductance(sensor, scene), slots)
    elif callable(scene):
        raise ValueError("times: got None, expected the time of each slot")
    else:
        shape = (sensor.element_count,)
        g = checked("scene", scene, "not negative", shape, dtype=dtype)
        exact = exact_voltages(sensor, g, slots)
    if converter is None:
        return exact
    require_kind("converter", converter, Converter)
    return converter(exact, key)


def exact_voltages(sensor: Sensor, g: Float[Array, " K"], grounds: Array) -> Array:
    return _under(sensor, _touched(sensor, g), grounds)


# The mesh's factor: a program by itself, whose shapes no number of grounds changes.
@eqx.filter_jit
def _touched(sensor: Sensor, g: Float[Array, " K"]) -> ContactReduction:
    fem = sheet_on_mesh(sensor)
    return fem_contact(fem, site_conductance(fem, g, sensor.divisions), sensor.divisions)


@eqx.filter_jit
def _under(sensor: Sensor, contact: ContactReduction, grounds: Array) -> Array:
    law = law_of(sensor, grounds, contact.resistance)
    return ground_voltages(contact, *law, sensor.drive_voltage)


@eqx.filter_jit
def _moving_voltages(
    sensor: Sensor, scene: Callable[[Array], AbstractShape], grounds: Array, times: Array
) -> Array:
    def slot(ground_and_time: tuple[Array, Array]) -> Array:
        ground, time = ground_and_time
        g = contact_conductance(sensor, scene(time))
        return exact_voltages(sensor, g, ground[None])[0]

    return jax.lax.map(slot, (grounds, times))
