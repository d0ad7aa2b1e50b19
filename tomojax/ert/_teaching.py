"""Teaches responses: from the physics of the sheet, and from presses."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from tomojax._require import require
from tomojax.ert._learning import place_by_physics, Posterior
from tomojax.ert._locator import LEAST_KNOWN, QUIET
from tomojax.ert._presses import Presses
from tomojax.ert._response import compressed, Response
from tomojax.ert._sheet_change import background, sensitivities
from tomojax.ert.recorded._recording import PairRecording

_CANDIDATES = 48  # along the sheet's longer side: places lie closer than presses are wide
LENGTHS = (0.14, 0.2, 0.28, 0.4)  # of the last map, in widths of the sheet
_UNLABELLED = 600  # presses that the rounds take; a map of so many is made in a second
_LABELLED = 1000  # likewise of places that stay where they are, in a dozen maps
_CLEARLY = 1.5  # more of the frames' squares

# Shares by which the sheet may be wider than told: a skin may reach beyond its ring of
# electrodes. Up to a tenth places move most, and beyond a third they hardly move at all.
_WIDER = (0.1, 0.3)
_LIKELIER = 2.0  # each frame, by a wider sheet, where that is taken


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
    pressed = use.frames & (_size(flat, use.scale) > QUIET)
    known, free = pressed & recording.known, pressed & ~recording.known
    chosen = np.concatenate(
        [
            random.permutation(np.flatnonzero(known))[:_LABELLED],
            random.permutation(np.flatnonzero(free))[:_UNLABELLED],
        ]
    )
    chosen.sort()
    fewest = 20  # errors of fewer say nothing of how readings go together
    require(len(chosen) >= fewest, "v", f"{len(chosen)} presses", f"at least {fewest}")
    told = recording.known[chosen]
    model, start = _nominal(recording, use, chosen)
    width, dtype = max(recording.box), model.at.dtype
    values = compressed(flat[chosen][:, use.scale > 0], use.scale[use.scale > 0])
    xy = np.array(start.xy)
    if recording.places is not None:
        xy[told] = recording.places[chosen[told]]
    # Candidates have a spacing: no place is more certain than a cell.
    wide = np.where(told, 0, np.maximum(start.deviation, width / _CANDIDATES))
    presses = Presses(
        voltages=recording.voltages[chosen],
        values=values.astype(dtype),
        told=told,
        xy=xy,
        deviation=wide.astype(dtype),
        at=model.at,
        scale=use.scale,
        width=width,
    )
    placed = presses.placed(progress)
    by, length = placed.mapped([share * width for share in LENGTHS])
    by = replace(placed.corrected(by, length), **placed.limits(length, random))
    enough = told.sum() >= LEAST_KNOWN
    return replace(by, **presses.deviations(length, progress)) if enough else by


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


def _nominal(
    recording: PairRecording, use: _Usable, chosen: np.ndarray | None = None
) -> tuple[Response, Posterior]:
    """Returns the physics as a response, and the places of the chosen frames by it."""
    used = use.scale > 0
    if chosen is None:
        chosen = np.flatnonzero(use.frames)[:_LABELLED]
    flat = recording.voltages.reshape(len(recording.voltages), -1)[chosen][:, used]
    fits = [_fit(recording, flat, used, 0.0)]
    for wider in _shares(recording):
        with suppress(ValueError):  # no mesh has cells that are fine enough for it
            fits.append(_fit(recording, flat, used, wider))
    best = max(fits, key=lambda fit: fit.likelihood)
    clearly = best.likelihood - fits[0].likelihood > np.log(_LIKELIER)
    at, columns, found, whitener, _ = best if clearly else fits[0]
    dtype = columns.dtype
    size = np.median(np.linalg.norm(flat, axis=1))
    response = Response(
        at=at,
        readings=columns,
        spread=np.zeros(len(at), dtype),
        whitener=whitener,
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


class _Fit(NamedTuple):
    """Presses that are placed by the physics of one sheet."""

    at: Float[np.ndarray, "G 2"]
    columns: Float[np.ndarray, "G K"]
    found: Posterior
    whitener: Float[np.ndarray, "K K"]
    likelihood: float  # log p of a frame, the mean, less a constant


def _shares(recording: PairRecording) -> tuple[float, ...]:
    """Returns by which shares the sheet may be wider than told.

    A curved sheet is as it is told, and so is one whose outline hides a part from its box's
    middle: grown about the middle, it would not hold all that it held.
    """
    grows = recording.outline.surface is None
    for loop in recording.outline.loops[:1]:
        x, y = (loop - recording.origin - np.array(recording.box) / 2).T
        turns = x * np.roll(y, -1) - y * np.roll(x, -1)
        grows &= bool((turns > 0).all() or (turns < 0).all())
    return _WIDER if grows else ()


def _fit(
    recording: PairRecording,
    flat: Float[np.ndarray, "n K"],
    used: Bool[np.ndarray, " N"],
    wider: float,
) -> _Fit:
    """Places presses by the physics of a sheet that is wider than told by a share."""
    at, columns = _physics(recording, wider)
    columns = columns[:, used]
    columns = (_sign(flat, columns) * columns).astype(columns.dtype)
    found, whitener = place_by_physics(flat.astype(columns.dtype), columns, at)
    whitener = np.asarray(whitener)
    chi2 = flat.shape[1] * np.asarray(found.chi2).mean()
    likelihood = np.log(np.diag(whitener)).sum() - chi2 / 2
    return _Fit(at, columns, found, whitener, float(likelihood))


def _physics(recording: PairRecording, wider: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns candidate places, and how readings change by a local change at each."""
    sensor, at = recording.sensor(wider=wider), candidates(recording, _CANDIDATES)
    begins = (wider / 2 * np.array(recording.box)).astype(np.float32)
    columns = np.asarray(sensitivities(sensor, recording.pairs, at + begins))
    if recording.magnitude:
        columns = columns * np.sign(np.asarray(background(sensor, recording.pairs)))
    return (at + recording.origin).astype(np.float32), columns.reshape(len(at), -1)


def candidates(recording: PairRecording, count: int) -> Float[np.ndarray, "G 2"]:
    """Returns places all over the sheet, `count` along its longer side, from its box's 0.

    Within two diameters of an edge, a press changes its electrodes more than the sheet.
    """
    sensor, step = recording.sensor(), max(recording.box) / count
    sides = [np.arange(step / 2, side, step) for side in recording.box]
    at = np.stack(np.meshgrid(*sides, indexing="ij"), -1).reshape(-1, 2)
    turn = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    ring = 2 * recording.electrode_diameter * np.stack([np.cos(turn), np.sin(turn)], 1)
    inside = np.asarray([sensor.on_sheet(jnp.asarray(at + one)) for one in ring]).all(0)
    require(inside.any(), "outline", "a sheet narrower than its electrodes", "a wider one")
    return at[inside].astype(np.float32)
