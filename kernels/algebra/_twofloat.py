"""Multiplies in twice the working precision, as the sum of two floats (high, low).

Residuals that float32 cannot hold refine an ill-conditioned solve. Two floats hold such
residuals where the hardware or the process has float32 only. The methods are Dekker's
splitting and Knuth's sum (Numer. Math. 18, 1971; TAOCP 2, 4.2.2), with factors cut by a bit
mask. The four part products are then exact, so a compiler that fuses multiplications and
additions changes nothing.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

TwoFloat = tuple[Array, Array]  # value = high + low, |low| ≤ half an ulp of high

# Upper halves of the significands: 12 of 24 bits, 26 of 53.
_MASKS = {"float32": (jnp.uint32, 0xFFFFF000), "float64": (jnp.uint64, -1 << 27)}


def _split(a: Array) -> tuple[Array, Array]:
    integer, mask = _MASKS[a.dtype.name]
    bits = lax.bitcast_convert_type(a, integer)
    kept = bits & jnp.asarray(mask % (1 << 8 * a.dtype.itemsize), integer)
    high = lax.bitcast_convert_type(kept, a.dtype)
    return high, a - high


def _two_sum(a: Array, b: Array) -> TwoFloat:
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def multiply(a: Array, b: TwoFloat) -> TwoFloat:
    """Multiplies a·b, elementwise."""
    (a1, a2), (b1, b2) = _split(a), _split(b[0])
    middle, low = _two_sum(a1 * b2, a2 * b1)
    high, low_too = _two_sum(a1 * b1, middle)
    return high, low + low_too + (a2 * b2 + a * b[1])


def add(a: TwoFloat, b: TwoFloat) -> TwoFloat:
    """Adds a + b, elementwise."""
    high, low = _two_sum(a[0], b[0])
    low = low + a[1] + b[1]
    total = high + low
    return total, low - (total - high)


def negative(a: TwoFloat) -> TwoFloat:
    """Returns −a."""
    return -a[0], -a[1]


def widen(a: Array) -> TwoFloat:
    """Takes a float as two, of which the low one is zero."""
    return a, jnp.zeros_like(a)


def matvec(matrix: Float[Array, "n k"], x: TwoFloat) -> TwoFloat:
    """Multiplies matrix·x in two floats, with the sum taken pairwise."""
    high, low = multiply(matrix, x)
    count = high.shape[-1]
    half = 1 << max(count - 1, 0).bit_length()
    high, low = (jnp.pad(a, ((0, 0), (0, half - count))) for a in (high, low))
    while half > 1:
        half //= 2
        high, error = _two_sum(high[:, :half], high[:, half:])
        low = low[:, :half] + low[:, half:] + error
    return add((high[:, 0], low[:, 0]), widen(jnp.zeros_like(high[:, 0])))
