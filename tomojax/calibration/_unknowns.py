"""Orders the values that a calibration finds in a vector, with what is known before."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tomojax.kernels.sheet import smooth_orders
from tomojax.sensor import Calibration, nominal_noise, Sensor, WAVES

# What is known of a rig beforehand, 1 σ: gains, zeros (of the noise), the sheet's longest
# wave (which falls as the wave's length does), and resistances at grounds: of each, and
# what all have in common, of the sheet's resistance; electrodes' places, of their diameter.
_GAIN, _ZERO, _SHEET, _GROUND, _GROUNDS, _OFF = 1e-3, 1.1, 0.03, 0.01, 0.1, 0.04

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
    known = np.zeros((ends[-1],) * 2)

    def put(name: str, covariance: np.ndarray | float) -> None:
        at = parts[name]
        known[at, at] = np.eye(at.stop - at.start) * covariance

    tared = 1 if np.size(before.offset) == 1 else _TARED
    put("gain", _GAIN**2)
    put("offset", (_ZERO * nominal_noise(sensor) / tared) ** 2)
    put("sheet", (_SHEET / (smooth_orders(MOST) ** 2).sum(1)) ** 2)
    put("electrodes", (_OFF * float(sensor.electrode_diameter)) ** 2)
    rho = float(np.asarray(sensor.sheet_resistance).mean())
    known[parts["ground"], parts["ground"]] = rho**2 * (
        _GROUND**2 * np.eye(m) + _GROUNDS**2
    )
    return Unknowns(parts, start, np.linalg.inv(known))


def widened(unknowns: Unknowns, state: Float[np.ndarray, " P"]) -> Unknowns:
    """Widens the prior of electrodes' places, if a first pass found them farther off."""
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


def calibration_of(
    unknowns: Unknowns, state: Float[np.ndarray, " P"], before: Calibration
) -> Calibration:
    """Returns the calibration with the values of a state."""
    values = values_of(unknowns, state)
    return replace(before, **values)


def values_of(unknowns: Unknowns, state: Float[np.ndarray, " P"]) -> dict[str, tuple]:
    """Returns a state's values by their names in `Calibration`."""
    found = {n: tuple(state[at].tolist()) for n, at in unknowns.parts.items()}
    places = state[unknowns.parts["electrodes"]].reshape(2, -1).T
    return found | {"electrodes": tuple(map(tuple, places.tolist()))}
