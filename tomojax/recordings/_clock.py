"""Makes times from the scans' numbers where a rig's clock cannot be believed."""

import numpy as np
from jaxtyping import Bool, Float, Int

# A clock of 32 bits of µs begins anew after so long, s.
_WRAP = 2**32 * 1e-6

# Nobody rests longer between two scans of one recording, s: the clock was set.
_PAUSE = 86400.0

# Between scans, over the time of their slots: a clock that runs otherwise is none of s.
RATES = (0.5, 100.0)

# More steps than this part that do not rise: the clock is coarse, or stands.
_FEW = 0.02

# Where the clock is coarse, the median of some scans is one time.
_LEAST = 32  # scans
_LONG = 1.0  # seconds that they last

# Jumps that are compared with each other: a clock that jumps more often has no such pairs.
_JUMPS = 1000


def mended_times(
    t0: Float[np.ndarray, " n"], numbers: Int[np.ndarray, " n"], interval: float
) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"], tuple[str, ...]]:
    """Returns rising start times, the scans with new times, and the reasons as sentences.

    **Arguments:** `t0` s, as read; `numbers` of the scans, counting lost scans; `interval`
    from scan to scan by f_switch, s. The times of a sound clock stay unchanged.
    """
    if _sound(t0, interval):
        return t0, np.zeros(len(t0), bool), ()
    times, wraps = _unwrapped(t0, numbers * interval)
    said = []
    if wraps:
        said.append(f"t0: the clock begins anew {wraps} times (2^32 µs); it is carried on")
    if not _sound(times, interval):
        times, why = _remade(times, numbers * interval, interval)
        said.append(why)
    return times, times != t0, tuple(said)


def usual_step(t0: Float[np.ndarray, " n"], nominal: float) -> float:
    """Returns the usual step of times, s: a rig may rest between scans."""
    return nominal if len(t0) < 2 else float(np.median(np.diff(t0)))


def _sound(t0: np.ndarray, interval: float) -> bool:
    if not np.isfinite(t0).all():
        return False
    steps = np.diff(t0)
    if not len(steps):
        return True
    rises = bool((steps > 0).all() and steps.max() < _PAUSE + 1e3 * interval)
    low, high = RATES
    return rises and low <= float(np.median(steps)) / interval <= high


def _unwrapped(t0: np.ndarray, due: np.ndarray) -> tuple[np.ndarray, int]:
    """Carries on the times of a clock that began anew; counts the new beginnings."""
    with np.errstate(invalid="ignore", over="ignore"):
        after = np.diff(t0) + _WRAP
        anew = (after >= 0) & (after < _WRAP / 2)
        anew &= after < np.maximum(1.0, RATES[1] * np.diff(due))
    times = t0.copy()
    times[1:] += _WRAP * np.cumsum(anew)
    return times, int(anew.sum())


def _remade(times: np.ndarray, due: np.ndarray, interval: float) -> tuple[np.ndarray, str]:
    """Makes times by the scans' numbers where the clock steps wrongly; tells the fault."""
    there = np.flatnonzero(np.isfinite(times) & (np.abs(times) < 1e15))
    clock, at = times[there], due[there]
    steps = np.diff(clock)
    wrong = np.flatnonzero((steps <= 0) | (steps >= _PAUSE + 1e3 * interval))
    median = float(np.median(steps)) / interval if len(steps) else 0.0
    few = len(wrong) <= max(1, _FEW * len(there)) and RATES[0] <= median <= RATES[1]
    made, why = None, ""
    if few and len(there):
        made = _stepped(clock, at, interval, (0.0, np.inf))
        first = int(there[wrong[0]]) if len(wrong) else 0
        gone = len(times) - len(there)
        why = (
            f"t0: the clock falls, stands or jumps {len(wrong)} times, first after scan"
            f" {first}; there time goes on by the scans' numbers"
        )
        if gone:
            why = f"t0: {gone} scans have no time; theirs is from the scans' numbers"
    elif len(there) >= 3 * _LEAST:
        made = _by_blocks(clock, at, interval)
        why = (
            "t0: the clock is coarse, or slots were timed in bursts: times are from the"
            " scans' numbers, fitted to the clock"
        )
    if made is None:
        told = f"; its scans are {median * interval:.3g} s apart" if len(steps) else ""
        why = (
            "t0: the clock cannot be believed: times are the scans' numbers at"
            f" {1 / interval:g} scans/s by f_switch{told}"
        )
        return due - due[0], why
    rate = (made[-1] - made[0]) / (at[-1] - at[0]) if len(at) > 1 else 1.0
    found = np.interp(due, at, made)
    found[due < at[0]] = made[0] - rate * (at[0] - due[due < at[0]])
    found[due > at[-1]] = made[-1] + rate * (due[due > at[-1]] - at[-1])
    return found, why


