"""Checks a rig that reads pairs of electrodes: dead electrodes, and exchanged wires."""

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tomojax._require import require
from tomojax.ert._sheet_change import background, sensitivities
from tomojax.ert._teaching import candidates
from tomojax.ert.recorded._pairs import Pairs
from tomojax.ert.recorded._recording import PairRecording

# A reading is dead whose changes are so much smaller than usual ones, and loud where they
# are so much larger: most readings at an electrode are alike within a factor of ten.
_SMALL, _LARGE = 1 / 30, 30.0

# Readings with exchanged roles may differ by so much of their size: converters, and sheets
# that a press moves between two injections.
_RECIPROCAL = 0.2

# An exchange explains so much of what frames leave otherwise, and is so many deviations
# beyond none: a sheet that is not the nominal one leaves much with any order.
_EXPLAINED, _SURE = 0.15, 6.0

# An injection or a pair of readings that is reversed agrees with the model as well as the
# others do, but for the sign: by so much of that at least.
_REVERSED = 0.7

# Frames, and readings of each, that are looked at: more say the same.
_FRAMES, _READINGS = 300, 2000
# Places along the sheet's longer side: a press is about as wide as their distance.
_PLACES = 20
# Exchanges are tried among so many electrodes, those that fit worst.
_WORST = 10
# At most so many exchanges are named.
_ROUNDS = 3


class PairFault(NamedTuple):
    """One thing that is wrong with a rig that reads pairs.

    `kind`: "dead", "loud", "swapped", "reversed" or "reciprocity". `electrodes` are those
    at fault. `value`: how much. `text` and `mend` say so in words.

    **Example:**

    >>> import tomojax as tx
    >>> tx.ert.PairFault("dead", (3,), 0.0, "electrode 3 says nothing", "mend it").kind
    'dead'
    """

    kind: str
    electrodes: tuple[int, ...]
    value: float
    text: str
    mend: str


def check(recording: PairRecording) -> list[PairFault]:
    """Finds electrodes that say nothing, and wires that are exchanged or reversed.

    Presses anywhere tell it, one at a time; no place need be known. Two wires count as
    exchanged where the nominal sheet explains presses much better with the two the other
    way round. A turn or a mirror image of all electrodes cannot be told from presses
    without places.

    **Raises:** `ValueError` for fewer than twenty frames with a change.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    >>> rim = 0.05 * np.stack([np.cos(angle), np.sin(angle)], 1)
    >>> disc = tx.recordings.Outline("disc", 0.1)
    >>> sensor = tx.Sensor.disc(0.1, rim + 0.05, electrode_diameter=0.01)
    >>> wired, places = [0, 1, 4, 3, 2, 5, 6, 7], np.random.default_rng(0)
    >>> places = places.uniform(0.02, 0.08, (60, 2))
    >>> pairs = tx.ert.Pairs.adjacent(8)
    >>> real = tx.ert.Pairs(np.take(wired, pairs.inject), np.take(wired, pairs.read))
    >>> volts = np.asarray(tx.ert.sensitivities(sensor, real, places))
    >>> recording = tx.ert.PairRecording(volts, pairs, rim, 0.01, outline=disc)
    >>> [(fault.kind, fault.electrodes) for fault in tx.ert.check(recording)]
    [('swapped', (2, 4))]
    """
    volts, pairs = np.nan_to_num(recording.voltages), recording.pairs
    faults, alive = _silent(recording)
    size = np.sqrt((np.where(alive, volts, 0) ** 2).sum((1, 2)))
    some = np.flatnonzero(size > 0.1 * np.quantile(size, 0.9))
    require(len(some) >= 20, "v", f"{len(some)} frames with a change", "twenty or more")
    few = some[np.linspace(0, len(some) - 1, min(len(some), _FRAMES)).astype(int)]
    fit = _Fit.of(recording, volts[few], alive)
    swapped, pairs = _swapped(fit, pairs)
    faults += swapped + _reversed(fit, pairs) + _not_reciprocal(recording, alive)
    return faults


