"""`shape`: finds where an object touches, as a field of two levels, in the exact model."""

from typing import ClassVar

from jaxtyping import Array, Float

from tomojax._programs import kept
from tomojax.methods._contract import Estimate, judged, Part
from tomojax.methods._rows import empty_rows, Rows
from tomojax.methods.shapes._described import described
from tomojax.methods.shapes._model import AbstractShape, Before, CELLS, PreparedShape


class ImageShape(AbstractShape):
    """The likeliest shape: g = level·logistic(f), f a Gaussian field beforehand.

    The image is g, S/m²; rows also have the probability that a pixel touches.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> method = tx.method(sensor, "shape", grid=16)
    >>> isinstance(method, tx.methods.ImageShape), method.image_unit
    (True, 'S/m^2')
    >>> bar = tx.Bar([0.04, 0.04], 0.04, 0.014, 0.0, 0.3)
    >>> volts = np.asarray(tx.voltages(sensor, bar, [0, 3, 12, 15]))
    >>> rows = tx.Batch(method, 1.0)(volts[None], np.array([[0, 3, 12, 15]]))
    >>> found = rows.touch[0] > 0.5  # the probability that a pixel touches
    >>> bool(0.7 < found.sum() * 0.005**2 / (0.04 * 0.014) < 1.5)
    True
    """

    image_unit: ClassVar[str] = "S/m^2"  # pyright: ignore
    residual_limit: ClassVar[float] = 0.1  # pyright: ignore
    stands_out: ClassVar[float] = 3.3
    cells_per_diameter: ClassVar[int] = CELLS
    padded: ClassVar[bool] = False
    seconds_per_slot: ClassVar[float] = 1.5e-2  # 29 ms alone, 110 ms for ten
    films: ClassVar[bool] = True

    def sizes(self, contacts: int, images: bool) -> dict[str, int]:
        nx, ny = self.shape
        return super().sizes(contacts, images) | ({"tx": nx, "ty": ny} if images else {})

    def estimate(
        self, prepared: PreparedShape, voltages: Float[Array, "S M"], count: int
    ) -> Estimate:
        """Fits the shape; the image can be differentiated by the voltages.

        The derivative holds each place's level constant.
        """
        fitted = self.fitted(prepared, voltages, self.nothing_before(), follow=True)
        return described(self, fitted, fitted.conductance, count)

    def block(self, prepared: PreparedShape, part: Part, count: int, images: bool) -> Rows:
        """Estimates frames one by one; a film's frame goes on from the frame before."""
        volts, films = part.voltages, part.films
        rows = empty_rows(len(volts), self.sizes(count, images))
        before = nothing = self.nothing_before()
        for k, v in enumerate(volts):
            follows = films is not None and k > 0 and films[k] == films[k - 1]
            start = before if follows else nothing
            row, before = _row(self, prepared, v, count, images, start)
            rows.put(k, row)
        return rows


@kept
def _row(
    method: ImageShape,
    prepared: PreparedShape,
    voltages: Float[Array, "S M"],
    count: int,
    images: bool,
    before: Before,
) -> tuple[Rows, Before]:
    fitted = method.fitted(prepared, voltages, before)
    estimate = described(method, fitted, fitted.conductance, count)
    return judged(method, estimate, voltages, images), fitted.next
