"""Fits one contact to each slot: its place, the electrode that is grounded, and the rest.

The fit does not believe the commanded ground, but finds the electrode that drains the
sheet. Mirrored or turned channels fit as well as sound ones, with the ground mirrored or
turned: physics cannot tell. Slots are fitted alone, so that no length of a scan matters.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer

from tomojax.bringup.sheet._plane import Plane, UNDER

# Residuals beyond this many of their deviations (median) are not counted.
_WILD = 5.0

# Lowest channels that a ground is looked for among.
_LOWEST = 3

# Gauss and Newton's steps.
_STEPS = 5

# Slots that fit so many times worse than usual are not counted.
_SOUND = 4.0

# A residual is as small as this part of the slot's span at best: else nothing is wild.
_FLOOR = 0.004


class Fits(NamedTuple):
    """Contacts fitted to n slots."""

    xy: Float[np.ndarray, "n 2"]  # contact, m
    ground: Integer[np.ndarray, " n"]  # electrode that drains
    current: Float[np.ndarray, " n"]  # over the sheet's conductance: V at 1 Ω per square
    level: Float[np.ndarray, " n"]  # V
    modelled: Float[np.ndarray, "n M"]  # V, by electrode; far from contact and ground
    far: Float[np.ndarray, "n M"]  # where it holds: 0 or 1
    left: Float[np.ndarray, " n"]  # V, median of residuals
    span: Float[np.ndarray, " n"]  # V, between high and low channels
    second: Float[np.ndarray, " n"]  # as `current`, by the electrode always grounded

    @property
    def relative(self) -> Float[np.ndarray, " n"]:
        """Returns the part of each slot's span that the fit leaves."""
        return self.left / np.maximum(self.span, 1e-12)


def sound(fits: Fits) -> Bool[np.ndarray, " n"]:
    """Finds slots that one contact explains about as well as usual."""
    return fits.relative < _SOUND * np.median(fits.relative)


def fitted(
    plane: Plane,
    volts: Float[np.ndarray, "n M"],
    weight: Float[np.ndarray, "n M"],
    told: Integer[np.ndarray, "n k"] | None = None,
    always: int | None = None,
) -> Fits:
    """Fits every slot; `volts` by electrode, `weight` 0 for a voltage that is not used.

    `told`: further grounds to try; `always`: an electrode that is grounded as well.
    """
    hidden = np.where(weight > 0, volts, np.inf)
    if always is not None:
        hidden[:, always] = np.inf
    tried = np.argsort(hidden, 1)[:, :_LOWEST]
    if told is not None:
        tried = np.concatenate([told, tried], 1)
    place, ground = _likeliest(plane, volts, weight, tried, always)
    xy = _nearer(plane, volts, weight, place, ground, always)
    first = _told(plane, volts, weight, xy, ground, always)
    # Once more without wild voltages, and with two grounds to choose from.
    least = np.maximum(1.5 * first.left, _FLOOR * first.span)
    counted = weight * (np.abs(volts - first.modelled) < _WILD * least[:, None])
    tried = np.stack([ground, tried[:, 0]], 1)
    place, ground = _likeliest(plane, volts, counted, tried, always)
    xy = _nearer(plane, volts, counted, place, ground, always)
    return _told(plane, volts, counted, xy, ground, always, weight)


def _likeliest(plane, volts, weight, tried, always) -> tuple[np.ndarray, np.ndarray]:
    """Searches each slot's place and ground of least cost among the grounds tried."""
    n = len(volts)
    cost, place, ground = np.full(n, np.inf), np.zeros(n, int), np.zeros(n, int)
    for k, sink in enumerate(tried.T):
        new = np.flatnonzero((tried[:, :k] != sink[:, None]).all(1))
        best, at = _searched(plane, volts[new], weight[new], sink[new], always)
        less = best < cost[new]
        new = new[less]
        cost[new], place[new], ground[new] = best[less], at[less], sink[new]
    return plane.places[place], ground


def _drop_sink(weight: np.ndarray, sink: np.ndarray, always: int | None) -> np.ndarray:
    weight = weight.copy()
    weight[np.arange(len(weight)), sink] = 0
    if always is not None:
        weight[:, always] = 0
    return weight


