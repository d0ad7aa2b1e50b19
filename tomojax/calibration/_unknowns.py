"""Orders the values that a calibration finds in a vector, with what is known before.

`slopes_by_rig` tells how voltages change with each unknown.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tomojax._require import require
from tomojax.kernels.contacts import field_at, Fitted, Sheet, thin_rows_at
from tomojax.kernels.sheet import Grounds, smooth_orders, volts_per_ampere
from tomojax.sensor import Calibration, make_moves, make_waves, nominal_noise, Sensor, WAVES

# What is known of a rig beforehand, 1 σ.
_GAIN = 1e-3
_ZERO = 1.1  # of the noise
_SHEET = 0.03  # of the longest wave; others' falls as their length does
_GROUND = 0.01  # of each ground path, of the sheet's resistance
_GROUNDS = 0.1  # of what all ground paths have in common
_OFF = 0.04  # of electrodes' places, of their diameter

# Zeros that were taken from contact-free slots are known so many times better.
_TARED = 10.0

# Half periods of the waves that are looked for.
MOST = max(WAVES.values())


class Unknowns(NamedTuple):
    """The vector θ of values: the range of each kind, and what is known of θ before."""

    parts: dict[str, slice]
    start: Float[np.ndarray, " P"]
    prior: Float[np.ndarray, "P P"]  # inverse covariance


def unknowns_of(sensor: Sensor, before: Calibration) -> Unknowns:
    """Builds the unknowns of a rig near `before`."""
    m, waves = sensor.electrode_count, len(smooth_orders(MOST))
    sizes = {"gain": m, "offset": m, "sheet": waves, "ground": m, "electrodes": 2 * m}
    ends = np.cumsum(list(sizes.values()))
    parts = {n: slice(e - k, e) for (n, k), e in zip(sizes.items(), ends)}
    start = np.zeros(ends[-1])
    for name in ("gain", "offset", "ground"):
        start[parts[name]] = getattr(before, name)
    start[parts["sheet"]] = all_waves(before.sheet)
    start[parts["electrodes"]] = np.broadcast_to(before.electrodes, (m, 2)).T.ravel()
    tared = 1 if np.size(before.offset) == 1 else _TARED
    rho = float(np.asarray(sensor.sheet_resistance).mean())
    variances = {
        "gain": _GAIN**2 * np.ones(m),
        "offset": (_ZERO * nominal_noise(sensor) / tared) ** 2 * np.ones(m),
        "sheet": (_SHEET / (smooth_orders(MOST) ** 2).sum(1)) ** 2,
        "ground": (rho * _GROUND) ** 2 * np.ones(m),
        "electrodes": (_OFF * float(sensor.electrode_diameter)) ** 2 * np.ones(2 * m),
    }
    known = np.diag(np.concatenate(list(variances.values())))
    known[parts["ground"], parts["ground"]] += (rho * _GROUNDS) ** 2
    return Unknowns(parts, start, np.linalg.inv(known))


def widened(unknowns: Unknowns, state: Float[np.ndarray, " P"]) -> Unknowns:
    """Widens the prior of electrodes' places, if a pass found them farther off."""
    at, prior = unknowns.parts["electrodes"], unknowns.prior.copy()
    square = float(np.mean((state - unknowns.start)[at] ** 2))
    prior[at, at] /= max(1.0, square * prior[at.start, at.start])
    return unknowns._replace(prior=prior)


def affine(places: Float[np.ndarray, "M 2"]) -> Float[np.ndarray, "N k"]:
    """Builds an orthonormal basis of affine maps' displacements, all x before all y."""
    one = np.column_stack([np.ones(len(places)), places - places.mean(0)])
    return np.kron(np.eye(2), np.linalg.qr(one)[0])


def all_waves(sheet: tuple[float, ...]) -> Float[np.ndarray, " q"]:
    """Lists a sheet's waves among all waves that are looked for."""
    every = [tuple(order) for order in smooth_orders(MOST)]
    found = np.zeros(len(every))
    for order, value in zip(smooth_orders(WAVES[len(sheet)]), sheet):
        found[every.index(tuple(order))] = value
    return found


def values_of(unknowns: Unknowns, state: Float[np.ndarray, " P"]) -> dict[str, tuple]:
    """Returns a state's values by their names in `Calibration`."""
    found = {n: tuple(state[at].tolist()) for n, at in unknowns.parts.items()}
    places = state[unknowns.parts["electrodes"]].reshape(2, -1).T
    return found | {"electrodes": tuple(map(tuple, places.tolist()))}


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
