"""`changes`: finds one or two local changes of the sheet's conductance, by the physics.

A small disc of radius a whose conductance is κ times the sheet's σ acts as a dipole. It
adds s·S(x) to the voltages, with s = 2πa²σ·(κ − 1)/(κ + 1) and S(x) of `sensitivities`.
Places start at the best candidates, or the best pair of candidates, and move by Gauss and
Newton's steps; strengths follow by least squares.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Bool, Float, Int, Integer

from tomojax._checks import require
from tomojax._custom_types import Numbers
from tomojax._programs import kept
from tomojax.ert._learning import whitener_of
from tomojax.ert._locator import QUIET
from tomojax.ert._sheet_change import background, sensitivities
from tomojax.ert.recorded._recording import PairRecording
from tomojax.kernels.algebra import solve_positive
from tomojax.kernels.contacts import thin_rows_at
from tomojax.kernels.flags import Flag
from tomojax.kernels.inverse import shrunk_covariance
from tomojax.sensor import Sensor

_STEPS = 64  # of the table of S along the sheet's longer side; each second is a candidate
_MARGIN = 3  # steps from an edge: slopes within two are rough, and a cubic reaches two
_MOVES = 30  # a place's moves at most: most need five
_DAMPING = 1e-3  # of the first move, of columns of length 1
_ALIKE = 0.9999  # candidates whose columns correlate by more are one
# Lone discs of finite elements leave up to this part of a frame, and two that touch leave
# twice as much: a second change is none below.
_OWN = 0.03
_ROUNDS = 3  # that learn the noise
_FILLED = 2  # rounds that put the model's readings where some are missing
_TOGETHER = 8  # frames that are fitted side by side: each looks at all pairs
_FEWEST = 20  # frames: what fewer leave says nothing of how readings go together
_PARTS = 16  # of a step, that tell how much of the step is in a disc
_DOUBTED = 2.0  # rms misfit, in deviations


class Changes(NamedTuple):
    """Local changes of n frames, up to C each, the strongest first; NaN where none is.

    Places are as the recording has them.

    **Example:**

    >>> import tomojax as tx
    >>> tx.ert.Changes._fields
    ('xy', 'covariance', 'strength', 'residual', 'flags')
    """

    xy: Float[np.ndarray, "n C 2"]  # m
    covariance: Float[np.ndarray, "n C 2 2"]  # m²
    strength: Float[np.ndarray, "n C"]  # s, S·m² of an ampere; below 0: conducts less
    residual: Float[np.ndarray, " n"]  # rms, in standard deviations of the readings
    flags: Integer[np.ndarray, " n"]  # bits of `Flag`


class _Maps(NamedTuple):
    """What a change of 1 S·m² adds, at the nodes of a grid over the sensor's box."""

    table: Float[Array, "nx ny K"]  # in deviations of the readings
    inside: Bool[Array, "nx ny"]  # where places may be
    starts: Int[Array, "G 2"]  # nodes that are candidates
    size: Float[Array, "2"]  # m


class _Fit(NamedTuple):
    xy: Float[Any, "n c 2"]
    covariance: Float[Any, "n c 2 2"]
    strength: Float[Any, "n c"]
    chi2: Float[Any, " n"]
    left: Float[Any, "n K"]