def _silent(recording: PairRecording) -> tuple[list[PairFault], Bool[np.ndarray, "C R"]]:
    """Finds electrodes whose readings say nothing; tells which readings say something."""
    volts, pairs = np.nan_to_num(recording.voltages), recording.pairs
    each = range(len(recording.electrode_xy))
    driven = [(pairs.inject == e).any(1)[:, None] for e in each]
    touches = [(pairs.read == e).any(2) | at for e, at in zip(each, driven)]
    still = (volts == volts[:1]).all(0)
    size = np.where(still, 0, np.sqrt(np.mean(volts**2, 0)))
    # An electrode's middle: one that jumps is part of half of a small rig's readings.
    usual = np.median([np.median(size[at]) for at in touches if at.any()])
    require(usual > 0, "v", "readings that never change", "changes under presses")
    dead, loud = size < _SMALL * usual, size > _LARGE * usual
    alive, faults = ~dead & ~loud, []
    for kind, bad, word in (("dead", dead, "hardly change"), ("loud", loud, "jump")):
        for e in each:
            part = float(bad[touches[e]].mean()) if touches[e].any() else 0.0
            if part > 0.6:
                told = f"{100 * part:.0f} % of the readings at electrode {e} {word}"
                mend = "look at its wire and its contact with the sheet"
                faults.append(PairFault(kind, (e,), part, told, mend))
    return faults, alive


class _Fit(NamedTuple):
    """Frames, and what a press at each place would make of any pair of electrodes."""

    frames: Float[np.ndarray, "n K"]
    kept: Bool[np.ndarray, "C R"]
    form: Float[np.ndarray, "P M M"]  # −∇R_e·∇R_f, against the first electrode
    level: Float[np.ndarray, "M M"] | None  # R_ef without a press, of signless readings

    @classmethod
    def of(cls, recording: PairRecording, volts: Any, alive: Any) -> "_Fit":
        rng, kept = np.random.default_rng(0), alive.copy()
        surplus = int(kept.sum()) - _READINGS
        if surplus > 0:
            at = rng.choice(np.flatnonzero(kept), surplus, replace=False)
            kept.reshape(-1)[at] = False
        m, sensor = len(recording.electrode_xy), recording.sensor()
        others = np.stack([np.arange(1, m), np.zeros(m - 1, int)], 1)
        both = Pairs(others, np.broadcast_to(others, (m - 1, m - 1, 2)))
        made = np.asarray(sensitivities(sensor, both, candidates(recording, _PLACES)))
        # Of any pairs the voltages are sums of these, as currents and readings add up.
        form = np.pad(made, ((0, 0), (1, 0), (1, 0)))
        level = np.pad(np.asarray(background(sensor, both)), ((1, 0), (1, 0)))
        return cls(
            _unit(volts[:, kept]), kept, form, level if recording.magnitude else None
        )

    def columns(self, pairs: Pairs) -> Float[np.ndarray, "P K"]:
        """Returns unit readings of a press at each place."""
        (a, b), (p, m) = pairs.inject.T[..., None], np.moveaxis(pairs.read, 2, 0)

        def sums(form: np.ndarray) -> np.ndarray:
            return form[..., p, a] - form[..., p, b] - form[..., m, a] + form[..., m, b]

        made = sums(self.form)
        if self.level is not None:
            made = made * np.sign(sums(self.level))
        return _unit(made[:, self.kept])

    def agreement(self, pairs: Pairs) -> Float[np.ndarray, " n"]:
        """Computes each frame's squared cosine with the press that explains it best."""
        return ((self.frames @ self.columns(pairs).T) ** 2).max(1)

    def explained(self, pairs: Pairs) -> Float[np.ndarray, "n K"]:
        """Returns the readings that explain each frame best, in their size."""
        columns = self.columns(pairs)
        product = self.frames @ columns.T
        best = (product**2).argmax(1)
        return columns[best] * product[np.arange(len(best)), best][:, None]


