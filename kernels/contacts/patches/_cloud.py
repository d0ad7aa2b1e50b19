"""Puts patches on a contact, and computes what the sheet has at them and between them."""

from typing import cast, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax.kernels.contacts._field import Near, rows_near
from tomojax.kernels.contacts._points import LONG, Sheet, SIZE_WIDTH, slope_of

# Rings of patches around the middle one: 1 + 6 + 12.
_RINGS = 2

# Electrodes whose metal patches tell from each other; for further ones they are one place.
_BESIDE = 8


def _rings(count: int) -> Float[np.ndarray, "n 2"]:
    """Places patches of equal area on a unit disc; second moments are an even disc's."""
    n, inner, found = 1 + 3 * count * (count + 1), 1, [np.zeros((1, 2))]
    for k in range(1, count + 1):
        square = (inner + 3 * k) / n
        turn = 2 * np.pi * (np.arange(6 * k) + k % 2 / 2) / (6 * k)
        found.append(np.sqrt(square) * np.stack([np.cos(turn), np.sin(turn)], 1))
        inner += 6 * k
    return np.concatenate(found)


_CLOUD = _rings(_RINGS)
COUNT = len(_CLOUD)

# Points of a patch that fields beside electrodes are averaged over.
_EACH = _rings(1) / np.sqrt(COUNT)


class Cloud(NamedTuple):
    """A contact's n patches."""

    off: Float[Array, "n 2"]  # from its middle, m
    moves: Float[Array, "n 2 3"]  # of that by size and lengths, m
    rows: Float[Array, "n 3 M"]  # R_e, Ω, and slopes by x and y, Ω/m
    plane: Float[Array, "n n"]  # potentials between patches, but for what all share, Ω
    taken: Float[Array, "n n"]  # of these by electrodes' metal, Ω


def product(how: str, *arrays: Array) -> Array:
    return jnp.einsum(how, *arrays, precision="highest")


def cloud_of(sheet: Sheet, place: Array, radius: Array, parameters: Array) -> Cloud:
    """Puts patches on an ellipse with the disc's area and the moments (a² − b²)/8."""
    near, size = cast(Near, sheet.near), sheet.field.size

    def root(p: Float[Array, "3"]) -> Float[Array, "2 2"]:
        # The root of four times the even ellipse's second moments.
        a = radius * jnp.exp(SIZE_WIDTH * (p[0] - parameters[2]))
        half = 4 * LONG * sheet.size**2 * p[1:]
        square = jnp.sqrt(a**4 + (half**2).sum())
        xx, yy = square + half[0] + a**2, square - half[0] + a**2
        both = jnp.stack([xx, half[1], half[1], yy]).reshape(2, 2)
        return both / jnp.sqrt(2 * (square + a**2))

    shape = parameters[2:5]
    unit, each = (jnp.asarray(a, place.dtype) for a in (_CLOUD, _EACH))
    off, each = (product("nk,kj->nj", a, root(shape)) for a in (unit, each))
    moves = product("nk,kjp->njp", unit, jax.jacfwd(root)(shape))
    at = size - jnp.abs(size - jnp.abs(place + off) % (2 * size))
    rows = rows_near(near, size, at, each)
    return Cloud(off, moves, rows, *_among(sheet, place, at, radius))


def _images(sheet: Sheet, at: Float[Array, "n 2"]) -> Float[Array, "k n 2"]:
    """Returns places, then their nearest images at the edges; of skins places alone."""
    if sheet.field.among is not None:
        return at[None]
    one = jnp.stack([at, -at, 2 * sheet.field.size - at])  # of each coordinate
    x, y = np.divmod(np.arange(9), 3)
    return jnp.stack([one[x, :, 0], one[y, :, 1]], -1)


def _among(sheet: Sheet, place: Array, at: Array, radius: Array) -> tuple[Array, Array]:
    """Computes potentials between patches, Ω: of the sheet, and what metal takes of them.

    Edges mirror the patches, and electrodes' metal answers them with dipoles.
    """
    near, images = cast(Near, sheet.near), _images(sheet, at)
    rim = radius / float(np.sqrt(COUNT) * np.exp(0.25))
    square = ((at[:, None] - images[:, None]) ** 2).sum(-1)
    # Units of length beyond all distances keep the matrix positive.
    unit = jnp.where(jnp.arange(len(images)) == 0, 6 * radius, 3 * sheet.field.size.max())
    ratio = jnp.maximum(square, rim**2) / unit[:, None, None] ** 2
    plane = -jnp.log(jnp.prod(ratio, 0)) / 2

    def field(images: Array, electrodes: Array) -> Array:
        away = images[:, :, None] - electrodes
        square = jnp.maximum((away**2).sum(-1, keepdims=True), near.radius**2)
        return (away / square).sum(0).reshape(images.shape[1], -1)

    one = field(_images(sheet, place[None]), near.electrodes)
    far = ((place - near.electrodes) ** 2).sum(-1)
    beside = jax.lax.top_k(-far, min(_BESIDE, len(far)))[1]
    some = field(images, near.electrodes[beside])
    rest = (one**2).sum() - (one.reshape(-1, 2)[beside] ** 2).sum()
    taken = product("ik,jk->ij", some, some) + rest
    return near.feed * plane, near.feed * near.answer * near.radius**2 * taken


def steep_of(
    sheet: Sheet, place: Float[Array, "C 2"], radius: Array
) -> Float[Array, "C C 2"]:
    """Computes ∇ at each place of one ampere into each contact, but for a place's images.

    Images of a contact's own patches are among the patches' potentials.
    """
    away = place - _images(sheet, place)[1:]
    square = jnp.maximum((away**2).sum(-1, keepdims=True), radius[:, None] ** 2)
    images = -cast(Near, sheet.near).feed * (away / square).sum(0)
    own = jnp.eye(len(place), dtype=place.dtype)[..., None]
    return slope_of(sheet, place, radius) - own * images
