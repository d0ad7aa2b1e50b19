"""Computes voltages of pairs, and how they change with the sheet's conductance.

A pair's voltage is wᵀR i: an ampere i enters and leaves by two electrodes, and w reads
between two. A change δσ of the sheet (S per square) adds −∫ δσ ∇u_w·∇u_i to the voltage,
where u_i = Σ i_e R_e(x) is the potential that the current makes, V per A, and u_w the
potential that the reading's electrodes would make.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tomojax._checks import checked, require
from tomojax._custom_types import Numbers
from tomojax._programs import kept
from tomojax.ert.recorded._pairs import Pairs
from tomojax.kernels.contacts import thin_rows_at
from tomojax.kernels.sheet import fem_fields, FemSheet, node_image, triangles
from tomojax.sensor import Sensor, sheet_on_mesh


class _Slots(NamedTuple):
    """`Pairs` as JAX takes them."""

    inject: Int[Array, "C 2"]
    read: Int[Array, "C R 2"]

    @classmethod
    def of(cls, sensor: Sensor, pairs: Pairs) -> "_Slots":
        pairs.within(sensor.electrode_count)
        return cls(jnp.asarray(pairs.inject), jnp.asarray(pairs.read))

    def voltages(self, table: Float[Array, "M M *n"]) -> Float[Array, "C R *n"]:
        """Computes wᵀ·table·i."""
        driven = table[:, self.inject[:, 0]] - table[:, self.inject[:, 1]]
        each = jnp.arange(len(self.inject))[:, None]
        plus, minus = self.read[..., 0], self.read[..., 1]
        return driven[plus, each] - driven[minus, each]


def background(sensor: Sensor, pairs: Pairs) -> Float[Array, "C R"]:
    """Computes the voltages of pairs on the sheet as it is, wᵀR i, V per A.

    **Raises:** `ValueError` for electrodes that the sensor does not have.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.disc(0.1, {"rim": 8}, electrode_diameter=0.01)
    >>> volts = tx.ert.background(sensor, tx.ert.Pairs.opposite(8))
    >>> volts.shape, float(volts[0, 0]) < 0  # nearer to where the current enters: minus
    ((8, 4), True)
    """
    return _voltages(_Slots.of(sensor, pairs), _fields(sensor)[0])


_voltages = jax.jit(_Slots.voltages)


# The mesh's factor: a program by itself, which does not know of pairs and places.
@kept
def _fields(sensor: Sensor) -> tuple[Float[Array, "M M"], Float[Array, "M nodes"]]:
    return fem_fields(sheet_on_mesh(sensor), sensor.divisions)


def sensitivities(sensor: Sensor, pairs: Pairs, places: Numbers) -> Float[Array, "n C R"]:
    """Computes what a small change of the sheet at a place adds: −∇u_w·∇u_i, 1/(A·S·m²)·V.

    The result times the change's conductance (S per square) and area (m²) is the change of
    the voltage, V per A. A small disc of radius a whose conductance is κ times the sheet's
    σ counts as 2πa²σ·(κ − 1)/(κ + 1) of these. Slopes come from a mesh's nodes by cubic
    interpolation: within two cells of an edge or an electrode they are rough.

    **Arguments:** `places` (n, 2), m, as the sensor has them: its box begins at 0.
    **Raises:** `ValueError` for places that are no numbers or leave the box.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.disc(0.1, {"rim": 8}, electrode_diameter=0.01)
    >>> pairs = tx.ert.Pairs.opposite(8)
    >>> tx.ert.sensitivities(sensor, pairs, [[0.05, 0.05], [0.03, 0.06]]).shape
    (2, 8, 4)
    """
    at = checked("places", places, "finite", (None, 2), dtype=sensor.dtype)
    host, size = np.asarray(at), np.asarray(sensor.size).tolist()
    inside = ((host >= 0) & (host <= sensor.size)).all()
    require(inside, "places", "some off the box", f"0 to {size} m, as the sensor has them")
    return _sensitivities(sensor, _fields(sensor)[1], _Slots.of(sensor, pairs), at)


@kept
def _sensitivities(
    sensor: Sensor,
    rows: Float[Array, "M nodes"],
    slots: _Slots,
    places: Float[Array, "n 2"],
) -> Float[Array, "n C R"]:
    shape = sensor.divisions
    numbers = node_image(np.arange((shape[0] + 1) * (shape[1] + 1)), shape)
    table = jnp.moveaxis(rows[:, numbers], 0, -1)

    def at_place(place: Float[Array, "2"]) -> Float[Array, "C R"]:
        slopes = thin_rows_at(table, sensor.size, place)[1:]  # ∂R_e, Ω/m
        inner = jnp.eye(2, dtype=place.dtype)
        if sensor.surface is not None:  # lengths in space, not in the chart
            along = jax.jacfwd(sensor.surface)(place)
            inner = jnp.linalg.inv(jnp.matmul(along.T, along, precision="highest"))
        product = jnp.einsum("im,ij,jn->mn", slopes, inner, slopes, precision="highest")
        return -slots.voltages(product)

    return jax.lax.map(at_place, places, batch_size=256)


def jacobian(sensor: Sensor, pairs: Pairs) -> Float[Array, "C R nx ny"]:
    """Computes how voltages change with the sheet's conductance, V per A per S per square.

    The entry of a cell of the mesh is −∫ ∇u_w·∇u_i over what is on the sheet of its two
    elements. The result is the derivative of `background`, exact on the mesh, electrodes'
    own resistances included.

    **Raises:** `ValueError` for electrodes that the sensor does not have.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.disc(0.1, {"rim": 8}, electrode_diameter=0.01)
    >>> tx.ert.jacobian(sensor, tx.ert.Pairs.opposite(8)).shape
    (8, 4, 30, 30)
    """
    return _jacobian(sensor, _Slots.of(sensor, pairs))


@kept
def _jacobian(sensor: Sensor, slots: _Slots) -> Float[Array, "C R nx ny"]:
    shape = sensor.divisions
    sheet = jnp.broadcast_to(1 / sensor.sheet_resistance, (sensor.element_count,))

    def on_mesh(sheet: Float[Array, " K"]) -> FemSheet:
        return sheet_on_mesh(eqx.tree_at(lambda s: s.sheet_resistance, sensor, 1 / sheet))

    fem, m = on_mesh(sheet), sensor.electrode_count

    # What electrodes lack on the mesh follows the sheet under them.
    def lacking(sheet: Float[Array, " K"]) -> Float[Array, " n"]:
        made = on_mesh(sheet)
        return jnp.concatenate([made.series, made.dipole_series])

    def fields(own: Float[Array, " n"]) -> tuple[Array, Array]:
        return fem_fields(fem._replace(series=own[:m], dipole_series=own[m:]), shape)

    own = jnp.concatenate([fem.series, fem.dipole_series])
    table, rows = jax.jacfwd(fields, has_aux=True)(own)
    by_own = jnp.matmul(
        slots.voltages(table), jax.jacrev(lacking)(sheet), precision="highest"
    )

    # Potentials are stationary: else only the elements' own stiffness counts.
    rows = rows[:, triangles(shape)]  # (M, K, 3)
    local = fem.local / sheet[:, None, None]

    def of_condition(pair: _Slots) -> Float[Array, "R K"]:
        (one, other), plus, minus = pair.inject, pair.read[:, 0], pair.read[:, 1]
        driven, read = rows[one] - rows[other], rows[plus] - rows[minus]
        return -jnp.einsum("rki,kij,kj->rk", read, local, driven, precision="highest")

    found = by_own + jax.lax.map(of_condition, slots)
    return found.reshape(*found.shape[:2], *shape, 2).sum(-1)
