"""Writes NetCDF-4 for xarray, after the CF conventions: named dimensions, units, flags."""

from pathlib import Path
from typing import Any

import numpy as np

from tomojax._whole import whole
from tomojax.exports._columns import event_columns
from tomojax.exports._source import plain, Progress, Source, WORDS
from tomojax.kernels.flags import Flag
from tomojax.results.loading import coordinates, Variable, variables


def write(source: Source, out: Path, progress: Progress) -> None:
    """Writes one file: rows along `t`, events along `event`."""
    import h5netcdf

    told = [v for n in source.names for v in variables(n, 1 + len(source.shape(n)))]
    told.sort(key=lambda variable: variable.field == "contact_xy")  # these stand last
    sizes = {"t": source.rows, "contact": source.contacts}
    for variable in told:
        sizes |= dict(zip(variable.dimensions[1:], source.shape(variable.field)))
    with whole(out) as part, h5netcdf.File(part, "w") as file:
        attributes = plain(source.attributes)
        attributes.pop("electrode_xy", None)  # are coordinates
        for name, value in attributes.items():  # an attribute is no list
            file.attrs[name] = np.array(value) if isinstance(value, list) else value
        file.attrs["Conventions"] = "CF-1.11"
        file.dimensions = sizes
        made = [_make(file, source, variable) for variable in told]
        places = coordinates(sizes, source.size, lambda: source.electrode_xy)
        for name, (dimension, values) in places.items():
            _variable(file, name, (dimension,), "f8", "m")[:] = values
        at = 0
        for block in source.blocks(source.names, progress):
            end = at + len(block["t"])
            for variable, place in zip(told, made):
                place[at:end] = block[variable.field][variable.part]
            at = end
        _events(file, source)


def _make(file: Any, source: Source, told: Variable) -> Any:
    kind = source.kind(told.field)
    made = _variable(file, told.name, told.dimensions, kind, source.unit(told.field))
    if told.name == "flags":
        made.attrs["flag_masks"] = np.array([f.value for f in Flag], kind)
        made.attrs["flag_meanings"] = " ".join(str(f.name) for f in Flag)
    return made


def _variable(file: Any, name: str, dimensions: tuple, kind: Any, unit: str) -> Any:
    made = file.create_variable(name, dimensions, kind)
    made.attrs["units"] = unit
    if name in WORDS:
        made.attrs["long_name"] = WORDS[name]
    return made


def _events(file: Any, source: Source) -> None:
    import h5py

    table = event_columns(source.events())
    file.dimensions["event"] = len(table["t_s"])
    for label, values in table.items():
        name, _, unit = label.partition("_")
        name = "event_kind" if name == "event" else f"event_{name}"
        text = values.dtype == object
        kind = h5py.string_dtype() if text else values.dtype
        made = _variable(file, name, ("event",), kind, unit or "1")
        if len(values):
            made[:] = values