def _searched(plane, volts, weight, sink, always) -> tuple[np.ndarray, np.ndarray]:
    """Searches all places for the least cost: closed form in I and C at each."""
    w = _drop_sink(weight, sink, always)
    (far, fared, squared), away = plane.searched, -plane.between[sink]
    s0 = w @ far
    sv, svv = (w * volts) @ far, (w * volts**2) @ far
    sd = w @ fared + (w * away) @ far
    sdv = (w * volts) @ fared + (w * volts * away) @ far
    sdd = w @ squared + 2 * (w * away) @ fared + (w * away**2) @ far
    s0 = np.maximum(s0, 1e-9)
    vv, dv, dd = svv - sv**2 / s0, sdv - sd * sv / s0, sdd - sd**2 / s0
    dd = np.maximum(dd, 1e-12)
    if always is None:
        cost = vv - np.maximum(dv, 0) ** 2 / dd
    else:
        # A part of the current leaves by the other electrode: one more column.
        more = -plane.between[always] - away  # (n, M)
        se = (w * more) @ far
        sev, see = (w * more * volts) @ far, (w * more**2) @ far
        sed = (w * more) @ fared + (w * more * away) @ far
        ev, ee, ed = sev - se * sv / s0, see - se**2 / s0, sed - se * sd / s0
        det = np.maximum(dd * ee - ed**2, 1e-9 * dd * np.maximum(ee, 1e-12) + 1e-15)
        a, b = (ee * dv - ed * ev) / det, (dd * ev - ed * dv) / det
        both = np.where((a > 0) & (b > 0), a * dv + b * ev, np.maximum(dv, 0) ** 2 / dd)
        cost = vv - both
    # A place that hides many electrodes has fewer to fit.
    free = np.maximum(s0 - 4, 0.5)
    cost = np.where(s0 > 4.5, cost / free, np.inf)
    at = cost.argmin(1)
    return cost[np.arange(len(cost)), at], at


def _columns(plane, potential, sink, always) -> list[np.ndarray]:
    first = potential - plane.between[sink]
    if always is None:
        return [first, np.ones_like(first)]
    return [first, np.ones_like(first), plane.between[sink] - plane.between[always]]


def _solved(columns: list[np.ndarray], volts: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Solves each slot's least squares in its columns, (n, k)."""
    a = np.stack(columns, -1)  # (n, M, k)
    weighed = a * w[..., None]
    normal = np.einsum("nmi,nmj->nij", weighed, a)
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-12))
    normal = normal / (scale[:, :, None] * scale[:, None])
    normal = normal + 1e-9 * np.eye(len(columns))
    right = np.einsum("nmi,nm->ni", weighed, volts) / scale
    return np.linalg.solve(normal, right[..., None])[..., 0] / scale


def _nearer(plane, volts, weight, xy, sink, always) -> np.ndarray:
    """Refines the places of the search by Gauss and Newton's steps."""
    w0 = _drop_sink(weight, sink, always)
    step = plane.pitch / 4
    least, most = 0.05 * plane.pitch, plane.size - 0.05 * plane.pitch
    for _ in range(_STEPS):
        w = w0 * (plane.distance(xy) > UNDER)
        potential, *slopes = plane.with_slopes(xy)
        columns = _columns(plane, potential, sink, always)
        x = _solved(columns, volts, w)
        x = _solved([*columns, *(x[:, :1] * slope for slope in slopes)], volts, w)
        move = np.clip(x[:, -2:], -step, step)
        xy = np.clip(xy + np.nan_to_num(move), least, most)
    return xy


def _told(plane, volts, counted, xy, sink, always, weight=None) -> Fits:
    weight = counted if weight is None else weight
    far = _drop_sink((plane.distance(xy) > UNDER).astype(float), sink, always)
    columns = _columns(plane, plane.from_electrodes(xy), sink, always)
    x = _solved(columns, volts, counted * far)
    modelled = np.einsum("nmi,ni->nm", np.stack(columns, -1), x)
    masked = np.where(weight * far > 0, np.abs(volts - modelled), np.nan)
    seen = np.where(weight > 0, volts, np.nan)
    masked[np.isnan(masked).all(1), 0] = np.inf
    left = _quantile(masked, 0.5)
    span = _quantile(seen, 0.95) - _quantile(seen, 0.05)
    second = x[:, 2] if always is not None else np.zeros(len(xy))
    return Fits(xy, sink, x[:, 0], x[:, 1], modelled, far, left, span, second)


def _quantile(values: Float[np.ndarray, "n M"], part: float) -> Float[np.ndarray, " n"]:
    """As `np.nanquantile` of each row, which takes one row after the other."""
    ranked = np.sort(values, 1)  # NaN last
    at = part * np.maximum((~np.isnan(values)).sum(1) - 1, 0)
    low, each = np.floor(at).astype(int), np.arange(len(values))
    one, other = ranked[each, low], ranked[each, np.ceil(at).astype(int)]
    return np.where(low == at, one, one + (at - low) * (other - one))
