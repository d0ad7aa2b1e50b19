"""Turns conductance into pressure: a law of the material, fitted to presses."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares

from tomojax._custom_types import Numbers
from tomojax._require import require
from tomojax.events import Pressing, pressure_of
from tomojax.sensor import Calibration

# Fewer presses than that tell nothing of a third number of a law.
_FEW = 5


def calibrate_presses(
    conductance: Numbers,  # (n,) S
    force: Numbers,  # (n,) N
    area: Numbers,  # (n,) or () m²
    calibration: Calibration | None = None,
    unloading: Bool[np.ndarray, " n"] | None = None,
) -> Calibration:
    """Fits a material's law to presses of known force; the presses choose the law.

    Laws are g = c·pᵏ (S/m² at Pa) and the same with an end, 1/g = 1/(c·pᵏ) + 1/m. Least
    squares fit ln(g/A) at p = F/A. From five presses on, that law is taken that tells
    presses which were left out of its fit with the smaller error. `pressure` of the result
    has c and k, or c, k and m. Conductances are those that `points` or `shape` found.

    A material with hysteresis wants presses while loading and while unloading; `unloading`
    tells which are which. Each law then stands beside one with a loop: while unloading, g
    is that of h times the pressure. `hysteresis` of the result is h.
    `deviation["force"]` is 1 σ of a force that a press left out is told by, as a part of
    the force. Without `unloading` it has the loop's error too.

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
    back = np.zeros(len(g), bool) if unloading is None else np.asarray(unloading)
    fine = back.shape == g.shape and back.dtype == bool
    require(fine, "unloading", f"{back.dtype} {back.shape}", f"booleans {g.shape}")
    p, density = np.log(f / a), np.log(g / a)
    require(np.ptp(p) > 1e-6, "force", "the same pressure in all", "different ones")
    k = _fitted(p, density, 0 * back).numbers[1]
    require(k > 0, "force", f"an exponent of {k:.3g}", "presses that conduct more with it")
    many = len(g) >= _FEW
    loops = [0 * back, 1 * back] if many and back.any() and not back.all() else [0 * back]
    tried = [
        (loop, ends) for loop in loops for ends in ([False, True] if many else [False])
    ]
    # By what is told of g: beyond its end a law tells no force.
    each = [_left_out(p, density, *one) for one in tried]
    best = int(np.argmin([np.mean(left**2) for left in each]))
    loop, ends = tried[best]
    law = _fitted(p, density, loop, ends)
    known = calibration or Calibration()
    deviation = dict(known.deviation or {})
    if len(g) > 2:
        c, k, *end = law.numbers
        steepness = k * (1 - np.exp(law(p, loop)) / (end[0] if end else np.inf))
        deviation["force"] = float(np.sqrt(np.mean((each[best] / steepness) ** 2)))
    made = {"pressure": law.numbers, "hysteresis": float(np.exp(law.width))}
    return replace(known, **made, deviation=deviation or None)


class _Law(NamedTuple):
    """A law of a material: g of a pressure, which a loop shifts while unloading."""

    numbers: tuple[float, ...]  # c, k, and m where it ends
    width: float  # ln of the hysteresis

    def __call__(self, p: np.ndarray, loop: np.ndarray) -> np.ndarray:
        """Computes ln g at ln p; `loop` is 1 while unloading, 0 while loading."""
        c, k, *end = self.numbers
        above = -np.log(end[0]) if end else -np.inf
        return -np.logaddexp(-np.log(c) - k * (p + self.width * loop), above)


def _fitted(
    p: np.ndarray, density: np.ndarray, loop: np.ndarray, ends: bool = False
) -> _Law:
    """Fits a law, with a loop where `loop` is 1 somewhere."""
    columns = [p, np.ones(len(p)), *([loop] if loop.any() else [])]
    k, offset, *higher = np.linalg.lstsq(np.stack(columns, 1), density)[0].tolist()
    width = max(higher[0] / max(k, 1e-3), 0.0) if higher else 0.0
    if not ends:
        return _Law((math.exp(offset), k), width)

    def law(x: np.ndarray) -> _Law:
        numbers = np.exp(np.clip(x[:3], -20, 20)).tolist()
        return _Law(tuple(numbers), float(x[3]) if higher else 0.0)

    first = [offset, math.log(max(k, 1e-3)), math.log(2) + density.max(), width]
    first = first[: 3 + len(higher)]
    found = least_squares(lambda x: law(x)(p, loop) - density, first)
    return law(found.x)._replace(width=max(law(found.x).width, 0.0))


def _left_out(
    p: np.ndarray, density: np.ndarray, loop: np.ndarray, ends: bool
) -> np.ndarray:
    """Computes the error of ln g at each press by a fit to the others."""
    if len(p) < 3:
        return np.zeros(len(p))
    kept = ~np.eye(len(p), dtype=bool)
    laws = [_fitted(p[k], density[k], loop[k], ends) for k in kept]
    off = [law(p[~k], loop[~k]) - density[~k] for law, k in zip(laws, kept)]
    return np.concatenate(off)


def pressure(
    calibration: Calibration, density: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """Computes p = (g/c)^(1/k), Pa, of conductances in S/m², as an image of `shape`.

    If the law has an end m, g is mg/(m − g) there, and p is NaN from m on. The loop's
    middle is taken: p is √h below the pressure while loading, where h is the hysteresis.

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
    return pressure_of(law, density) / math.sqrt(calibration.hysteresis)


def force(
    calibration: Calibration,
    conductance: Float[np.ndarray, "*n"],
    radius: Float[np.ndarray, "*n"],
    over_time: bool = False,
) -> Float[np.ndarray, "*n"]:
    """Computes F = p·πr², N, of contacts that press evenly.

    `over_time`: the values are rows of one contact in order, from its first. The force then
    follows the loop of a material with hysteresis, see `tomojax.events.Pressing`.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> known = tx.Calibration(pressure=(0.02, 0.5))  # of `calibrate_presses`
    >>> siemens, radius = np.array([1e-4]), np.array([0.005])
    >>> print(np.round(tx.calibration.force(known, siemens, radius), 2))  # N
    [0.32]
    """
    area = np.pi * radius**2
    middle = pressure(calibration, conductance / area)
    if not over_time or calibration.hysteresis == 1:
        return middle * area
    pressing = Pressing(calibration.pressure or (), calibration.hysteresis)
    return np.array([pressing(g) for g in (conductance / area).tolist()]) * area
