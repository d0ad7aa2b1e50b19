"""How fields of results are called in tables: columns, dimensions, names of flags."""

import numpy as np

from tomojax.kernels.flags import Flag

# Fields that a flat table has no columns for.
IMAGES = ("image", "residual_by_electrode", "touch", "image_deviation")

# Dimensions of a field's row: of each contact, of images, of electrodes.
DIMENSIONS = {
    "image": ("x", "y"),
    "touch": ("fine_x", "fine_y"),
    "image_deviation": ("fine_x", "fine_y"),
    "residual_by_electrode": ("electrode",),
    "contact_covariance": ("contact", "moment"),
}

# Units as they stand in a column's name.
_UNITS = {"m^2": "m2", "1": ""}

# Of fields with several numbers for each contact.
_PARTS = {
    "contact_xy": ("x", "y"),
    "contact_covariance": ("covariance_xx", "covariance_yy", "covariance_xy"),
}


def label(*parts: str, unit: str) -> str:
    """Returns a column's name with its unit: residual_V, contact1_x_m."""
    return "_".join(filter(None, (*parts, _UNITS.get(unit, unit))))


def parts_of(name: str) -> tuple[str, ...]:
    """Returns what the numbers of a contact's field are called."""
    return _PARTS.get(name, (name.removeprefix("contact_"),))


def flag_names(flags: np.ndarray) -> np.ndarray:
    """Names with a bar between, for each row; few combinations occur."""
    values, which = np.unique(flags, return_inverse=True)
    names = ["|".join(str(f.name) for f in Flag if int(v) & f.value) for v in values]
    return np.array(names, object)[which]
