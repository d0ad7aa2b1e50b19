"""Follows a results file's contacts over time: writes a file, a table, a picture."""
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportCallIssue=false, reportOptionalMemberAccess=false, reportOperatorIssue=false
# (h5py does not say whether a name is a group or a dataset)

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tomojax._pictures import lay_sheet, style
from tomojax._require import naming, require
from tomojax._stretch import stretch_of
from tomojax._whole import reason, whole
from tomojax.calibration import force
from tomojax.methods import fields_of_rows, Rows
from tomojax.results._file import check_output
from tomojax.results._track import Touch, touches, track, Tracks
from tomojax.results.loading import LoadedResults, strength
from tomojax.sensor import Calibration

# Datasets that tracks replace or add, with their units.
_UNITS = {name: field.unit for name, field in fields_of_rows().items()} | {
    "contact_track": "1",
    "contact_conductance_error": "1",
    "contact_force": "N",
}
# Paths that a picture shows.
_PATHS = 200

# What is about a contact by its place in the row, and so not the tracks'.
_LEFT_OUT = (
    "contact_angle",
    "contact_force",
    "contact_xyz",
    "contact_normal",
    "image",
    "residual_by_electrode",
)


def track_results(
    path: Path,
    out: Path,
    overwrite: bool = False,
    since: float | None = None,
    until: float | None = None,
    **options: Any,
) -> tuple[Tracks, list[Touch]]:
    """Runs `track` on a results file or a stretch; writes another file; returns touches.

    **Raises:** `ValueError` naming the file and its fault.
    """
    same = out.exists() and path.exists() and path.samefile(out)
    require(not same, f"{out}", "the results file", "another name")
    check_output(out, resume=False, overwrite=overwrite, resumes=False)
    with LoadedResults(path) as file:
        size, electrodes = file.size(), len(file.electrode_xy())
        drive = sheet = None
        if "contact_strength" not in file.names:
            drive, sheet = (file.number(n) for n in ("drive_voltage", "sheet_resistance"))
        told = "contact_covariance" in file.names
        need = "results of points or auto, with contact_covariance"
        method = file.attributes.get("method", "unknown method")
        require(told, f"{path}", method, need)
        with naming(path):
            t = file.read("t")
            part = slice(*stretch_of(t, since, until))
            t, rows = t[part], _rows(file, part)
            # As `Sensor.mean_pitch`, m.
            pitch = float(np.sqrt(np.prod(size) / electrodes))
            found = track(rows, drive, sheet, pitch=pitch, **options)
        try:
            with whole(out) as building:
                _write(building, file, part, found, options)
        except (OSError, RuntimeError) as error:  # HDF5 says it in either way
            text = reason(error).removeprefix(f"{out}: ")
            raise ValueError(f"{out}: cannot be written: {text}") from None
    return found, touches(found, t)


def _write(
    out: Path, file: LoadedResults, part: slice, found: Tracks, options: dict
) -> None:
    with h5py.File(out, "w") as new:
        new.attrs.update(file.attributes | {"tracked": json.dumps(options)})
        by_name = found._asdict() | _forces(file, found)
        if "contact_strength" in file.names:
            by_name = _of_presses(by_name)
        for name in file.names:
            if name not in by_name and name not in _LEFT_OUT:
                values = file.read(name)
                by_row = name == "t" or name in fields_of_rows()
                new[name] = values[part] if by_row else values
                new[name].attrs.update(file.attributes_of(name))
        for name, values in by_name.items():
            new.create_dataset(name, data=values).attrs["unit"] = _UNITS.get(name, "1")


def _forces(file: LoadedResults, found: Tracks) -> dict[str, np.ndarray]:
    """Computes each contact's force over its rows, where the results know a law."""
    told = json.loads(str(file.attributes.get("calibration", "{}")))
    if "contact_force" not in file.names or not told.get("pressure"):
        return {}
    law = Calibration(
        pressure=tuple(told["pressure"]), hysteresis=told.get("hysteresis", 1)
    )
    number, g, radius = (
        a.ravel()
        for a in (found.contact_track, found.contact_conductance, found.contact_radius)
    )
    newtons = np.full(number.shape, np.nan, np.float32)
    order = np.argsort(number, kind="stable")  # a contact's rows stay in order
    order = order[number[order] > 0]
    for of in np.split(order, np.flatnonzero(np.diff(number[order])) + 1):
        newtons[of] = force(law, g[of], radius[of], over_time=True)
    return {"contact_force": newtons.reshape(found.contact_track.shape)}


