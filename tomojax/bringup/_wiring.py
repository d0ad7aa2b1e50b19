"""Finds the electrode that each channel reads, and that each ground line grounds."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer

from tomojax.bringup.sheet._fit import Fits, fitted, sound
from tomojax.bringup.sheet._plane import Plane, starts

# Slots that starts are compared on.
_SOME = 120

# Rounds of assigning.
_ROUNDS = 12

# Blocks of slots, whose median no slot that is fitted wrongly moves.
_BLOCKS = 9

# A start, or an order, is better if it leaves so much less than the best before it.
_LESS = 0.7

# A channel moves to an electrode that fits so much better, of what its own leaves.
_BETTER = 0.4

# A channel moves if its own electrode leaves more than usual so many times, and more than
# this part of the voltages' span.
_MORE = 3.0
_LEAST = 0.006

# Electrodes without a channel that are tried as grounds, at most.
_BLIND = 4

# Part of the slots of a line that show the same ground.
_SHARE = 0.5

# A slot in which nothing is grounded spans no more than this part of the drive.
_FLAT = 0.02


class Order(NamedTuple):
    """The electrode that each channel reads, and the fits of contacts then."""

    electrode: Integer[np.ndarray, " M"]  # of each channel
    fits: Fits


def quality(fits: Fits) -> float:
    """Computes the part of a slot's span that fits leave, in the median."""
    return float(np.median(fits.relative))


def grounds_to_try(
    asked: np.ndarray, order: np.ndarray, usable: np.ndarray
) -> Integer[np.ndarray, "n k"]:
    """Lists grounds beside the lowest channels: commanded ones, and unread electrodes."""
    inside = np.where((asked >= 0) & (asked < len(order)), asked, 0)
    blind = order[~usable][:_BLIND]
    return np.column_stack([inside, *(np.full(len(inside), e) for e in blind)])


def fit_in_order(
    plane: Plane,
    volts: Float[np.ndarray, "n M"],
    order: Integer[np.ndarray, " M"],
    usable: Bool[np.ndarray, " M"],
    told: Integer[np.ndarray, "n k"] | None = None,
    always: int | None = None,
) -> Fits:
    """Fits contacts to voltages by channel, where channel c reads electrode `order[c]`.

    `told`: further grounds to try; `always`: a channel whose electrode is grounded as well.
    """
    back = np.argsort(order)
    weight = np.broadcast_to(usable[back].astype(float), volts.shape)
    on = None if always is None else int(order[always])
    return fitted(plane, volts[:, back], weight, told, on)


def order_of(
    plane: Plane,
    volts: Float[np.ndarray, "n M"],
    usable: np.ndarray,
    asked: Integer[np.ndarray, " n"],
    always: int | None = None,
    *,
    enough: float,
) -> Order:
    """Finds the order of channels in which contacts fit; only `usable` channels count."""
    n = len(volts)
    rng = np.random.default_rng(1)
    some = np.sort(rng.choice(n, min(n, _SOME), replace=False))

    def fit(order: np.ndarray, slots: np.ndarray) -> Fits:
        told = grounds_to_try(asked[slots], order, usable)
        return fit_in_order(plane, volts[slots], order, usable, told, always)

    best, lowest = np.arange(plane.count), np.inf
    for order in starts(plane).values():
        q = quality(fit(order, some))
        if q < _LESS * lowest:
            best, lowest = order, q
        if lowest < enough:
            break
    if lowest > 5 * enough:
        for order in _embedded(plane, volts):
            q = quality(fit(order, some))
            if q < _LESS * lowest:
                best, lowest = order, q
    every = np.arange(n)
    seen = {tuple(best)}
    for _ in range(_ROUNDS):
        slots = some if n > 2 * _SOME and len(seen) < 3 and lowest > enough else every
        fits = fit(best, slots)
        new = _assigned(costs(volts[slots], fits), best, usable)
        if tuple(new) in seen:
            if len(slots) == n:
                if (new == best).all():
                    return Order(best, fits)
                break
            lowest = 0.0
            continue
        seen.add(tuple(new))
        best = new
    return Order(best, fit(best, every))


def costs(volts: np.ndarray, fits: Fits) -> Float[np.ndarray, "M M"]:
    """Computes what each channel leaves at each electrode, at any gain, over span; rms."""
    weight = (fits.far * sound(fits)[:, None]) / np.maximum(fits.span, 1e-12)[:, None] ** 2
    rng = np.random.default_rng(2)
    blocks = np.array_split(rng.permutation(len(volts)), min(_BLOCKS, len(volts)))
    found = []
    for some in blocks:
        v, w, p = volts[some], weight[some], fits.modelled[some]
        xy, xx = v.T @ (w * p), (w * p**2).sum(0)
        square = (v**2).T @ w - np.maximum(xy, 0) ** 2 / np.maximum(xx, 1e-12)
        count = (w > 0).sum(0)
        mean = np.maximum(square, 0) / np.maximum(count, 1)
        found.append(np.where(count > 0, mean, np.nan))
    with np.errstate(all="ignore"):
        middle = np.nanmedian(np.where(np.isnan(found).all(0), 1.0, found), 0)
    return np.sqrt(middle)


