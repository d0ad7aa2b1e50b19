"""Holds how a rig differs from its nominal values: zeros, gains, the sheet's variation."""

import json
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import date
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tomojax._require import require
from tomojax._shown import named, shown
from tomojax._whole import write_text
from tomojax.files import read_json
from tomojax.kernels.sheet import cell_centres, smooth_modes
from tomojax.sensor._sensor import Sensor

SCHEMA = "tomojax-calibration"
VERSION = 1

# Numbers of waves that a sheet may be told in, see `smooth_modes`, by half periods along
# both sides together. Files of before have the fewer.
WAVES = {14: 4, 27: 6}

# Fields that may be unknown: None.
_UNKNOWN = ("noise", "pressure")

# Fields whose numbers are above 0,
_ABOVE = ("gain", "noise", "error", "own", "pressure")
# namely this or more.
_LEAST = 1e-12

# The largest number of a rig, of either sign.
_MOST = 1e9

# Values of a field that are printed.
_PRINTED = 4

# Axes that the values of a field may have.
_AXES = {
    "noise": (0,),
    "pressure": (1,),
    "sheet": (1,),
    "error": (0,),
    "own": (0,),
    "hysteresis": (0,),
    "electrodes": (0, 2),
} | {name: (0, 1) for name in ("offset", "gain", "ground")}


@dataclass(frozen=True)
class Calibration:
    """The values of a rig with M channels; the defaults are the nominal values.

    V = (reading − `offset`)/`gain`. The sheet's resistance is the nominal one times
    1 + Σ_q `sheet`_q·wave_q(x). The waves cos(πix/a)·cos(πjy/b) have 1 ≤ i + j ≤ 4 (14
    values) or 6 (27), in the order of j within i, and mean square 1. `ground`: the excess
    of a grounded electrode's resistance to the sheet over its nominal disc's, Ω.
    `electrodes`: each electrode's shift from its nominal place along x and y, m. `noise` of
    a corrected reading, V rms, with the errors of zeros; None: `nominal_noise`. `error`:
    the channels' common error with these values, as a part of the error with nominal
    values. `own`: the same part for each channel's own error. `pressure`: c, k and, where
    it ends, m of a contact's law, S/m² at Pa, see `calibrate_presses`. `hysteresis`: the
    pressure while loading over the one while unloading, at the same conductance.
    `deviation`: 1 σ of the values by their names, where known; `made`: the day (ISO 8601).

    **Example:**

    >>> import numpy as np
    >>> import tomojax as tx
    >>> known = tx.Calibration(offset=0.01, gain=2.0)
    >>> print(known.voltages(np.array([2.01, 0.01])))
    [1. 0.]
    >>> known.save("rig.json")
    >>> tx.Calibration.load("rig.json") == known
    True
    """

    offset: tuple[float, ...] | float = 0.0
    gain: tuple[float, ...] | float = 1.0
    noise: float | None = None
    sheet: tuple[float, ...] = field(default_factory=lambda: (0.0,) * min(WAVES))
    ground: tuple[float, ...] | float = 0.0
    electrodes: tuple[tuple[float, float], ...] | float = 0.0
    error: float = 1.0
    own: float = 1.0
    pressure: tuple[float, ...] | None = None
    hysteresis: float = 1.0
    deviation: dict[str, Any] | None = None
    made: str | None = None

    def __post_init__(self) -> None:
        for name, axes in _AXES.items():
            _require_numbers(name, getattr(self, name), axes)
        law, told = self.pressure or (1, 1), "c and k, or c, k and m, above 0"
        require(np.shape(law) in ((2,), (3,)), "pressure", self.pressure, told)
        require(self.hysteresis >= 1, "hysteresis", self.hysteresis, "1 or more")
        waves = " or ".join(map(str, WAVES))
        require(len(self.sheet) in WAVES, "sheet", len(self.sheet), f"{waves} waves")
        shape = np.shape(self.electrodes)
        pairs = not shape or shape[1:] == (2,)
        require(pairs, "electrodes", f"shape {shape}", "x and y of each, m")
        grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 9)] * 2), -1).reshape(-1, 2)
        positive = bool((self.sheet_factor(grid, np.ones(2)) > 0).all())
        require(positive, "sheet", self.sheet, "less than the sheet itself")
        require(_is_day(self.made), "made", repr(self.made)[:40], "a day as 2026-01-31")
        known = self.deviation if isinstance(self.deviation, dict) else {}
        told = type(self.deviation).__name__
        require(known or not self.deviation, "deviation", told, "values by their names")
        for name, value in known.items():
            _require_numbers(f"deviation of {name}"[:60], value, (0, 1, 2))

    def __repr__(self) -> str:
        """Shows what is not nominal; values of channels by their range."""
        told = {f.name: getattr(self, f.name) for f in fields(self)}
        if self.deviation:
            told["deviation"] = tuple(self.deviation)  # of which values it is known
        told = {n: v for n, v in told.items() if v is not None and not _nominal(n, v)}
        return named(self, **{name: _range(value) for name, value in told.items()})

    def voltages(self, readings: Float[np.ndarray, "*n M"]) -> Float[np.ndarray, "*n M"]:
        """Corrects readings for zeros and gains, in the readings' dtype."""
        offset, gain = (np.asarray(a, readings.dtype) for a in (self.offset, self.gain))
        return (readings - offset) / gain

    def readings(self, voltages: Float[np.ndarray, "*n M"]) -> Float[np.ndarray, "*n M"]:
        """Computes the readings that voltages would give: the inverse of `voltages`."""
        offset, gain = (np.asarray(a, voltages.dtype) for a in (self.offset, self.gain))
        return voltages * gain + offset

    def age_hours(self, today: date | None = None) -> float:
        """Counts hours since the day of the calibration; 0 where no day is noted."""
        if self.made is None:
            return 0.0
        return 24.0 * ((today or date.today()) - date.fromisoformat(self.made)).days

    def sheet_factor(self, places: np.ndarray, size: np.ndarray) -> np.ndarray:
        """Computes the sheet's resistance over its mean at places (n, 2); `size`: sides."""
        if not any(self.sheet):
            return np.ones(len(places))
        at, sides = (jnp.asarray(np.asarray(a, float)) for a in (places, size))
        modes, _ = smooth_modes(at, sides, WAVES[len(self.sheet)])
        return 1 + np.asarray(self.sheet) @ np.asarray(modes)

    def sensor(self, sensor: Sensor, divisions: tuple[int, int]) -> Sensor:
        """Makes the sensor with calibrated sheet and electrodes, on a mesh of `divisions`.

        **Raises:** `ValueError` for a calibration of another number of electrodes.
        """
        self.check_count(sensor.electrode_count)
        if np.any(self.electrodes):
            moved = np.asarray(sensor.electrode_xy, float) + np.asarray(self.electrodes)
            sensor = replace(sensor, electrode_xy=jnp.asarray(moved, sensor.dtype))
        if not any(self.sheet):
            return sensor
        size = np.asarray(sensor.size)
        centres = np.repeat(cell_centres(divisions) * size, 2, axis=0)  # of both halves
        factor = self.sheet_factor(centres, size)
        values = np.asarray(sensor.sheet_resistance) * factor
        return replace(sensor, sheet_resistance=values, divisions=divisions)

    def check_count(self, electrodes: int) -> None:
        """Checks the number of electrodes. **Raises:** `ValueError` for another number."""
        for name in ("offset", "gain", "ground", "electrodes"):
            told = np.shape(getattr(self, name))
            fits = not told or told[0] == electrodes
            require(fits, name, f"{told[:1]} values", f"{electrodes} of them")

    def save(self, path: Path | str) -> None:
        """Writes JSON; the file appears whole or not at all."""
        content = {"schema": SCHEMA, "schema_version": VERSION, **asdict(self)}
        write_text(path, json.dumps(content, indent=1) + "\n")

    @classmethod
    def load(cls, path: Path | str, electrodes: int | None = None) -> "Calibration":
        """Reads a file; `electrodes`: how many the rig has, where that is known.

        **Raises:** `ValueError` naming the file and the field.
        """
        content = read_json(path, "not a calibration")
        known = isinstance(content, dict) and content.pop("schema", None) == SCHEMA
        require(known, f"{path}: schema", "another", SCHEMA)
        version = content.pop("schema_version", None)
        require(version == VERSION, f"{path}: schema_version", version, str(VERSION))
        names = sorted(one.name for one in fields(cls))
        for name in content:
            at = f"{path}: {name!r:.60}"
            require(name in names, at, "this field", ", ".join(names))
        try:
            made = cls(**{name: _tuples(value) for name, value in content.items()})
            if electrodes is not None:
                made.check_count(electrodes)
            return made
        except (TypeError, ValueError, OverflowError) as error:
            why = " ".join(str(error).split())[:300]  # an array's words have many lines
            raise ValueError(f"{path}: {why}") from None


