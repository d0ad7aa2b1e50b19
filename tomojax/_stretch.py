"""A stretch of a file: rows between two times, counted from the file's first row."""

from bisect import bisect_left
from functools import partial
from typing import Any

from tomojax._require import require

# A row's time less the first's is rounded, s; no clock of a rig tells as little.
_SLACK = 1e-9


def stretch_of(t: Any, since: float | None, until: float | None) -> tuple[int, int]:
    """Finds rows with since ≤ t − t[0] < until: first, one after the last; `t` rises, s.

    `t` is an array, or gives times by their numbers: only a few are asked for.
    **Raises:** `ValueError` where no row lies there.
    """
    begin = float(t[0])
    place = partial(bisect_left, t, key=lambda one: float(one) - begin)
    start, stop = 0, len(t)
    held = f"a stretch of the file, which holds 0 to {float(t[-1]) - begin:.6g} s"
    if since is not None:
        start = place(since - _SLACK)
        require(0 <= since and start < stop, "from", f"{since:g} s", held)
    if until is not None:
        stop = place(until - _SLACK)
        require(stop > start, "to", f"{until:g} s", f"more than from; {held}")
    return start, stop
