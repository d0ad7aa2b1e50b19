"""Finds a rig's gains, zeros, sheet, grounds and electrodes, from contacts anywhere."""

from collections.abc import Callable
from dataclasses import replace
from datetime import date
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from tomojax._custom_types import Numbers
from tomojax._require import require
from tomojax.calibration._frames import Known, points_of, Sums, sums_of
from tomojax.calibration._unknowns import (
    rig_slopes,
    Unknowns,
    unknowns_of,
    values_of,
    widened,
)
from tomojax.kernels.flags import Flag
from tomojax.methods import Batch
from tomojax.sensor import Calibration, Sensor

# What is never believed to be known better, of what nominal values leave.
_LEAST = 0.1

# Passes at most: what places of electrodes and the sheet make is not quite linear.
_PASSES = 8

# Passes end where no value changes by more than this part of its deviation.
_ENOUGH = 0.2

# Passes end where the cost falls by less than this part.
_LITTLE = 0.003

# 1 σ of a place that is given, of the pitch.
_GIVEN = 0.005

# 1 σ of a place that `points` has found: the contact is free, beside what voltages tell.
_FOUND = 0.5

# Frames scatter by no less than this part of what errors as told would make them.
_SCATTER = 0.05

# Keeps a direction that no frame shows from a division by 0. In units of rounding: what is
# less is rounding, of either sign.
_NEVER = 1e-9
_ROUNDING = 1e3

# Contacts within this part of a pitch make the same errors of the model.
_ALIKE = 0.25

# Frames that at least are needed.
_FEWEST = 16

# Squares of a pitch, of all, that these frames lie in.
_TOUCHED = 0.1


class Calibrated(NamedTuple):
    """A calibration, and how sure its values are."""

    calibration: Calibration
    places: Float[np.ndarray, "n 2"]  # of the contacts that it is made of, m
    covariance: Float[np.ndarray, "P P"]  # of the values
    unknowns: Unknowns  # what they are; the prior that, with errors as told, gives these
    state: Float[np.ndarray, " P"]  # the values as a vector
    frames: Known  # that were used
    told: Calibration  # of the last pass, with the errors that it was told of

    @property
    def parts(self) -> dict[str, slice]:
        """Returns the range of each kind among the values."""
        return self.unknowns.parts


def calibrate(
    sensor: Sensor,
    voltages: Numbers,  # (n, S, M)
    grounds: Numbers,  # (n, S)
    places: Numbers | None = None,  # (n, 2)
    calibration: Calibration | None = None,
    *,
    spread: Numbers | None = None,  # (n,) or ()
    times: Numbers | None = None,  # (n, S)
    progress: Callable[[str], None] = lambda text: None,
) -> Calibration:
    """Finds gains, zeros, the sheet's waves, grounds and electrodes' places by contacts.

    Each of n frames of S slots shows one compact contact. Its place need not be known.
    Places, sizes, currents and the rig's values are one least squares problem,

        min Σ |C^(−1/2)(V − V(θ, contact))|² + (θ − θ₀)ᵀP(θ − θ₀).

    The contacts are eliminated frame by frame (Schur complement), so that the cost grows
    with the frames. Each of Gauss and Newton's steps makes a new table of the sheet.

    **Arguments:** `voltages` V, as read; NaN in all frames for a channel that is not used;
    `places` m, NaN where not known (by default none is known); `spread` 1 σ of `places`, m
    (0.005 pitches by default); `calibration`: known values (such as zeros and noise by
    `tare`), nominal by default; `times` of the slots, s, between which a contact may move
    (None: contacts are held still); `progress` is called with a text on each stage.
    **Raises:** `ValueError` for shapes that do not fit, values that are no numbers, and
    places off the sheet. Frames with one contact too seldom or in too few places raise
    `ValueError` too.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(2, 2, divisions=(8, 8), dtype=np.float32)
    >>> places = np.random.default_rng(0).uniform(0.012, 0.028, (16, 2))
    >>> volts = np.stack([tx.voltages(sensor, tx.Disc(xy, 0.004, 1.0)) for xy in places])
    >>> grounds = np.tile(np.arange(4), (16, 1))
    >>> known = tx.calibration.calibrate(sensor, volts, grounds, places)
    >>> len(known.gain), len(known.sheet), known.error <= 1
    (4, 27, True)
    """
    known = known_frames(sensor, voltages, grounds, places, spread, times)
    return calibrated(sensor, known, calibration, progress).calibration


