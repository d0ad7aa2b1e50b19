"""Learns a skin's own response to presses, and places presses by it.

A response is a smooth map from places to readings (`kernels.inverse.smooth_map`), at
candidate places, with the covariance of what readings scatter about it. Readings v count as
asinh(v/2s), with s their usual size: errors of large readings grow with the readings.
"""

from collections.abc import Callable
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
    learn_places,
    Learned,
    learned,
    place,
    place_by_physics,
    Posterior,
)
from tomojax.ert._recording import PairRecording
from tomojax.ert._sheet_change import background, sensitivities
from tomojax.files import open_container
from tomojax.kernels.flags import Flag

SCHEMA = "tomojax-response"
_NUMBERS = {"limit": float, "own": float, "known": int}  # attributes of a file

_CANDIDATES = 48  # along the sheet's longer side: places lie closer than presses are wide
_LENGTHS = (0.14, 0.2, 0.28, 0.4)  # of the last map, in widths of the sheet
_UNLABELLED = 600  # presses that the rounds take; a map of so many is made in a second
_LABELLED = 1800  # likewise of places that stay where they are
_HIDDEN = 20  # known places that judge the map: a share of 68 % of 20 is known to 10 %
_LEAST_KNOWN = 2 * _HIDDEN
_STRENGTHS = (0.5, 0.7, 1.4, 2.0)  # of a press, tried where none of the usual one fits
_CLEARLY = 1.5  # more of the frames' squares
_QUIET = 0.25  # of a usual press's strength: nothing presses
# χ² with two degrees of freedom has 68.27 % of its values below this one.
_WITHIN = 2.298


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
    - `limit`: the largest χ² of a reading that a lone press leaves.
    - `own`: the deviation of the map itself, from known places that it had not seen, m.
    - `known`: the number of places that it was learned with.

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
                where[field.name] = getattr(self, field.name)

    @classmethod
    def load(cls, path: Path | str) -> "Response":
        """Reads what `save` wrote.

        **Raises:** `ValueError` for a file that is no response.
        """
        with open_container(path) as file:
            schema = file.attributes.get("schema")
            require(schema == SCHEMA, f"{path}: schema", repr(schema), repr(SCHEMA))
            arrays = [field.name for field in fields(cls) if field.name not in _NUMBERS]
            read: dict[str, Any] = {name: file.read_whole(name) for name in arrays}
            told = {name: kind(file.attributes[name]) for name, kind in _NUMBERS.items()}
        return cls(**read, **told)

    def locate(self, voltages: Float[np.ndarray, "n C R"]) -> Located:
        """Places one press a frame: the mean over candidates by their probabilities.

        A frame that no usual press explains is tried as a weaker and as a stronger one;
        `HIGH_RESIDUAL` then says that no lone press explains it. `PLACE_UNCERTAIN` is on
        every row where too few places were known to say how far places are off.

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
            usual = self._voltages(found, strength, filled)
            found, strength = self._placed(np.where(missing, usual, filled))
        flags = np.zeros(len(flat), np.uint32)
        flags[np.asarray(found.chi2) > self.limit] |= Flag.HIGH_RESIDUAL.value
        flags[strength < _QUIET] = Flag.NO_CONTACT.value
        if self.known < _LEAST_KNOWN:
            flags |= np.uint32(Flag.PLACE_UNCERTAIN.value)
        flags[missing.any(1)] |= Flag.DEAD_CHANNEL.value
        flags[missing.mean(1) > 0.5] |= Flag.NO_DATA.value
        covariance = np.asarray(found.covariance, float) + self.own**2 * np.eye(2)
        residual = np.sqrt(np.asarray(found.chi2, float))
        return Located(np.asarray(found.xy, float), covariance, strength, residual, flags)

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
        usual = self._voltages(found)
        weight = 1 / self.scale[self.used] ** 2
        product = np.sum(flat * usual * weight, 1)
        return found, product / np.maximum(np.sum(usual**2 * weight, 1), 1e-30)

    def _by_map(self, flat: Float[np.ndarray, "n K"]) -> Posterior:
        values = _compressed(flat, self.scale[self.used]).astype(self.at.dtype)
        return place(values, self.readings, self.spread, self.whitener, self.at)

    def _voltages(self, found: Posterior, *scaled: np.ndarray) -> np.ndarray:
        """Returns what the found presses' readings are."""
        mapped = np.asarray(self.readings, float)[np.asarray(found.best)]
        if self.known < 0:
            size = np.linalg.norm(scaled[1], axis=1) if scaled else np.ones(len(mapped))
            norm = np.linalg.norm(mapped, axis=1)
            return mapped * (size / np.maximum(norm, 1e-30))[:, None]
        usual = 2 * self.scale[self.used] * np.sinh(mapped)
        return usual * scaled[0][:, None] if scaled else usual


