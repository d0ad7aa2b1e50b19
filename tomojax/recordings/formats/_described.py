"""Makes a rig from a description given beside files that do not describe the rig."""

from pathlib import Path
from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.files import read_toml
from tomojax.recordings._recording import PAPER, Rig

# Keys of a sidecar, of options, or of arrays beside the voltages.
KEYS = {
    *PAPER,
    "size",
    "electrode_xy",
    "rows",
    "columns",
    "pitch",
    "scale",
    "offset",
    "rails",
    "resolution",
    "slots",
    "notes",
    "settle_delay",
    "convert_period",
    "units",
    "schema",
    "schema_version",
}

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
    told: dict[str, Any], electrodes: int, codes: np.dtype | None, f_switch: float | None
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
    for name, value in PAPER.items():
        if name not in told:
            require(paper, name, "none", "it: in a file .toml beside, or --layout")
            told[name] = value
            said.append(f"{name} {value:g}")
    size, xy = _places(told, electrodes, said)
    text = f"the file does not say, the paper's is taken: {', '.join(said)}"
    sentences = (text,) if said else ()
    rails, resolution = _range(told, codes)
    if not np.isfinite(rails).all():
        sentences += ("rails are not told: what saturates below the drive is not seen",)
    rig = Rig(
        **{name: number(told, name) for name in PAPER},
        size=size,
        electrode_xy=xy,
        rails=rails,
        resolution=resolution,
        notes=str(told.get("notes", "")),
    )
    return rig, sentences


def number(told: dict[str, Any], name: str) -> float:
    """Reads one number of the description, which may be text."""
    try:
        found = float(np.asarray(told[name], float).reshape(()))
    except (TypeError, ValueError):
        raise ValueError(f"{name}: got {told[name]!r}, expected one number") from None
    require(np.isfinite(found), name, found, "a number")
    return found


def numbers(told: dict[str, Any], name: str) -> np.ndarray:
    """Reads an array of the description; a text has commas."""
    value = told[name]
    try:
        found = np.asarray(value.split(",") if isinstance(value, str) else value, float)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: got {value!r}, expected numbers") from None
    require(bool(np.isfinite(found).all()), name, "NaN or infinite", "numbers")
    return found


def _places(
    told: dict[str, Any], electrodes: int, said: list[str]
) -> tuple[tuple[float, float], np.ndarray]:
    """Returns the sheet's size and the electrodes' places, m."""
    if "electrode_xy" in told:
        xy = numbers(told, "electrode_xy").reshape(-1, 2)
        require("size" in told, "size", "none", "the sheet's, m")
    else:
        if not {"rows", "columns"} & told.keys() and electrodes == 64:
            told |= {"rows": 8, "columns": 8, "pitch": 0.02}
            said.append("8 × 8 electrodes at 20 mm")
        for name in ("rows", "columns", "pitch"):
            require(name in told, name, "none", "it, or electrode_xy and size")
        rows, columns = (round(number(told, n)) for n in ("rows", "columns"))
        fits = rows * columns == electrodes
        require(fits, "rows", f"{rows} × {columns}", f"{electrodes} voltages in a slot")
        pitch = number(told, "pitch")
        index = np.indices((rows, columns)).reshape(2, -1).T
        xy = pitch * (index + 0.5)
        told.setdefault("size", [rows * pitch, columns * pitch])
    size = numbers(told, "size")
    require(size.shape == (2,), "size", size.tolist(), "two lengths, m")
    return (float(size[0]), float(size[1])), xy


def _range(told: dict, codes: np.dtype | None) -> tuple[tuple[float, float], float]:
    """Returns the lowest and highest readable voltage, and the voltage of one code, V."""
    resolution = number(told, "resolution") if "resolution" in told else 0.0
    if "scale" in told:
        resolution = abs(scaled(told)[0])
    if "rails" not in told:
        if codes is None:
            return (-np.inf, np.inf), resolution
        limits = np.iinfo(codes)
        scale, offset = scaled(told)
        low, high = sorted(scale * float(c) + offset for c in (limits.min, limits.max))
        return (low, high), resolution
    rails = np.sort(numbers(told, "rails"))
    require(rails.shape == (2,), "rails", rails.tolist(), "two voltages")
    near = _ROUNDED * (rails[1] - rails[0]) / 2
    return (float(rails[0] + near), float(rails[1] - near)), resolution


def scaled(told: dict[str, Any]) -> tuple[float, float]:
    """Returns V per code, and V at code 0."""
    offset = number(told, "offset") if "offset" in told else 0.0
    return number(told, "scale"), offset
