"""Computes figures of merit of images on the sensor's elements."""

from typing import NamedTuple

import jax
from jaxtyping import Array, Float

from tomojax._checks import float_array, require_array, require_shape
from tomojax._custom_types import Numbers
from tomojax._shown import tuple_shown
from tomojax.kernels.images import (
    greit_figures,
    GreitFigures,
    half_area_radius,
    half_width,
    image_error,
    image_place,
)
from tomojax.kernels.sheet import cell_sides
from tomojax.sensor import Sensor


class Figures(NamedTuple):
    """Figures of merit of one image, or of a batch with a leading axis.

    - `half_width`: half the width at half the maximum, m.
    - `half_area_radius`: radius of a circle as large as the area above half the maximum, m.
    - `place` (…, 2): centre of what exceeds half the maximum, m.
    - `image_error`: distance from the truth at the best scale, a part of the truth; 0 is
      the truth.
    - `greit`: GREIT's figures, see `GreitFigures`; `position_error` in m, the others parts.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> truth = tx.sensor.contact_conductance(sensor, tx.Disc([0.03, 0.05], 0.01, 1.0))
    >>> figures = tx.paper.figures_of_merit(sensor, truth, truth)
    >>> print(np.round(1e3 * figures.place), np.round(1e3 * figures.half_width))  # mm
    [30. 50.] 10.0
    >>> figures._replace(greit=None)  # its print-out has units
    Figures(half_width=9.781 mm, half_area_radius=9.772 mm, place=[30, 50] mm,
        image_error=0, greit=None)
    """

    half_width: Float[Array, "*frames"]  # m, half the width at half the maximum
    half_area_radius: Float[Array, "*frames"]  # m, of the area above half the maximum
    place: Float[Array, "*frames 2"]  # m, centre of what exceeds half the maximum
    image_error: Float[Array, "*frames"]  # relative, at the best scale
    greit: GreitFigures

    def __repr__(self) -> str:
        metres = {name: ("mm", 1e3) for name in ("half_width", "half_area_radius", "place")}
        return tuple_shown(self, **metres)


def pixels(sensor: Sensor, image: Numbers) -> Float[Array, "*frames nx ny"]:
    """Turns values per element (…, K) into an image (…, nx, ny): each cell's mean.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> tx.paper.pixels(sensor, jnp.arange(512.0)).shape
    (16, 16)
    """
    k = sensor.element_count
    array = float_array("image", image)
    require_shape("image", array, (k,), (None, k))
    return array.reshape(*array.shape[:-1], *sensor.divisions, 2).mean(-1)


def cell_size(sensor: Sensor) -> Float[Array, "2"]:
    """Computes the sides of a pixel, m.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> print(np.round(1e3 * tx.paper.cell_size(sensor)))  # mm
    [5. 5.]
    """
    return cell_sides(sensor.divisions, sensor.size)


def figures_of_merit(sensor: Sensor, image: Numbers, truth: Numbers) -> Figures:
    """Measures an image's (K,) width, place and error, or those of a batch (frames, K).

    `truth` (K,) or (frames, K) is the true image in any unit; see `half_width`,
    `image_place`, `image_error` and `greit_figures` for the definitions. Distances
    between an estimated and a true place are differences of `place`.
    **Raises:** `ValueError` for shapes that do not fit and values that are not numbers.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> touch = tx.Disc([0.03, 0.05], 0.01, 1.0)
    >>> volts = tx.voltages(sensor, touch, [0, 15])
    >>> image = tx.reconstruct(tx.jacobian(sensor, [0, 15]), volts).image
    >>> truth = tx.sensor.contact_conductance(sensor, touch)
    >>> figures = tx.paper.figures_of_merit(sensor, image, truth)
    >>> bool(figures.half_width > 0.005), bool(figures.image_error > 0)  # it is blurred
    (True, True)
    """
    images, truths = pixels(sensor, image), pixels(sensor, truth)
    require_array("image", images, "finite")
    require_array("truth", truths, "finite")
    one_truth = truths.ndim == 2
    require_shape("truth", truths, images.shape, images.shape[-2:])
    if images.ndim == 2:
        return _figures(images, truths, cell_size(sensor))
    over = (0, None if one_truth else 0, None)
    return jax.vmap(_figures, over)(images, truths, cell_size(sensor))


@jax.jit
def _figures(image: Array, truth: Array, cell: Array) -> Figures:
    return Figures(
        half_width(image, cell),
        half_area_radius(image, cell),
        image_place(image, cell),
        image_error(image, truth),
        greit_figures(image, truth, cell),
    )
