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
from typing import Any, NamedTuple

import numpy as np

# Kinds of r.
KINDS = 4

# Powers of q, for an error of 1e-16.
TERMS = 6


class Series(NamedTuple):
    """Two places on a rectangle, and the numbers of the series between them.

    Arrays of the series have three axes before those of the places: kinds of r, powers of
    q, and the two θ.
    """

    a: Any  # the shorter side, along x, m
    b: Any
    x: Any  # x − x', m
    y: tuple[Any, Any]  # y and y', m
    square: Any  # of the distance, m²
    meet: Any  # nearer than rounding tells apart: slopes would be noise
    gap: Any  # |y − y'|, m
    side: Any  # the sign of y − y'; 0 where the places meet
    r: Any
    rate: Any  # ∂ ln r/∂y, 1/m
    angle: Any  # θ
    bend: Any  # sin²(θ/2)
    factor: Any  # 1 − 2r cos θ + r²; the first vanishes as the places meet, and is 1 there


def series(
    one: tuple[Any, Any],
    other: tuple[Any, Any],
    sides: tuple[Any, Any],
    xp: Any,
    kinds: int = KINDS,
    terms: int = TERMS,
) -> Series:
    """Prepares x and y of two places, arrays that broadcast, for `potential` and `slope`.

    `sides` a ≤ b are those along x and y, m. The largest r have the first of four `kinds`
    and of any `terms`.
    """
    (x, y), (x_, y_), (a, b) = one, other, sides
    square = (x - x_) ** 2 + (y - y_) ** 2
    meet = square < xp.finfo(square.dtype).eps * a**2
    gap, side = (xp.where(meet, 0, f(y - y_)) for f in (xp.abs, xp.sign))
    # e^{−π(2b − y − y')/a} written through the distances to the other edge, since q/far
    # would underflow in float32 on a long sheet.
    away = [gap, y + y_, 2 * b - (y + y_), 2 * b - gap]
    rate = [-side, -xp.ones_like(side), xp.ones_like(side), side]
    away, rate = (xp.stack(xp.broadcast_arrays(*some[:kinds])) for some in (away, rate))
    # As axes, not unrolled, for the sake of compile time.
    places = (1,) * square.ndim
    powers = np.arange(terms, dtype=square.dtype).reshape(-1, 1, *places)
    r = xp.exp(-np.pi / a * away)[:, None, None] * xp.exp(-2 * np.pi * b / a) ** powers
    angle = np.pi / a * xp.stack([x - x_, x + x_])[None, None]
    bend = xp.sin(angle / 2) ** 2
    factor = (1 - r) ** 2 + 4 * r * bend
    first = np.zeros(factor.shape[:3] + places, bool)
    first[0, 0, 0] = True
    return Series(
        a=a,
        b=b,
        x=x - x_,
        y=(y, y_),
        square=square,
        meet=meet,
        gap=gap,
        side=side,
        r=r,
        rate=np.pi / a * rate[:, None, None],
        angle=angle,
        bend=bend,
        factor=xp.where(first & meet, 1, factor),
    )


def potential(
    at: Series,
    rim: Any,
    xp: Any,
    solid: bool = False,
    log_product: Callable[[Any], Any] = lambda factors: np.log(factors.prod((0, 1, 2))),
    rest: Any = 0.0,
) -> Any:
    """Computes G(x, x') at 1 Ω per square; the source is a disc of radius `rim`, m.

    Within the rim the value is the rim's. If `solid`, the value is that of an evenly
    charged disc less its mean: ln a − (1 − d²/a²)/2 for ln d. The slope of this value is
    the field of a disc's dipole, d/a² inside. The dipole's own second slope is 1/(2πa²), as
    it must be. `rest`: the sum of the logarithms that `at` leaves out.
    """
    # Near the other place the first factor is (π d/a)². Within the rim d is the rim.
    inside = at.square < rim**2
    apart = xp.where(at.meet, (at.a / np.pi) ** 2, at.square)
    within = xp.log(rim**2) + (at.square / rim**2 - 1 if solid else 0)
    logs = log_product(at.factor) + xp.where(inside, within - xp.log(apart), 0)
    y, y_ = at.y
    mean = at.b / 3 + (y**2 + y_**2) / (2 * at.b) - (y + y_ + at.gap) / 2
    return mean / at.a - (logs + rest) / (4 * np.pi)


def slope(
    at: Series, rim: Any, xp: Any, solid: bool = False, rest: tuple[Any, Any] = (0.0, 0.0)
) -> tuple[Any, Any]:
    """Computes ∂G/∂x and ∂G/∂y of `potential`, 1/m at 1 Ω per square."""
    y, y_ = at.y
    part = at.r / at.factor
    by_x = (2 * np.pi / at.a * xp.sin(at.angle) * part).sum((0, 1, 2))
    by_y = (at.rate * (4 * at.bend - 2 * (1 - at.r)) * part).sum((0, 1, 2))
    # Within the rim ln d is left out.
    inside = at.square < rim**2
    far = inside & ~at.meet
    less = xp.where(far, 2 / xp.where(far, at.square, 1), 0)
    less = less - xp.where(inside, 2 / rim**2, 0) if solid else less
    by_x, by_y = by_x + rest[0] - at.x * less, by_y + rest[1] - (y - y_) * less
    mean = (y / at.b - (1 + at.side) / 2) / at.a
    return -by_x / (4 * np.pi), mean - by_y / (4 * np.pi)


def turned(size: Any, places: Any, xp: Any) -> tuple[Any, Any]:
    """Returns x and y of places (…, 2), x along the shorter side of the rectangle."""
    across = size[0] > size[1]
    x, y = places[..., 0], places[..., 1]
    return xp.where(across, y, x), xp.where(across, x, y)
