"""Writes located presses as results, version 1."""

import json
from pathlib import Path

import numpy as np

from tomojax._environment import environment
from tomojax.ert._recording import PairRecording
from tomojax.ert._response import Located
from tomojax.kernels.flags import Flag, NO_ANSWER
from tomojax.methods import empty_rows, fields_of_rows
from tomojax.results import Dataset, write_rows


def write_results(
    recording: PairRecording,
    found: Located,
    out: Path,
    response: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Writes a row for each frame: place, covariance, strength, residual and flags.

    Places are as the recording has them. `contact_strength` is relative, and `residual`
    counts standard deviations. A row without a contact, or without an answer, has NaN.

    **Raises:** `ValueError` where OUT cannot be made, or is there already.
    """
    rows = empty_rows(len(found.xy), {"C": 1})
    there = found_contact(found)
    rows.contact_count[:] = there
    rows.contact_xy[there, 0] = found.xy[there]
    moments = found.covariance[:, [0, 1, 0], [0, 1, 1]]
    rows.contact_covariance[there, 0] = moments[there]
    rows.residual[:], rows.flags[:] = found.residual, found.flags
    units = {n: field.unit for n, field in fields_of_rows().items()} | {"residual": "1"}
    strength = np.where(there, found.strength, np.nan).astype(np.float32)[:, None]
    values = {"t": recording.t0, "contact_strength": strength}
    values |= {n: v for n, v in rows._asdict().items() if v is not None and n != "rung"}
    units |= {"t": "s", "contact_strength": "1"}
    columns = {n: (Dataset(v.shape, v.dtype.str, units[n]), v) for n, v in values.items()}
    origin = recording.origin
    lines = recording.outline.lines(recording.box)
    if not recording.outline.loops:
        lines = [line + origin for line in lines]
    told = {"calibration": response and str(response), "frames": len(found.xy)}
    attributes = {
        "method": "response" if response else "nominal",
        "rate": "scan",
        "kind": "conductivity",
        "size": recording.box,
        "origin": origin,
        "electrode_xy": recording.electrode_xy,
        "outline": json.dumps([line.tolist() for line in lines]),
        "recording": recording.path.name,
        "recording_sha256": recording.digest(),
        "versions": json.dumps(environment()),
        "configuration": json.dumps(told, sort_keys=True),
    }
    write_rows(out, columns, attributes, overwrite)


def found_contact(found: Located) -> np.ndarray:
    """Tells which frames have a contact and a place."""
    none = (found.flags & int(Flag.NO_CONTACT | NO_ANSWER)) > 0
    return ~none & np.isfinite(found.xy).all(1)
