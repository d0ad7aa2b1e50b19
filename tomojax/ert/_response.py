"""Learns a skin's own response to presses, and places presses by it.

A response is a smooth map from places to readings (`kernels.inverse.smooth_map`), at
candidate places, with the covariance of what readings scatter about it. Readings v count as
asinh(v/2s), with s their usual size: errors of large readings grow with the readings.
"""

import functools
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tomojax._require import require
from tomojax._whole import whole
from tomojax.ert._locator import locate, Located, Locator
from tomojax.files import open_container

SCHEMA = "tomojax-response"
_NUMBERS = dict.fromkeys(("limit", "own", "alone", "share", "reach"), float) | {
    "known": int
}  # attributes of a file


@dataclass(frozen=True, eq=False)
class Response:
    """What a skin's readings are for a press at each of G candidate places.

    - `at` (G, 2): the candidates, m. `readings` (G, K): the map there, of asinh(v/2s) with
      the usual sizes `scale` s (C·R,); columns of the physics, of frames of norm 1, where
      `known` is −1. `spread` (G,): the map's variance, over a reading's noise.
    - `whitener` (K, K): W with WᵀW the inverse of the errors' covariance.
    - `limit`: the largest χ² of a reading that a lone press leaves. `alone`: the largest
      log of the ratio of its χ² to that of two presses.
    - `own`: the deviation of the map itself, from known places that it had not seen, m;
      `share`: what counts of the deviation by the probabilities, where that is too large.
    - `known`: the number of places that it was learned with.
    - `taught` (M, K), `weights` (M, 2), `reach`: the move from where the map places presses
      to where they were is k(y, taught)·weights, by a kernel of length `reach` of readings.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> one = tx.ert.Response(
    ...     at=np.array([[0.0, 0.0], [0.01, 0.0]]),
    ...     readings=np.array([[1.0, 0.1, 0.2], [0.1, 1.0, 0.2]]),
    ...     spread=np.zeros(2),
    ...     whitener=100 * np.eye(3),
    ...     scale=np.ones(3),
    ...     limit=4.0,
    ...     own=0.001,
    ...     known=100,
    ... )
    >>> one.locate(2 * np.sinh(one.readings)[:, None]).xy.round(3).tolist()
    [[0.0, 0.0], [0.01, 0.0]]
    """

    at: Float[np.ndarray, "G 2"]
    readings: Float[np.ndarray, "G K"]
    spread: Float[np.ndarray, " G"]
    whitener: Float[np.ndarray, "K K"]
    scale: Float[np.ndarray, " N"]
    limit: float
    own: float
    known: int
    alone: float = np.inf
    share: float = 1.0
    taught: Float[np.ndarray, "M K"] | None = None
    weights: Float[np.ndarray, "M 2"] | None = None
    reach: float = 1.0

    @property
    def used(self) -> Bool[np.ndarray, " N"]:
        """Tells which readings count: the others never changed, or are no numbers."""
        return np.asarray(self.scale > 0)

    def save(self, path: Path | str) -> None:
        """Writes the response to a file (HDF5)."""
        import h5py

        with whole(path) as part, h5py.File(part, "w") as file:
            file.attrs["schema"] = SCHEMA
            for field in fields(self):
                where = file.attrs if field.name in _NUMBERS else file
                if (value := getattr(self, field.name)) is not None:
                    where[field.name] = value

    @classmethod
    def load(cls, path: Path | str) -> "Response":
        """Reads what `save` wrote.

        **Raises:** `ValueError` for a file that is no response.
        """
        try:
            opened = open_container(path)
        except OSError as error:
            told = f"{path}: file: got no HDF5 file ({error}), expected a response"
            raise ValueError(f"{told} of tomojax calibrate") from None
        with opened as file:
            schema = file.attributes.get("schema")
            require(schema == SCHEMA, f"{path}: schema", repr(schema), repr(SCHEMA))
            names = {field.name for field in fields(cls)} & set(file.names)
            read: dict[str, Any] = {name: file.read_whole(name) for name in names}
            for name, kind in _NUMBERS.items():
                read[name] = kind(file.attributes[name])
        return cls(**read)

    @functools.cached_property
    def locator(self) -> Locator:
        """Returns the response made ready for frames: a pure function."""
        return Locator(self)

    def locate(self, voltages: Float[np.ndarray, "n C R"]) -> Located:
        """Places one press a frame: the mean over candidates by their probabilities.

        Known places then tell how far such readings' places are off.
        A frame that no usual press explains is tried as a weaker and as a stronger one;
        `HIGH_RESIDUAL` then says that no lone press explains it, or that two presses, whose
        readings add up, explain it clearly better. `PLACE_UNCERTAIN` is on every row where
        too few places were known to say how far places are off. `locator` answers one frame
        at a time, within other compiled code too.

        **Raises:** `ValueError` for readings that are not the response's.
        """
        return self.placed(voltages)[0]

    def placed(
        self, voltages: Float[np.ndarray, "n C R"]
    ) -> tuple[Located, Float[np.ndarray, " n"]]:
        """Locates, and returns log(χ² by one press / χ² by two); 0 by the physics."""
        return locate(self.locator, voltages, len(self.scale))


def compressed(flat: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Returns asinh(v/2s): about v/2s where small, and its logarithm where large."""
    return np.arcsinh(flat / (2 * scale))
