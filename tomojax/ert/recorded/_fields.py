"""Reads the fields of recordings of pairs, from files and from what lies beside them."""

from pathlib import Path
from typing import Any

import numpy as np

from tomojax._require import require
from tomojax.ert.recorded._pairs import Pairs, undriven
from tomojax.files import open_container, read_csv, read_npz
from tomojax.recordings import number, sidecar, variable

TEXTS = "units", "notes", "outline", "kind", "schema", "protocol", "reference"
NUMBERS = "scale", "offset", "electrode_diameter", "f_switch"
_MORE = "diameter", "size", "magnitude", "rotated", "schema_version", "frames", "seconds"
_RIM = "rim", "rim_diameter", "first_angle", "clockwise"
ARRAYS = (
    "v", "t0", "places", "condition", "inject", "read", "electrode_xy", "outline_xy",
    "holes", "reference",
)  # fmt: skip
_NAMES = {*TEXTS, *NUMBERS, *_MORE, *_RIM, *ARRAYS}

# Names of columns that are no readings: the time, and where somebody pressed.
_COLUMNS = {
    **dict.fromkeys(("t", "t_s", "time", "time_s"), "t0"),
    **dict.fromkeys(("x", "x_m"), "x"),
    **dict.fromkeys(("y", "y_m"), "y"),
}
_TABLES = ".csv", ".tsv", ".txt"


def fields_of(path: Path) -> dict[str, Any]:
    """Reads a file's fields by name; those of PATH.toml replace them.

    **Raises:** `ValueError` for a file that cannot be read, and names without a use.
    """
    beside = sidecar(path)
    unknown = sorted(beside.keys() - _NAMES)
    require(not unknown, "description", unknown, f"some of {sorted(_NAMES)}")
    if path.suffix.lower() in _TABLES:
        return _of_table(path) | beside
    if path.suffix.lower() == ".npz":
        return dict(read_npz(path, "no recording", ("v",), sorted(_NAMES))) | beside
    return _of_container(path) | beside


def _of_table(path: Path) -> dict[str, Any]:
    """Reads a line for each frame: its readings, and perhaps its time and its place."""
    names, values, _ = read_csv(path, "file")
    known = [_COLUMNS.get(name.lower(), "v") for name in names] or ["v"] * values.shape[1]
    twice = [name for name in set(known) - {"v"} if known.count(name) > 1]
    require(not twice, "columns", f"{twice} twice", "each once")
    both = ("x" in known) == ("y" in known)
    require(both, "columns", "x or y alone", "both, or none")
    found = {name: values[:, [k == name for k in known]] for name in {*known}}
    if "x" in found:
        found["places"] = np.concatenate([found.pop("x"), found.pop("y")], 1)
    return found


def _of_container(path: Path) -> dict[str, Any]:
    """Reads attributes and datasets of HDF5, or MATLAB's variables, axes as written."""
    with open_container(path) as file:
        matlab = any("MATLAB_class" in file.attributes_of(n) for n in _readable(file))
        found = {n: v for n, v in file.attributes.items() if n in _NAMES}
        for name in _readable(file):
            short = name.removeprefix("conditions/")
            word = file.attributes_of(name).get("MATLAB_class") == b"char"
            if matlab and name in _NAMES and (word or name not in ARRAYS):
                found[name] = variable(file, name)
            elif short in ARRAYS:
                values = file.read_whole(name)
                require(values.dtype.kind in "iuf", name, values.dtype, "numbers")
                found[short] = values.T if matlab else values
        return found


def _readable(file: Any) -> list[str]:
    return [name for name in file.names if file.refused(name) is None]


def text(told: dict[str, Any], name: str, default: str = "") -> str:
    """Returns a field that is a text."""
    value = told.get(name, default)
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def flag(told: dict[str, Any], name: str) -> bool:
    """Returns a field that is true or false; false where it is not told."""
    value = np.squeeze(np.asarray(told.get(name, False)))
    fits = value.shape == () and value.dtype.kind in "biuf" and value in (0, 1)
    require(bool(fits), name, repr(told.get(name)), "true or false")
    return bool(value)


def electrodes_of(told: dict[str, Any]) -> np.ndarray:
    """Returns electrodes' places, m: as they are told, or evenly around a round rim."""
    if "rim" not in told:
        require("electrode_xy" in told, "electrode_xy", "none", "it, or rim: how many")
        return np.asarray(told["electrode_xy"], float)
    count = number("rim", told["rim"])
    fits = count == int(count) and 4 <= count <= 1 << 12
    require(fits, "rim", told["rim"], "how many electrodes are on the rim")
    across = told.get("rim_diameter", told.get("diameter"))
    require(across is not None, "rim_diameter", "none", "m, or the disc's diameter")
    turn = -1 if flag(told, "clockwise") else 1
    angle = np.radians(number("first_angle", told.get("first_angle", 0.0)))
    angle = angle + turn * 2 * np.pi * np.arange(int(count)) / int(count)
    radius = number("rim_diameter", across) / 2
    return radius * np.stack([np.cos(angle), np.sin(angle)], 1)


def readings_of(told: dict[str, Any], electrodes: int) -> tuple[np.ndarray, Pairs]:
    """Returns voltages (n, C, R) in `units`, and their pairs.

    A frame in one row has the readings of one injection after the other. Readings at driven
    electrodes are left out where a protocol is told by its name.
    """
    require("v" in told, "v", f"only {sorted(told)[:20]}", "it")
    volts = np.asarray(told["v"])
    require(volts.dtype.kind in "iuf", "v", volts.dtype, "numbers")
    scale, offset = (
        number(n, told.get(n, usual)) for n, usual in (("scale", 1), ("offset", 0))
    )
    volts = scale * volts.astype(float) + offset
    name = text(told, "protocol")
    rows = int(np.prod(volts.shape[1:]))
    if not name:
        for one in ("inject", "read"):
            require(one in told, one, "none", "it, or protocol: 'opposite' and the like")
        pairs = Pairs(np.asarray(told["inject"]), np.asarray(told["read"]))
        whole, kept = pairs, np.ones(pairs.read.shape[:2], bool)
    else:
        rotated = flag(told, "rotated")
        pairs = Pairs.named(name, electrodes, rotated)
        driven = rows == pairs.conditions * electrodes
        whole = Pairs.named(name, electrodes, rotated, driven)
        kept = undriven(whole.inject, whole.read) | (not driven)
    shape = whole.read.shape[:2]
    fits = volts.ndim in (2, 3) and rows == shape[0] * shape[1]
    fits = fits and (volts.ndim == 2 or volts.shape[1:] == shape)
    told_shape = f"(frames, {shape[0]}, {shape[1]}), or a row for each frame"
    require(fits, "v", f"shape {volts.shape}", told_shape)
    volts = volts.reshape(-1, *shape)
    if "condition" in told:
        volts = _ordered(volts, np.asarray(told["condition"]))
    return volts[:, kept].reshape(len(volts), pairs.conditions, -1), pairs


def _ordered(volts: np.ndarray, condition: np.ndarray) -> np.ndarray:
    """Puts a frame's injections in their order; NaN stands for those that are missing."""
    n, c, _ = volts.shape
    fits, shape = condition.shape == (n, c), f"shape {condition.shape}"
    require(fits, "condition", shape, f"{(n, c)}, as v has")
    inside = np.isin(condition, np.arange(c)).all()
    require(inside, "condition", int(condition.max(initial=0)), f"0 to {c - 1}")
    ordered = np.full(volts.shape, np.nan)
    ordered[np.arange(n)[:, None], condition.astype(int)] = volts
    return ordered
