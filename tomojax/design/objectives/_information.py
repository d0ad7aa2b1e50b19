"""Rates a set of ground conditions: figures of weights over slots.

Each slot l counts w_l times. The slots' information adds up, F = F₀ + Σ_l w_l F_l. Every
figure in this file is convex in w: `relax` finds the least figure, which no set of slots
can beat.

`ShapeInformation` rates how well a set tells shapes: the variance left of `shape`'s field.
"""

from abc import abstractmethod
from dataclasses import replace
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tomojax._require import require_whole
from tomojax.kernels.algebra import matmul
from tomojax.kernels.contacts import solve_small
from tomojax.methods import ImageShape, UNIT
from tomojax.sensor import Sensor

Criterion = Literal["place", "a", "d", "worst", "rigs"]


class AbstractObjective(eqx.Module):
    """P figures of a weighting, the lower the better.

    A class says `convex = True` where its figures are convex in the weights; a design then
    has a bound. `swaps` = n tries n swaps of slots in each step of an exchange, those where
    the slope is steepest; None tries all swaps.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = tx.design.design_places(sensor, count=4)
    >>> objective = tx.design.design_objective(sensor, places, "points", "place")
    >>> isinstance(objective, tx.design.AbstractObjective)
    True
    >>> objective(jnp.ones(objective.slots)).shape  # a figure for each place
    (4,)
    >>> objective.slots, objective.unit, objective.convex
    (16, 'm', True)
    """

    convex: ClassVar[bool] = False
    swaps: ClassVar[int | None] = None

    @property
    def unit(self) -> str:
        """Returns the figures' unit; "1" by default."""
        return "1"

    @property
    def worst(self) -> bool:
        """Tells whether the highest figure counts; by default the mean does."""
        return False

    @property
    @abstractmethod
    def slots(self) -> int:
        """Returns L, the number of ground conditions to choose from."""

    @abstractmethod
    def __call__(self, weights: Float[Array, " L"]) -> Float[Array, " P"]:
        """Returns the figures of weights w ≥ 0; weights of 0 and 1 are a set."""

    @property
    def dtype(self) -> jnp.dtype:
        return jnp.result_type(*jax.tree.leaves(self))

    @abstractmethod
    def alone(self, k: Array) -> "AbstractObjective":
        """Returns the objective of figure k only."""

    def in_reach(self) -> "AbstractObjective":
        """Returns the objective with parameters that a descent can start from."""
        return self

    def value(self, weights: Float[Array, " L"]) -> Float[Array, ""]:
        """Returns the one number that a design makes small."""
        figures = self(weights)
        return figures.max() if self.worst else figures.mean()


def place_prior(unit: Float[Array, ""]) -> Float[Array, "3 3"]:
    """Returns the prior information on place (per unit) and size.

    A contact's place is known to a pitch beforehand, and its size to what `points` knows of
    it. Without the first, one slot may say nothing.
    """
    known = jnp.full_like(unit, UNIT**2)
    return jnp.diag(jnp.stack([known, known, jnp.ones_like(known)]))


class PlaceInformation(AbstractObjective):
    """The least error of a contact's place by `points`, after Cramér and Rao.

    F_l = JᵀN⁻¹J of place and size, with the slot's current free. The currents are those
    that the ground really draws; N has the errors of `points`, or stated errors. Figures in
    m: "place" and "worst" √(C_xx + C_yy), "d" (det C)^(1/4). "a" is the variance C_xx +
    C_yy, m².
    """

    convex: ClassVar[bool] = True
    criterion: str = eqx.field(static=True)
    information: Float[Array, "P L 3 3"]  # of x, y (per unit) and size
    length: Float[Array, ""]  # the unit, m

    @property
    def unit(self) -> str:
        return "m2" if self.criterion == "a" else "m"

    @property
    def worst(self) -> bool:
        return self.criterion == "worst"

    @property
    def slots(self) -> int:
        return self.information.shape[1]

    def alone(self, k: Array) -> "PlaceInformation":
        return replace(self, information=self.information[k][None])

    def __call__(self, weights: Float[Array, " L"]) -> Float[Array, " P"]:
        told = jnp.einsum("l,plij->pij", weights, self.information, precision="highest")
        place = jnp.broadcast_to(jnp.eye(3, 2, dtype=told.dtype), (len(told), 3, 2))
        known = told + place_prior(self.length)
        covariance = solve_small(known, place)[:, :2] * self.length**2
        if self.criterion == "d":
            return jnp.linalg.det(covariance) ** 0.25
        variance = jnp.trace(covariance, axis1=1, axis2=2)
        return variance if self.criterion == "a" else jnp.sqrt(variance)


class ImageVariance(AbstractObjective):
    """The posterior variance of an image where a contact may be.

    For φ ~ N(0, σ²/λ) and errors of variance σ², the variance is λuᵀ(H + λI)⁻¹u with H =
    Σ_l w_l c_l² A_lᵀA_l. The contact in the image's basis is u, |u| = 1. The variance is
    the part that these slots leave open of all that slots could tell. The current of slot l
    relative to the slots' mean is c_l ("source"; Eq. 3's J contains c_l).
    "d" is the geometric mean over the directions that the contacts span.

    **Example:**

    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> places = tx.design.design_places(sensor, count=4)
    >>> objective = tx.design.design_objective(sensor, places, "source", "place", grid=16)
    >>> isinstance(objective, tx.design.ImageVariance)
    True
    >>> few, all_slots = jnp.zeros(16).at[:4].set(1), jnp.ones(16)
    >>> bool(objective.value(all_slots) < objective.value(few))
    True
    """

    convex: ClassVar[bool] = True
    criterion: str = eqx.field(static=True)
    grams: Float[Array, "L r r"]  # A_lᵀN⁻¹A_l
    columns: Float[Array, "P r"]
    shares: Float[Array, "contacts L"] | None  # c_l²
    lam: Float[Array, ""]

    @property
    def worst(self) -> bool:
        return self.criterion == "worst"

    @property
    def slots(self) -> int:
        return len(self.grams)

    def alone(self, k: Array) -> "ImageVariance":
        shares = None if self.shares is None else self.shares[k][None]
        return replace(self, columns=self.columns[k][None], shares=shares)

    def __call__(self, weights: Float[Array, " L"]) -> Float[Array, " P"]:
        if self.criterion == "d":
            mean = weights if self.shares is None else weights * self.shares.mean(0)
            half = self._half(mean, self.columns)
            lower = jnp.linalg.cholesky(matmul(half, half.T))
            return jnp.exp(2 * jnp.log(jnp.diagonal(lower)).mean())[None]
        if self.shares is None:
            return (self._half(weights, self.columns) ** 2).sum(1)

        def one(share_and_column: tuple[Array, Array]) -> Array:
            share, column = share_and_column
            return (self._half(weights * share, column[None]) ** 2).sum()

        return jax.lax.map(one, (self.shares, self.columns))

    def _half(self, weights: Array, columns: Float[Array, "q r"]) -> Float[Array, "q r"]:
        told = jnp.einsum("l,lrs->rs", weights, self.grams, precision="highest")
        system = told / self.lam + jnp.eye(len(told), dtype=told.dtype)
        lower = jnp.linalg.cholesky(system)
        solve = jax.scipy.linalg.solve_triangular
        return solve(lower, columns.T, lower=True).T


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
