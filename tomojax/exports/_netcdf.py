"""Writes NetCDF-4 for xarray, after the CF conventions: named dimensions, units, flags."""

from pathlib import Path
from typing import Any

import numpy as np

from tomojax._whole import whole
from tomojax.exports._columns import event_columns
from tomojax.exports._source import plain, Progress, Source, WORDS
from tomojax.kernels.flags import Flag
from tomojax.results.loading import DIMENSIONS


def write(source: Source, out: Path, progress: Progress) -> None:
    """Writes one file: rows along `t`, events along `event`."""
    import h5netcdf

    # NetCDF has no place for two numbers of a contact but a dimension of its own.
    fields = {name: name for name in source.names if name != "contact_xy"}
    with whole(out) as part, h5netcdf.File(part, "w") as file:
        attributes = plain(source.attributes)
        electrodes = attributes.pop("electrode_xy", None)
        file.attrs.update({n: _fit(v) for n, v in attributes.items()})
        file.attrs["Conventions"] = "CF-1.11"
        file.dimensions = {"t": source.rows, "contact": source.contacts}
        made = {name: _make(file, source, name) for name in fields}
        places = [
            _variable(file, f"contact_{axis}", ("t", "contact"), "f4", "m") for axis in "xy"
        ]
        _grids(file, source)
        if electrodes is not None and "electrode" in file.dimensions:
            for axis, values in zip("xy", np.asarray(electrodes).T):
                _variable(file, f"electrode_{axis}", ("electrode",), "f8", "m")[:] = values
        at = 0
        for block in source.blocks(source.names, progress):
            end = at + len(block["t"])
            for name, variable in made.items():
                variable[at:end] = block[name]
            for axis, variable in enumerate(places):
                variable[at:end] = block["contact_xy"][..., axis]
            at = end
        _events(file, source)


def _make(file: Any, source: Source, name: str) -> Any:
    shape = source.shape(name)
    dimensions = DIMENSIONS.get(name, ("contact",) * len(shape))
    for dimension, size in zip(dimensions, shape):
        if dimension not in file.dimensions:
            file.dimensions[dimension] = size
    kind = source.kind(name)
    made = _variable(file, name, ("t", *dimensions), kind, source.unit(name))
    if name == "flags":
        made.attrs["flag_masks"] = np.array([f.value for f in Flag], kind)
        made.attrs["flag_meanings"] = " ".join(str(f.name) for f in Flag)
    return made


def _variable(file: Any, name: str, dimensions: tuple, kind: Any, unit: str) -> Any:
    made = file.create_variable(name, dimensions, kind)
    made.attrs["units"] = unit
    if name in WORDS:
        made.attrs["long_name"] = WORDS[name]
    return made


def _grids(file: Any, source: Source) -> None:
    """Writes the centres of pixels."""
    for name, axes in (("image", ("x", "y")), ("touch", ("fine_x", "fine_y"))):
        if name in source.names:
            for axis, values in zip(axes, source.pixels(name)):
                _variable(file, axis, (axis,), "f8", "m")[:] = values


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


def _fit(value: Any) -> Any:
    """Turns a list into an array, as NetCDF's attributes need."""
    return np.array(value) if isinstance(value, list) else value
