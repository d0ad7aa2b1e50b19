"""Reads results files in the making: their attributes, and where their datasets lie."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.files import open_container
from tomojax.results.loading._load import LoadedResults


def attributes(path: Path) -> dict[str, Any]:
    """Reads the attributes of a results file, or of a file in the making."""
    with LoadedResults(path) as opened:
        found = opened.attributes
    try:
        told = json.loads(found["configuration"])
    except (KeyError, TypeError, ValueError, RecursionError):
        told = None
    require(isinstance(told, dict), f"{path}: configuration", "none", "a run's")
    return found


def places(path: Path) -> dict[str, tuple[int, np.dtype, tuple[int, ...]]]:
    """Finds each dataset in a file in the making: offset, type, shape of a row.

    **Raises:** `ValueError` where a dataset is not in one piece, or overlaps another.
    """
    try:
        with open_container(path) as file:
            names = file.names
            found = {n: (file.place(n), file.dtype(n), file.shape(n)) for n in names}
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: not a results file: {error}") from None
    end = 0
    for place, kind, shape in sorted(found.values(), key=lambda one: one[0] or 0):
        apart, told = place is not None and place >= end, "not laid out by tomojax"
        require(apart, f"{path}: datasets", told, "one after the other")
        end = (place or 0) + kind.itemsize * int(np.prod(shape))
    return {n: (p or 0, kind, shape[1:]) for n, (p, kind, shape) in found.items()}
