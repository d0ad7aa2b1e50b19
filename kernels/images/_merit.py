"""Computes figures of merit of an image on pixels (nx, ny) of size `cell` (dx, dy), m.

Each function takes one image and can be batched. Sums and interpolations have a gradient
(half width, place, image error, separation, amplitude, ringing). Figures that count pixels
have none (resolution, shape deformation).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from tomojax._shown import tuple_shown


class GreitFigures(NamedTuple):
    """GREIT's figures (Adler et al., Physiol. Meas. 30 S35, 2009) of a point-like target.

    The figures are taken on the quarter set: the pixels above a quarter of the maximum.
    """

    amplitude: Float[Array, ""]  # AR: sum of the image over the sum of the target
    position_error: Float[Array, ""]  # PE: m, between the centres of quarter set and target
    resolution: Float[Array, ""]  # RES: √(area of the quarter set / area of the image)
    shape_deformation: Float[Array, ""]  # SD: part of the quarter set outside its circle
    ringing: Float[Array, ""]  # RNG: opposite sign outside that circle / sum inside it

    def __repr__(self) -> str:
        return tuple_shown(self, position_error=("mm", 1e3))


def pixel_places(
    shape: tuple[int, ...], cell: Float[Array, "2"]
) -> tuple[Float[Array, " nx"], Float[Array, " ny"]]:
    """Returns centres of the pixels along x and y, m."""
    x, y = ((jnp.arange(n, dtype=cell.dtype) + 0.5) * d for n, d in zip(shape, cell))
    return x, y


def half_width(image: Float[Array, "nx ny"], cell: Float[Array, "2"]) -> Float[Array, ""]:
    """Measures half the width at half the maximum, m: the mean over ±x and ±y.

    Each direction starts at the highest pixel and ends where the image, linearly
    interpolated, falls to half, or else at the image's edge.
    """
    peak = jnp.unravel_index(jnp.argmax(image), image.shape)
    top = image[peak]
    lines = [(image[:, peak[1]] / top, peak[0]), (image[peak[0]] / top, peak[1])]
    lines += [(line[::-1], len(line) - 1 - at) for line, at in lines]
    steps = (*cell, *cell)
    reach = [_distance_to_half(line, at) * d for (line, at), d in zip(lines, steps)]
    return sum(reach, jnp.zeros_like(top)) / len(reach)


def _distance_to_half(line: Float[Array, " n"], start: Array) -> Float[Array, ""]:
    """Counts pixels from `start` (where the line is 1) up to the first fall to 1/2."""
    index = jnp.arange(len(line))
    below = (index > start) & (line <= 0.5)
    after = jnp.argmax(below)
    before = jnp.maximum(after - 1, 0)
    fall = line[before] - line[after]
    part = (line[before] - 0.5) / jnp.where(fall > 0, fall, 1)
    inside = (before - start).astype(line.dtype) + part
    to_edge = (len(line) - start).astype(line.dtype) - 0.5
    return jnp.where(below.any(), inside, to_edge)


def half_area_radius(
    image: Float[Array, "nx ny"], cell: Float[Array, "2"]
) -> Float[Array, ""]:
    """Computes the radius of a circle with the area above half the maximum, m."""
    area = _area(image >= image.max() / 2, cell)
    return jnp.sqrt(area / jnp.pi)


def image_place(image: Float[Array, "nx ny"], cell: Float[Array, "2"]) -> Float[Array, "2"]:
    """Finds the contact: the centre of all that exceeds half the maximum, m."""
    weight = jnp.maximum(image - image.max() / 2, 0)
    return _centre(weight, cell)


def _centre(weight: Float[Array, "nx ny"], cell: Float[Array, "2"]) -> Float[Array, "2"]:
    x, y = pixel_places(weight.shape, cell)
    total = weight.sum()
    return jnp.stack([weight.sum(1) @ x, weight.sum(0) @ y]) / total


def _area(inside: Bool[Array, "nx ny"], cell: Float[Array, "2"]) -> Float[Array, ""]:
    return jnp.sum(inside.astype(cell.dtype)) * cell.prod()


def image_error(
    image: Float[Array, "nx ny"], truth: Float[Array, "nx ny"]
) -> Float[Array, ""]:
    """Computes ‖a·image − truth‖/‖truth‖ with the best a: 0 is the truth, 1 is nothing.

    The error has no scale: Eq. 3's image has the unit of its Jacobian's column, and λ
    shrinks the image. The error is also 1 where the image is orthogonal to the truth.
    """
    dot = jnp.sum(image * truth)
    cosine = dot**2 / (jnp.sum(image**2) * jnp.sum(truth**2))
    return jnp.sqrt(jnp.maximum(1 - jnp.where(dot > 0, cosine, 0), 0))


def greit_figures(
    image: Float[Array, "nx ny"], target: Float[Array, "nx ny"], cell: Float[Array, "2"]
) -> GreitFigures:
    """Computes AR, PE, RES, SD and RNG; of the true image `target` only sums count."""
    signed = image * jnp.sign(image.flatten()[jnp.argmax(jnp.abs(image))])
    quarter = signed >= signed.max() / 4
    area = _area(quarter, cell)
    centre = _centre(quarter.astype(image.dtype), cell)
    circle = _disc(image.shape, cell, centre, area)
    opposite = -jnp.sum(jnp.where((signed < 0) & ~circle, signed, 0))
    return GreitFigures(
        image.sum() / target.sum(),
        jnp.linalg.norm(centre - _centre(target, cell)),
        jnp.sqrt(area / (image.size * cell.prod())),
        _area(quarter & ~circle, cell) / area,
        opposite / jnp.sum(jnp.where(circle, signed, 0)),
    )


def _disc(shape, cell, centre, area) -> Bool[Array, "nx ny"]:
    x, y = pixel_places(shape, cell)
    away = (x[:, None] - centre[0]) ** 2 + (y - centre[1]) ** 2
    return away <= area / jnp.pi