def calibrated(
    sensor: Sensor,
    known: Known,
    calibration: Calibration | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Calibrated:
    """Calibrates as `calibrate` does; returns the frames and the covariance too."""
    before = calibration or Calibration()
    if not np.isfinite(known.places).all():
        progress("finding the contacts")
        n = len(known.places)
        known = _found(sensor, before, known)
        progress(f"{len(known.places)} of {n} frames show one contact without a doubt")
    known = known._replace(weight=_weight(known.places, _ALIKE * sensor.mean_pitch))
    unknowns, slopes = unknowns_of(sensor, before), rig_slopes(sensor)
    state = trial = unknowns.start
    now, lowest, step = before, np.inf, 0 * state
    weighed = False
    sums, first, prior = None, None, unknowns.prior
    covariance = np.linalg.inv(prior)
    for number in range(_PASSES):
        progress(f"pass {number + 1}")
        told = replace(before, **values_of(unknowns, trial))
        points = points_of(sensor, told)
        volts = told.voltages(known.voltages.astype(float))
        new = sums_of(points, slopes, volts, known)
        first = first or new
        cost = _cost(unknowns, new, trial)
        if cost < lowest:
            better = cost < (1 - _LITTLE) * lowest
            if np.isfinite(lowest) and not weighed:
                # A first step that fits better: now discs miss what is left of a frame.
                usual, weighed = np.median(new.each), True
                less = usual / np.maximum(new.each, usual)
                known = known._replace(weight=known.weight * less)
                new = sums_of(points, slopes, volts, known)
            if weighed:
                unknowns = widened(unknowns, trial)
                cost = _cost(unknowns, new, trial)
            state, now, sums, lowest = trial, told, new, cost
            step, covariance, prior = _step(unknowns, sums, state, sensor.dtype)
            if not better:
                break
        else:  # the slopes are not exact, nor are residuals linear
            step = step / 2
        trial = state + step
        if np.abs(step / np.sqrt(np.diag(covariance))).max() < _ENOUGH:
            break
    assert first is not None and sums is not None

    def part(square: np.ndarray | np.floating) -> float:
        return float(np.clip(np.sqrt(square), _LEAST, 1))

    return Calibrated(
        calibration=replace(
            now,
            own=part(sums.left / np.maximum(sums.free, 1)) * before.own,
            error=part(sums.shared / first.shared) * before.error,
            deviation=values_of(unknowns, np.sqrt(np.diag(covariance))),
            made=date.today().isoformat(),
        ),
        places=known.places,
        covariance=covariance,
        unknowns=unknowns._replace(prior=prior),
        state=state,
        frames=known,
        told=now,
    )


def _cost(unknowns: Unknowns, sums: Sums, state: np.ndarray) -> float:
    off = state - unknowns.start
    return float(sums.left + off @ unknowns.prior @ off)


def _step(
    unknowns: Unknowns, sums: Sums, state: np.ndarray, dtype: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Computes Gauss and Newton's step, the values' covariance, and the step's prior.

    Errors that frames share, the shapes of contacts above all, do not average out as noise
    does. The scatter of frames along each direction shows what frames really know of that
    direction. If that is less than the number of frames says, the prior counts for more.
    """
    root = np.linalg.cholesky(np.linalg.inv(unknowns.prior))
    known, turn = np.linalg.eigh(root.T @ sums.normal @ root)
    known = np.maximum(known, 0)
    scatter = np.einsum("ij,ik,kj->j", turn, root.T @ sums.scatter @ root, turn)
    never = max(_NEVER, _ROUNDING * float(np.finfo(dtype).eps))
    part = np.maximum(known, never) / np.maximum(scatter, _SCATTER * known + never)
    along = turn.T @ (root.T @ sums.right)
    off = turn.T @ np.linalg.solve(root, state - unknowns.start)
    whole = 1 + part * known
    step = root @ turn @ ((part * along - off) / whole)
    back = np.linalg.solve(root.T, turn)
    return step, root @ (turn / whole) @ turn.T @ root.T, (back / part) @ back.T


def known_frames(
    sensor: Sensor,
    voltages: Numbers,
    grounds: Numbers,
    places: Numbers | None = None,
    spread: Numbers | None = None,
    times: Numbers | None = None,
) -> Known:
    """Checks frames and what is known of them, as `calibrate` says and raises."""
    m, v, under = sensor.electrode_count, np.asarray(voltages), np.asarray(grounds)
    fits = v.ndim == 3 and v.shape[2] == m and len(v) > 0
    require(fits, "voltages", f"shape {v.shape}", f"(frames, slots, {m})")
    n, slots = v.shape[:2]
    require(under.shape == (n, slots), "grounds", under.shape, f"{(n, slots)}")
    inside = under.dtype.kind in "iu" and under.min() >= 0 and under.max() < m
    require(bool(inside), "grounds", "an electrode that is none", f"0 to {m - 1}")
    finite = np.isfinite(v)
    whole = (finite.any((0, 1)) == finite.all((0, 1))).all() and finite.any()
    wanted = "volts, or a channel of NaN"
    require(bool(whole), "voltages", "some that are no numbers", wanted)
    given = np.full((n, 2), np.nan) if places is None else np.asarray(places, float)
    require(given.shape == (n, 2), "places", given.shape, f"{(n, 2)}")
    size, told = np.asarray(sensor.size), np.isfinite(given).all(1)
    on = ((given[told] >= 0) & (given[told] <= size)).all() and not np.isinf(given).any()
    require(bool(on), "places", "some off the sheet", f"0 to {size.tolist()} m")
    pitch = sensor.mean_pitch
    near = np.asarray(_GIVEN * pitch if spread is None else spread, float)
    require(near.shape in ((), (n,)), "spread", near.shape, f"() or ({n},)")
    require(bool((near > 0).all()), "spread", "0 or less", "m, above 0")
    at = np.zeros(under.shape) if times is None else np.asarray(times, float)
    fits = at.shape == under.shape and bool(np.isfinite(at).all())
    require(fits, "times", f"shape {at.shape}", f"{under.shape}, s")
    wide = np.where(told, near, _FOUND * pitch)
    return Known(v, under, given, spread=wide, times=at, weight=np.ones(n))


def _weight(places: np.ndarray, side: float) -> Float[np.ndarray, " n"]:
    """Computes 1 over the number of frames in the same square, which share model errors."""
    cells = np.floor(places / side).astype(int)
    _, which, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    return 1 / count[which.ravel()]


def _found(sensor: Sensor, before: Calibration, known: Known) -> Known:
    """Keeps the frames with one contact, at places given or found by `points`."""
    points = points_of(sensor, before)
    batch = Batch(points, 1.0, contacts=2, images=False)
    volts = before.voltages(known.voltages.astype(points.noise.dtype))
    rows = batch(volts, known.grounds)
    bad = int(Flag.HIGH_RESIDUAL | Flag.PLACE_UNCERTAIN | Flag.SATURATED)
    long = np.isfinite(rows.contact_angle[:, 0])
    lone = (rows.contact_count == 1) & (rows.flags & bad == 0) & ~long
    wanted = f"{_FEWEST} or more with one contact"
    require(
        lone.sum() >= _FEWEST, "voltages", f"{lone.sum()} of {len(lone)} frames", wanted
    )
    told = np.isfinite(known.places).all(1, keepdims=True)
    places = np.where(told, known.places, rows.contact_xy[:, 0])[lone]
    cells = np.unique(np.floor(places / sensor.mean_pitch).astype(int), axis=0)
    least = int(np.ceil(_TOUCHED * sensor.electrode_count))
    seen = f"contacts in {len(cells)} squares of a pitch"
    require(len(cells) >= least, "voltages", seen, f"{least} or more: rub the whole sheet")
    return Known(*(a[lone] for a in known))._replace(places=places)