def _require_numbers(name: str, value: Any, axes: tuple[int, ...]) -> None:
    """Checks numbers with such axes. **Raises:** `ValueError` for anything else.

    None stands for an unknown value, where a field allows None. No number of a rig comes
    near the limits; beyond them float32 has infinities, and zeros that divide.
    """
    if value is None and name in _UNKNOWN:
        return
    try:
        kind, values = np.asarray(value).dtype.kind, np.asarray(value, float)
    except (TypeError, ValueError, OverflowError):  # texts, lists of any lengths
        kind, values = "O", np.full(1, np.nan)
    shown = str(value)[:60] + ("…" if len(str(value)) > 60 else "")
    fine = np.isfinite(values).all() and (kind in "iuf" or not values.size)
    require(fine, name, shown, "numbers")
    require((np.abs(values) <= _MOST).all(), name, shown, f"up to {_MOST:g}")
    if name in _ABOVE:
        require((values >= _LEAST).all(), name, shown, f"above 0, {_LEAST:g} or more")
    fits = values.ndim in axes
    require(fits, name, f"shape {values.shape}", f"{' or '.join(map(str, axes))} axes")


def _nominal(name: str, value: Any) -> bool:
    if name == "hysteresis":
        return value == 1
    return name in ("offset", "sheet", "ground", "electrodes") and not np.any(value)


def _range(value: Any) -> str:
    numbers = np.asarray(value)
    if numbers.dtype.kind not in "iuf" or numbers.size <= _PRINTED:
        return shown(numbers if numbers.dtype.kind in "iuf" else value)
    return f"{shown(float(numbers.min()))} to {shown(float(numbers.max()))}"


def _is_day(made: Any) -> bool:
    try:
        return made is None or bool(date.fromisoformat(made))
    except (TypeError, ValueError):
        return False


def _tuples(value: Any) -> Any:
    """Turns JSON's lists into tuples, in dictionaries too."""
    if isinstance(value, dict):
        return {name: _tuples(one) for name, one in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