def _assigned(cost: np.ndarray, order: np.ndarray, usable: np.ndarray) -> np.ndarray:
    m = len(order)
    own = cost[np.arange(m), order]
    usual = np.median(own[usable])
    wrong = usable & (own > max(_MORE * usual, _LEAST))
    # Electrodes that no sound channel has; dead channels keep theirs if they are left.
    free = np.setdiff1d(np.arange(m), order[~wrong & usable])
    moving = np.flatnonzero(wrong)
    if not len(moving):
        return order
    from scipy.optimize import linear_sum_assignment  # `info` seldom comes here

    table = cost[np.ix_(moving, free)]
    table = np.where(free == order[moving][:, None], _BETTER * table, table)
    rows, columns = linear_sum_assignment(table)
    c, e, new = moving[rows], free[columns], order.copy()
    better = cost[c, e] < _BETTER * own[c]
    new[c[better]] = e[better]
    # Whoever lost its electrode takes one that is left.
    return _whole(new, order, usable, cost)


def _whole(
    new: np.ndarray, order: np.ndarray, usable: np.ndarray, cost: np.ndarray
) -> np.ndarray:
    """Makes a permutation again: the best fit keeps an electrode that two channels take."""
    m = len(new)
    taken: dict[int, int] = {}
    for c in sorted(range(m), key=lambda c: (not usable[c], cost[c, new[c]])):
        taken.setdefault(int(new[c]), c)
    left = [e for e in range(m) if e not in taken]
    for c in range(m):
        if taken[int(new[c])] != c:
            e = int(order[c]) if int(order[c]) in left else left[0]
            left.remove(e)
            new[c] = e
    return new


def _embedded(plane: Plane, volts: np.ndarray) -> list[np.ndarray]:
    """Orders channels by likeness, slot by slot: neighbours on the sheet are alike."""
    from scipy.optimize import linear_sum_assignment

    m = plane.count
    scaled = volts / np.maximum(np.median(volts, 1, keepdims=True), 1e-9)
    ranks = scaled.argsort(1).argsort(1) / m
    apart = ((ranks[:, :, None] - ranks[:, None]) ** 2).mean(0)
    centre = np.eye(m) - 1 / m
    values, vectors = np.linalg.eigh(-centre @ apart @ centre / 2)
    flat = vectors[:, -2:] * np.sqrt(np.maximum(values[-2:], 0))
    # As wide as the electrodes lie, along their own axes and turned by an eighth.
    goal = plane.xy - plane.xy.mean(0)
    found = []
    for angle in np.arange(8) * np.pi / 8:
        for flip in (1, -1):
            c, s = np.cos(angle), np.sin(angle)
            turned = flat @ np.array([[c, -s], [s, c]]) * [1, flip]
            turned = turned / turned.std(0) * goal.std(0)
            table = ((turned[:, None] - goal) ** 2).sum(2)
            found.append(linear_sum_assignment(table)[1])
    return found


class Lines(NamedTuple):
    """The electrode of each ground line, by the number that is commanded."""

    asked: Integer[np.ndarray, " L"]
    ground: Integer[np.ndarray, " L"]  # electrode that is grounded; −1: none; −2: unsure
    share: Float[np.ndarray, " L"]  # of the slots that say so
    slots: Integer[np.ndarray, " L"]

    def moved(self, image: Integer[np.ndarray, " M"]) -> "Lines":
        """Replaces each electrode by its image."""
        known = image[np.maximum(self.ground, 0)]
        return self._replace(ground=np.where(self.ground >= 0, known, self.ground))


def lines_of(fits: Fits, asked: np.ndarray, flat: np.ndarray) -> Lines:
    """Finds the electrode that most slots of each commanded ground show."""
    relative = fits.relative
    weight = 1 / (1 + (relative / max(np.median(relative), 1e-6)) ** 2)
    numbers = np.unique(asked)
    ground, share, count = [], [], []
    for g in numbers:
        own = asked == g
        count.append(int(own.sum()))
        if flat[own].mean() > _SHARE:
            ground.append(-1)
            share.append(float(flat[own].mean()))
            continue
        votes = np.bincount(fits.ground[own], weight[own] * ~flat[own] + 1e-12)
        best = int(votes.argmax())
        share.append(float(votes[best] / votes.sum()))
        ground.append(best if share[-1] > _SHARE else -2)
    return Lines(numbers, np.array(ground), np.array(share), np.array(count))


def floating(volts: np.ndarray, usable: np.ndarray, drive: float) -> np.ndarray:
    """Finds slots in which nothing is grounded: all channels high and alike."""
    v = volts[:, usable]
    middle, high = np.quantile(v, [0.5, 0.95], axis=1)
    third = np.sort(v, 1)[:, min(2, v.shape[1] - 1)]
    return (high - third < _FLAT * drive) & (middle > 0.1 * drive)
