"""What a rig is beside its nominal values: zeros, gains, and how its sheet varies."""

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

SCHEMA, VERSION = "tomojax-calibration", 1

# Numbers of waves that a sheet may be told in, see `smooth_modes`, by half periods along
# both sides together. Files of before have the fewer.
WAVES = {14: 4, 27: 6}


# Fields that None stands in for; those above 0; and what a number of a rig may be.
_UNKNOWN, _ABOVE = ("noise", "pressure"), ("gain", "noise", "error", "own", "pressure")
_LEAST, _MOST = 1e-12, 1e9

# Values of a field that are printed.
_PRINTED = 4

# Axes that the values of a field may have.
_AXES = {
    "noise": (0,),
    "pressure": (1,),
    "sheet": (1,),
    "error": (0,),
    "own": (0,),
    "electrodes": (0, 2),
} | {name: (0, 1) for name in ("offset", "gain", "ground")}


@dataclass(frozen=True)
class Calibration:
    """Of a rig with M channels; the default is its nominal values.

    V = (reading − `offset`)/`gain`. The sheet's resistance is the nominal one times
    1 + Σ_q `sheet`_q·wave_q(x), the waves cos(πix/a)·cos(πjy/b), 1 ≤ i + j ≤ 4 (14 values)
    or 6 (27), in the order of j within i, of mean square 1. `ground`: what a grounded
    electrode's own resistance to the sheet has beside its nominal disc's, Ω. `electrodes`:
    how far each lies from its nominal place along x and y, m. `noise`: of a
    corrected reading, V rms, with what is left of zeros; None: `nominal_noise`. `error`: of
    what the channels have in common with these values, as a part of what nominal values
    leave; `own`: the same of what each channel has of its own. `pressure`: c and k of the
    contact's g = c·pᵏ, S/m² at Pa, see `calibrate_presses`. `deviation`: 1 σ of the values
    by their names, where they are known; `made`: the day (ISO 8601).

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
    pressure: tuple[float, float] | None = None
    deviation: dict[str, Any] | None = None
    made: str | None = None

    def __post_init__(self) -> None:
        for name, axes in _AXES.items():
            _require_numbers(name, getattr(self, name), axes)
        law = (1, 1) if self.pressure is None else self.pressure
        require(np.shape(law) == (2,), "pressure", self.pressure, "c and k, above 0")
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
        """Tells what is not nominal, and the range of values that channels have apart."""
        told = {f.name: getattr(self, f.name) for f in fields(self)}
        if self.deviation:
            told["deviation"] = tuple(self.deviation)  # of which values it is known
        told = {n: v for n, v in told.items() if v is not None and not _nominal(n, v)}
        return named(self, **{name: _range(value) for name, value in told.items()})

    def voltages(self, readings: Float[np.ndarray, "*n M"]) -> Float[np.ndarray, "*n M"]:
        """Readings corrected for zeros and gains, in their dtype."""
        offset, gain = (np.asarray(a, readings.dtype) for a in (self.offset, self.gain))
        return (readings - offset) / gain

    def readings(self, voltages: Float[np.ndarray, "*n M"]) -> Float[np.ndarray, "*n M"]:
        """What would have been read: the inverse of `voltages`."""
        offset, gain = (np.asarray(a, voltages.dtype) for a in (self.offset, self.gain))
        return voltages * gain + offset

    def age_hours(self, today: date | None = None) -> float:
        """Hours since the day when it was made; 0 where nobody noted that."""
        if self.made is None:
            return 0.0
        return 24.0 * ((today or date.today()) - date.fromisoformat(self.made)).days

    def sheet_factor(self, places: np.ndarray, size: np.ndarray) -> np.ndarray:
        """The sheet's resistance at places (n, 2) of a sheet of `size`, over its mean."""
        at, sides = (jnp.asarray(np.asarray(a, float)) for a in (places, size))
        modes, _ = smooth_modes(at, sides, WAVES[len(self.sheet)])
        return 1 + np.asarray(self.sheet) @ np.asarray(modes)

    def sensor(self, sensor: Sensor, divisions: tuple[int, int]) -> Sensor:
        """The sensor with sheet and electrodes as they are, on a mesh of `divisions`.

        **Raises:** `ValueError` for a calibration of another number of electrodes.
        """
        self.check_count(sensor.electrode_count)
        if np.any(self.electrodes):
            moved = np.asarray(sensor.electrode_xy, float) + np.asarray(self.electrodes)
            sensor = replace(sensor, electrode_xy=jnp.asarray(moved, sensor.dtype))
        if not any(self.sheet):
            return sensor
        centres = element_centres(np.asarray(sensor.size), divisions)
        factor = self.sheet_factor(centres, np.asarray(sensor.size))
        values = np.asarray(sensor.sheet_resistance) * factor
        return replace(sensor, sheet_resistance=values, divisions=divisions)

    def check_count(self, electrodes: int) -> None:
        """**Raises:** `ValueError` for a calibration of another number of electrodes."""
        for name in ("offset", "gain", "ground", "electrodes"):
            told = np.shape(getattr(self, name))
            fits = not told or told[0] == electrodes
            require(fits, name, f"{told[:1]} values", f"{electrodes} of them")

    def save(self, path: Path | str) -> None:
        """As JSON; the file is there whole or not at all."""
        content = {"schema": SCHEMA, "schema_version": VERSION, **asdict(self)}
        write_text(path, json.dumps(content, indent=1) + "\n")

    @classmethod
    def load(cls, path: Path | str, electrodes: int | None = None) -> "Calibration":
        """Of a file; `electrodes`: how many the rig has, where that is known.

        **Raises:** `ValueError` naming the file and the field.
        """
        content = read_json(path, "not a calibration")
        known = isinstance(content, dict) and content.pop("schema", None) == SCHEMA
        require(known, f"{path}: schema", "another", SCHEMA)
        version = content.pop("schema_version", None)
        require(version == VERSION, f"{path}: schema_version", version, str(VERSION))
        names = {one.name for one in fields(cls)}
        for name in content:
            require(
                name in names,
                f"{path}: {name!r:.60}",
                "this field",
                ", ".join(sorted(names)),
            )
        try:
            made = cls(**{name: _tuples(value) for name, value in content.items()})
            if electrodes is not None:
                made.check_count(electrodes)
            return made
        except (TypeError, ValueError, OverflowError) as error:
            why = " ".join(str(error).split())[:300]  # an array's words have many lines
            raise ValueError(f"{path}: {why}") from None


def _require_numbers(name: str, value: Any, axes: tuple[int, ...]) -> None:
    """**Raises:** `ValueError` for anything but numbers with such axes.

    None stands for what is not known, where that may be. No number of a rig comes near
    the limits; beyond them float32 has infinities, and zeros that divide.
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
    """JSON's lists as tuples, in dictionaries too."""
    if isinstance(value, dict):
        return {name: _tuples(one) for name, one in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def element_centres(size: np.ndarray, divisions: tuple[int, int]) -> np.ndarray:
    """Of a mesh's two elements per cell, (K, 2), m: of their cells."""
    return np.repeat(cell_centres(divisions) * size, 2, axis=0)