def _stepped(
    clock: np.ndarray, due: np.ndarray, interval: float, rates: tuple[float, float]
) -> np.ndarray | None:
    """Puts the clock's wrong steps right; returns None where most steps are wrong."""
    steps, usual = np.diff(clock), np.diff(due)
    good = (steps > 0) & (steps < _PAUSE + 1e3 * usual)
    good &= (steps >= rates[0] * usual) & (steps <= rates[1] * usual)
    if len(steps) and good.mean() < 0.5:
        return None
    rate = float(np.median(steps[good] / usual[good])) if good.any() else 1.0
    jumps = steps - rate * usual
    good &= ~_taken_back(jumps, good, interval)
    more = np.zeros(len(clock))
    more[1:] = np.cumsum(np.where(good, 0.0, -jumps))
    # A jump that was taken back leaves the clock as it was.
    near = np.where(np.abs(more) < interval / 2, 0.0, more)
    made = clock + near
    return made if (np.diff(made) > 0).all() else clock + more


def _taken_back(jumps: np.ndarray, good: np.ndarray, interval: float) -> np.ndarray:
    """Finds jumps forward that a fall of the same size takes back: neither is time."""
    found = np.zeros(len(jumps), bool)
    falls = np.flatnonzero(~good & (jumps < 0))
    ahead = np.flatnonzero(good & (jumps > 2 * interval))
    if not len(ahead) or len(falls) > _JUMPS or len(ahead) > _JUMPS:
        return found
    for fall in falls:
        alike = ahead[np.abs(jumps[ahead] + jumps[fall]) <= 2 * interval]
        alike = alike[~found[alike]]
        if len(alike):
            found[alike[np.argmin(np.abs(alike - fall))]] = True
    return found


def _by_blocks(clock: np.ndarray, due: np.ndarray, interval: float) -> np.ndarray | None:
    """Makes times by the scans' numbers, held to the clock's median in blocks of scans."""
    size = min(len(clock) // 3, max(_LEAST, round(_LONG / interval)))
    count = len(clock) // size
    cut = slice(0, count * size)
    off = np.median((clock - due)[cut].reshape(count, size), 1)
    middle = np.median(due[cut].reshape(count, size), 1)
    anchors = _stepped(off + middle, middle, interval, RATES)
    if anchors is None:
        return None
    rate = (anchors[-1] - anchors[0]) / (middle[-1] - middle[0])
    ends = due[[0, -1]]
    first = anchors[0] - rate * (middle[0] - ends[0])
    last = anchors[-1] + rate * (ends[1] - middle[-1])
    at = np.concatenate([ends[:1], middle, ends[1:]])
    return np.interp(due, at, np.concatenate([[first], anchors, [last]]))


def mended_gaps(gaps: np.ndarray, scans: int) -> tuple[np.ndarray, tuple[str, ...]]:
    """Puts gaps in the order of their numbers; each begins after the last gap's end.

    The number of lost scans stays as told. Gaps of a shape other than (g, 2) stay
    unchanged.
    """
    if gaps.ndim != 2 or gaps.shape[1:] != (2,) or not len(gaps) or (gaps < 0).any():
        return gaps, ()
    found = gaps[np.argsort(gaps[:, 0], kind="stable")]
    lost = found[:, 1]
    before = np.concatenate([[0], np.cumsum(lost)[:-1]])
    # By rows: a gap is before the row of its number less what was lost until there.
    rows = np.clip(np.maximum.accumulate(found[:, 0] - before), 0, scans)
    found = np.stack([rows + before, lost], 1)
    if np.array_equal(found, gaps):
        return gaps, ()
    return found, ("gaps: numbers out of order or beyond the end; they are put in order",)
