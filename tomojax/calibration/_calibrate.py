"""A rig's gains, zeros and sheet, from contacts at known places."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Integer

from tomojax._custom_types import Numbers
from tomojax._require import require
from tomojax.kernels import contacts as model
from tomojax.kernels.algebra import least_squares, solve_positive
from tomojax.kernels.contacts import field_at, slot_columns, whitened_columns
from tomojax.kernels.sheet import smooth_modes
from tomojax.methods import fitting_of, method as make_method, Points, UNIT
from tomojax.sensor import Calibration, make_variation, nominal_noise, Sensor

# What is known of a rig beforehand, 1 σ: gains, zeros (of the noise), the sheet's longest
# wave (which falls as the wave's length does), places (of the pitch), and resistances at
# grounds: of each, and what all have in common, of the sheet's resistance.
_GAIN, _ZERO, _SHEET, _PLACE, _GROUND, _GROUNDS = 1e-3, 1.1, 0.03, 0.005, 0.01, 0.1

# What is never believed to be known better, of what nominal values leave.
_LEAST = 0.1

# Mesh that a sheet is told on, and a step of each wave.
_MESH, _STEP = (32, 32), 0.02

# Passes (the sheet's effect is not quite linear), steps of a contact's own fit, and frames
# of a compiled call.
_PASSES, _STEPS, _FRAMES = 2, 12, 64


class Known(NamedTuple):
    """Frames with one contact each, at a known place."""

    voltages: Float[np.ndarray, "n S M"]
    grounds: Integer[np.ndarray, "n S"]
    places: Float[np.ndarray, "n 2"]


class _Waves(NamedTuple):
    """What each wave of the sheet adds to the field, per unit."""

    values: Float[Array, "q nx ny A M"]
    electrodes: Float[Array, "q M M"]


def calibrate(
    sensor: Sensor,
    voltages: Numbers,  # (n, S, M)
    grounds: Numbers,  # (n, S)
    places: Numbers,  # (n, 2)
    calibration: Calibration | None = None,
) -> Calibration:
    """Gains and zeros of the channels and waves of the sheet, from known places.

    One round contact in each of n frames of S slots, at `places` (m, known to 0.1 mm);
    its size and its currents are found. The likeliest values given what is usual: linear
    least squares with priors, twice, since the sheet's effect is not quite linear.

    **Arguments:** `voltages` V, as read; `calibration` what is known (zeros and noise by
    `tare`, for one), nominal by default.
    **Raises:** `ValueError` for shapes that do not fit, values that are no numbers or
    places off the sheet.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(2, 2, divisions=(8, 8), dtype=np.float32)
    >>> places = np.random.default_rng(0).uniform(0.015, 0.025, (16, 2))
    >>> volts = np.stack([tx.voltages(sensor, tx.Disc(xy, 0.005, 1.0)) for xy in places])
    >>> frames, grounds = volts.reshape(64, 1, 4), np.tile(np.arange(4), 16)[:, None]
    >>> known = tx.calibration.calibrate(sensor, frames, grounds, places.repeat(4, 0))
    >>> len(known.gain), len(known.sheet), known.error <= 1
    (4, 14, True)
    """
    known = _checked(sensor, voltages, grounds, places)
    before = calibration or Calibration()
    rho = float(np.asarray(sensor.sheet_resistance).mean())
    waves, now = _waves(sensor), before
    sums = _sums(_points(sensor, now), waves, known, now)
    start = sums[2]
    for _ in range(_PASSES):
        now = _solved(sums[0], sums[1], now, before, rho, nominal_noise(sensor))
        sums = _sums(_points(sensor, now), waves, known, now)
    error = float(np.clip(np.sqrt(sums[2] / start), _LEAST, 1))
    return replace(now, error=error * before.error)


def _points(sensor: Sensor, calibration: Calibration) -> Points:
    points = make_method(sensor, "points", 32, calibration)
    assert isinstance(points, Points)
    return points


def _checked(sensor, voltages, grounds, places) -> Known:
    m, v = sensor.electrode_count, np.asarray(voltages)
    grounds, places = np.asarray(grounds), np.asarray(places, float)
    fits = v.ndim == 3 and v.shape[2] == m and len(v) > 0
    require(fits, "voltages", f"shape {v.shape}", f"(frames, slots, {m})")
    require(grounds.shape == v.shape[:2], "grounds", grounds.shape, f"{v.shape[:2]}")
    inside = grounds.dtype.kind in "iu" and grounds.min() >= 0 and grounds.max() < m
    require(bool(inside), "grounds", "an electrode that is none", f"0 to {m - 1}")
    require(places.shape == (len(v), 2), "places", places.shape, f"{(len(v), 2)}")
    size = np.asarray(sensor.size)
    on = np.isfinite(places).all() and (places >= 0).all() and (places <= size).all()
    require(bool(on), "places", "some off the sheet", f"0 to {size.tolist()} m")
    require(bool(np.isfinite(v).all()), "voltages", "some that are no numbers", "volts")
    return Known(v, grounds, places)


def _waves(sensor: Sensor) -> _Waves:
    """By differences: a wave of the sheet at a time."""
    count = len(Calibration().sheet)
    found = []
    for k in range(count):
        sheet = tuple(_STEP * (np.arange(count) == k))
        found.append(make_variation(Calibration(sheet=sheet).sensor(sensor, _MESH)))
    steps = [(f.values, f.electrodes) for f in found]
    return _Waves(*(jnp.stack(a) / _STEP for a in zip(*steps)))


def _sums(points, waves, known: Known, calibration) -> tuple:
    """Normal matrix, right side and Σ of the misfit, over all frames."""
    used = np.ones(known.voltages.shape[1:], bool)
    prepared = points.prepare(known.grounds[0], used, 1.0)
    dtype = points.errors.noise.dtype
    volts = calibration.voltages(known.voltages.astype(float))
    total: tuple | None = None
    for k in range(0, len(volts), _FRAMES):
        part = np.arange(k, k + _FRAMES)
        weight = jnp.asarray(part < len(volts), dtype)
        part = np.minimum(part, len(volts) - 1)
        sums = _frames(
            points,
            waves,
            prepared,
            jnp.asarray(volts[part], dtype),
            jnp.asarray(known.grounds[part]),
            jnp.asarray(known.places[part], dtype),
            weight,
        )
        sums = tuple(np.asarray(s, float) for s in sums)
        total = sums if total is None else tuple(a + b for a, b in zip(total, sums))
    assert total is not None
    return total


@eqx.filter_jit
def _frames(points, waves, prepared, volts, grounds, places, weight) -> tuple:
    def one(v, g, place, weight):
        sums = _frame(points, waves, prepared._replace(grounds=g), v, place)
        return tuple(weight * s for s in sums)

    each = jax.vmap(one)(volts, grounds, places, weight)
    return tuple(s.sum(0) for s in each)


def _frame(
    points: Points, waves: _Waves, prepared, volts: Float[Array, "S M"], place: Array
) -> tuple[Array, Array, Array]:
    """AᵀQA and AᵀQr; Q takes out the contact's currents, size and place.

    And the mean square of what the channels still have in common, of what nominal values
    leave.
    """
    scene = fitting_of(points, prepared, volts, 1)
    # Each channel's own errors alone: what they have in common is what is looked for.
    none = 0 * scene.frame.common
    alone = scene.frame._replace(common=none, filter=none)
    frame = alone._replace(whitened=whitened_columns(alone, volts))
    sheet = points.sheet
    unit = place / sheet.unit

    def fit(p: Array):
        # Known to _PLACE: a parameter of unit size is that far off.
        placed = unit + p[:2] * (_PLACE / UNIT)
        found = model.discs(sheet, frame, model.round_disc(placed, p[2]))
        return found.rest[:, : volts.shape[1]], p, found.fitted

    tolerance = prepared.tolerance
    ended = least_squares(fit, jnp.zeros((1, 3), volts.dtype), tolerance, _STEPS)
    rest, tangent = ended.rest, ended.slope.transpose(1, 2, 0)  # (S, M), (S, M, 3)
    fitted = fit(ended.parameters)[2]
    # Slots that do not fit at all count little, as in the fit.
    robust = jax.lax.rsqrt(1 + (rest**2).sum(1) / tolerance)[:, None]
    scale = scene.frame.scale * robust
    slopes = _by_rig(points, waves, frame, fitted) * scale[..., None]
    sums = _cleared(
        slopes, fitted.voltages * scale, tangent * robust[..., None], rest * robust
    )
    left = whitened_columns(scene.frame, volts - fitted.voltages)[:, volts.shape[1] :]
    return *sums, jnp.square(left * robust).mean()


def _cleared(
    slopes: Float[Array, "S M P"],
    column: Float[Array, "S M"],
    tangent: Float[Array, "S M 3"],
    rest: Float[Array, "S M"],
) -> tuple[Float[Array, "P P"], Float[Array, " P"]]:
    """AᵀQA and AᵀQr: without each slot's current, and without three shared parameters."""
    length = jnp.maximum((column**2).sum(1, keepdims=True), 1e-30)
    along = jnp.einsum("sm,smp->sp", column / length, slopes, precision="highest")
    slopes = slopes - column[..., None] * along[:, None]
    a = slopes.reshape(-1, slopes.shape[-1])
    t, r = tangent.reshape(-1, 3), rest.ravel()
    own = jnp.matmul(t.T, t, precision="highest") + jnp.eye(3, dtype=r.dtype)
    both = jnp.concatenate([a, r[:, None]], 1)
    shared = jnp.matmul(t.T, both, precision="highest")
    cleared = jnp.matmul(both.T, both, precision="highest")
    cleared = cleared - jnp.matmul(
        shared.T, solve_positive(own, shared), precision="highest"
    )
    return cleared[:-1, :-1], cleared[:-1, -1]


