"""Computes slopes of one contact's voltages by the values that a calibration finds."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tomojax._require import require
from tomojax.calibration._unknowns import MOST
from tomojax.kernels.contacts import field_at, Fitted, Sheet, thin_rows_at
from tomojax.kernels.sheet import Grounds, volts_per_ampere
from tomojax.sensor import make_moves, make_waves, Sensor


class RigSlopes(NamedTuple):
    """Slopes of the tables of potentials by the rig's values."""

    waves: Float[Array, "q nx ny M"]  # R_e by each wave of the sheet, Ω
    waves_among: Float[Array, "q M M"]  # R_ee'
    moves: Float[Array, "2 nx ny A M"]  # R_e by the place of electrode e, Ω/m
    moves_among: Float[Array, "2 M M"]  # R_ee' by that of e


def rig_slopes(sensor: Sensor) -> RigSlopes:
    """Computes slopes for nominal values: these hardly depend on the rig's errors.

    **Raises:** `ValueError` for a sensor with a table of conditions: a ground path's
    resistance is one unknown of a single ground, which conductances do not tell.
    """
    alone = sensor.conditions is None
    require(alone, "sensor", "a table of conditions", "one grounded electrode a slot")
    return RigSlopes(*make_waves(sensor, MOST), *make_moves(sensor))


def slopes_by_rig(
    sheet: Sheet, slopes: RigSlopes, grounds: Int[Array, " S"], fitted: Fitted
) -> Float[Array, "S M P"]:
    """Computes ∂V by gains, zeros, waves, resistances at grounds and electrodes' places.

    The order is that of `Unknowns`; the contact has current I at x: V_i = I·[R_i(x) −
    R_l(x) − R_il + R_ll + z_l].
    """
    volts, current = fitted.voltages, fitted.current  # (S, M), (S, 1)
    place, radius = fitted.place[0], fitted.radius[0]
    unit = jnp.eye(volts.shape[1], dtype=volts.dtype)
    own = unit[None]  # (1, M, M): of each channel its own unknown
    of_ground = unit[grounds][:, None]  # (S, 1, M): of all channels the ground's
    each = current[..., None]

    def wave(table: Array, among: Array) -> Float[Array, "S M"]:
        at = thin_rows_at(table, sheet.field.size, place)[0]
        return current * volts_per_ampere(Grounds(among, 0.0), at, grounds)

    waves = [wave(*pair) for pair in zip(slopes.waves, slopes.waves_among)]

    def move(table: Array, among: Array) -> Float[Array, "S M M"]:
        at = field_at(sheet.field._replace(values=table), place, radius)
        # R_i(x) − R_il by the place of i; R_ll − R_l(x) − R_li by that of l.
        by_own = (at - among[:, grounds].T)[..., None] * own
        level = 2 * jnp.diagonal(among)[grounds] - at[grounds]
        by_ground = (level[:, None] - among[grounds])[..., None] * of_ground
        return each * (by_own + by_ground)

    whole = volts[..., None] * own, jnp.broadcast_to(own, (*volts.shape, len(unit)))
    grounded = jnp.broadcast_to(each * of_ground, whole[0].shape)
    moved = [move(*pair) for pair in zip(slopes.moves, slopes.moves_among)]
    return jnp.concatenate([*whole, jnp.stack(waves, -1), grounded, *moved], -1)
