"""Learns a skin's own response to presses, and places presses by it.

A response is a smooth map from places to readings (`kernels.inverse.smooth_map`), at
candidate places, with the covariance of what readings scatter about it. Readings v count as
asinh(v/2s), with s their usual size: errors of large readings grow with the readings.
"""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Integer

from tomojax._require import require
from tomojax._whole import whole
from tomojax.ert._learning import (
    by_columns,
    least_chi2,
    moves,
    place,
    Posterior,
)
from tomojax.files import open_container
from tomojax.kernels.flags import Flag

SCHEMA = "tomojax-response"
_NUMBERS = dict.fromkeys(("limit", "own", "alone", "share", "reach"), float) | {
    "known": int
}  # attributes of a file

HIDDEN = 20  # known places that judge a map: a share of 68 % of 20 is known to 10 %
LEAST_KNOWN = 2 * HIDDEN
_STRENGTHS = (0.5, 0.7, 1.4, 2.0)  # of a press, tried where none of the usual one fits
QUIET = 0.25  # of a usual press's strength: nothing presses
# Two presses are tried on a tenth of the candidates' extent, at these strengths: halves, so
# that what one press explains two explain about as well, and no strength tells them apart.
_COARSE = 10
_BOTH = ((1.0, 1.0), (0.5, 0.5), (1.0, 0.5), (0.5, 1.0))


class Located(NamedTuple):
    """Places of n frames, m, as the recording has them.

    **Example:**

    >>> import tomojax as tx
    >>> tx.ert.Located._fields
    ('xy', 'covariance', 'strength', 'residual', 'flags')
    """

    xy: Float[np.ndarray, "n 2"]
    covariance: Float[np.ndarray, "n 2 2"]  # m²
    strength: Float[np.ndarray, " n"]  # of the press, over the usual press's there
    residual: Float[np.ndarray, " n"]  # rms, in standard deviations of the readings
    flags: Integer[np.ndarray, " n"]  # bits of `Flag`


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

    def locate(self, voltages: Float[np.ndarray, "n C R"]) -> Located:
        """Places one press a frame: the mean over candidates by their probabilities.

        Known places then tell how far such readings' places are off.
        A frame that no usual press explains is tried as a weaker and as a stronger one;
        `HIGH_RESIDUAL` then says that no lone press explains it, or that two presses, whose
        readings add up, explain it clearly better. `PLACE_UNCERTAIN` is on every row where
        too few places were known to say how far places are off.

        **Raises:** `ValueError` for readings that are not the response's.
        """
        flat = np.asarray(voltages, float).reshape(len(voltages), -1)
        shown = f"{flat.shape[1]} a frame"
        require(flat.shape[1] == len(self.scale), "v", shown, f"{len(self.scale)}")
        flat = flat[:, self.used]
        missing = ~np.isfinite(flat)
        filled = np.where(missing, 0.0, flat)
        found, strength = self._placed(filled)
        if missing.any():  # a reading that is missing is as the press there has it
            usual = strength[:, None] * self._usual(found)
            filled = np.where(missing, usual, filled)
            found, strength = self._placed(filled)
        flags = np.zeros(len(flat), np.uint32)
        chi2 = np.asarray(found.chi2)
        doubted = (chi2 > self.limit) | (self.gain_of_two(filled) > self.alone)
        flags[doubted] |= Flag.HIGH_RESIDUAL.value
        flags[strength < QUIET] = Flag.NO_CONTACT.value
        if self.known < LEAST_KNOWN:
            flags |= np.uint32(Flag.PLACE_UNCERTAIN.value)
        flags[missing.any(1)] |= Flag.DEAD_CHANNEL.value
        flags[missing.mean(1) > 0.5] |= Flag.NO_DATA.value
        covariance = self.share**2 * np.asarray(found.covariance, float)
        covariance += self.own**2 * np.eye(2)
        residual = np.sqrt(chi2.astype(float))
        return Located(np.asarray(found.xy, float), covariance, strength, residual, flags)

    def gain_of_two(self, flat: Float[np.ndarray, "n K"]) -> Float[np.ndarray, " n"]:
        """Returns log(χ² by one press / χ² by two), each the least; 0 by the physics."""
        if self.known < 0:
            return np.zeros(len(flat))
        values = compressed(flat, self.scale[self.used]).astype(self.at.dtype)
        raw, low = np.sinh(self.readings), self.at.min(0)
        step = (self.at.max(0) - low).max() / _COARSE + 1e-12
        cells = np.floor((self.at - low) / step)
        few = np.unique(cells, axis=0, return_index=True)[1]
        apart = np.abs(cells[few][:, None] - cells[few]).max(-1) > 1
        one, other = few[np.array(np.nonzero(np.triu(apart)))]

        if not len(one):
            return np.zeros(len(flat))

        def least(mapped: np.ndarray) -> np.ndarray:
            mapped = np.arcsinh(mapped).astype(self.at.dtype)
            return np.asarray(least_chi2(values, mapped, self.whitener))

        lone = [least(each * raw) for each in (1.0, *_STRENGTHS)]
        both = [least(a * raw[one] + b * raw[other]) for a, b in _BOTH]
        by_one, by_two = (np.log(np.maximum(np.min(c, 0), 1e-30)) for c in (lone, both))
        return by_one - by_two

    def _placed(
        self, flat: Float[np.ndarray, "n K"]
    ) -> tuple[Posterior, Float[np.ndarray, " n"]]:
        if self.known < 0:
            size = np.linalg.norm(flat, axis=1, keepdims=True)
            unit = np.asarray(flat / np.where(size > 0, size, 1), self.at.dtype)
            found, strength = by_columns(unit, self.readings, self.whitener, self.at)
            usual = self.scale[self.used][0]  # the norm of a usual frame
            return found, np.asarray(strength[:, 0] > 0) * size[:, 0] / usual
        found = self._by_map(flat)
        poor = np.flatnonzero(np.asarray(found.chi2) > self.limit)
        for strength in _STRENGTHS if len(poor) else ():
            other = self._by_map(flat[poor] / strength)
            better = np.asarray(other.chi2) < np.asarray(found.chi2)[poor]
            put = [np.array(field) for field in found]
            for mine, new in zip(put, other, strict=True):
                mine[poor[better]] = np.asarray(new)[better]
            found = Posterior(*(jnp.asarray(one) for one in put))
        usual = self._usual(found)
        weight = 1 / self.scale[self.used] ** 2
        product = np.sum(flat * usual * weight, 1)
        return found, product / np.maximum(np.sum(usual**2 * weight, 1), 1e-30)

    def _by_map(self, flat: Float[np.ndarray, "n K"]) -> Posterior:
        values = compressed(flat, self.scale[self.used]).astype(self.at.dtype)
        found = place(values, self.readings, self.spread, self.whitener, self.at)
        if self.taught is None or self.weights is None:
            return found
        reach = np.asarray(self.reach, self.at.dtype)
        return found._replace(xy=found.xy - moves(values, self.taught, self.weights, reach))

    def _usual(self, found: Posterior) -> Float[np.ndarray, "n K"]:
        """Returns the readings of presses of the usual strength at the found places."""
        mapped = np.asarray(self.readings, float)[np.asarray(found.best)]
        scale = self.scale[self.used]
        if self.known < 0:
            return scale * mapped / np.linalg.norm(mapped, axis=1, keepdims=True)
        return 2 * scale * np.sinh(mapped)


def compressed(flat: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Returns asinh(v/2s): about v/2s where small, and its logarithm where large."""
    return np.arcsinh(flat / (2 * scale))
