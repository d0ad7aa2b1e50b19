"""Computes waves over a rectangle that describe a sheet's variation, and what they change.

The changes of electrodes' potentials are of first order, in closed form and in NumPy: if
σ = σ₀(1 − w), −σ₀Δδφ = −σ₀∇·(w∇φ). In cosines a wave w = cos(ix)·cos(jy) moves each
coefficient of φ to four others, (a ± i, b ± j).
"""

import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float, Int

# Half periods along x and y together of the waves that a sheet's errors are told in.
_LONGEST = 4


def cosine_waves(
    places: Float[Array, "n 2"],
    size: Float[Array, "2"],
    orders: Int[np.ndarray, "q 2"],
) -> Float[Array, "q n"]:
    """Computes cos(πix/a)·cos(πjy/b) at places, for `orders` (i, j) of half periods."""
    angles = jnp.asarray(np.pi * orders, places.dtype)[:, None] * (places / size)
    return jnp.prod(jnp.cos(angles), -1)


def smooth_orders(most: int = _LONGEST) -> Int[np.ndarray, "q 2"]:
    """Lists half periods (i, j) of waves, 1 ≤ i + j ≤ most, in the order of j within i."""
    pairs = [(i, j) for i in range(most + 1) for j in range(most + 1 - i) if i + j]
    return np.array(pairs)


def smooth_modes(
    places: Float[Array, "n 2"], size: Float[Array, "2"], most: int = _LONGEST
) -> tuple[Float[Array, "q n"], Float[np.ndarray, " q"]]:
    """Computes `cosine_waves` of mean square 1 for 1 ≤ i + j ≤ most, and 1/(i² + j²)."""
    orders = smooth_orders(most)
    modes = jnp.asarray(heights(orders)[:, None], places.dtype)
    return modes * cosine_waves(places, size, orders), 1 / (orders**2).sum(1)


def heights(orders: Int[np.ndarray, "q 2"]) -> Float[np.ndarray, " q"]:
    """Computes the factors that make the waves' mean squares 1."""
    return np.sqrt(2.0 ** (orders > 0).sum(1))


def rectangle_wave_fields(
    places: Float[np.ndarray, "M 2"],
    x: Float[np.ndarray, " nx"],
    y: Float[np.ndarray, " ny"],
    radius: float,
    size: Float[np.ndarray, "2"],
    orders: Int[np.ndarray, "q 2"],
    most: int,
    averaged: float = 0.0,
) -> tuple[Float[np.ndarray, "q M M"], Float[np.ndarray, "q M nx ny"]]:
    """Computes changes of electrodes' potentials at each other and at (x, y), per wave.

    The sheet has 1 Ω per square, and waves cos(πix/a)·cos(πjy/b) of the resistance.
    **Arguments:** `places` and `radius` of electrodes, m; `orders` (i, j); `most`: half
    periods up to which the potentials are followed along each side; `averaged`: radius of
    the discs around the points that the potentials are averaged over, m.
    """
    k = [np.pi * np.arange(most) / side for side in size]
    square = k[0][:, None] ** 2 + k[1] ** 2
    square[0, 0] = np.inf  # the mean is free
    # Fed through the electrodes' rims.
    rim = scipy.special.j0(np.sqrt(np.where(np.isinf(square), 0, square)) * radius)
    twice = np.where(np.arange(most) > 0, 2.0, 1.0)
    norm = twice[:, None] * twice / (size[0] * size[1])
    at = [np.cos(places[:, i, None] * k[i]) for i in (0, 1)]  # (M, most)
    field = np.einsum("ma,mb,ab->mab", *at, norm * rim / square)
    ka = np.sqrt(np.where(np.isinf(square), 0, square)) * averaged
    disc = disc_mean(ka)
    waves_x, waves_y = np.cos(x[:, None] * k[0]), np.cos(y[:, None] * k[1])
    found_ee, found = [], []
    for order in orders:
        moved = _moved(field, order, k) / square
        found_ee.append(np.einsum("eab,fa,fb->ef", moved * rim, *at, optimize=True))
        found.append(waves_x @ (moved * disc) @ waves_y.T)
    return np.stack(found_ee), np.stack(found)


def disc_mean(ka: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Computes 2J₁(ka)/ka: the mean of a wave of vector k over a disc of radius a."""
    return np.where(ka > 0, 2 * scipy.special.j1(ka) / np.where(ka > 0, ka, 1), 1)


def _moved(
    field: Float[np.ndarray, "M n n"], order: Int[np.ndarray, "2"], k: list[np.ndarray]
) -> Float[np.ndarray, "M n n"]:
    """Computes the coefficients of −∇·(w∇φ) from the coefficients of φ."""
    most, found = field.shape[1], np.zeros_like(field)
    step = [int(i) * each[1] for i, each in zip(order, k)]
    for s in (1, -1):
        for t in (1, -1):
            a, b = np.arange(most) + s * order[0], np.arange(most) + t * order[1]
            # sin is odd: a wave vector keeps its sign where its cosine is folded back.
            steep = k[0][:, None] * (k[0] + s * step[0])[:, None]
            steep = (steep + k[1] * (k[1] + t * step[1])) / 4
            inside = (np.abs(a) < most), (np.abs(b) < most)
            rows, columns = np.abs(a[inside[0]]), np.abs(b[inside[1]])
            part = (field * steep)[:, inside[0]][:, :, inside[1]]
            at = slice(None), rows[:, None], columns
            np.add.at(found, at, part)  # pyright: ignore (it takes slices too)
    return found