def _by_rig(points, waves: _Waves, frame, fitted) -> Float[Array, "S M P"]:
    """Slopes of the voltages by gains, zeros, waves and resistances at grounds."""
    m = fitted.voltages.shape[1]
    unit = jnp.eye(m, dtype=fitted.voltages.dtype)
    gains = fitted.voltages[..., None] * unit
    zeros = jnp.broadcast_to(unit, gains.shape)

    def wave(values: Array, electrodes: Array) -> Float[Array, "S M"]:
        field = points.sheet.field._replace(values=values, electrodes=electrodes)
        at = field_at(field, fitted.place[0], fitted.radius[0])
        columns = slot_columns(field, at, frame.grounds, jnp.zeros_like(at[0]))
        return fitted.current * columns

    sheet = jnp.moveaxis(jax.vmap(wave)(*waves), 0, -1)
    # All channels alike, in the slots of that ground.
    total = fitted.current.sum(1)[:, None, None]
    grounded = total * unit[frame.grounds][:, None]
    grounded = jnp.broadcast_to(grounded, gains.shape)
    return jnp.concatenate([gains, zeros, sheet, grounded], -1)


def _solved(
    normal, right, now: Calibration, before: Calibration, rho: float, noise: float
) -> Calibration:
    """The likeliest values, near those `before`; `rho` Ω of the sheet, `noise` V."""
    q = len(now.sheet)
    m = (len(right) - q) // 3
    sizes = {"gain": m, "offset": m, "sheet": q, "ground": m}
    state, start = (
        np.concatenate([np.broadcast_to(getattr(c, n), k) for n, k in sizes.items()])
        for c in (now, before)
    )
    # Zeros that were taken from contact-free slots are known to the noise's mean.
    zero = _ZERO * noise / (1 if np.size(before.offset) == 1 else 10)
    strength = smooth_modes(jnp.zeros((1, 2)), jnp.ones(2))[1]
    width = np.concatenate([np.full(m, _GAIN), np.full(m, zero), _SHEET * strength])
    known = np.zeros((len(state),) * 2)
    known[:-m, :-m] = np.diag(width**2)
    known[-m:, -m:] = rho**2 * (_GROUND**2 * np.eye(m) + _GROUNDS**2)
    prior = np.linalg.inv(known)
    state = state + np.linalg.solve(normal + prior, right - prior @ (state - start))
    parts = np.split(state, np.cumsum(list(sizes.values()))[:-1])
    return replace(now, **{n: tuple(p.tolist()) for n, p in zip(sizes, parts)})
