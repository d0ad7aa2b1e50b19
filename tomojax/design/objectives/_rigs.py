"""Simulates rigs that are nearly nominal: the truth for designs by simulation."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from tomojax._checks import checked, require
from tomojax._custom_types import Numbers
from tomojax._shown import tuple_shown
from tomojax.kernels.contacts import field_at, green_of, metallic, Sheet, solve_small
from tomojax.kernels.sheet import centroids, cosine_waves, Grounds
from tomojax.methods import sheet_of
from tomojax.sensor import converter_of, resistances, Sensor

# How rigs of scenes vary, 1 σ.
_SHEET = 0.02
_OFF = 0.015  # electrodes' places, of their diameter
GAIN = 5e-4

# The waves of a sheet: at most so many half periods along a side.
_WAVES = 4


@eqx.filter_jit  # as one program to compile
def varied(sensor: Sensor, key: Array) -> Sensor:
    """Varies a rig: its sheet in long waves, and its electrodes' places."""
    sheet, places = jax.random.split(key)
    middles = centroids(sensor.divisions, sensor.size).astype(sensor.dtype)
    orders = np.indices((_WAVES, _WAVES)).reshape(2, -1).T
    length = jnp.asarray(np.hypot(*orders.T), sensor.dtype).at[0].set(jnp.inf)
    strength = jax.random.normal(sheet, (_WAVES, _WAVES), sensor.dtype).ravel() / length
    waves = strength @ cosine_waves(middles, sensor.size, orders)
    part = 1 + _SHEET * waves / waves.std()
    spread = _OFF * sensor.electrode_diameter
    off = spread * jax.random.normal(places, sensor.electrode_xy.shape, sensor.dtype)
    return replace(
        sensor,
        sheet_resistance=sensor.sheet_resistance * part,
        electrode_xy=sensor.electrode_xy + off,
    )


class Difference(NamedTuple):
    """A rig's resistances less nominal ones, by elements: the mesh's own errors cancel."""

    electrodes: Float[Array, "M M"]
    elements: Float[Array, "M K"]


def differences(sensor: Sensor, keys: Array) -> Iterator[Difference]:
    """Yields the difference of a rig for each of the keys."""
    nominal = resistances(sensor, "fem")
    for key in keys:
        table = resistances(varied(sensor, key), "fem")
        yield Difference(
            table.electrodes - nominal.electrodes, table.elements - nominal.elements
        )


def disc_shares(
    sensor: Sensor, places: Float[np.ndarray, "P 2"], radius: float
) -> Float[Array, "K P"]:
    """Computes elements' shares of each disc's current; a small disc feeds the nearest."""
    middles = np.asarray(centroids(sensor.divisions, sensor.size))
    apart = np.hypot(*(middles[:, None] - places).transpose(2, 0, 1))
    inside = (apart <= np.maximum(radius, apart.min(0) * (1 + 1e-9))).astype(float)
    return jnp.asarray(inside / inside.sum(0), sensor.dtype)


class SimulatedScenes(NamedTuple):
    """Contacts and the voltages of all ground conditions.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = tx.design.design_places(sensor, count=4)
    >>> scenes = tx.design.simulate_scenes(sensor, places, rigs=1)
    >>> volts = scenes.voltages[:, tx.paper.exploration(sensor)]
    >>> volts.shape
    (4, 2, 16)
    """

    places: Float[Array, "P ..."]  # (P, 2), or (P, C, 2), m
    voltages: Float[Array, "P L M"]  # V

    def __repr__(self) -> str:
        return tuple_shown(self)