def nominal(recording: PairRecording) -> Response:
    """Takes the physics of the sheet for the response; learns the readings' errors alone.

    A press is one local change of the sheet's conductance, of any strength; the change's
    sign is the likelier one.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    >>> rim = 0.05 * np.stack([np.cos(angle), np.sin(angle)], 1)
    >>> disc = tx.recordings.Outline("disc", 0.1)
    >>> sensor = tx.Sensor.disc(0.1, rim + 0.05, electrode_diameter=0.01)
    >>> pairs = tx.ert.Pairs.opposite(8)
    >>> places = np.random.default_rng(0).uniform(-0.02, 0.02, (30, 2))
    >>> volts = -np.asarray(tx.ert.sensitivities(sensor, pairs, places + 0.05))
    >>> recording = tx.ert.PairRecording(volts, pairs, rim, 0.01, outline=disc)
    >>> found = tx.ert.nominal(recording).locate(volts)
    >>> bool(np.abs(found.xy - places).max() < 0.002)
    True
    """
    return _nominal(recording, _usable(recording))[0]


def learn(
    recording: PairRecording,
    *,
    frames: int | None = None,
    progress: Callable[[str], None] | None = None,
    dtype: type = np.float32,
) -> Response:
    """Learns a skin's response from presses, one a frame, at known or unknown places.

    Presses without a place are placed by the physics first, then by maps that other presses
    make, in rounds. Nothing then tells turns, mirrors and smooth warps of the whole from
    the truth but the physics, and a few known places.

    **Arguments:** `frames`: how many of the first frames it takes, all by default. Fewer
    places are `recording.knowing`. `progress` is called with a text, round by round.
    Where the physics is right, and no place is known, `nominal` is nearer to the truth.

    **Raises:** `ValueError` for fewer than twenty presses.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> rng = np.random.default_rng(0)
    >>> angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    >>> rim = 0.05 * np.stack([np.cos(angle), np.sin(angle)], 1)
    >>> places = rng.uniform(-0.02, 0.02, (60, 2))
    >>> waves = rng.normal(size=(2, 8, 4)) / 0.03  # readings no sheet would give
    >>> volts = np.sin(np.einsum("ni,icr->ncr", places, waves))
    >>> told = {"outline": tx.recordings.Outline("disc", 0.1), "places": places}
    >>> pairs = tx.ert.Pairs.opposite(8)
    >>> recording = tx.ert.PairRecording(volts, pairs, rim, 0.01, **told)
    >>> found = tx.ert.learn(recording).locate(volts)
    >>> bool(np.median(np.abs(found.xy - places)) < 0.003)
    True
    """
    flat = recording.voltages.reshape(len(recording.voltages), -1)
    use = _usable(recording)
    use.frames[len(flat) if frames is None else frames :] = False
    random = np.random.default_rng(0)
    pressed = use.frames & (_size(flat, use.scale) > _QUIET)
    known, free = pressed & recording.known, pressed & ~recording.known
    chosen = np.concatenate(
        [
            random.permutation(np.flatnonzero(known))[:_LABELLED],
            random.permutation(np.flatnonzero(free))[:_UNLABELLED],
        ]
    )
    chosen.sort()
    fewest = 20
    require(len(chosen) >= fewest, "v", f"{len(chosen)} presses", f"at least {fewest}")
    told = recording.known[chosen]
    model, start = _nominal(recording, use, chosen)
    at, width = model.at.astype(dtype), max(recording.box)
    values = _compressed(flat[chosen][:, use.scale > 0], use.scale[use.scale > 0])
    values = values.astype(dtype)
    nowhere = np.full((len(flat), 2), np.nan)
    true = (nowhere if recording.places is None else recording.places)[chosen]

    def placed(fixed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        xy = np.where(fixed[:, None], true, start.xy).astype(dtype)
        # Candidates have a spacing: no place is more certain than a cell.
        wide = np.maximum(start.deviation, width / _CANDIDATES)
        wide = np.where(fixed, 0, wide).astype(dtype)
        return learn_places(values, xy, wide, at, width, progress)

    own = 0.0
    if told.sum() >= _LEAST_KNOWN:  # some are found as if they were not known
        # Twenty or more, a fifth of many: what is judged is nearly the whole.
        every = np.clip(told.sum() // _HIDDEN, 2, 5)
        hidden = np.flatnonzero(told)[::every]
        fixed = told.copy()
        fixed[hidden] = False
        xy, _, moments = placed(fixed)
        own = _own_deviation((xy - true)[hidden], moments[hidden], width)
    xy, deviation, _ = placed(told)

    def best(of: np.ndarray) -> Learned:
        lengths = [np.asarray(share * width, dtype) for share in _LENGTHS]
        made = [learned(xy[of], values[of], deviation[of], at, one) for one in lengths]
        return max(made, key=lambda one: float(one.map.evidence))

    def response(by: Learned, limit: float = np.inf) -> Response:
        return Response(
            at=at,
            readings=np.asarray(by.map.readings),
            spread=np.asarray(by.map.spread),
            whitener=np.asarray(by.whitener),
            scale=use.scale,
            limit=limit,
            own=own,
            known=int(told.sum()),
        )

    # A map of half the presses says what χ² the other half has; one in a hundred is let go.
    order = random.permutation(len(chosen))
    half, rest = order[::2], order[1::2]
    unseen = response(best(half)).locate(recording.voltages[chosen[rest]])
    return response(best(order), float(np.quantile(unseen.residual**2, 0.99)))


def _own_deviation(
    away: Float[np.ndarray, "n 2"], covariance: Float[np.ndarray, "n 2 2"], width: float
) -> float:
    """Returns the least deviation of the map by which 68 % of places are within 1 σ, m."""
    tried = np.linspace(0, width / 4, 500)

    def within(own: float) -> bool:
        inverse = np.linalg.inv(covariance + own**2 * np.eye(2))
        squares = np.einsum("ni,nij,nj->n", away, inverse, away)
        return bool(np.mean(squares < _WITHIN) >= 0.6827)

    return float(next(filter(within, tried), tried[-1]))


class _Usable(NamedTuple):
    """Which frames are whole; the usual size of each reading, 0 where it says nothing."""

    frames: Bool[np.ndarray, " n"]
    scale: Float[np.ndarray, " N"]


def _usable(recording: PairRecording) -> _Usable:
    flat = recording.voltages.reshape(len(recording.voltages), -1)
    dead = np.isnan(flat).mean(0) > 0.5
    middle = np.nanmedian(np.where(dead, 0.0, flat), 0)
    # 1.4826 times this median is a normal variable's deviation.
    scale = 1.4826 * np.nanmedian(np.abs(np.where(dead, 0.0, flat) - middle), 0)
    require((scale > 0).any(), "v", "readings that never change", "presses")
    frames = np.asarray(np.isfinite(flat[:, scale > 0]).all(1))
    return _Usable(frames, scale)


def _size(flat: Float[np.ndarray, "n N"], scale: Float[np.ndarray, " N"]) -> np.ndarray:
    """Returns how large frames are, over the usual one."""
    used = scale > 0
    size = np.sqrt(np.nanmean((flat[:, used] / scale[used]) ** 2, 1))
    return size / np.nanmedian(size)


def _compressed(flat: np.ndarray, scale: np.ndarray) -> np.ndarray:
    return np.arcsinh(flat / (2 * scale))


def _nominal(
    recording: PairRecording, use: _Usable, chosen: np.ndarray | None = None
) -> tuple[Response, Posterior]:
    """Returns the physics as a response, and the places of the chosen frames by it."""
    used = use.scale > 0
    if chosen is None:
        chosen = np.flatnonzero(use.frames)[:_LABELLED]
    flat = recording.voltages.reshape(len(recording.voltages), -1)[chosen][:, used]
    at, columns = _physics(recording)
    columns = columns[:, used]
    dtype = columns.dtype
    sign = _sign(flat, columns)
    columns = (sign * columns).astype(dtype)
    found, whitener = place_by_physics(flat.astype(dtype), columns, at)
    size = np.median(np.linalg.norm(flat, axis=1))
    response = Response(
        at=at,
        readings=columns,
        spread=np.zeros(len(at), dtype),
        whitener=np.asarray(whitener),
        scale=np.where(used, size, 0.0),
        limit=float(np.quantile(np.asarray(found.chi2), 0.99)),
        own=0.0,
        known=-1,
    )
    return response, found


def _sign(flat: Float[np.ndarray, "n K"], columns: Float[np.ndarray, "G K"]) -> int:
    """Tells whether presses lower (−1) or raise the sheet's conductance.

    A press thins most sheets: it raises the conductance only where that explains clearly
    more of the frames, by one local change each.
    """
    unit = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    alike = unit @ (columns / np.linalg.norm(columns, axis=1, keepdims=True)).T
    lower, higher = (np.mean(np.maximum(s * alike, 0).max(1) ** 2) for s in (-1, 1))
    return 1 if higher > _CLEARLY * lower else -1


def _physics(recording: PairRecording) -> tuple[np.ndarray, np.ndarray]:
    """Returns candidate places, and how readings change by a local change at each."""
    sensor = recording.sensor()
    steps = max(recording.box) / _CANDIDATES
    sides = [np.arange(steps / 2, side, steps) for side in recording.box]
    at = np.stack(np.meshgrid(*sides, indexing="ij"), -1).reshape(-1, 2)
    # Within two diameters of an edge, a press changes its electrodes more than the sheet.
    turn = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    ring = 2 * recording.electrode_diameter * np.stack([np.cos(turn), np.sin(turn)], 1)
    inside = np.asarray([sensor.on_sheet(jnp.asarray(at + one)) for one in ring]).all(0)
    require(inside.any(), "outline", "a sheet narrower than its electrodes", "a wider one")
    at = at[inside].astype(np.float32)
    columns = np.asarray(sensitivities(sensor, recording.pairs, at))
    if recording.magnitude:
        columns = columns * np.sign(np.asarray(background(sensor, recording.pairs)))
    return (at + recording.origin).astype(np.float32), columns.reshape(len(at), -1)
