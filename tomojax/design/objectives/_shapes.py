"""Rates how well a set of grounds tells shapes: the variance left of `shape`'s field."""

from dataclasses import replace
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax._require import require_whole
from tomojax.design.objectives._information import AbstractObjective
from tomojax.kernels.algebra import matmul
from tomojax.methods import ImageShape
from tomojax.sensor import Sensor

# Pixels of a pitch.
_PIXELS = 2.5

# Waves whose coefficients are looked at, the longest.
_WAVES = 48


class ShapeInformation(AbstractObjective):
    """The variance that slots leave of a shape, as a part of the prior variance.

    Shapes are drawn from the field's own prior. The figure is the mean diagonal of (I + Σ_l
    w_l F_l)⁻¹ over the longest waves, with F_l = JᵀN⁻¹J of slot l.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> objective = tx.design.shape_objective(sensor, shapes=2)
    >>> few, all_slots = jnp.zeros(16).at[:4].set(1), jnp.ones(16)
    >>> bool(objective.value(all_slots) < objective.value(few)), objective.unit
    (True, '1')
    """

    convex: ClassVar[bool] = True
    information: Float[Array, "P L K K"]
    swaps: ClassVar[int | None] = 32

    @property
    def slots(self) -> int:
        return self.information.shape[1]

    def alone(self, k: Array) -> "ShapeInformation":
        return replace(self, information=self.information[k][None])

    def __call__(self, weights: Float[Array, " L"]) -> Float[Array, " P"]:
        told = jnp.einsum("l,plij->pij", weights, self.information, precision="highest")
        unit = jnp.eye(told.shape[-1], dtype=told.dtype)
        lower = jnp.linalg.cholesky(told + unit)
        solve = jax.scipy.linalg.solve_triangular
        half = jax.vmap(lambda one: solve(one, unit, lower=True))(lower)
        return (half**2).sum((1, 2)) / len(unit)


def shape_objective(sensor: Sensor, shapes: int = 8, seed: int = 0) -> ShapeInformation:
    """Makes the objective of `--method shape`, over shapes drawn by `seed`.

    The shapes conduct so well that current enters within a pitch of their rim.
    **Raises:** `ValueError` for a number of shapes below 1.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> objective = tx.design.shape_objective(sensor, shapes=2)
    >>> found = tx.design.design(objective, slots=3)
    >>> found.grounds.shape, found.bound <= found.value
    ((3,), True)
    """
    require_whole("shapes", shapes)
    pitches = float(np.max(np.asarray(sensor.size))) / sensor.mean_pitch
    side = max(8, round(_PIXELS * pitches))
    model = ImageShape.of(sensor, (side, side))
    errors, count = model.every_slot(), model.field.waves.shape[2]
    drawn = jax.random.normal(jax.random.key(seed), (shapes, count), model.cell.dtype)
    return ShapeInformation(jnp.stack([_information(model, errors, w) for w in drawn]))


@jax.jit
def _information(model: ImageShape, errors: Any, w: Array) -> Float[Array, "L K K"]:
    slopes = model.slopes_at(errors, w)[:, :, :_WAVES]
    return jax.vmap(lambda s: matmul(s.T, s))(slopes)
