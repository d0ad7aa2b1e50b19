"""`shape`: finds where an object touches, as a field of two levels, in the exact model."""

from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int, Integer

from tomojax._programs import kept
from tomojax.methods._contract import AbstractMethod, Estimate, judged
from tomojax.methods._rows import empty_rows, Rows
from tomojax.methods.shapes._described import described
from tomojax.methods.shapes._model import Before, CELLS, PreparedShape, ShapeModel
from tomojax.sensor import Calibration, Sensor


class ImageShape(AbstractMethod):
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

    shape: tuple[int, int] = eqx.field(static=True)
    cell: Float[Array, "2"]
    model: ShapeModel

    @classmethod
    def of(cls, sensor: Sensor, shape: tuple[int, int]) -> "ImageShape":
        """Makes the method for an image of `shape` pixels."""
        model = ShapeModel.of(sensor, shape)
        return cls(shape, model.cell, model)

    def calibrated(self, calibration: Calibration) -> "ImageShape":
        return replace(self, model=self.model.calibrated(calibration))

    @property
    def drive_sign(self) -> Float[Array, ""]:
        return self.model.drive_sign

    @property
    def noise(self) -> Float[Array, ""]:
        return self.model.errors.noise

    @property
    def electrode_count(self) -> int:
        return self.model.source.electrode_count

    def sizes(self, contacts: int, images: bool) -> dict[str, int]:
        nx, ny = self.shape
        return super().sizes(contacts, images) | ({"tx": nx, "ty": ny} if images else {})

    def prepare(self, grounds: np.ndarray, good: np.ndarray, lam: float) -> PreparedShape:
        return self.model.prepare(grounds, good, lam)

    def estimate(
        self, prepared: PreparedShape, voltages: Float[Array, "S M"], count: int
    ) -> Estimate:
        """Fits the shape; the image can be differentiated by the voltages.

        The derivative holds each place's level constant.
        """
        nothing = self.model.nothing_before()
        fitted = self.model.fitted(prepared, voltages, nothing, follow=True)
        return described(self.model, fitted, fitted.conductance, count)

    def block(
        self,
        prepared: PreparedShape,
        voltages: Float[Array, "n S M"],
        grounds: Integer[np.ndarray, "n S"],
        count: int,
        images: bool,
        films: Int[np.ndarray, " n"] | None = None,
    ) -> Rows:
        """Estimates frames one by one; a film's frame goes on from the frame before."""
        rows = empty_rows(len(voltages), self.sizes(count, images))
        before = nothing = self.model.nothing_before()
        for k, v in enumerate(voltages):
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
    fitted = method.model.fitted(prepared, voltages, before)
    estimate = described(method.model, fitted, fitted.conductance, count)
    return judged(method, estimate, voltages, images), fitted.next