def _unit(rows: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    return rows / np.where(size > 0, size, 1)


def _swapped(fit: _Fit, pairs: Pairs) -> tuple[list[PairFault], Pairs]:
    """Finds exchanged electrodes, the clearest first; returns the pairs as they are."""
    faults: list[PairFault] = []
    for _ in range(_ROUNDS):
        now = fit.agreement(pairs)
        best = None
        for one, other in combinations(_worst(fit, pairs), 2):
            order = np.arange(fit.form.shape[1])
            order[[one, other]] = other, one
            tried = Pairs(order[pairs.inject], order[pairs.read])
            gain = fit.agreement(tried) - now
            if best is None or gain.mean() > best[0].mean():
                best = gain, tuple(sorted((int(one), int(other)))), tried
        if best is None:
            break
        gain, both, tried = best
        explained = float(gain.mean() / max(1 - now.mean(), 1e-12))
        sure = gain.mean() > _SURE * gain.std() / np.sqrt(len(gain))
        if explained < _EXPLAINED or not sure:
            break
        told = f"electrodes {both[0]} and {both[1]} seem exchanged: that explains "
        told += f"{100 * explained:.0f} % of what presses leave"
        mend = "exchange the two wires, or their numbers in inject and read"
        faults.append(PairFault("swapped", both, explained, told, mend))
        pairs = tried
    return faults, pairs


def _worst(fit: _Fit, pairs: Pairs) -> list[int]:
    """Lists the electrodes at whose readings and injections the most is left."""
    left = (fit.frames - fit.explained(pairs)) ** 2
    grid = np.zeros((2, *fit.kept.shape))
    grid[0][fit.kept], grid[1][fit.kept] = left.sum(0), (fit.frames**2).sum(0)
    told = []
    for e in range(fit.form.shape[1]):
        at = (pairs.read == e).any(2) | (pairs.inject == e).any(1)[:, None]
        told.append(grid[0][at].sum() / max(grid[1][at].sum(), 1e-30))
    return np.argsort(told)[::-1][:_WORST].tolist()


def _reversed(fit: _Fit, pairs: Pairs) -> list[PairFault]:
    """Finds injections, and pairs of readings, whose signs are the other way round."""
    made, faults = fit.explained(pairs), []
    if fit.level is not None:
        return faults  # magnitudes have no sign
    condition, reading = np.nonzero(fit.kept)
    ends = pairs.read[condition, reading]
    names = [tuple(sorted(pair)) for pair in ends.tolist()]
    groups = {
        ("injection", tuple(p)): condition == c for c, p in enumerate(pairs.inject.tolist())
    }
    groups |= {
        ("reading", pair): np.array([n == pair for n in names]) for pair in set(names)
    }
    alike = []
    for some in groups.values():
        one, other = fit.frames[:, some], made[:, some]
        size = np.sqrt((one**2).sum() * (other**2).sum())
        alike.append(float((one * other).sum() / size) if size > 0 else 0.0)
    least = -_REVERSED * max(float(np.median(alike)), 0.0)
    for (what, pair), value in zip(groups, alike):
        if value < least:
            told = f"the {what} of electrodes {pair[0]} and {pair[1]} has the other sign"
            faults.append(
                PairFault("reversed", pair, value, told, "exchange its two wires")
            )
    return faults


def _not_reciprocal(recording: PairRecording, alive: Any) -> list[PairFault]:
    """Finds electrodes whose readings with exchanged roles disagree."""
    told = recording.pairs.exchanged()
    if not len(told):
        return []
    c, r, d, s, sign = told.T
    one, other = recording.voltages[:, c, r], recording.voltages[:, d, s] * sign
    if recording.magnitude:
        one, other = abs(one), abs(other)
    good = alive[c, r] & alive[d, s]
    size = np.sqrt(np.nanmean(one**2, 0) * np.nanmean(other**2, 0))
    apart = np.sqrt(np.nanmean((one - other) ** 2, 0))[good] / size[good]
    if not good.any():
        return []
    ends = np.concatenate([recording.pairs.inject[c], recording.pairs.read[c, r]], 1)[good]
    each = {int(e): float(np.median(apart[(ends == e).any(1)])) for e in np.unique(ends)}
    bad = tuple(e for e, middle in each.items() if middle > _RECIPROCAL)
    if not bad:
        return []
    middle, named = float(np.median(apart)), len(bad) <= len(each) // 2
    where = f" at electrodes {', '.join(map(str, bad))}" if named else ""
    most = 100 * max(each.values())
    text = f"readings with exchanged roles differ by up to {most:.0f} %{where}"
    mend = "read slower, or look at what loads the electrodes"
    return [PairFault("reciprocity", bad if named else (), middle, text, mend)]
