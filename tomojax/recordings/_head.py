"""Writes what a recording says of its rig, and reads that back from a mapping."""

from typing import Any

import h5py
import numpy as np

from tomojax.recordings import _described
from tomojax.recordings._recording import PAPER, Rig, SCHEMA


def attributes(rig: Rig, scale: float, offset: float) -> dict[str, Any]:
    """Returns the attributes of a recording, and its tables as lists."""
    tables = {name: table.tolist() for name, table in rig.tables().items()}
    return {
        "schema": SCHEMA,
        "schema_version": rig.version,
        **{name: getattr(rig, name) for name in PAPER},
        "size": list(rig.size),
        "scale": scale,
        "offset": offset,
        # The rig does not tell these.
        "settle_delay": float("nan"),
        "convert_period": float("nan"),
        "units": "V",
        "notes": rig.notes,
        **({} if rig.outline is None else rig.outline.attributes()),
        "electrode_xy": np.asarray(rig.electrode_xy, float).tolist(),
        **({"tables": tables} if tables else {}),
    }


def write_attributes(file: h5py.File, told: dict[str, Any]) -> None:
    """Writes attributes, and the tables among them, into a recording in the making."""
    names = dict(told)
    tables = names.pop("tables", {}) | {"electrode_xy": names.pop("electrode_xy")}
    for name, rows in tables.items():
        file[name] = np.asarray(rows, float)
    file.attrs.update(names)


def rig_of(told: dict[str, Any]) -> Rig:
    """Returns the rig that a recording's attributes describe."""
    tables = told.get("tables", {})
    named = {name.removeprefix("conditions/"): rows for name, rows in tables.items()}
    count = len(told["electrode_xy"])
    return _described.rig_of(told | named, count, np.dtype(np.int16))[0]
