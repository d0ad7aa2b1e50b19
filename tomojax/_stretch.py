"""A stretch of a file: rows between two times, counted from the file's first row."""

import numpy as np
from jaxtyping import Float

from tomojax._require import require

# A row's time less the first's is rounded, s; no clock of a rig tells as little.
_SLACK = 1e-9


def stretch_of(
    t: Float[np.ndarray, " n"], since: float | None, until: float | None
) -> tuple[int, int]:
    """Finds rows with since ≤ t − t[0] < until: first, one after the last; `t` rises, s.

    **Raises:** `ValueError` where no row lies there.
    """
    start, stop = 0, len(t)
    length = float(t[-1] - t[0])
    held = f"a stretch of the file, which holds 0 to {length:.6g} s"
    if since is not None:
        start = int(np.searchsorted(t - t[0], since - _SLACK, "left"))
        require(0 <= since and start < stop, "from", f"{since:g} s", held)
    if until is not None:
        stop = int(np.searchsorted(t - t[0], until - _SLACK, "left"))
        require(stop > start, "to", f"{until:g} s", f"more than from; {held}")
    return start, stop
