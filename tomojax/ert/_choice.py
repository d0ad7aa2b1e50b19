"""Chooses the conditions that tell most of a press's place, by a learned response."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import scipy
from jax.dtypes import canonicalize_dtype
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float, Int

from tomojax._require import require
from tomojax.design import AbstractObjective, design
from tomojax.ert._left_out import LeftOut
from tomojax.ert._response import Response
from tomojax.ert.recorded._pairs import Pairs
from tomojax.ert.recorded._recording import PairRecording

_PLACES = 200  # that figures are computed for: a mean over more does not differ
# The least weight of a condition: the slope of a weight's root is infinite at 0.
_LEAST = 1e-6


class PressInformation(AbstractObjective):
    """The least error of a press's place by some of the conditions, after Cramér and Rao.

    F = JᵀD(DΣD + ε(I − D²))⁻¹DJ + P, with the map's slopes J at a place, the covariance Σ
    of what readings scatter about the map, D² = diag(w) of each reading's condition, and ε
    the least eigenvalue of Σ. Weights of 0 and 1 are sets of conditions, exactly; between
    them F is concave in w, so that `tomojax.design.relax` gives a bound. P is what is known
    of a place without a reading: a quarter of the sheet's width. Figures √(tr F⁻¹), m.
    Source: Chaloner and Verdinelli, Bayesian experimental design: a review, 1995.

    **Example:**

    >>> import numpy as np
    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> slopes = jnp.array([[[1.0, 0.0], [1.0, 0.0], [0.0, 3.0]]])  # of one place
    >>> free = np.arange(3)  # each reading is a condition
    >>> none = jnp.zeros(3)
    >>> told = tx.ert.PressInformation(slopes, jnp.eye(3), 1.0, free, free, none, 1.0)
    >>> print(f"{float(told(jnp.array([1.0, 0.0, 1.0]))[0]):.3f} m")  # √(1/2 + 1/10)
    0.775 m
    >>> sorted(tx.design.design(told, slots=2).grounds.tolist())[-1]  # the third and one
    2
    """

    convex: ClassVar[bool] = True
    slopes: Float[Array, "P K 2"]
    covariance: Float[Array, "K K"]
    least: float  # ε
    of: Int[np.ndarray, " K"]  # the condition of each reading
    free: Int[np.ndarray, " L"]  # the conditions to choose from
    given: Float[Array, " C"]  # 1 for the conditions that are measured anyway
    known: float  # P, 1/m²

    @property
    def unit(self) -> str:
        return "m"

    @property
    def slots(self) -> int:
        return len(self.free)

    @property
    def dtype(self) -> jnp.dtype:
        return self.slopes.dtype

    def alone(self, k: Array) -> "PressInformation":
        return replace(self, slopes=self.slopes[k][None])

    def __call__(self, weights: Float[Array, " L"]) -> Float[Array, " P"]:
        each = self.given.at[self.free].set(weights)[self.of]
        root = jnp.sqrt(_LEAST + (1 - _LEAST) * each)
        rest = jnp.diag(self.least * (1 - root**2))
        low = jnp.linalg.cholesky(root[:, None] * self.covariance * root + rest)
        count = len(self.slopes)
        slopes = jnp.moveaxis(self.slopes, 1, 0).reshape(len(root), -1)
        white = solve_triangular(low, root[:, None] * slopes, lower=True)
        white = white.reshape(-1, count, 2)
        told = jnp.einsum("kpi,kpj->pij", white, white, precision="highest")
        told = told + self.known * jnp.eye(2, dtype=told.dtype)
        # Of a 2 × 2 matrix, tr F⁻¹ = tr F / det F.
        return jnp.sqrt(jnp.trace(told, axis1=1, axis2=2) / jnp.linalg.det(told))


def press_information(
    response: Response,
    pairs: Pairs,
    *,
    after: Sequence[int] = (),
    near: Any = None,
) -> PressInformation:
    """Makes the objective that rates conditions by a learned response.

    **Arguments:** `after`: conditions that are measured anyway; the others are to choose
    from. `near`: a place (2,), m, alone, say where the first conditions found a press; all
    places by default.
    **Raises:** `ValueError` for pairs that the response was not learned with, conditions
    that are not there, and `nominal` responses, whose frames have no size.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> x, y = np.meshgrid(*2 * [np.arange(8) * 0.01], indexing="ij")
    >>> x, y = x.ravel(), y.ravel()
    >>> response = tx.ert.Response(
    ...     at=np.stack([x, y], 1),
    ...     readings=np.stack([x, y, y], 1),
    ...     spread=np.zeros(64),
    ...     whitener=1e3 * np.eye(3),
    ...     scale=np.ones(3),
    ...     limit=4.0,
    ...     own=0.0,
    ...     known=100,
    ... )
    >>> pairs = tx.ert.Pairs([[0, 1], [1, 2], [2, 3]], [[[2, 3]], [[3, 4]], [[4, 5]]])
    >>> told = tx.ert.press_information(response, pairs, after=[0])
    >>> told.slots, told.unit  # conditions to choose from
    (2, 'm')
    """
    of = _conditions(response, pairs)
    count = pairs.conditions
    given = np.isin(np.arange(count), after)
    require(given.sum() == len(after), "after", after, f"conditions, 0 to {count - 1}")
    at, dtype = np.asarray(response.at, float), canonicalize_dtype(response.readings.dtype)
    here, slopes = _slopes(at, np.asarray(response.readings, float))
    some = np.arange(len(here))[:: -(-len(here) // _PLACES)]
    if near is not None:
        near = np.asarray(near, float)
        require(near.shape == (2,), "near", f"shape {near.shape}", "(2,), m")
        some = np.argmin(np.linalg.norm(at[here] - near, axis=1), keepdims=True)
    covariance = _covariance(response)
    return PressInformation(
        slopes=jnp.asarray(slopes[some], dtype),
        covariance=jnp.asarray(covariance, dtype),
        least=float(np.linalg.eigvalsh(covariance)[0]),
        of=of[response.used],
        free=np.flatnonzero(~given),
        given=jnp.asarray(given, dtype),
        known=float((4 / np.ptp(at[:, 0])) ** 2),
    )


def choose(
    response: Response,
    pairs: Pairs,
    count: int,
    *,
    after: Sequence[int] = (),
    near: Any = None,
    presses: PairRecording | None = None,
) -> list[int]:
    """Chooses `count` conditions that place a press best: `tomojax.design.design`.

    `press_information` has the objective, the arguments and the errors. It sees what the
    map tells of a place, and no more.

    **Arguments:** `presses`: a recording with 40 known places or more. Conditions are then
    taken one after another, by how far its presses are placed: maps of one half place the
    other half, and known places correct them. Some conditions alone tell no place, but how
    far others' places are off. It takes about a minute for four of 16 conditions.

    **Returns:** the conditions' numbers; each adds most to those before.

    **Raises:** `ValueError` for too few known places, and for `presses` beside `near`.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> x, y = np.meshgrid(*2 * [np.arange(8) * 0.01], indexing="ij")
    >>> x, y = x.ravel(), y.ravel()
    >>> response = tx.ert.Response(
    ...     at=np.stack([x, y], 1),
    ...     readings=np.stack([x, 0 * x, x, 3 * y], 1),  # the last condition tells of y
    ...     spread=np.zeros(64),
    ...     whitener=1e3 * np.eye(4),
    ...     scale=np.ones(4),
    ...     limit=4.0,
    ...     own=0.0,
    ...     known=100,
    ... )
    >>> pairs = tx.ert.Pairs([[0, 1], [1, 2]], [[[2, 3], [3, 4]], [[3, 4], [4, 5]]])
    >>> tx.ert.choose(response, pairs, 1)
    [1]
    >>> tx.ert.choose(response, pairs, 1, after=[1], near=(0.01, 0.02))
    [0]
    """
    objective = press_information(response, pairs, after=after, near=near)
    if presses is not None:
        require(near is None, "near", near, "None beside presses")
        free = len(objective.free)
        require(0 < count <= free, "count", count, f"1 to {free} conditions")
        return LeftOut.of(response, presses).choose(objective.of, count, after)
    found = design(objective, count).grounds
    return [int(objective.free[one]) for one in found]


def restrict(response: Response, pairs: Pairs, conditions: Sequence[int]) -> Response:
    """Returns the response of some conditions alone; frames keep all readings' shape.

    The readings of the other conditions do not count, be they measured or NaN. Places are
    the map's: `learn` from these conditions alone also knows how far its places are off,
    and looks for two presses at once.

    **Raises:** `ValueError` as `choose` does.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> at = np.array([[0.0, 0.0], [0.01, 0.0]])
    >>> response = tx.ert.Response(
    ...     at=at,
    ...     readings=np.array([[1.0, 0.1], [0.1, 1.0]]),
    ...     spread=np.zeros(2),
    ...     whitener=100 * np.eye(2),
    ...     scale=np.ones(2),
    ...     limit=4.0,
    ...     own=0.0,
    ...     known=100,
    ... )
    >>> pairs = tx.ert.Pairs([[0, 1], [1, 2]], [[[2, 3]], [[3, 0]]])
    >>> one = tx.ert.restrict(response, pairs, [0])
    >>> one.locate(np.array([[[2.1], [np.nan]]])).xy.round(3).tolist()
    [[0.0, 0.0]]
    """
    of, used = _conditions(response, pairs), response.used
    some = np.isin(of, conditions)
    fits = len(conditions) and set(conditions) <= set(of.tolist()) and (some & used).any()
    require(fits, "conditions", conditions, f"some of 0 to {of.max()} that tell anything")
    keep = some[used]
    low = np.linalg.cholesky(_covariance(response)[np.ix_(keep, keep)])
    return replace(
        response,
        readings=response.readings[:, keep],
        whitener=np.linalg.inv(low).astype(response.whitener.dtype),
        scale=np.where(some, response.scale, 0.0),
        alone=np.inf,
        taught=None,
        weights=None,
    )


def _conditions(response: Response, pairs: Pairs) -> Int[np.ndarray, " N"]:
    """Returns the condition of each reading; refuses what does not go together."""
    shape = pairs.conditions, pairs.readings
    told = f"{shape[0]} × {shape[1]} readings"
    require(np.prod(shape) == len(response.scale), "pairs", told, f"{len(response.scale)}")
    require(response.known >= 0, "response", "the nominal sheet", "a learned one")
    return np.repeat(np.arange(shape[0]), shape[1])


def _covariance(response: Response) -> Float[np.ndarray, "K K"]:
    white = np.asarray(response.whitener, float)
    return np.linalg.inv(white.T @ white)


def _slopes(
    at: Float[np.ndarray, "G 2"], mapped: Float[np.ndarray, "G K"]
) -> tuple[Int[np.ndarray, " H"], Float[np.ndarray, "H K 2"]]:
    """Returns the candidates that have neighbours along both axes, and ∂f/∂(x, y) there."""
    tree = scipy.spatial.KDTree(at)
    spacing = tree.query(at[:1], 2)[0][0, 1]
    apart, ahead = tree.query(at[:, None] + spacing * np.eye(2))
    here = np.flatnonzero((apart < 0.1 * spacing).all(1))
    each = (mapped[np.asarray(ahead)[here]] - mapped[here][:, None]) / spacing
    return here, np.swapaxes(each, 1, 2)
