"""Turns conductance into pressure: a power law, fitted to presses of known force."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tomojax._custom_types import Numbers
from tomojax._require import require
from tomojax.sensor import Calibration


def calibrate_presses(
    conductance: Numbers,  # (n,) S
    force: Numbers,  # (n,) N
    area: Numbers,  # (n,) or () m²
    calibration: Calibration | None = None,
) -> Calibration:
    """Fits a material's power law g = c·pᵏ (S/m² at Pa) to presses of known force.

    Least squares fit ln(g/A) = ln c + k·ln(F/A); c and k are the calibration's
    `pressure`. Conductances are those that `points` or `shape` found.

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
    p = np.log(f / a)
    require(np.ptp(p) > 1e-6, "force", "the same pressure in all", "different ones")
    k, offset = np.polyfit(p, np.log(g / a), 1)
    require(k > 0, "force", f"an exponent of {k:.3g}", "presses that conduct more with it")
    return replace(calibration or Calibration(), pressure=(float(np.exp(offset)), float(k)))


def pressure(
    calibration: Calibration, density: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """Computes p = (g/c)^(1/k), Pa, of conductances in S/m², as an image of `shape`.

    **Raises:** `ValueError` without a power law.

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
    return (np.maximum(density, 0) / law[0]) ** (1 / law[1])


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
