"""How fields of results are called in tables: columns, dimensions, names of flags."""

from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from tomojax.kernels.flags import Flag

# Fields that a flat table has no columns for.
IMAGES = ("image", "residual_by_electrode", "touch", "image_deviation")

# Dimensions of a field's row where they are not of each contact alone.
_DIMENSIONS = {
    "image": ("x", "y"),
    "touch": ("fine_x", "fine_y"),
    "image_deviation": ("fine_x", "fine_y"),
    "residual_by_electrode": ("electrode",),
    "contact_covariance": ("contact", "moment"),
    "contact_xyz": ("contact", "space"),
    "contact_normal": ("contact", "space"),
}

# Units as they stand in a column's name.
_UNITS = {"m^2": "m2", "1": ""}

# Of fields with several numbers for each contact.
_PARTS = {
    "contact_xy": ("x", "y"),
    "contact_covariance": ("covariance_xx", "covariance_yy", "covariance_xy"),
    "contact_xyz": ("space_x", "space_y", "space_z"),
    "contact_normal": ("normal_x", "normal_y", "normal_z"),
}

# What tells how strong contacts are, the best first: factor and words for pictures.
_STRENGTHS = {
    "contact_force": (1.0, "force, N"),
    "contact_strength": (1.0, "strength"),
    "contact_conductance": (1e6, "conductance, µS"),
}


def strength(names: Collection[str]) -> tuple[str, float, str]:
    """Returns the field that tells how strong contacts are, its factor and its words."""
    name = next((n for n in _STRENGTHS if n in names), "contact_conductance")
    return name, *_STRENGTHS[name]


def label(*parts: str, unit: str) -> str:
    """Returns a column's name with its unit: residual_V, contact1_x_m."""
    return "_".join(filter(None, (*parts, _UNITS.get(unit, unit))))


def parts_of(name: str) -> tuple[str, ...]:
    """Returns what the numbers of a contact's field are called."""
    return _PARTS.get(name, (name.removeprefix("contact_"),))


class Variable(NamedTuple):
    """A variable of NetCDF or xarray, and its part of a field."""

    name: str
    field: str
    part: tuple[Any, ...]  # an index of the field
    dimensions: tuple[str, ...]


def variables(field: str, axes: int) -> list[Variable]:
    """Returns the variables of a field with so many axes, rows among them.

    NetCDF has no place for two numbers of a contact but a dimension of its own.
    """
    if field == "contact_xy":
        each = enumerate(("contact_x", "contact_y"))
        return [Variable(n, field, (..., k), ("t", "contact")) for k, n in each]
    dimensions = _DIMENSIONS.get(field, ("contact",) * (axes - 1))
    return [Variable(field, field, (), ("t", *dimensions))]


def coordinates(
    sizes: Mapping[str, int],
    size: Float[np.ndarray, "2"],
    electrode_xy: Callable[[], Float[np.ndarray, "M 2"]] | None,
) -> dict[str, tuple[str, np.ndarray]]:
    """Returns the places of pixels and electrodes along the dimensions in `sizes`, m."""
    found = {}
    for axes in (("x", "y"), ("fine_x", "fine_y")):
        for axis, side in zip(axes, size):
            if axis in sizes:
                count = sizes[axis]
                found[axis] = axis, (np.arange(count) + 0.5) * side / count
    if "electrode" in sizes and electrode_xy is not None:
        for axis, places in zip("xy", electrode_xy().T):
            found[f"electrode_{axis}"] = "electrode", places
    return found


def flag_names(flags: np.ndarray) -> np.ndarray:
    """Names with a bar between, for each row; few combinations occur."""
    values, which = np.unique(flags, return_inverse=True)
    names = ["|".join(str(f.name) for f in Flag if int(v) & f.value) for v in values]
    return np.array(names, object)[which]
