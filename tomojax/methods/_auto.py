"""`auto`: the smallest model that explains a frame."""

from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from tomojax._programs import kept
from tomojax._stopping import stop_if_asked
from tomojax.kernels.algebra import matmul
from tomojax.kernels.contacts import best_currents, whitened_columns
from tomojax.kernels.flags import Flag
from tomojax.methods._contract import AbstractMethod, Estimate, Frame, judged, Part, Rung
from tomojax.methods._errors import highest_cost, misfit_cost, PreparedErrors, whitened
from tomojax.methods._maps import factors_of
from tomojax.methods._rows import Rows
from tomojax.methods._source import PreparedSource, Source
from tomojax.methods.points._points import Points
from tomojax.methods.shapes._image_shape import described, ImageShape
from tomojax.methods.shapes._model import PreparedShape
from tomojax.sensor import Calibration, Sensor


class PreparedAuto(NamedTuple):
    """Arrays for S slots with their good channels."""

    errors: PreparedErrors
    source: PreparedSource
    shape: PreparedShape


class Auto(AbstractMethod):
    """Fits each frame by `points`; unexplained frames by `source`; the rest by `shape`.

    A model explains a frame whose misfit is at the noise: the converter's, with the model's
    own error (`Errors`). The tolerance is that of `points`; λ is `source`'s.
    """

    image_unit: ClassVar[str] = "A/m^2"  # pyright: ignore
    residual_limit: ClassVar[float] = 0.1  # pyright: ignore
    tells_covariance: ClassVar[bool] = True
    tells_rung: ClassVar[bool] = True
    any_grounds: ClassVar[bool] = True
    films: ClassVar[bool] = True
    stands_out: ClassVar[float] = Points.stands_out
    padded: ClassVar[bool] = False
    # As `points`; `shape` works on some, a twentieth or so, for a hundred times as long.
    seconds_per_slot: ClassVar[float] = 2e-3
    cells_per_diameter: ClassVar[int] = ImageShape.cells_per_diameter

    shape: tuple[int, int] = eqx.field(static=True)
    cell: Float[Array, "2"]
    points: Points
    shapes: ImageShape
    inside: Bool[Array, "nx ny"] | None
    grounded: Bool[np.ndarray, "L M"]

    @classmethod
    def of(cls, sensor: Sensor, shape: tuple[int, int]) -> "Auto":
        """Makes the method for an image of `shape` pixels."""
        points = Points.of(sensor, shape)
        shapes = ImageShape.of(sensor, shape)
        return cls(
            shape=shape,
            cell=points.cell,
            points=points,
            shapes=shapes,
            inside=points.inside,
            grounded=points.grounded,
        )

    def calibrated(self, calibration: Calibration) -> "Auto":
        points = self.points.calibrated(calibration)
        shapes = self.shapes.calibrated(calibration)
        return replace(self, points=points, shapes=shapes)

    @property
    def source(self) -> Source:
        """Returns the rung between `points` and `shape`."""
        return self.shapes.source

    @property
    def drive_sign(self) -> Float[Array | np.ndarray, ""]:
        return self.points.drive_sign

    @property
    def highest(self) -> Float[Array | np.ndarray, ""] | float:
        return self.points.highest

    @property
    def noise(self) -> Float[Array, ""]:
        return self.points.noise

    def choose_lambda(self, frames: list[Frame]) -> float:
        """Returns the λ that `source` chooses."""
        return self.source.choose_lambda(frames)

    def scale(self) -> float:
        return self.source.scale()

    def prepare(self, grounds: np.ndarray, good: np.ndarray, lam: float) -> PreparedAuto:
        shape = self.shapes.prepare(grounds, good, 1.0)
        return PreparedAuto(shape.errors, self.source.prepare(grounds, good, lam), shape)

    def estimate(
        self, prepared: PreparedAuto, voltages: Float[Array, "S M"], count: int
    ) -> Estimate:
        points = self.points.estimate(prepared.errors, voltages, count)
        some = points.contacts.count > 0
        points = points._replace(rung=jnp.where(some, Rung.POINTS.value, 0))
        # As `block` judges.
        flags = judged(self.points, points, voltages, images=False).flags
        left = flags & Flag.HIGH_RESIDUAL.value > 0

        larger = partial(self.larger, prepared, voltages, count)
        return jax.lax.cond(left, larger, lambda: points)

    def larger(
        self, prepared: PreparedAuto, voltages: Float[Array, "S M"], count: int
    ) -> Estimate:
        """Fits a frame that `points` does not explain."""
        explained, source = self._source(prepared, voltages, count)
        largest = partial(self._shape, prepared, voltages, count)
        return jax.lax.cond(explained, lambda: source, largest)

    def block(self, prepared: PreparedAuto, part: Part, count: int, images: bool) -> Rows:
        """Estimates n frames; fits a larger model only to the frames that ask for one."""
        found = self.points.block(prepared.errors, part, count, images)
        rows = jax.tree.map(np.array, found)
        rows.rung[:] = np.where(rows.contact_count > 0, Rung.POINTS, Rung.NOTHING)
        for k in np.flatnonzero(rows.flags & Flag.HIGH_RESIDUAL.value):
            stop_if_asked()  # each takes as long as hundreds of the others
            here = prepared
            if (part.grounds[k] != np.asarray(prepared.errors.grounds)).any():
                good, lam = np.asarray(prepared.errors.used), prepared.source.lam
                here = self.prepare(part.grounds[k], good, float(lam))
            rows.put(k, _larger(self, here, part.voltages[k], count, images))
        return rows

    def _source(
        self, prepared: PreparedAuto, voltages: Float[Array, "S M"], count: int
    ) -> tuple[Bool[Array, ""], Estimate]:
        """Tells whether `source`'s image explains the slots; each has its own current."""
        estimate = self.source.estimate(prepared.source, voltages, count)
        frame = whitened(prepared.errors, voltages).frame
        coefficients = matmul(voltages.ravel(), prepared.source.operators)
        law, dtype = self.source, voltages.dtype
        shared = jnp.asarray(law.shared, dtype)
        slots = jax.tree.map(partial(_as, dtype), law.slots)
        volts = matmul(factors_of(slots, shared, frame.grounds), coefficients)
        columns = whitened_columns(frame, volts)
        _, rest = best_currents(columns[:, None], frame.whitened)
        tolerance = prepared.errors.tolerance
        costs = misfit_cost((rest**2).sum(1), tolerance)
        cost = costs.sum() / prepared.errors.slot_count
        rung = jnp.asarray(Rung.SOURCE.value)
        # Its flags stay: the image explains the slots, the contacts read off it may not.
        return cost < highest_cost(tolerance), estimate._replace(rung=rung)

    def _shape(
        self, prepared: PreparedAuto, voltages: Float[Array, "S M"], count: int
    ) -> Estimate:
        model = self.shapes
        fitted = model.fitted(prepared.shape, voltages, model.nothing_before())
        image = fitted.current / jnp.prod(self.cell)
        estimate = described(model, fitted, image, count)
        # Every rung's image is a current; what touches is told by `shape` itself.
        rung = jnp.asarray(Rung.SHAPE.value)
        return estimate._replace(rung=rung, touch=None, deviation=None)


def _as(dtype: Any, values: Any) -> Any:
    """Returns numbers of another dtype; whole numbers stay."""
    return jnp.asarray(values, dtype) if eqx.is_inexact_array_like(values) else values


@kept
def _larger(
    method: Auto,
    prepared: PreparedAuto,
    voltages: Float[Array, "S M"],
    count: int,
    images: bool,
) -> Rows:
    estimate = method.larger(prepared, voltages, count)
    return judged(method, estimate, voltages, images)
