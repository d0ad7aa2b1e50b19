"""Follows contacts over time: joins each contact's rows and combines them."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Integer

from tomojax._require import require, require_whole
from tomojax._shown import tuple_shown
from tomojax.kernels.algebra import filter_levels, Levels, Measured, smooth_levels
from tomojax.methods import Rows

# A contact is the one of the row before that is no farther.
_REACH = 0.75  # pitches
_SIGMAS = 5.0  # standard deviations of a feeble one's place

# Standard deviation of voltages by the model's error, as a part of them. It tells how well
# V0 − u, and so a conductance, is known.
_MODEL = 0.02
# Of a current by the converter's noise, of what the drive lets flow through a square.
_NOISE = 4.5e-5
# Of a press's strength, which a response tells about so well.
_PRESS = 0.1
# Of ln g where a row does not tell it; and what still tells nothing, once followed.
_ANY, _UNTOLD_G = 1e4, 25.0
_ASTRAY = 0.5  # pitches that a place is off where ln g is by 1
_UNTOLD = 0.15  # pitches, of a place that comes without a standard deviation

# Drifts that are tried for `drift=None`: standard deviations per row, of a place in pitches
# and of ln g.
_DRIFTS = ((0.0, 0.0), (5e-4, 0.003), (1.5e-3, 0.01), (5e-3, 0.03), (1.5e-2, 0.1))


class Tracks(NamedTuple):
    """Tracks: n rows of up to C contacts, NaN-padded, strongest first.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> rows = tx.methods.empty_rows(6, {"C": 1})  # as "points" fills them: 6 frames
    >>> rows.contact_count[:], rows.residual[:] = 1, 0
    >>> rows.contact_xy[:] = [0.03, 0.05]  # m
    >>> rows.contact_covariance[:] = [1e-8, 1e-8, 0]  # xx, yy, xy, m²
    >>> rows.contact_current[:], rows.contact_radius[:] = 1e-4, 0.005
    >>> rows.contact_conductance[:] = 1e-4
    >>> tracks = tx.track(rows, drive_voltage=4.5, sheet_resistance=10e3)
    >>> print(tracks.contact_count, np.round(1e3 * tracks.contact_xy[-1, 0]))  # mm
    [1 1 1 1 1 1] [30. 50.]
    """

    contact_count: Integer[np.ndarray, " n"]
    contact_track: Integer[np.ndarray, "n C"]  # a contact's number, from 1; 0: none
    contact_xy: Float[np.ndarray, "n C 2"]  # m
    contact_covariance: Float[np.ndarray, "n C 3"]  # xx, yy, xy, m²
    contact_conductance: Float[np.ndarray, "n C"]  # S
    contact_conductance_error: Float[np.ndarray, "n C"]  # σ of its logarithm
    contact_current: Float[np.ndarray, "n C"]  # A, as in the rows; held in gaps
    contact_radius: Float[np.ndarray, "n C"]  # m, the same

    def __repr__(self) -> str:
        return tuple_shown(self)


class _Paths(NamedTuple):
    """Rows with C places; a contact keeps one place from its first row to its last."""

    number: Integer[np.ndarray, "n C"]  # of the contact; 0: none
    source: Integer[np.ndarray, "n C"]  # which contact of the row; −1: not seen


def track(
    rows: Rows,
    drive_voltage: float | None,
    sheet_resistance: float | None,
    *,
    smooth: bool = True,
    hold: int = 3,
    least: int = 3,
    drift: tuple[float, float] | None = None,
    pitch: float = 0.020,
) -> Tracks:
    """Finds each contact's place and conductance from all rows that show the contact.

    A Kalman filter follows a state that stands still, or drifts, and begins anew at a step.
    The filter of ln g is separate. The standard deviation of a still contact falls as 1/√n,
    and a step shows at once.

    **Arguments:** `rows` of `points` or `auto` (their contacts come with covariances);
    `drive_voltage` V; `sheet_resistance` Ω/sq; both None where the rows' conductances and
    currents are strengths of presses, which nothing drives; `smooth`: later rows count as
    well as earlier rows; `hold`: rows that a present contact may be missing from (a feeble
    contact is not seen under every ground). `least`: rows that have to show a contact
    (fewer rows show a ghost). `drift`: standard deviations per row of place (m) and ln g,
    the likeliest by default; `pitch` of the electrodes, m.
    **Raises:** `ValueError` for rows without covariances and values out of range.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> rows = tx.methods.empty_rows(6, {"C": 1})  # as "points" fills them: 6 frames
    >>> rows.contact_count[:], rows.residual[:] = 1, 0
    >>> rows.contact_xy[:] = [0.03, 0.05]  # m
    >>> rows.contact_covariance[:] = [1e-8, 1e-8, 0]  # xx, yy, xy, m²
    >>> rows.contact_current[:], rows.contact_radius[:] = 1e-4, 0.005
    >>> rows.contact_conductance[:] = 1e-4
    >>> tracks = tx.track(rows, drive_voltage=4.5, sheet_resistance=10e3)
    >>> print(tracks.contact_track[:, 0])
    [1 1 1 1 1 1]
    """
    _check(rows, drive_voltage, sheet_resistance, hold, least, drift, pitch)
    # Of a larger model of auto's, that tells none.
    here = np.isfinite(rows.contact_covariance) | np.isnan(rows.contact_xy[..., :1])
    wide = np.array([(_UNTOLD * pitch) ** 2] * 2 + [0], np.float32)
    covariance = np.where(here, rows.contact_covariance, wide)
    rows = rows._replace(contact_covariance=covariance)
    paths = _follow(rows, hold, least, _REACH * pitch)
    if not paths.number.any():
        none = np.zeros((*paths.number.shape, 2, 2))
        return _arranged(rows, paths, none[..., 0], none, none[..., 0], none)
    there = paths.source >= 0
    begins = np.diff(paths.number, axis=0, prepend=0) != 0
    pick = lambda values: _picked(values, paths.source)  # noqa: E731
    square = pick(rows.contact_covariance)[..., [[0, 2], [2, 1]]]  # of xx, yy, xy
    place = pick(rows.contact_xy), square
    g, current = pick(rows.contact_conductance), pick(rows.contact_current)
    untold = ~np.isfinite(_picked(rows.contact_conductance, paths.source, np.nan))
    height = np.log(np.maximum(g, 1e-30))[..., None]
    spread = np.full(g.shape, _PRESS**2, np.float32)
    if drive_voltage is not None and sheet_resistance is not None:
        spread = _height_noise(g, current, drive_voltage, sheet_resistance)
    # What is feeble beside its ground is told neither where nor how strong.
    spread += np.trace(place[1], axis1=-2, axis2=-1) / (_ASTRAY * pitch) ** 2
    spread = np.where(untold, _ANY, spread)[..., None, None]
    drifts = [(pitch * d, g) for d, g in _DRIFTS] if drift is None else [drift]
    followed = []
    for k, (z, r) in enumerate((place, (height, spread))):
        each = jnp.asarray([d[k] ** 2 for d in drifts], jnp.float32)
        z, origin = _centred(z)
        measured = Measured(*map(jnp.asarray, (z, r.astype(np.float32), there, begins)))
        found = _likeliest(measured, each, smooth)
        followed += [np.asarray(found.mean) + origin, np.asarray(found.covariance)]
    return _arranged(rows, paths, *followed)


def _check(rows, drive_voltage, sheet_resistance, hold, least, drift, pitch) -> None:
    require(np.isfinite(pitch) and pitch > 0, "pitch", pitch, "m, above 0")
    told = np.isfinite(rows.contact_covariance).any() or not rows.contact_count.any()
    require(told, "rows", "contacts without covariance", "those of points or auto")
    none = drive_voltage is None, sheet_resistance is None
    require(
        none[0] == none[1], "sheet_resistance", sheet_resistance, "a number, or None twice"
    )
    if not any(none):
        require(np.isfinite(drive_voltage), "drive_voltage", drive_voltage, "volts")
        fine = np.isfinite(sheet_resistance) and sheet_resistance > 0
        require(fine, "sheet_resistance", sheet_resistance, "ohms, above 0")
    require_whole("hold", hold, 0)
    require_whole("least", least)
    if drift is not None:
        numbers = len(drift) == 2 and np.isfinite(drift).all() and min(drift) >= 0
        require(numbers, "drift", drift, "two numbers, 0 or more: m and ln g per row")


def _follow(rows: Rows, hold: int, least: int, within: float) -> _Paths:
    """Joins the contacts of each row to the nearest contacts before, the nearest first."""
    n, most = rows.contact_xy.shape[:2]
    number, source = np.zeros((n, most), int), np.full((n, most), -1)
    places, widths = np.zeros((most, 2)), np.zeros(most)
    last = np.full(most, -hold - 2)  # row in which it was seen last
    names = np.zeros(most, int)
    for k in np.flatnonzero(rows.contact_count):
        seen = rows.contact_xy[k, : rows.contact_count[k]]
        alive = k - last <= hold + 1
        apart = np.hypot(*(places[:, None] - seen).transpose(2, 0, 1))
        wide = np.sqrt(rows.contact_covariance[k, : len(seen), :2].sum(-1))
        reach = np.maximum(within, _SIGMAS * np.maximum(wide, widths[:, None]))
        apart[~alive] = np.inf
        free = list(np.argsort(np.where(alive, n + last, last), kind="stable"))
        for _ in range(len(seen)):
            slot, which = np.unravel_index(apart.argmin(), apart.shape)
            if not apart[slot, which] <= reach[slot, which]:
                which = next(c for c in range(len(seen)) if c not in source[k])
                slot = free[0]
                names[slot] = names.max() + 1
                places[slot], widths[slot] = seen[which], wide[which]
            elif last[slot] < k - 1:  # there all along
                number[last[slot] + 1 : k, slot] = names[slot]
            number[k, slot], source[k, slot] = names[slot], which
            # Weighed, lest a ghost draws the place away; not for long, as contacts move.
            gain = widths[slot] ** 2 / (widths[slot] ** 2 + wide[which] ** 2 + 1e-30)
            places[slot] += gain * (seen[which] - places[slot])
            narrowed = np.sqrt(1 - gain) * widths[slot]
            widths[slot], last[slot] = max(narrowed, wide[which] / 2), k
            free.remove(slot)
            apart[slot], apart[:, which] = np.inf, np.inf
    # Ghosts go, and the others close up.
    shown = np.bincount(number[source >= 0], minlength=number.max() + 1) >= least
    shown[0] = False
    renamed = np.cumsum(shown) * shown
    return _Paths(renamed[number], np.where(shown[number], source, -1))


def _picked(values: np.ndarray, source: np.ndarray, none: float = 1.0) -> np.ndarray:
    """Picks each path's values from its row, or from an earlier row in a gap."""
    rows = np.where(source >= 0, np.arange(len(source))[:, None], -1)
    rows = np.maximum(np.maximum.accumulate(rows, 0), 0)
    which = np.maximum(np.take_along_axis(source, rows, 0), 0)
    found = values[rows, which]
    return np.nan_to_num(found, nan=none)


