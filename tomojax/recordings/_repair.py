"""Repairs a recording that only a person can put right."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tomojax._require import require
from tomojax._whole import whole
from tomojax.recordings._chunks import CHUNK_SLOTS, Progress
from tomojax.recordings._hdf5 import Hdf5Recording
from tomojax.recordings._head import attributes, write_attributes


def repair_recording(
    recording: Hdf5Recording,
    out: Path | str,
    scans: tuple[int, int] | None = None,
    channels: Sequence[int] | None = None,
    grounds: Sequence[int] | None = None,
    join: int = 1,
    progress: Progress = lambda done, total: None,
) -> Path:
    """Writes a recording, put right, as a new file; the old file stays unchanged.

    **Arguments:** `recording`: opened with its right `header`, see `open_recording`; the
    reader has put the times right. `scans`: the first scan to keep, and the scan behind the
    last. `channels` (M,): the electrode that each channel reads. `grounds` (M,): the
    electrode that each line switches (−1: none). `check` writes `channels` and `grounds`.
    `join`: so many scans become one, as the single slots that a rig sends. A scan with a
    lost part is left out, and counted as lost. Codes are copied, not rounded again.
    **Raises:** `ValueError` for arguments that do not fit; `OSError` for a full disk.

    **Example:**

    >>> from pathlib import Path
    >>> import tomojax as tx
    >>> path = Path(tx.__file__).with_name("demo.h5")
    >>> with tx.open_recording(path, header={"f_switch": 5000.0}) as recording:
    ...     out = tx.recordings.repair_recording(recording, "sound.h5", scans=(0, 10))
    >>> with tx.open_recording(out) as sound:
    ...     sound.scans, sound.rig.f_switch
    (10, 5000.0)
    """
    require(
        isinstance(recording, Hdf5Recording), "recording", type(recording), "one in HDF5"
    )
    first, last = (0, recording.scans) if scans is None else scans
    inside = 0 <= first < last <= recording.scans
    require(inside, "scans", f"{first}:{last}", f"a part of 0:{recording.scans}")
    m = recording.electrodes
    back = np.arange(m)
    if channels is not None:
        back = np.argsort(channels)
        fits = sorted(channels) == list(range(m))
        require(fits, "channels", list(channels)[:8], f"each of 0 to {m - 1} once")
    lines = np.arange(m)
    if grounds is not None:
        lines = np.asarray(grounds)
        fits = lines.shape == (m,) and ((lines >= -1) & (lines < m)).all()
        require(fits, "grounds", list(grounds)[:8], f"{m} electrodes, or -1")
    require(join >= 1, "join", join, "1 or more")
    starts, gaps = _starts(recording, first, last, join)
    require(len(starts), "join", join, "so many scans in a row, of which none is lost")
    total, together = len(starts), np.arange(join)
    with whole(Path(out)) as part, h5py.File(part, "w") as file:
        write_attributes(file, _told(recording, join))
        shape = total, join * recording.slots
        packed: dict[str, Any] = {"compression": "gzip", "shuffle": True}
        v = file.create_dataset("v", (*shape, m), recording.code_type, **packed)
        ground = file.create_dataset("ground", shape, "u1" if m < 255 else "u2", **packed)
        t0 = file.create_dataset("t0", total, "f8")
        file["gaps"] = gaps
        _mark(file, recording, first, last)
        each = max(1, CHUNK_SLOTS // shape[1])
        for begin in range(0, total, each):
            rows = slice(begin, min(begin + each, total))
            some = starts[rows]
            low, high = int(some[0]), int(some[-1]) + join
            at = (some - low)[:, None] + together
            codes, asked = (a[at] for a in recording.read_codes(low, high))
            asked = asked.reshape(len(some), -1)
            known = (asked >= 0) & (asked < m)
            switched = np.where(known, lines[np.where(known, asked, 0)], asked)
            # A line that switches none is no electrode: the slot says so of itself.
            none = np.iinfo(ground.dtype).max
            v[rows] = codes.reshape(*asked.shape, m)[..., back]
            ground[rows] = np.where((switched < 0) | (switched > none), none, switched)
            t0[rows] = recording.t0[some]
            progress(rows.stop, total)
    return Path(out)


def _told(recording: Hdf5Recording, join: int) -> dict[str, Any]:
    joined = (f"each {join} scans joined",) if join > 1 else ()
    said = "; ".join((f"repaired from {recording.path.name}", *joined, *recording.mended))
    told = attributes(recording.rig, *recording.codes_to_volts)
    return told | {"notes": "\n".join(filter(None, (recording.rig.notes, said)))}


def _mark(file: h5py.File, recording: Hdf5Recording, first: int, last: int) -> None:
    """Keeps the marks of the kept scans; keeps all marks where all scans are kept."""
    t = recording.t0[first:last]
    low = -np.inf if first == 0 else t[0]
    high = np.inf if last == recording.scans else t[-1] + recording.interval
    kept = [(moment, text) for moment, text in recording.marks if low <= moment < high]
    if kept:
        file["marks_t"] = np.array([moment for moment, _ in kept], float)
        file["marks"] = np.array([text.encode() for _, text in kept], "S")
    if len(recording.host_time):
        file["host_time"] = recording.host_time


def _starts(
    recording: Hdf5Recording, first: int, last: int, join: int
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the row of each new scan's first part, and the gaps by the new numbers."""
    gone = recording.lost_before()
    gone[first] = 0  # what was lost before the first kept scan
    rows = np.arange(first, last)
    # Lost parts have numbers too: a rig goes on in its pattern while they are lost.
    number = rows - first + np.cumsum(gone[first:last])
    begins = np.flatnonzero(number % join == 0)
    begins = begins[begins + join <= len(rows)]
    begins = begins[number[begins + join - 1] == number[begins] + join - 1]
    end = number[-1] + 1 + gone[last]
    lost = np.diff(np.append(number[begins], end) // join, prepend=-1) - 1
    after = np.flatnonzero(lost)
    # A gap's number counts the scans lost before it.
    before = np.cumsum(lost)[after] - lost[after]
    return rows[begins], np.stack([after + before, lost[after]], 1).astype(np.int64)
