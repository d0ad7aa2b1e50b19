"""Chooses the conditions that tell most of a press's place, by a learned response."""

import numpy as np
from scipy.spatial import KDTree

from tomojax._require import require
from tomojax.ert._pairs import Pairs
from tomojax.ert._response import Response


def choose(response: Response, pairs: Pairs, count: int) -> list[int]:
    """Chooses `count` of the conditions one by one, each the best beside those before.

    The best has the largest mean log det(JᵀΣ⁻¹J + P) over the candidate places, D-optimal:
    J are the map's slopes, Σ is the covariance of what readings scatter about the map, both
    of the chosen conditions' readings. P is what is known of a place without any, a quarter
    of the sheet's width. The criterion is Bayesian D-optimality: Chaloner and Verdinelli,
    Bayesian experimental design: a review, 1995.

    **Returns:** the conditions' numbers, the best first.
    **Raises:** `ValueError` for pairs that the response was not learned with, for counts
    that are none, and for `nominal` responses, whose frames have no size.

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
    """
    shape = pairs.conditions, pairs.readings
    told = f"{shape[0]} × {shape[1]} readings"
    require(np.prod(shape) == len(response.scale), "pairs", told, f"{len(response.scale)}")
    require(1 <= count <= shape[0], "count", f"{count}", f"1 to {shape[0]}")
    require(response.known >= 0, "response", "the nominal sheet", "a learned one")
    of = np.repeat(np.arange(shape[0]), shape[1])[response.used]
    at = np.asarray(response.at, float)
    slopes = _slopes(at, np.asarray(response.readings, float))
    white = np.asarray(response.whitener, float)
    covariance = np.linalg.inv(white.T @ white)
    before = (4 / np.ptp(at[:, 0])) ** 2 * np.eye(2)
    chosen: list[int] = []

    def told_by(conditions: list[int]) -> float:
        some = np.isin(of, conditions)
        if not some.any():
            return -np.inf
        low = np.linalg.cholesky(covariance[np.ix_(some, some)])
        mine = np.linalg.solve(low, slopes[:, some])
        return float(np.mean(np.linalg.slogdet(np.swapaxes(mine, 1, 2) @ mine + before)[1]))

    for _ in range(count):
        left = [one for one in range(shape[0]) if one not in chosen]
        chosen.append(max(left, key=lambda one: told_by([*chosen, one])))
    return chosen


def _slopes(at: np.ndarray, mapped: np.ndarray) -> np.ndarray:
    """Returns ∂f/∂x and ∂f/∂y (G', K, 2) at candidates that have neighbours along both."""
    tree = KDTree(at)
    spacing = tree.query(at[:1], 2)[0][0, 1]
    steps = spacing * np.eye(2)
    apart, ahead = tree.query(at[:, None] + steps)
    here = (apart < 0.1 * spacing).all(1)
    each = (mapped[np.asarray(ahead)[here]] - mapped[here][:, None]) / spacing
    return np.swapaxes(each, 1, 2)
