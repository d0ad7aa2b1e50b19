"""Reads descriptions of a rig: numbers by the names of recording version 1."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Shaped

from tomojax._require import require
from tomojax.files import read_toml
from tomojax.recordings._outline import Outline
from tomojax.recordings._recording import check_numbers, PAPER, Rig

# Attributes of a recording that its reader uses.
FIELDS = {
    *PAPER, "scale", "offset", "size", "notes", "units", "schema", "schema_version",
    "outline", "diameter", "kind",
}  # fmt: skip

# Keys of a sidecar, of options, or of arrays beside the voltages.
KEYS = {
    *FIELDS,
    "electrode_xy",
    "rows",
    "columns",
    "pitch",
    "rails",
    "resolution",
    "slots",
    "settle_delay",
    "convert_period",
    "outline_xy",
    "holes",
    "surface",
    "to_ground",
}

MOST_SLOTS = 1 << 16  # of a scan; no rig has as many

_ROUNDED = 1e-4  # of a rail, as rounding of codes may leave it


def sidecar(path: Path) -> dict[str, Any]:
    """Reads the description PATH.toml beside PATH.csv; empty where none exists."""
    beside = path.with_suffix(".toml")
    return read_toml(beside, "no description of a rig") if beside.exists() else {}


def check_keys(told: dict[str, Any], name: str) -> None:
    """Checks the keys. **Raises:** `ValueError` for a key without a use."""
    unknown = sorted(told.keys() - KEYS)
    require(not unknown, name, unknown, f"some of {sorted(KEYS)}")


def rig_of(
    told: dict[str, Any],
    electrodes: int,
    codes: np.dtype | None = None,
    f_switch: float | None = None,
) -> tuple[Rig, tuple[str, ...]]:
    """Makes the rig; returns the rig, and the assumptions as sentences.

    `codes`: the type of whole numbers that `scale` turns into volts; `f_switch` by the
    file's times, Hz.
    **Raises:** `ValueError` for missing values: only 64 electrodes have a usual rig.
    """
    said = []
    told = dict(told)
    if "f_switch" not in told and f_switch is not None:
        told["f_switch"] = f_switch
    paper = electrodes == 64
    missing = [name for name in PAPER if name not in told]
    wanted = f"{'it' if len(missing) == 1 else 'them'}: in a file .toml beside, or --layout"
    require(paper or not missing, ", ".join(missing), "none", wanted)
    for name, value in PAPER.items():
        if name in missing:
            told[name] = value
            said.append(f"{name} {value:g}")
    size, xy = _places(told, electrodes, said)
    text = f"the file does not say, the paper's is taken: {', '.join(said)}"
    sentences = (text,) if said else ()
    rails, resolution = _range(told, codes)
    if not np.isfinite(rails).all():
        sentences += ("rails are not told: what saturates below the drive is not seen",)
    table = told.get("to_ground")
    rig = Rig(
        size=size,
        electrode_xy=xy,
        rails=rails,
        resolution=resolution,
        notes=str(told.get("notes", "")),
        outline=Outline.read(told, told.get),
        conditions=None if table is None else np.asarray(table, float),
        **{name: number(name, told[name]) for name in PAPER},
    )
    check_numbers(rig)
    return rig, sentences


def number(name: str, value: Any) -> float:
    """Reads one number of the description, which may be text."""
    try:
        found = float(np.asarray(value, float).reshape(()))
    except (TypeError, ValueError):
        found = np.nan
    require(np.isfinite(found), name, repr(value), "one number")
    return found


def numbers(name: str, value: Any) -> np.ndarray:
    """Reads an array of the description; a text has commas."""
    try:
        found = np.asarray(value.split(",") if isinstance(value, str) else value, float)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: got {value!r}, expected numbers") from None
    require(bool(np.isfinite(found).all()), name, "NaN or infinite", "numbers")
    return found


def slots_of(value: Any) -> int:
    """Reads the number of slots of a scan, which may be text."""
    slots = number("slots", value)
    whole = 1 <= slots <= MOST_SLOTS and slots == int(slots)
    require(whole, "slots", repr(value), f"a whole number up to {MOST_SLOTS}")
    return int(slots)


def whole_numbers(ground: np.ndarray) -> np.ndarray:
    """Returns grounds as whole numbers; −1, told as a fault, for what is none."""
    fine = np.isfinite(ground) & (np.abs(ground) < 2**31)
    return np.where(fine, ground, -1).astype(int)


def size_of(value: Any) -> tuple[float, float]:
    """Reads the size of the sheet, m."""
    size = numbers("size", value).ravel()
    require(size.shape == (2,), "size", size.tolist(), "two lengths, m")
    return float(size[0]), float(size[1])


def _places(
    told: dict[str, Any], electrodes: int, said: list[str]
) -> tuple[tuple[float, float], np.ndarray]:
    """Returns the sheet's size and the electrodes' places, m."""
    if "electrode_xy" in told:
        xy = numbers("electrode_xy", told["electrode_xy"]).reshape(-1, 2)
        require("size" in told, "size", "none", "the sheet's, m")
    else:
        if not {"rows", "columns"} & told.keys() and electrodes == 64:
            told |= {"rows": 8, "columns": 8, "pitch": 0.02}
            said.append("8 × 8 electrodes at 20 mm")
        for name in ("rows", "columns", "pitch"):
            require(name in told, name, "none", "it, or electrode_xy and size")
        rows, columns = (round(number(n, told[n])) for n in ("rows", "columns"))
        fits = rows * columns == electrodes
        require(fits, "rows", f"{rows} × {columns}", f"{electrodes} voltages in a slot")
        pitch = number("pitch", told["pitch"])
        index = np.indices((rows, columns)).reshape(2, -1).T
        xy = pitch * (index + 0.5)
        told.setdefault("size", [rows * pitch, columns * pitch])
    return size_of(told["size"]), xy


def _range(
    told: dict[str, Any], codes: np.dtype | None
) -> tuple[tuple[float, float], float]:
    """Returns the lowest and highest readable voltage, and the voltage of one code, V."""
    if "scale" in told:
        resolution = abs(scaled(told)[0])
    else:
        resolution = number("resolution", told.get("resolution", 0.0))
    if "rails" not in told:
        if codes is None:
            return (-np.inf, np.inf), resolution
        return rails_of(codes, *scaled(told)), resolution
    rails = np.sort(numbers("rails", told["rails"]))
    require(rails.shape == (2,), "rails", rails.tolist(), "two voltages")
    near = _ROUNDED * (rails[1] - rails[0]) / 2
    return (float(rails[0] + near), float(rails[1] - near)), resolution


def scaled(told: dict[str, Any]) -> tuple[float, float]:
    """Returns V per code, and V at code 0."""
    return number("scale", told["scale"]), number("offset", told.get("offset", 0.0))


def volts_of(
    codes: Shaped[np.ndarray, "*n"], scale: float, offset: float
) -> Float32[np.ndarray, "*n"]:
    """Turns codes into volts, by way of float64."""
    volts = np.multiply(codes, scale, dtype=np.float64)
    volts += offset
    return volts.astype(np.float32)


def rails_of(codes: np.dtype, scale: float, offset: float) -> tuple[float, float]:
    """Returns the lowest and highest voltage that codes of a type can tell."""
    limits = np.iinfo(codes)
    low, high = sorted(scale * float(c) + offset for c in (limits.min, limits.max))
    return low, high
