"""The law by which a material conducts under pressure, in NumPy alone."""

import math

import numpy as np
from jaxtyping import Float


def pressure_of(
    law: tuple[float, ...], density: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """Computes p, Pa, of conductances in S/m² by 1/g = 1/(c·pᵏ) + 1/m.

    `law`: c and k, and m where the law has an end; p is NaN from there on.

    **Example:**

    >>> import numpy as np
    >>> from tomojax.events import pressure_of
    >>> print(np.round(pressure_of((0.02, 0.5, 4.0), np.array([1.0, 2.0, 4.0]))))  # Pa
    [ 4444. 40000.    nan]
    """
    c, k, *end = law
    g = np.maximum(density, 0)
    if end:
        g = np.where(g < end[0], g / np.maximum(1 - g / end[0], 1e-12), np.nan)
    return (g / c) ** (1 / k)


class Pressing:
    """Tells the pressure of one contact row by row, of a material with hysteresis.

    x is ln p of the law while loading, and ln p = x − s·ln h: s = 0 while loading, 1 while
    unloading. A contact begins with s = 0; s goes to the other end while x goes back by
    ln h. That is the width of the loop; plays of all widths up to twice that end so too.
    Noise moves s by no more than its own share of that width.

    **Arguments:** `law` as of `pressure_of`; `hysteresis`: h, see `Calibration`.

    **Example:**

    >>> from tomojax.events import Pressing
    >>> pressing = Pressing((0.02, 0.5), hysteresis=1.5)
    >>> [round(pressing(density)) for density in (1.0, 2.0, 1.0)]  # S/m² to Pa
    [2500, 10000, 1667]
    """

    def __init__(self, law: tuple[float, ...], hysteresis: float = 1.0):
        self._law, self._width = law, math.log(hysteresis)
        self._before, self._share = math.inf, 0.0

    def __call__(self, density: float) -> float:
        p = float(pressure_of(self._law, np.array([density]))[0])
        if not (p > 0 and self._width):
            return p
        if self._before < math.inf:
            turned = self._share - (math.log(p) - self._before) / self._width
            self._share = min(max(turned, 0.0), 1.0)
        self._before = math.log(p)
        return p * math.exp(-self._width * self._share)