def changes(
    recording: PairRecording,
    most: int = 2,
    noise: Numbers | None = None,
    sheet: Sensor | None = None,
    radius: float = 0.0,
) -> Changes:
    """Finds one or two local changes in each frame, as dipoles in the sheet's field.

    A further change is believed where it lowers χ² by more than 3·ln(readings): Schwarz's
    criterion, for a place and a strength. χ² is over the number of readings where the
    model misses more than the noise. Two changes of a frame have one sign.

    **Arguments:** `most` changes in a frame, 1 or 2. `noise`: the deviation of a reading,
    in the recording's units, one number or (C, R). Without `noise` the errors of readings,
    as parts of a frame's size, are learned from what the changes leave of all frames.
    `sheet`: a sensor, its box at 0, that stands for the nominal `recording.sensor()`.
    `radius` of the discs, m: near electrodes fields bend within a disc, and S is then the
    mean over it. That is exact for any field, but for what a disc's own field moves.

    **Raises:** `ValueError` for other `most`, `noise` that is not above 0, and fewer than
    20 frames without `noise`.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    >>> rim = 0.05 * np.stack([np.cos(angle), np.sin(angle)], 1)
    >>> disc = tx.recordings.Outline("disc", 0.1)
    >>> sensor = tx.Sensor.disc(0.1, rim + 0.05, electrode_diameter=0.01)
    >>> pairs = tx.ert.Pairs.opposite(8)
    >>> places = np.array([[0.02, 0.0], [-0.01, 0.015]])
    >>> volts = -1e-9 * np.asarray(tx.ert.sensitivities(sensor, pairs, places + 0.05))
    >>> volts = volts.sum(0, keepdims=True)  # both in one frame
    >>> recording = tx.ert.PairRecording(volts, pairs, rim, 0.01, outline=disc)
    >>> found = tx.ert.changes(recording, noise=1e-3 * np.std(volts))
    >>> np.sort(found.xy[0], 0).round(3).tolist()
    [[-0.01, 0.0], [0.02, 0.015]]
    """
    require(most in (1, 2), "most", most, "1 or 2 changes")
    flat = recording.voltages.reshape(len(recording.voltages), -1)
    missing = ~np.isfinite(flat)
    used = missing.mean(0) <= 0.5
    flat, missing = np.where(missing, 0.0, flat)[:, used], missing[:, used]
    enough = len(flat) >= _FEWEST or noise is not None
    require(enough, "v", f"{len(flat)} frames", f"{_FEWEST} or more, or the noise")
    each = np.ones(flat.shape[1])
    if noise is not None:
        each = np.broadcast_to(noise, recording.voltages.shape[1:]).ravel()[used]
        require(bool((each > 0).all()), "noise", np.min(each), "deviations above 0")
    maps, unit = _maps(recording, used, each, sheet or recording.sensor(), radius)
    size = np.linalg.norm(flat := flat / each, axis=1, keepdims=True)
    scale = np.where((size > 0) & (noise is None), size, 1.0)
    frames = (flat / scale).astype(maps.table.dtype)
    found = _best(frames, maps, 1)
    for _ in range(_FILLED if missing.any() else 0):
        frames = np.where(missing, frames - found.left, frames)
        found = _best(frames, maps, 1)
    further = np.asarray(found.chi2) > _OWN**2 * np.sum(frames**2, 1)
    for _ in range(_ROUNDS if noise is None else 0):
        white = whitener_of(shrunk_covariance(found.left))
        frames = np.asarray(frames @ white.T)
        maps = maps._replace(table=maps.table @ white.T)
        found = _best(frames, maps, most, further)
    if noise is not None:
        found = _best(frames, maps, most, further)
    quiet = (noise is None) & (size[:, 0] < QUIET * np.median(size))
    flags = np.where(quiet, Flag.NO_CONTACT.value, 0).astype(np.uint32)
    if noise is None:  # errors that all frames share move places, and are not in sight
        flags |= np.uint32(Flag.PLACE_UNCERTAIN.value)
    flags[missing.any(1)] |= Flag.DEAD_CHANNEL.value
    flags[missing.mean(1) > 0.5] |= Flag.NO_DATA.value
    return _told(recording, found, scale / unit, flags)


def _told(
    recording: PairRecording,
    found: _Fit,
    scale: Float[np.ndarray, "n 1"],
    flags: Integer[np.ndarray, " n"],
) -> Changes:
    """Puts the strongest first, NaN where none is, and flags in their places."""
    strength = np.asarray(found.strength, float) * scale
    order = np.argsort(-np.abs(strength), 1)
    strength = np.take_along_axis(strength, order, 1)
    xy = np.take_along_axis(np.asarray(found.xy, float), order[..., None], 1)
    moments = np.asarray(found.covariance, float)
    moments = np.take_along_axis(moments, order[..., None, None], 1)
    flags[(strength == 0).all(1)] |= Flag.NO_CONTACT.value
    there = (strength != 0) & (flags & Flag.NO_CONTACT.value == 0)[:, None]
    residual = np.sqrt(np.asarray(found.chi2, float) / found.left.shape[1])
    flags[residual > _DOUBTED] |= Flag.HIGH_RESIDUAL.value
    own = np.diagonal(moments, axis1=2, axis2=3)
    sure = (own > 0).all(2) & (own.mean(2) <= (recording.sensor().mean_pitch / 2) ** 2)
    flags[(there & ~sure).any(1)] |= Flag.PLACE_UNCERTAIN.value
    return Changes(
        np.where(there[..., None], xy + recording.origin, np.nan),
        np.where(there[..., None, None], moments, np.nan),
        np.where(there, strength, np.nan),
        residual,
        flags,
    )


