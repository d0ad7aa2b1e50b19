"""Repairs a recording that only a person can put right."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tomojax._require import require
from tomojax._whole import whole
from tomojax.recordings._chunks import CHUNK_SLOTS
from tomojax.recordings._hdf5 import Hdf5Recording
from tomojax.recordings._recording import SCHEMA, VERSION


def repair_recording(
    recording: Hdf5Recording,
    out: Path | str,
    scans: tuple[int, int] | None = None,
    channels: Sequence[int] | None = None,
    grounds: Sequence[int] | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Writes a recording, put right, as a new file; the old file stays unchanged.

    **Arguments:** `recording`: opened with its right `header`, see `open_recording`; the
    reader has put the times right. `scans`: the first scan to keep, and the scan behind the
    last. `channels` (M,): the electrode that each channel reads. `grounds` (M,): the
    electrode that each line switches (−1: none). `check` writes `channels` and `grounds`.
    Codes are copied, not rounded again.
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
    total = last - first
    with whole(Path(out)) as part, h5py.File(part, "w") as file:
        _describe(file, recording)
        shape = total, recording.slots
        packed: dict[str, Any] = {"compression": "gzip", "shuffle": True}
        v = file.create_dataset("v", (*shape, m), recording.code_type, **packed)
        ground = file.create_dataset("ground", shape, "u1" if m < 255 else "u2", **packed)
        t0 = file.create_dataset("t0", total, "f8")
        file["gaps"] = _gaps(recording, first, last)
        _mark(file, recording, first, last)
        each = max(1, CHUNK_SLOTS // recording.slots)
        for start in range(first, last, each):
            stop = min(start + each, last)
            codes, asked = recording.read_codes(start, stop)
            known = (asked >= 0) & (asked < m)
            switched = np.where(known, lines[np.where(known, asked, 0)], asked)
            # A line that switches none is no electrode: the slot says so of itself.
            none = np.iinfo(ground.dtype).max
            rows = slice(start - first, stop - first)
            v[rows] = codes[..., back]
            ground[rows] = np.where((switched < 0) | (switched > none), none, switched)
            t0[rows] = recording.times(start, stop)
            progress(stop - first, total)
    return Path(out)


def _describe(file: h5py.File, recording: Hdf5Recording) -> None:
    rig = recording.rig
    names = "f_switch", "drive_voltage", "ground_resistance", "sheet_resistance"
    file.attrs.update({name: getattr(rig, name) for name in names})
    said = "; ".join((f"repaired from {recording.path.name}", *recording.mended))
    scale, offset = recording.codes_to_volts
    file.attrs.update(
        schema=SCHEMA,
        schema_version=VERSION,
        scale=scale,
        offset=offset,
        size=list(rig.size),
        electrode_diameter=rig.electrode_diameter,
        settle_delay=np.nan,
        convert_period=np.nan,
        units="V",
        notes="\n".join(filter(None, (rig.notes, said))),
    )
    file["electrode_xy"] = np.asarray(rig.electrode_xy, float)


def _mark(file: h5py.File, recording: Hdf5Recording, first: int, last: int) -> None:
    """Keeps the marks of the kept scans; keeps all marks where all scans are kept."""
    t = recording.times(first, last)
    low = -np.inf if first == 0 else t[0]
    high = np.inf if last == recording.scans else t[-1] + recording.interval
    kept = [(moment, text) for moment, text in recording.marks if low <= moment < high]
    if kept:
        file["marks_t"] = np.array([moment for moment, _ in kept], float)
        file["marks"] = np.array([text.encode() for _, text in kept], "S")


def _gaps(recording: Hdf5Recording, first: int, last: int) -> np.ndarray:
    """Returns the gaps between the kept scans, by the new file's scan numbers."""
    rows, found, lost = recording.rows_after_gaps(), [], 0
    for row, gone in zip(rows.tolist(), recording.gaps[:, 1].tolist()):
        if first < row <= last:
            found.append((row - first + lost, gone))
            lost += gone
    return np.array(found, np.int64).reshape(-1, 2)