def _height_noise(g, current, drive_voltage: float, sheet_resistance: float) -> np.ndarray:
    """Computes ln g's variance: the model's error of V0 − u, and the current's noise."""
    current = np.maximum(np.abs(current), 1e-15)
    below = np.maximum(np.abs(drive_voltage) * g / current - 1, 0)  # u/(V0 − u)
    noise = _NOISE * abs(drive_voltage) / sheet_resistance / current
    return (_MODEL**2 * (1 + below**2) + noise**2).astype(np.float32)


def _centred(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Subtracts the median, so that float32 has its digits where they are needed."""
    middle = np.median(values, (0, 1))
    return (values - middle).astype(np.float32), middle


@eqx.filter_jit
def _likeliest(measured: Measured, drifts: Float[Array, " k"], smooth: bool) -> Levels:
    """Filters n rows of C paths with the drift that makes all measurements likeliest."""
    unit = jnp.eye(measured.value.shape[-1], dtype=measured.value.dtype)
    paths = jax.vmap(filter_levels, (1, None), 1)
    drift = drifts[0]
    if len(drifts) > 1:
        every = lambda d: paths(measured, d * unit).likelihood.sum()  # noqa: E731
        drift = drifts[jnp.argmax(jax.lax.map(every, drifts))]
    if smooth:
        paths = jax.vmap(smooth_levels, (1, None), 1)
    return paths(measured, drift * unit)


def _arranged(
    rows: Rows,
    paths: _Paths,
    xy: Float[np.ndarray, "n C 2"],
    covariance: Float[np.ndarray, "n C 2 2"],
    height: Float[np.ndarray, "n C k"],  # ln g comes first
    error: Float[np.ndarray, "n C k k"],  # its variance
) -> Tracks:
    """Makes tracks with the strongest contact first, as in rows."""
    number = paths.number
    present = number > 0
    n, most = number.shape
    current = _picked(rows.contact_current, paths.source)
    strength = np.where(present, np.abs(current), -1)
    order = np.argsort(-strength, 1, kind="stable")
    here = np.take_along_axis(present, order, 1)

    def sorted_(values: np.ndarray) -> np.ndarray:
        extra = (1,) * (values.ndim - 2)
        values = np.take_along_axis(values, order.reshape(n, most, *extra), 1)
        mask = here.reshape(n, most, *extra)
        return np.where(mask, values, np.nan).astype(np.float32)

    variance = error[..., 0, 0]
    told = variance < _UNTOLD_G
    return Tracks(
        contact_count=present.sum(1).astype(np.uint8),
        contact_track=np.take_along_axis(number, order, 1).astype(np.uint32),
        contact_xy=sorted_(xy),
        contact_covariance=sorted_(covariance[..., [0, 1, 0], [0, 1, 1]]),
        contact_conductance=sorted_(np.where(told, np.exp(height[..., 0]), np.nan)),
        contact_conductance_error=sorted_(np.where(told, np.sqrt(variance), np.nan)),
        contact_current=sorted_(current),
        contact_radius=sorted_(_picked(rows.contact_radius, paths.source, np.nan)),
    )


class Touch(NamedTuple):
    """One contact from its first row to its last.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> rows = tx.methods.empty_rows(6, {"C": 1})  # as "points" fills them: 6 frames
    >>> rows.contact_count[:], rows.residual[:] = 1, 0
    >>> rows.contact_xy[:] = [0.03, 0.05]  # m
    >>> rows.contact_covariance[:] = [1e-8, 1e-8, 0]  # xx, yy, xy, m²
    >>> rows.contact_current[:], rows.contact_radius[:] = 1e-4, 0.005
    >>> rows.contact_conductance[:] = 1e-4
    >>> tracks = tx.track(rows, drive_voltage=4.5, sheet_resistance=10e3)
    >>> touch, = tx.results.touches(tracks, t=0.1 * np.arange(6))
    >>> touch.rows, round(touch.end, 1), [round(1e3 * x) for x in touch.xy]  # s, mm
    (6, 0.5, [30, 50])
    """

    track: int
    start: float  # s
    end: float  # s, of the last row that has it
    rows: int
    xy: tuple[float, float]  # m, in the middle of its time
    conductance: float  # S, the highest; a press's strength


def touches(tracks: Tracks, t: Float[np.ndarray, " n"]) -> list[Touch]:
    """Lists every contact of a recording, in order; `t` the rows' times, s.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> rows = tx.methods.empty_rows(6, {"C": 1})  # as "points" fills them: 6 frames
    >>> rows.contact_count[:], rows.residual[:] = 1, 0
    >>> rows.contact_xy[:] = [0.03, 0.05]  # m
    >>> rows.contact_covariance[:] = [1e-8, 1e-8, 0]  # xx, yy, xy, m²
    >>> rows.contact_current[:], rows.contact_radius[:] = 1e-4, 0.005
    >>> rows.contact_conductance[:] = 1e-4
    >>> tracks = tx.track(rows, drive_voltage=4.5, sheet_resistance=10e3)
    >>> for touch in tx.results.touches(tracks, t=0.1 * np.arange(6)):
    ...     print(touch.track, touch.rows, f"{touch.start:.1f} to {touch.end:.1f} s")
    1 6 0.0 to 0.5 s
    """
    row, column = np.nonzero(tracks.contact_track)
    names = tracks.contact_track[row, column]
    order = np.argsort(names, kind="stable")
    found = []
    for part in np.split(order, np.flatnonzero(np.diff(names[order])) + 1):
        if not len(part):
            continue
        r, c = row[part], column[part]
        x, y = np.median(tracks.contact_xy[r, c], 0).tolist()
        touch = Touch(
            track=int(names[part[0]]),
            start=float(t[r[0]]),
            end=float(t[r[-1]]),
            rows=len(part),
            xy=(x, y),
            conductance=float(np.fmax.reduce(tracks.contact_conductance[r, c])),
        )
        found.append(touch)
    return found
