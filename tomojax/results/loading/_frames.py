"""Results as tables of other libraries: pandas and xarray."""

from typing import Any, TYPE_CHECKING

import numpy as np

from tomojax._require import library
from tomojax.methods import DOUBT, fields_of_rows
from tomojax.results.loading._labels import DIMENSIONS, flag_names, IMAGES, label, parts_of

if TYPE_CHECKING:
    from tomojax.results.loading._load import LoadedResults

_EXTRA = "tables"


def to_pandas(results: "LoadedResults") -> Any:
    """Returns a line for each contact of each row; a row without contacts keeps one.

    `contact` counts from 1 and is 0 in a row without; `doubt` says which to leave out.
    """
    pandas = library("pandas", _EXTRA)
    count = results.read("contact_count").astype(int)
    most = max(1, results.contacts)
    row, at = np.nonzero(np.arange(most) < np.maximum(count, 1)[:, None])
    table = {"row": row, "t_s": results.read("t")[row]}
    table["contact"] = np.where(count[row] > 0, at + 1, 0)
    whole = {}
    for name in _fields(results):
        if name in IMAGES or name == "t":
            continue
        values, unit = results.read(name), _unit(results, name)
        if values.ndim == 1:
            whole[label(name, unit=unit)] = values[row]
            continue
        columns = values[row, at].reshape(len(row), -1)
        for k, part in enumerate(parts_of(name)):
            table[label(part, unit=unit)] = columns[:, k]
    if "flags" in whole:
        whole["flag_names"] = flag_names(whole["flags"])
        whole["doubt"] = (whole["flags"] & int(DOUBT)) > 0
    return pandas.DataFrame(table | whole)


def to_xarray(results: "LoadedResults") -> Any:
    """Returns the variables of a NetCDF export, in memory."""
    xarray = library("xarray", _EXTRA)
    variables: dict[str, Any] = {}
    for name in _fields(results):
        values, about = results.read(name), {"units": _unit(results, name)}
        given = ("contact",) * (values.ndim - 1)
        dimensions = ("t", *DIMENSIONS.get(name, given))
        if name == "contact_xy":
            for k, axis in enumerate("xy"):
                place = ("t", "contact"), values[..., k], about
                variables[f"contact_{axis}"] = place
        else:
            variables[name] = (dimensions, values, about)
    made = xarray.Dataset(variables, attrs=_plain(results.attributes))
    metres = {"units": "m"}
    for x, y in (("x", "y"), ("fine_x", "fine_y")):
        for axis, side in zip((x, y), results.size()):
            if axis in made.sizes:
                n = made.sizes[axis]
                made = made.assign_coords({axis: (axis, _middles(n, side), metres)})
    if "electrode" in made.sizes:
        each = zip("xy", results.electrode_xy().T)
        places = {f"electrode_{a}": ("electrode", xy, metres) for a, xy in each}
        made = made.assign_coords(places)
    return made


def _fields(results: "LoadedResults") -> list[str]:
    """Returns datasets with an entry for each row, the usual ones first."""
    usual = ("t", *fields_of_rows())
    names = [name for name in usual if name in results.names]
    others = [name for name in results.names if name not in usual]
    return [n for n in names + others if results.shape(n)[:1] == (results.rows,)]


def _unit(results: "LoadedResults", name: str) -> str:
    return str(results.unit(name).get("unit", "1"))


def _middles(count: int, side: float) -> np.ndarray:
    return (np.arange(count) + 0.5) * side / count


def _plain(attributes: dict[str, Any]) -> dict[str, Any]:
    """Leaves out the places of electrodes, which are coordinates."""
    return {name: v for name, v in attributes.items() if name != "electrode_xy"}
