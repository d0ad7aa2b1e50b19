"""Turns conductance into pressure: a law of the material, fitted to presses."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from tomojax._custom_types import Numbers
from tomojax._require import require
from tomojax.events import pressure_of
from tomojax.sensor import Calibration

# Fewer presses than that tell nothing of a third number of a law.
_FEW = 5


def calibrate_presses(
    conductance: Numbers,  # (n,) S
    force: Numbers,  # (n,) N
    area: Numbers,  # (n,) or () m²
    calibration: Calibration | None = None,
) -> Calibration:
    """Fits a material's law to presses of known force; the presses choose the law.

    Laws are g = c·pᵏ (S/m² at Pa) and the same with an end, 1/g = 1/(c·pᵏ) + 1/m. Least
    squares fit ln(g/A) at p = F/A. From five presses on, that law is taken that tells
    presses which were left out of its fit with the smaller error. `pressure` of the result
    has c and k, or c, k and m; `deviation["force"]` is 1 σ of a force that a press left out
    is told by, as a part of the force. Give presses while loading and while unloading where
    the material has hysteresis: that error has it then. Conductances are those that
    `points` or `shape` found.

    **Raises:** `ValueError` for fewer than two presses, equal presses, and numbers that are
    not above 0.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> force, area = np.array([1.0, 2.0, 4.0]), 1e-4  # N and m²
    >>> siemens = 0.02 * np.sqrt(force / area) * area
    >>> c, k = tx.calibration.calibrate_presses(siemens, force, area).pressure
    >>> print(f"g = {c:.2f}·p^{k:.2f}")
    g = 0.02·p^0.50
    """
    g, f = (np.asarray(a, float) for a in (conductance, force))
    require(g.ndim == 1 and len(g) > 1, "conductance", f"shape {g.shape}", "two or more")
    require(f.shape == g.shape, "force", f"shape {f.shape}", f"{g.shape}")
    a = np.asarray(area, float)
    require(a.shape in ((), g.shape), "area", f"shape {a.shape}", f"() or {g.shape}")
    for name, values in (("conductance", g), ("force", f), ("area", a)):
        fine = np.isfinite(values).all() and (values > 0).all()
        require(bool(fine), name, values, "numbers above 0")
    p, density = np.log(f / a), np.log(g / a)
    require(np.ptp(p) > 1e-6, "force", "the same pressure in all", "different ones")
    k = _power(p, density)[1]
    require(k > 0, "force", f"an exponent of {k:.3g}", "presses that conduct more with it")
    fits = [_power, _ending] if len(g) >= _FEW else [_power]
    # By what is told of g: beyond its end a law tells no force.
    each = [_left_out(fit, p, density) for fit in fits]
    best = int(np.argmin([np.mean(left**2) for left in each]))
    law = fits[best](p, density)
    known = calibration or Calibration()
    deviation = dict(known.deviation or {})
    if len(g) > 2:
        steepness = law[1] * (1 - np.exp(_of(law, p)) / (law[2] if law[2:] else np.inf))
        deviation["force"] = float(np.sqrt(np.mean((each[best] / steepness) ** 2)))
    return replace(known, pressure=law, deviation=deviation or None)


def _of(law: tuple[float, ...], p: np.ndarray) -> np.ndarray:
    """Computes ln g at ln p."""
    c, k, *end = law
    return -np.logaddexp(-np.log(c) - k * p, -np.log(end[0]) if end else -np.inf)


def _power(p: np.ndarray, density: np.ndarray) -> tuple[float, ...]:
    k, offset = np.polyfit(p, density, 1)
    return float(np.exp(offset)), float(k)


def _ending(p: np.ndarray, density: np.ndarray) -> tuple[float, ...]:
    """Fits c, k and m; they are above 0."""
    c, k = _power(p, density)
    first = np.log([c, max(k, 1e-3), 2 * np.exp(density.max())])
    found = least_squares(lambda x: _of(tuple(np.exp(x)), p) - density, first)
    return tuple(float(a) for a in np.exp(np.clip(found.x, -20, 20)))


def _left_out(fit: Callable, p: np.ndarray, density: np.ndarray) -> np.ndarray:
    """Computes the error of ln g at each press by a fit to the others."""
    if len(p) < 3:
        return np.zeros(len(p))
    kept = ~np.eye(len(p), dtype=bool)
    laws = [fit(p[k], density[k]) for k in kept]
    return np.concatenate([_of(law, p[~k]) - density[~k] for law, k in zip(laws, kept)])


def pressure(
    calibration: Calibration, density: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """Computes p = (g/c)^(1/k), Pa, of conductances in S/m², as an image of `shape`.

    If the law has an end m, g is mg/(m − g) there, and p is NaN from m on.

    **Raises:** `ValueError` without a law.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> known = tx.Calibration(pressure=(0.02, 0.5))  # of `calibrate_presses`
    >>> print(np.round(tx.calibration.pressure(known, np.array([1.0, 2.0]))))  # Pa
    [ 2500. 10000.]
    """
    law = calibration.pressure
    if law is None:
        raise ValueError("calibration: got none of presses, expected `calibrate_presses`")
    return pressure_of(law, density)


def force(
    calibration: Calibration,
    conductance: Float[np.ndarray, "*n"],
    radius: Float[np.ndarray, "*n"],
) -> Float[np.ndarray, "*n"]:
    """Computes F = p·πr², N, of contacts that press evenly.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> known = tx.Calibration(pressure=(0.02, 0.5))  # of `calibrate_presses`
    >>> siemens, radius = np.array([1e-4]), np.array([0.005])
    >>> print(np.round(tx.calibration.force(known, siemens, radius), 2))  # N
    [0.32]
    """
    area = np.pi * radius**2
    return pressure(calibration, conductance / area) * area
