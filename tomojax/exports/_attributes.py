"""Attributes of a results file as JSON and NetCDF can hold them."""

from typing import Any

import numpy as np


def plain(attributes: dict[str, Any]) -> dict[str, Any]:
    """Numbers, lists and texts; what JSON has no word for becomes text."""
    return {name: _plain(value) for name, value in attributes.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return value if isinstance(value, bool | int | float | str) else str(value)