def _of_presses(found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Renames what `_rows` has put where a contact's conductance and current are."""
    sign = np.sign(found.pop("contact_current"))
    found.pop("contact_radius")
    size, error = (found.pop(f"contact_conductance{more}") for more in ("", "_error"))
    return found | {"contact_strength": sign * size, "contact_strength_error": error}


def _rows(file: LoadedResults, part: slice) -> Rows:
    names = [f for f in Rows._fields if f not in _LEFT_OUT and f in file.names]
    some = {f: file.read(f)[part] for f in names}
    if "contact_strength" in file.names:
        pressed = file.read("contact_strength")[part]
        some |= {"contact_conductance": abs(pressed), "contact_current": pressed}
    for name in ("contact_count", "contact_xy", "contact_conductance", "contact_current"):
        require(name in some, f"{file.path}: {name}", "none", "this dataset")
    n = len(some["contact_count"])
    none = dict.fromkeys(Rows._fields) | {"rung": np.zeros(n, np.uint8)}
    none["contact_radius"] = np.full(some["contact_current"].shape, np.nan)  # of presses
    return Rows(**(none | some))  # pyright: ignore


def text(found: list[Touch], out: Path, most: int = 30) -> str:
    """Formats the touches of a file of tracks as a table."""
    with LoadedResults(out) as file:
        pressed = "contact_strength" in file.names
    unit, factor = ("strength", 1.0) if pressed else ("     µS", 1e6)
    head = f"  start s    end s     ms    rows    x mm    y mm {unit}"
    lines = [
        f"{touch.start:9.4f} {touch.end:8.4f} {1e3 * (touch.end - touch.start):6.1f} "
        f"{touch.rows:7d} {1e3 * touch.xy[0]:7.2f} {1e3 * touch.xy[1]:7.2f} "
        f"{factor * touch.conductance:7.3g}"
        for touch in found[:most]
    ]
    if len(found) > most:
        lines.append(f"and {len(found) - most} more")
    return "\n".join([f"{len(found)} contacts", head, *lines] if found else ["no contact"])


def picture(path: Path, out: Path) -> Any:
    """Draws places and strengths before and after, and the places' ellipses."""
    from matplotlib.figure import Figure

    from tomojax.results.plots import enlarge

    with LoadedResults(path) as raw:
        t, before = raw.read("t"), raw.read("contact_xy")
        name, factor, words = strength(raw.names)
        before_g = raw.read(name)
    with LoadedResults(out) as file:
        later, xy, g = (file.read(n) for n in ("t", "contact_xy", name))
        spread, names = file.read("contact_covariance"), file.read("contact_track")
        box, electrodes, outline = file.box(), file.electrode_xy(), file.outline()
    figure = Figure(figsize=(14, 8), layout="constrained")
    figure.suptitle(f"Contacts of {path.name}, followed over time")
    grid = figure.add_gridspec(3, 3)
    left = [figure.add_subplot(grid[k, :2]) for k in range(3)]
    step = max(1, len(t) // 20_000)
    shown = np.unique(names[names > 0])[:_PATHS]
    for axes, old, new, label in zip(
        left,
        (1e3 * before[..., 0], 1e3 * before[..., 1], factor * before_g),
        (1e3 * xy[..., 0], 1e3 * xy[..., 1], factor * g),
        ("x, mm", "y, mm", words),
    ):
        axes.plot(t[::step], old[::step], ".", ms=4, color="0.6")
        for number in shown:
            row, column = (a[::step] for a in np.nonzero(names == number))
            axes.plot(later[row], new[row, column], lw=1, color=style(int(number))["color"])
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    left[0].set_title("Places and strengths", loc="left")
    for look, label in (({"marker": ".", "ls": "none"}, "row by row"), ({}, "followed")):
        colour = "0.6" if look else style(1)["color"]
        left[0].plot([], [], color=colour, **look, label=label)
    place = {"loc": "lower right", "bbox_to_anchor": (1, 1), "ncols": 2}
    left[0].legend(**place, frameon=False)
    left[2].set(xlabel="time, s", yscale="log")
    sheet = figure.add_subplot(grid[:, 2])
    lay_sheet(sheet, box, electrodes, outline=outline)
    _paths(sheet, xy, spread, names)
    small = enlarge(sheet, 1e3 * xy[names > 0], 1e3 * box)
    where = "enlarged" if small else "on the sheet"
    sheet.set_title(f"Paths, {where};\nellipses: two standard deviations")
    return figure


def _paths(axes: Any, xy: np.ndarray, spread: np.ndarray, names: np.ndarray) -> None:
    """Draws the path of each contact, and ellipses about some of its places."""
    from tomojax.plots import ellipses

    for number in np.unique(names[names > 0])[:_PATHS]:
        row, column = np.nonzero(names == number)
        colour = style(int(number))["color"]
        axes.plot(*(1e3 * xy[row, column].T), lw=0.8, color=colour)
        ellipses(axes, xy[row, column], spread[row, column], 6, ec=colour)
