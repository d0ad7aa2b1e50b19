"""Lists the ladder's methods by name, and makes a method by its name."""

from importlib import import_module
from typing import Any

import numpy as np

from tomojax._programs import remembered
from tomojax._require import one_of, require, require_kind, require_whole
from tomojax.methods._contract import AbstractMethod
from tomojax.methods._maps import pixel_divisions
from tomojax.sensor import Calibration, Sensor


class _Methods(dict):
    """Methods by name; one that is told as "module:class" is imported when looked up."""

    def __getitem__(self, name: str) -> type:
        found = super().__getitem__(name)
        if not isinstance(found, str):
            return found
        module, _, kind = found.partition(":")
        return getattr(import_module(f"tomojax.methods.{module}"), kind)

    def get(self, name: str, default: Any = None) -> Any:
        return self[name] if name in self else default


METHODS: dict[str, type] = _Methods(
    auto="_auto:Auto",
    source="_source:Source",
    linear="_linear:Linear",
    points="points._points:Points",
    shape="shapes._image_shape:ImageShape",
)

# For each pitch: `source` reads a place around a peak, for which fewer are too few.
_PIXELS = 4


def method(
    sensor: Sensor,
    name: str = "source",
    grid: int | None = None,
    calibration: Calibration | None = None,
) -> AbstractMethod:
    """Makes the method of that name on an image of `grid` × `grid` pixels.

    Each side has four pixels a pitch by default, and 32 at least. A `calibration` gives
    the sheet as measured. The calibration's zeros and gains are for the reader of the
    voltages.

    "source" finds the current image of each slot and assumes nothing of the contact;
    "linear" is the paper's Eq. 3 with J(0); "points" fits a few compact contacts;
    "auto" takes the smallest of points, source and shape that explains a frame;
    "shape" finds where an object touches, as a field of two levels, and how surely.

    **Raises:** `ValueError` for an unknown name or a grid below 8.

    **Example:**

    >>> import tomojax as tx
    >>> sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    >>> method = tx.method(sensor, "source", grid=16)
    >>> method.shape, method.electrode_count
    ((16, 16), 16)
    >>> tx.method(sensor, "guess")
    Traceback (most recent call last):
        ...
    ValueError: method: got 'guess', expected one of auto, source, ...
    >>> tx.method(sensor, "conductance")
    Traceback (most recent call last):
        ...
    ValueError: method: got 'conductance', expected 'shape', which took its place
    """
    require_kind("sensor", sensor, Sensor)
    if calibration is not None:
        require_kind("calibration", calibration, Calibration)
    require(name in METHODS, "method", repr(name), one_of(name, METHODS))
    if grid is None:
        pitches = np.asarray(sensor.size, float) / sensor.mean_pitch
        sides = np.clip(np.ceil(_PIXELS * pitches * (1 - 1e-5)), 32, 512).astype(int)
        # A sheet with a value per element has a mesh of its own.
        even = sensor.sheet_resistance.ndim == 0
        nx, ny = sides if even else (sides.max(), sides.max())
        shape = int(nx), int(ny)
    else:
        check_grid(grid)
        shape = (int(grid), int(grid))
    found = METHODS[name]
    # The package's source names what is kept; a method of the user's is made each time.
    make = _kept if found.__module__.startswith("tomojax.") else _made
    return make(found, sensor, shape, calibration)


def _made(
    kind: type, sensor: Sensor, shape: tuple[int, int], calibration: Calibration | None
) -> AbstractMethod:
    if calibration is None:
        return kind.of(sensor, shape)
    fine = pixel_divisions(sensor, shape, kind.cells_per_diameter)
    return kind.of(calibration.sensor(sensor, fine), shape).calibrated(calibration)


_kept = remembered(_made)


def check_grid(grid: int) -> None:
    """Checks the pixels along a side. **Raises:** `ValueError` for another number."""
    require_whole("grid", grid, 8, 512)
