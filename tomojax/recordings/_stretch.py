"""Makes a stretch of a recording a recording itself."""

from collections.abc import Callable
from functools import partial

import numpy as np

from tomojax._require import naming
from tomojax._stretch import stretch_of
from tomojax.recordings._recording import Recording, Scans


class Stretch(Recording):
    """Scans of another recording between two times; see `between`."""

    def __init__(self, whole: Recording, start: int, stop: int):
        self._whole, self._start = whole, start
        if whole.opener is not None:
            self.opener = partial(_again, whole.opener, start, stop)
        self.path, self.rig = whole.path, whole.rig
        self.slots, self.electrodes = whole.slots, whole.electrodes
        self.scans, self.stretch = stop - start, (start, stop)
        self.mended, self.marks = whole.mended, whole.marks
        self.host_time = whole.host_time
        self.interval = whole.interval
        self.t0, self.retimed = whole.t0[start:stop], whole.retimed[start:stop]
        rows = whole.rows_after_gaps()
        lost = whole.gaps[:, 1]
        # Scans lost before the first one are none of the stretch's.
        inside = (rows > start) & (rows <= stop)
        before = np.cumsum(lost[inside]) - lost[inside]
        self.gaps = np.stack([rows[inside] - start + before, lost[inside]], 1).astype(int)

    def read(self, start: int, stop: int) -> Scans:
        stop = min(stop, self.scans)
        return self._whole.read(self._start + start, self._start + stop)

    def digest(self) -> str:
        """Computes the SHA-256 of the whole file."""
        return self._whole.digest()

    def close(self) -> None:
        self._whole.close()


def between(recording: Recording, since: float | None, until: float | None) -> Recording:
    """Returns the scans that start in a stretch of time; without one, the recording itself.

    **Arguments:** `since` and `until` s after the first scan; None: the recording's ends.
    **Raises:** `ValueError` where no scan starts in the stretch.

    **Example:**

    >>> from pathlib import Path
    >>> import tomojax as tx
    >>> path = Path(tx.__file__).with_name("demo.h5")  # comes with the package
    >>> with tx.open_recording(path) as recording:
    ...     part = tx.recordings.between(recording, 0.2, 0.6)
    ...     print(recording.scans, part.scans, part.read(0, 1).t0)
    200 40 [0.2]
    """
    if since is None and until is None:
        return recording
    with naming(recording.path):
        start, stop = stretch_of(recording.t0, since, until)
    return Stretch(recording, start, stop)


def _again(opener: Callable[[], Recording], start: int, stop: int) -> Stretch:
    return Stretch(opener(), start, stop)
