"""Holds a recording that is read whole: slots one after another, cut into scans."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Integer, Shaped

from tomojax._require import require
from tomojax.recordings._described import (
    check_keys,
    rig_of,
    scaled,
    slots_of,
    volts_of,
    whole_numbers,
)
from tomojax.recordings._recording import Recording, Scans, settle

# Longest scan whose grounds are looked for in a file that does not say.
_LONGEST = 4096


class MemoryRecording(Recording):
    """Slots of a file that has been read, with a description of the rig.

    **Arguments:** `values` volts, or codes where `told` has a `scale`; `ground` of each
    slot; `t` of each slot, s, or None; `number` of each slot, counting lost slots; `codes`:
    the type of codes that come as other numbers, NaN among these.
    """

    def __init__(
        self,
        path: Path,
        told: dict[str, Any],
        values: Shaped[np.ndarray, "n M"],
        ground: Shaped[np.ndarray, " n"],
        t: Float[np.ndarray, " n"] | None = None,
        number: Integer[np.ndarray, " n"] | None = None,
        gaps: np.ndarray | None = None,
        codes: np.dtype | None = None,
    ):
        check_keys(told, "description")
        self.path = path
        require(len(values) > 0, "v", "no slots", "at least one")
        if codes is None and values.dtype.kind in "iu" and "scale" in told:
            codes = values.dtype
        coded = "scale" in told
        volts = volts_of(values, *scaled(told)) if coded else values.astype(np.float32)
        ground = whole_numbers(ground)
        order, self.mended = _in_order(volts, ground, t, number)
        volts, ground = volts[order], ground[order]
        t, number = (None if a is None else a[order] for a in (t, number))
        self.slots, said = _slots(told, ground, number)
        self.mended += said
        self.electrodes = values.shape[1]
        f_switch = None if "f_switch" in told else _rate(t)
        self.rig, said = rig_of(told, self.electrodes, codes, f_switch)
        self.mended += said
        numbers = self._cut(volts, ground, t, number)
        if gaps is not None and gaps.size:
            self.gaps = np.reshape(gaps, (-1, 2)).astype(int)
        settle(self, numbers)
        self._scans = self._scans._replace(t0=self.t0)

    def _cut(
        self,
        volts: Float[np.ndarray, "n M"],
        ground: Integer[np.ndarray, " n"],
        t: Float[np.ndarray, " n"] | None,
        number: Integer[np.ndarray, " n"] | None,
    ) -> Integer[np.ndarray, " scans"]:
        """Cuts slots into scans, and returns the scans' numbers.

        A missing slot has no voltages and no ground.
        """
        s, n = self.slots, len(volts)
        if number is None:
            whole, rest = divmod(n, s)
            if rest:
                self.mended += (f"the last {rest} slots make no whole scan: left out",)
            place = np.arange(whole * s)
            numbers = np.arange(whole)
        else:
            own = number - number[0]
            scan = own // s
            there = np.unique(scan)
            place = np.searchsorted(there, scan) * s + own % s
            steps = np.diff(there)
            lost = np.flatnonzero(steps > 1)
            self.gaps = np.stack([there[lost] + 1, steps[lost] - 1], 1).astype(int)
            whole, numbers = len(there), there
        require(whole > 0, "v", f"{n} slots", f"{s}, a scan")
        kept = slice(len(place))
        v = np.full((whole * s, self.electrodes), np.nan, np.float32)
        v[place], g = volts[kept], np.full(whole * s, -1)
        g[place] = ground[kept]
        self.scans = whole
        times = numbers * s / self.rig.f_switch
        if t is not None:
            slot = np.full(whole * s, np.nan)
            slot[place] = t[kept] - (place % s) / self.rig.f_switch
            # A scan whose first slot is lost begins as its others tell.
            each = slot.reshape(whole, s)
            times = each[np.arange(whole), np.isfinite(each).argmax(1)]
        self.t0 = times
        self._scans = Scans(v.reshape(whole, s, -1), g.reshape(whole, s), times)
        return numbers

    def read(self, start: int, stop: int) -> Scans:
        return self._scans.part(start, stop)


def _in_order(
    volts: Float[np.ndarray, "n M"],
    ground: Integer[np.ndarray, " n"],
    t: Float[np.ndarray, " n"] | None,
    number: Integer[np.ndarray, " n"] | None,
) -> tuple[Integer[np.ndarray, " k"], tuple[str, ...]]:
    """Returns which slots to take, in order; and sentences on those sent twice or late.

    Numbers put slots in order. Without numbers, a slot that has the time, the ground and
    the readings of the slot before was sent twice.
    **Raises:** `ValueError` for one number of slots that differ: the count began anew.
    """
    n = len(volts)
    order, key = np.arange(n), t if number is None else number
    if key is None:
        return order, ()
    if number is not None:
        order = np.argsort(number, kind="stable")
    at, before = order[1:], order[:-1]
    same = key[at] == key[before]
    twice, alike = np.flatnonzero(same), np.zeros(n - 1, bool)
    at, before = at[twice], before[twice]
    equal = (volts[at] == volts[before]) | np.isnan(volts[at])
    alike[twice] = equal.all(1) & (ground[at] == ground[before])
    differ = "number", "one number of slots that differ", "a slot's own, each higher"
    require(number is None or alike[same].all(), *differ)
    order = order[np.concatenate([[True], ~alike])]
    late = int((np.diff(order) < 0).sum())
    said = (f"slots sent twice: {n - len(order)}; each counts once",) * bool(alike.any())
    return order, said + (f"slots out of order: {late}; they are put in order",) * (
        late > 0
    )


def _rate(t: np.ndarray | None) -> float | None:
    """Computes slots a second from the slots' times."""
    if t is None or len(t) < 2:
        return None
    step = float(np.nanmedian(np.diff(t)))
    return 1 / step if step > 0 else None


def _slots(
    told: dict, ground: np.ndarray, number: np.ndarray | None
) -> tuple[int, tuple[str, ...]]:
    """Returns the slots of a scan, as described, or by the period of the grounds."""
    if "slots" in told:
        return slots_of(told["slots"]), ()
    n = len(ground)
    own = np.arange(n) if number is None else number - number[0]  # lost slots count
    for period in range(1, min(_LONGEST, n // 2) + 1):
        if _repeats(ground[:_LONGEST], own[:_LONGEST] % period):
            if _repeats(ground, own % period):
                return period, (f"a scan is {period} slots, the period of the grounds",)
    expected = "the slots of a scan, such as slots=10 in a file .toml beside or --layout"
    raise ValueError(f"slots: got none, expected {expected}; grounds have no period")


def _repeats(ground: np.ndarray, place: np.ndarray) -> bool:
    """Tells whether each place of a scan has one ground alone, and some place has two."""
    each = np.zeros(place.max() + 1, ground.dtype)
    each[place] = ground
    return len(place) > len(each) and bool((each[place] == ground).all())
