"""Describes a recording, for `tomojax info`."""

from datetime import datetime, UTC
from pathlib import Path

import numpy as np

from tomojax.kernels.flags import Flag
from tomojax.recordings._chunks import CHUNK_SLOTS, Progress, read_chunk
from tomojax.recordings._recording import Recording

_CHANNELS = 20  # that are not used, and told
_STRETCHES = 5  # of a fault, that are told


def summary(recording: Recording) -> dict:
    """Describes the recording's shape and rig, with units in the keys."""
    rig = recording.rig
    grounds = recording.read(0, 1).grounds[0]
    seconds = float(recording.t0[-1] - recording.t0[0] + recording.interval)
    return {
        "scans": recording.scans,
        "slots": recording.slots,
        "electrodes": recording.electrodes,
        "f_switch_Hz": rig.f_switch,
        "duration_s": seconds,
        "first_pattern": grounds.tolist(),
        "scans_lost": int(recording.gaps[:, 1].sum()),
        "drive_V": rig.drive_voltage,
        "range_V": [float(f"{r:.6g}") for r in rig.rails],
        "sheet_resistance_ohm": rig.sheet_resistance,
        "ground_resistance_ohm": rig.ground_resistance,
        "size_m": list(rig.size),
        "electrode_diameter_m": rig.electrode_diameter,
        "notes": rig.notes,
        "mended": list(recording.mended),
        "marks_s": [[t, text] for t, text in recording.marks],
    } | _began(recording)


def _began(recording: Recording) -> dict[str, str]:
    """Tells when the recording began by the host's clock, where it knows."""
    if not len(recording.host_time):
        return {}
    try:
        moment = datetime.fromtimestamp(float(recording.on_host(recording.t0[0])), UTC)
    except (OSError, OverflowError, ValueError):  # a time that no calendar has
        return {}
    return {"began": moment.isoformat(timespec="milliseconds")}


def faults(
    recording: Recording, progress: Progress = lambda done, total: None
) -> list[dict]:
    """Lists each kind of fault: the number of scans, their places, and the channels."""
    size = max(1, CHUNK_SLOTS // 4 // recording.slots)
    starts = range(0, recording.scans, size)
    flags = np.zeros(recording.scans, np.uint32)
    silent = np.zeros(recording.electrodes, int)
    for k, start in enumerate(starts):
        stop = min(start + size, recording.scans)
        chunk = read_chunk(recording, start, stop)
        flags[start:stop] = chunk.flags
        # Channels that are out while others of their slot are in use.
        used = chunk.good.any(-1, keepdims=True)
        silent += (used & ~chunk.good).any(1).sum(0)
        progress(k + 1, len(starts))
    rows = []
    for flag in Flag:
        where = np.flatnonzero(flags & flag.value)
        if where.size:
            found = {"fault": flag.name, "scans": int(where.size), "where": _runs(where)}
            rows.append(found)
    worst = np.argsort(-silent, kind="stable")[: np.count_nonzero(silent)]
    for channel in worst[:_CHANNELS]:
        told = f"channel {channel} not used"
        rows.append({"fault": told, "scans": int(silent[channel]), "where": []})
    if len(worst) > _CHANNELS:
        told = f"{len(worst) - _CHANNELS} more channels not used in fewer scans"
        rows.append({"fault": told, "scans": None, "where": []})
    return rows


def _runs(where: np.ndarray) -> list[list[int]]:
    """Returns [first, last] of the first stretches of neighbours."""
    parts = np.split(where, np.flatnonzero(np.diff(where) > 1) + 1)
    return [[int(p[0]), int(p[-1])] for p in parts[:_STRETCHES]]


def text(path: Path, found: dict, rows: list[dict]) -> str:
    """Formats the description for people."""
    slots, alone = found["slots"], found["slots"] == 1
    held = "slots, each a scan of its own," if alone else f"scans of {slots} slots"
    lines = [
        f"{path}: can be read",
        f"  {found['scans']} {held} of {found['electrodes']} electrodes, "
        f"{found['duration_s']:.6g} s at {found['f_switch_Hz']:g} slots/s",
        f"  first scan grounds {found['first_pattern'][:12]}"
        + (" …" if found["slots"] > 12 else ""),
        f"  object at {found['drive_V']:g} V; sheet of "
        f"{found['sheet_resistance_ohm']:g} Ω/sq, "
        f"{1e3 * found['size_m'][0]:g} mm × {1e3 * found['size_m'][1]:g} mm; "
        f"readings from {found['range_V'][0]:g} to {found['range_V'][1]:g} V",
    ]
    if "began" in found:
        lines.append(f"  began at {found['began']} by the host's clock")
    if found["notes"]:
        lines.append(f"  notes: {found['notes']}")
    if found["scans_lost"]:
        lines.append(
            f"  {found['scans_lost']} scans lost; numbers below count those present"
        )
    lines += [f"  put right: {sentence}" for sentence in found["mended"]]
    lines += [f"  mark at {t:.6g} s: {said}".rstrip(": ") for t, said in found["marks_s"]]
    if not rows:
        lines.append("  no faults")
    for row in rows:
        where = ", ".join(f"{a}" if a == b else f"{a}–{b}" for a, b in row["where"])
        count = "" if row["scans"] is None else f": {row['scans']} scans"
        lines.append(f"  {row['fault']}{count}" + (f": {where}" if where else ""))
        flag = Flag.__members__.get(row["fault"])
        if flag is not None:
            lines.append(f"    {flag.explanation}")
    return "\n".join(lines)
