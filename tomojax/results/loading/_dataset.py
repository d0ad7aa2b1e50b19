"""Makes Datasets of xarray: of results, and of the rows of a Dataset of voltages."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from tomojax._require import library, require
from tomojax.methods import fields_of_rows
from tomojax.results.loading._labels import coordinates, variables

_NEEDED = "time", "slot", "electrode"


def dataset(
    columns: Iterable[tuple[str, np.ndarray, str]],
    told: dict[str, Any],
    size: np.ndarray,
    electrode_xy: Callable[[], np.ndarray] | None = None,
) -> Any:
    """Makes a Dataset of fields (name, values, unit), with `told` as its attributes."""
    found: dict[str, Any] = {}
    for name, values, unit in columns:
        for one in variables(name, values.ndim):
            found[one.name] = (one.dimensions, values[one.part], {"units": unit})
    made = library("xarray", "tables").Dataset(found, attrs=told)
    places, metres = coordinates(made.sizes, size, electrode_xy), {"units": "m"}
    return made.assign_coords(
        {name: (dimension, at, metres) for name, (dimension, at) in places.items()}
    )


def apply(data: Any, method: Any, **options: Any) -> Any:
    """Returns the rows of a Dataset of voltages as a Dataset.

    Voltages in chunks of Dask along `time` stay lazy: each chunk is a task. xarray is an
    extra, `tomojax[tables]`.

    **Arguments:** `data` has `voltages` (time, slot, electrode), V, and `ground` (slot) or
    (time, slot); NaN are voltages that are not used. `options` are those of `Batch`.
    **Raises:** `ValueError` as `Batch`, and for a variable or dimension that is missing.

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> import xarray as xr
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> volts = np.asarray(tx.voltages(sensor, tx.Disc([0.03, 0.05], 0.006, 1.0), [0, 15]))
    >>> voltages = ("time", "slot", "electrode"), np.stack([volts, 0 * volts])
    >>> data = xr.Dataset({"voltages": voltages, "ground": ("slot", [0, 15])})
    >>> rows = tx.results.apply(data, tx.method(sensor, "points"), contacts=1)
    >>> print(1e3 * rows.contact_x.values.round(3).ravel(), rows.contact_x.units)
    [30. nan] m
    """
    from tomojax.methods import Batch  # imports JAX: files are read without

    for name in ("voltages", "ground"):
        require(name in data, name, sorted(map(str, data)), f"a variable {name}")
    missing = sorted(set(_NEEDED) - set(data.voltages.dims))
    require(not missing, "voltages", data.voltages.dims, f"dimensions {_NEEDED}")
    data = data[["voltages", "ground"]]
    if data.voltages.chunks is not None:
        one = apply(data.isel(time=slice(0, 1)).compute(), method, **options)
        whole = one.chunk().isel(time=np.zeros(data.sizes["time"], int))
        whole = whole.chunk(time=data.chunksizes["time"]).assign_coords(
            {name: c for name, c in data.coords.items() if c.dims == ("time",)}
        )
        given = data.chunk(slot=-1, electrode=-1), (method,), options
        blocks = library("xarray", "tables").map_blocks
        return blocks(apply, given[0], args=given[1], kwargs=given[2], template=whole)
    volts = data.voltages.transpose(*_NEEDED)
    grounds = data.ground.broadcast_like(volts.isel(electrode=0)).transpose(*_NEEDED[:2])
    rows = Batch(method, **options)(volts.values, grounds.values)
    fields = fields_of_rows()
    columns = [
        (name, values, fields[name].unit or method.image_unit)
        for name, values in rows._asdict().items()
        if values is not None
    ]
    size = np.asarray(method.cell) * method.shape
    return (
        dataset(columns, {}, size)
        .rename(t="time")
        .assign_coords({name: c for name, c in data.coords.items() if c.dims == ("time",)})
    )