def _maps(
    recording: PairRecording,
    used: Bool[np.ndarray, " N"],
    each: Float[np.ndarray, " K"],
    sensor: Sensor,
    radius: float,
) -> tuple[_Maps, float]:
    """Returns S over the box, over the readings' deviations and a unit; and the unit."""
    step = max(recording.box) / _STEPS
    counts = [max(round(side / step), 4) for side in recording.box]
    # The table's nodes are nodes of the mesh: slopes between two nodes are rough.
    fine = [n * -(-own // n) for n, own in zip(counts, sensor.divisions)]
    sensor = sensor.on_mesh((fine[0], fine[1]), sensor.sheet_resistance)
    shape = counts[0] + 1, counts[1] + 1
    lines = [np.linspace(0, s, n + 1) for s, n in zip(recording.box, counts)]
    at = np.stack(np.meshgrid(*lines, indexing="ij"), -1).reshape(-1, 2)
    columns = np.asarray(sensitivities(sensor, recording.pairs, at))
    if recording.magnitude:
        columns = columns * np.sign(np.asarray(background(sensor, recording.pairs)))
    turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = _MARGIN * step * np.stack([np.cos(turn), np.sin(turn)], 1)
    inside = np.asarray([sensor.on_sheet(at + one) for one in ring]).all(0)
    table = columns.reshape(*shape, -1)[..., used] / each
    table = _mean_over_disc(table, radius / step).reshape(len(at), -1)
    unit = float(np.sqrt((table[inside] ** 2).mean()))
    inside = inside.reshape(shape)
    even = (np.indices(shape) % 2 == 0).all(0)
    require(bool((inside & even).any()), "outline", "too narrow a sheet", "a wider one")
    return _Maps(
        jnp.asarray((table / unit).reshape(*shape, -1), sensor.dtype),
        jnp.asarray(inside),
        jnp.asarray(np.argwhere(inside & even)),
        jnp.asarray(recording.box, sensor.dtype),
    ), unit


def _mean_over_disc(
    table: Float[np.ndarray, "nx ny K"], radius: float
) -> Float[np.ndarray, "nx ny K"]:
    """Averages a table over discs of a radius, in steps; a step counts by its part."""
    if radius == 0:
        return table
    reach = int(np.ceil(radius + 0.5))
    fine = (np.arange((2 * reach + 1) * _PARTS) + 0.5) / _PARTS - reach - 0.5
    within = np.hypot(*np.meshgrid(fine, fine)) < radius
    part = within.reshape(2 * reach + 1, _PARTS, -1, _PARTS).mean((1, 3))
    return np.stack([scipy.ndimage.convolve(one, part / part.sum()) for one in table.T]).T


def _best(
    frames: Float[np.ndarray, "n K"],
    maps: _Maps,
    most: int,
    further: Bool[np.ndarray, " n"] | None = None,
) -> _Fit:
    """Fits none, one and up to `most` changes, and keeps what Schwarz's criterion does.

    A strength of 0 is no change. `further`: which frames may have more than one.
    """
    (n, k), dtype = frames.shape, frames.dtype
    best = _Fit(
        xy=np.zeros((n, most, 2), dtype),
        covariance=np.zeros((n, most, 2, 2), dtype),
        strength=np.zeros((n, most), dtype),
        chi2=np.sum(frames**2, 1),
        left=frames,
    )
    for count in range(1, most + 1):
        found = jax.tree.map(np.asarray, _fitted(jnp.asarray(frames), maps, count))
        # Before the noise is known, it is what the changes leave.
        noise = np.maximum(0.0 if further is None else 1.0, found.chi2 / (k - 3 * count))
        more = count - (best.strength != 0).sum(1)
        price = (3 * np.log(k) * more).astype(dtype)
        fits = best.chi2 - found.chi2 > price * noise
        if count > 1 and further is not None:
            fits &= further
        wide = [(0, 0), (0, most - count)]
        found = found._replace(
            xy=np.pad(found.xy, [*wide, (0, 0)]),
            covariance=np.pad(found.covariance, [*wide, (0, 0), (0, 0)]),
            strength=np.pad(found.strength, wide),
        )
        best = jax.tree.map(
            lambda new, old, fits=fits: np.where(
                fits.reshape(-1, *[1] * (new.ndim - 1)), new, old
            ),
            found,
            best,
        )
    return best


@kept
def _fitted(frames: Float[Array, "n K"], maps: _Maps, count: int) -> _Fit:
    """Fits `count` changes to each frame."""
    columns = maps.table[maps.starts[:, 0], maps.starts[:, 1]]
    length = jnp.sqrt(jnp.sum(columns**2, 1))
    columns = columns / length[:, None]
    alike = jnp.matmul(columns, columns.T, precision="highest")
    step = maps.size / (jnp.asarray(maps.inside.shape, frames.dtype) - 1)

    def start(frame: Float[Array, " K"]) -> Float[Array, "c 2"]:
        along = jnp.matmul(columns, frame, precision="highest")
        if count == 1:
            best = jnp.argmax(along**2)[None]
        else:  # every pair of candidates
            one, other = along[:, None], along[None]
            apart = jnp.maximum(1 - alike**2, 1 - _ALIKE**2)
            gain = (one**2 + other**2 - 2 * alike * one * other) / apart
            signs = (one - alike * other) * (other - alike * one) > 0
            best = jnp.argmax(jnp.where(signs & (alike < _ALIKE), gain, 0))
            best = jnp.stack(jnp.divmod(best, len(columns)))
        return maps.starts[best].astype(frame.dtype) * step

    def look(frame: Float[Array, " K"], xy: Float[Array, "c 2"]) -> "_Look":
        rows = jax.vmap(thin_rows_at, (None, None, 0))(maps.table, maps.size, xy)
        own = rows[:, 0]
        matrix, long = _normal(own)
        right = jnp.matmul(own, frame, precision="highest") / long
        strength = solve_positive(matrix, right[:, None])[:, 0] / long
        left = frame - jnp.matmul(strength, own, precision="highest")
        slopes = strength[:, None, None] * rows[:, 1:]
        nearest = jnp.round(xy / step).astype(int)
        limit = jnp.asarray(maps.inside.shape) - 1
        there = maps.inside[tuple(jnp.clip(nearest, 0, limit).T)]
        fits = there.all() & (strength * strength[0] >= 0).all() & (nearest >= 0).all()
        cost = jnp.where(fits, jnp.sum(left**2), jnp.inf)
        jacobian = jnp.concatenate([slopes.reshape(2 * count, -1), own])
        return _Look(xy, strength, left, jacobian, cost)

    def move(carry: tuple, frame: Float[Array, " K"]) -> tuple:
        at, damping = carry
        matrix, long = _normal(at.jacobian)
        uphill = jnp.matmul(at.jacobian, at.left, precision="highest") / long
        damped = matrix + damping * jnp.eye(3 * count, dtype=matrix.dtype)
        way = solve_positive(damped, uphill[:, None])[:, 0] / long
        there = look(frame, at.xy + way[: 2 * count].reshape(count, 2))
        better = there.cost < at.cost
        at = jax.tree.map(lambda new, old: jnp.where(better, new, old), there, at)
        return at, jnp.where(better, damping / 4, 8 * damping)

    def one(frame: Float[Array, " K"]) -> _Fit:
        first = look(frame, start(frame)), jnp.asarray(_DAMPING, frame.dtype)
        at = jax.lax.fori_loop(0, _MOVES, lambda _, c: move(c, frame), first)[0]
        matrix, long = _normal(at.jacobian)
        spread = solve_positive(matrix, jnp.eye(3 * count, dtype=matrix.dtype))
        spread = (spread / long / long[:, None])[: 2 * count, : 2 * count]
        blocks = jnp.stack(
            [spread[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(count)]
        )
        chi2 = jnp.sum(at.left**2)
        blocks = blocks * jnp.maximum(1, chi2 / (len(frame) - 3 * count))
        return _Fit(at.xy, blocks, at.strength, chi2, at.left)

    n = len(frames)
    every = jnp.pad(frames, ((0, -n % _TOGETHER), (0, 0)), mode="edge")
    found = jax.lax.map(jax.vmap(one), every.reshape(-1, _TOGETHER, frames.shape[1]))
    return jax.tree.map(lambda v: v.reshape(-1, *v.shape[2:])[:n], found)


class _Look(NamedTuple):
    """The model at some places."""

    xy: Float[Array, "c 2"]
    strength: Float[Array, " c"]
    left: Float[Array, " K"]
    jacobian: Float[Array, "p K"]  # by places, and by strengths
    cost: Float[Array, ""]


def _normal(
    jacobian: Float[Array, "p K"],
) -> tuple[Float[Array, "p p"], Float[Array, " p"]]:
    """Returns the products of rows of length 1, and the lengths."""
    long = jnp.sqrt(jnp.sum(jacobian**2, 1))
    rows = jacobian / long[:, None]
    return jnp.matmul(rows, rows.T, precision="highest"), long
