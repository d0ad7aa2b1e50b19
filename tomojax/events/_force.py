"""The law by which a material conducts under pressure, in NumPy alone."""

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
