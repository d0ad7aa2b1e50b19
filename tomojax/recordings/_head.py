"""Writes what a recording says of its rig, and reads that back from a mapping."""

from typing import Any

import h5py
import numpy as np

from tomojax.recordings._described import rails_of
from tomojax.recordings._outline import Outline
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
    tables = {name: np.asarray(rows) for name, rows in told.get("tables", {}).items()}
    scale = float(told["scale"])
    return Rig(
        **{name: float(told[name]) for name in PAPER},  # pyright: ignore
        size=tuple(told["size"]),
        electrode_xy=np.asarray(told["electrode_xy"], float),
        rails=rails_of(np.dtype(np.int16), scale, told["offset"]),
        resolution=abs(scale),
        outline=Outline.read(told, tables.get),
        conditions=tables.get("conditions/to_ground"),
    )