def simulate_scenes(
    sensor: Sensor,
    places: Numbers,
    *,
    radius: Numbers = 0.002,
    conductance: float = 1.0,
    rigs: int = 4,
    seed: int = 0,
) -> SimulatedScenes:
    """Simulates contacts (discs, m and S) at `places` on `rigs` that differ from `sensor`.

    Each rig's sheet varies by 2 % rms in waves of half a side and longer. Electrodes are
    off by 1.5 % of their diameter (75 µm of 5 mm), gains by 0.05 %. The 16-bit converter
    has 0.3 mV of noise for a drive of 4.5 V. Rigs take turns over the places. A contact of
    1 S holds the sheet at V0, as in Eq. 1.

    Contacts draw their current evenly, or as metal does, from an even sheet in closed form.
    A rig's difference is computed by elements. On a mesh alone, a contact that holds the
    sheet at V0 holds all touched nodes: such a contact is larger by an element. Metal that
    touches the grounded electrode leaves the sheet no current.

    **Arguments:** `places` (P, 2), or (P, C, 2) of C contacts at once; one `radius`, or a
    radius for each scene (P,).
    **Raises:** `ValueError` for other shapes, places off the sheet, radii and conductances
    not above 0, and `rigs` outside 1 to the scenes' number.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = tx.design.design_places(sensor, count=4)
    >>> scenes = tx.design.simulate_scenes(sensor, places, rigs=1)
    >>> scenes.places.shape, scenes.voltages.shape  # scenes, slots, channels
    ((4, 2), (4, 16, 16))
    """
    shapes, dtype = ((None, 2), (None, None, 2)), sensor.dtype
    given = checked("places", places, "finite", *shapes, dtype=dtype)
    at = np.asarray(given).reshape(len(given), -1, 2)
    off = int(((at < 0) | (at > np.asarray(sensor.size))).any(-1).sum())
    require(off == 0, "places", f"{off} off the sheet", "places on it")
    require(1 <= rigs <= len(at), "rigs", rigs, f"1 to {len(at)}, one scene each at least")
    radii = checked("radius", radius, "positive", (), (len(at),), dtype=dtype)
    checked("conductance", conductance, "positive")
    radii = np.broadcast_to(np.asarray(radii), len(at))
    away = np.linalg.norm(at[:, :, None] - np.asarray(sensor.electrode_xy), axis=-1)
    reach = radii + np.asarray(sensor.electrode_diameter) / 2
    touched = (away < reach[:, None, None]).any(1)
    sheet, converter = sheet_of(sensor), converter_of(sensor)
    found = np.empty((len(at), sensor.electrode_count, sensor.electrode_count))
    keys = jax.random.split(jax.random.key(seed), rigs)
    split = jax.vmap(lambda key: jax.random.split(key, 3))(keys)
    for number, more in enumerate(differences(sensor, split[:, 0])):
        # As many for each rig, for one compilation.
        turns = np.arange(number, len(at), rigs)
        some = np.resize(turns, -(-len(at) // rigs))
        shares = disc_shares(sensor, at[some].reshape(-1, 2), float(radii.mean()))
        there = np.asarray(more.elements) @ np.asarray(shares)
        there = there.T.reshape(*at[some].shape[:2], -1)
        drawn = at[some], radii[some], there, touched[some]
        exact = exact_on_rig(sheet, *drawn, more.electrodes, conductance)
        gains = 1 + GAIN * jax.random.normal(split[number, 1], found.shape[1:2])
        seen = converter(gains.astype(sensor.dtype) * exact, split[number, 2])
        found[turns] = seen[: len(turns)]
    return SimulatedScenes(given, jnp.asarray(found, sensor.dtype))


def _alone(sheet: Sheet) -> Grounds:
    """**Raises:** `ValueError` for a sensor with a table of conditions."""
    if not isinstance(sheet.slots, Grounds):
        raise ValueError(
            "sensor: got a table of conditions, expected grounds of one electrode each; "
            "tomojax.voltages simulates scenes of such a table"
        )
    return sheet.slots


@jax.jit
def exact_on_rig(
    sheet: Sheet,
    places: Float[Array, "n C 2"],
    radii: Float[Array, " n"],
    there: Float[Array, "n C M"],
    touched: Bool[Array, "n M"],
    electrodes: Float[Array, "M M"],
    conductance: Array | float,
) -> Float[Array, "n L M"]:
    """Computes voltages of contacts at V0 behind 1/`conductance`; `there` and `electrodes`
    are the rig's R_m(x_c) and R_mn less the sheet's."""
    each = sheet.field.electrodes + electrodes
    grounds = jnp.arange(len(each))
    slots = _alone(sheet)._replace(electrodes=each)
    own, columns = slots.path(grounds), slots.offset(grounds)
    # Metal's current is at its rim: as an even disc's that is larger by e^¼.
    metal = metallic(sheet, conductance)
    larger = jnp.exp(metal / 4)
    z = jnp.broadcast_to(slots.resistance, own.shape)
    short = sheet.drive_voltage * z / (z + 1 / conductance)

    def scene(some: tuple[Array, Array, Array, Array]) -> Float[Array, "L M"]:
        place, radius, more, touched = some
        radius = jnp.broadcast_to(radius * larger, place.shape[:1])
        potential = jax.vmap(field_at, (None, 0, 0))(sheet.field, place, radius) + more
        among = jax.vmap(green_of(sheet, place, radius))(place)
        among = among + jnp.eye(len(place), dtype=among.dtype) / conductance

        def slot(ground: Array) -> Float[Array, " M"]:
            at_ground = potential[:, ground]
            loop = among - at_ground - at_ground[:, None] + own[ground]
            drive = jnp.broadcast_to(sheet.drive_voltage, (len(place), 1))
            current = solve_small(loop, drive)[:, 0]
            volts: Array = current @ (potential - at_ground[:, None] + columns[ground])
            return jnp.where(touched[ground] & (metal > 0.5), short[ground], volts)

        return jax.vmap(slot)(grounds)

    return jax.lax.map(scene, (places, radii, there, touched))
