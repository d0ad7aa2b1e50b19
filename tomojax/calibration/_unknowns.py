"""Orders the values that a calibration finds in a vector, with what is known before."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tomojax.kernels.sheet import smooth_orders
from tomojax.sensor import Calibration, nominal_noise, Sensor, WAVES

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


def values_of(unknowns: Unknowns, state: Float[np.ndarray, " P"]) -> dict[str, tuple]:
    """Returns a state's values by their names in `Calibration`."""
    found = {n: tuple(state[at].tolist()) for n, at in unknowns.parts.items()}
    places = state[unknowns.parts["electrodes"]].reshape(2, -1).T
    return found | {"electrodes": tuple(map(tuple, places.tolist()))}
