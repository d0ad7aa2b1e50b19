"""Computes the Green's function of a homogeneous rectangle: its cosine series, summed.

For −Δ G = ρ(δ − 1/(ab)) with insulated edges the double cosine series is summed over one
index to hyperbolic functions. The hyperbolic functions, expanded in exponentials and summed
over the other index, leave logarithms (θ_j = π(x ∓ x')/a, b ≥ a, q = exp(−2πb/a)):

    G = ρ·{ [b/3 + (y² + y'²)/2b − max(y, y')]/a − (1/4π)·Σ ln(1 − 2r cos θ + r²) }

The sum is over both θ and r ∈ {e^{−π|y−y'|/a}, e^{−π(y+y')/a}, q/…, q/…}·q^j, j = 0, 1, ….
Each j gains a factor of exp(−2π) or better, so six terms reach 1e-16. Sources are discs:
outside a disc the field is that of a point, inside the value is the rim's.

The functions take arrays of NumPy and of JAX: `xp` is `numpy` or `jax.numpy`. This file
imports no JAX.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

# Kinds of r.
KINDS = 4

# Powers of q, for an error of 1e-16.
TERMS = 6


class Series:
    """Two places on a rectangle, and the numbers of the series between them.

    Arrays of the series have three axes before those of the places: kinds of r, powers of
    q, and the two θ.
    """

    def __init__(
        self,
        one: tuple[Any, Any],
        other: tuple[Any, Any],
        sides: tuple[Any, Any],
        xp: Any,
        kinds: int = KINDS,
        terms: int = TERMS,
    ):
        """Takes x and y of two places, arrays that broadcast, and the sides a ≤ b, m.

        The largest r have the first of four `kinds` and of any `terms`.
        """
        (x, y), (x_, y_), (a, b) = one, other, sides
        self.xp, self.sides, self.y = xp, sides, (y, y_)
        self.apart = x - x_, y - y_
        self.square = self.apart[0] ** 2 + self.apart[1] ** 2
        # Nearer than rounding tells apart the two are one place: slopes would be noise.
        self.meet = self.square < xp.finfo(self.square.dtype).eps * a**2
        gap = xp.where(self.meet, 0, xp.abs(y - y_))
        side = xp.where(self.meet, 0, xp.sign(y - y_))
        self.gap, self.side = gap, side
        # e^{−π(2b − y − y')/a} written through the distances to the other edge, since q/far
        # would underflow in float32 on a long sheet.
        away = [gap, y + y_, 2 * b - (y + y_), 2 * b - gap]
        rate = [-side, -xp.ones_like(side), xp.ones_like(side), side]
        away, rate = (xp.stack(xp.broadcast_arrays(*some[:kinds])) for some in (away, rate))
        # As axes, not unrolled, for the sake of compile time.
        places = (1,) * self.square.ndim
        powers = np.arange(terms, dtype=self.square.dtype).reshape(-1, 1, *places)
        power = xp.exp(-2 * np.pi * b / a) ** powers
        exponent = (-np.pi / a * away)[:, None, None]
        self.r = xp.exp(exponent) * power
        # 1 − r. NumPy's tables need its digits where places nearly meet. Compiled code does
        # without `expm1`: a step should need few functions of a C library.
        self.less = 1 - self.r
        if xp is np:
            self.less = 1 - power - np.expm1(exponent) * power
        self.rate = np.pi / a * rate[:, None, None]  # ∂ ln r/∂y
        self.angle = np.pi / a * xp.stack([x - x_, x + x_])[None, None]
        self.bend = xp.sin(self.angle / 2) ** 2
        # 1 − 2r cos θ + r². The first vanishes as the places meet, and counts as 1 there.
        factor = self.less**2 + 4 * self.r * self.bend
        first = np.zeros(factor.shape[:3] + places, bool)
        first[0, 0, 0] = True
        self.factor = xp.where(first & self.meet, 1, factor)

    def potential(
        self,
        rim: Any,
        solid: bool = False,
        log_product: Callable[[Any], Any] = lambda f: np.log(f.prod((0, 1, 2))),
        rest: Any = 0.0,
    ) -> Any:
        """Computes G(x, x') at 1 Ω per square; the source is a disc of radius `rim`, m.

        Within the rim the value is the rim's. If `solid`, the value is that of an evenly
        charged disc less its mean: ln a − (1 − d²/a²)/2 for ln d. The slope of this value
        is the field of a disc's dipole, d/a² inside. The dipole's own second slope is
        1/(2πa²), as it must be. `rest`: the sum of the logarithms that are left out.
        """
        xp, (a, b), (y, y_) = self.xp, self.sides, self.y
        # Near the other place the first factor is (π d/a)². Within the rim d is the rim.
        square = xp.where(self.meet, (a / np.pi) ** 2, self.square)
        within = xp.log(rim**2) + (self.square / rim**2 - 1 if solid else 0)
        inside = self.square < rim**2
        logs = log_product(self.factor) + xp.where(inside, within - xp.log(square), 0)
        mean = b / 3 + (y**2 + y_**2) / (2 * b) - (y + y_ + self.gap) / 2
        return mean / a - (logs + rest) / (4 * np.pi)

    def slope(
        self, rim: Any, solid: bool = False, rest: tuple[Any, Any] = (0.0, 0.0)
    ) -> tuple[Any, Any]:
        """Computes ∂G/∂x and ∂G/∂y of `potential`, 1/m at 1 Ω per square."""
        xp, (a, b) = self.xp, self.sides
        part = self.r / self.factor
        by_x = (2 * np.pi / a * xp.sin(self.angle) * part).sum((0, 1, 2))
        by_y = (self.rate * (4 * self.bend - 2 * self.less) * part).sum((0, 1, 2))
        # Within the rim ln d is left out.
        inside = self.square < rim**2
        far = inside & ~self.meet
        less = xp.where(far, 2 / xp.where(far, self.square, 1), 0)
        less = less - xp.where(inside, 2 / rim**2, 0) if solid else less
        by_x = by_x + rest[0] - self.apart[0] * less
        by_y = by_y + rest[1] - self.apart[1] * less
        mean = (self.y[0] / b - (1 + self.side) / 2) / a
        return -by_x / (4 * np.pi), mean - by_y / (4 * np.pi)


def turned(size: Any, places: Any, xp: Any) -> tuple[Any, Any]:
    """Returns x and y of places (…, 2), x along the shorter side of the rectangle."""
    across = size[0] > size[1]
    x, y = places[..., 0], places[..., 1]
    return xp.where(across, y, x), xp.where(across, x, y)
