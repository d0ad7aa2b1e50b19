"""Writes and draws a calibration, and how sure each of its values is."""

from typing import Any

import numpy as np

from tomojax._pictures import lay_sheet, show_image, SIGNED
from tomojax.calibration._calibrate import Calibrated
from tomojax.calibration._unknowns import affine, all_waves
from tomojax.kernels.sheet import cell_centres
from tomojax.sensor import Sensor

# A square that fewer frames touch is hardly known.
_FEW = 2

# Frames hardly tell what keeps more than this part of its variance from before them.
_KEPT = 0.5


def summary(sensor: Sensor, found: Calibrated) -> dict[str, Any]:
    """Lists the values that were found and 1 σ of each kind, lengths in mm.

    The certainty of electrodes' places has two parts. One part is an affine map of all
    electrodes (shift, turn, stretch), which a rub without a ruler hardly shows. The other
    part is all else. `not_told` names moves that these frames show hardly or not at all.
    """
    calibration, m = found.calibration, sensor.electrode_count
    touched = squares_touched(sensor, found.places)
    moved = np.broadcast_to(calibration.electrodes, (m, 2))
    whole, relative = _certainty(sensor, found)
    deviation = calibration.deviation or {}

    def known(name: str) -> float:
        return float(np.sqrt(np.mean(np.square(deviation[name]))))

    waves = all_waves(calibration.sheet)
    unsure = float(np.linalg.norm(deviation["sheet"]))
    return {
        "frames": len(found.places),
        "squares": touched.size,
        "squares_touched": int((touched >= _FEW).sum()),
        "gain_percent": 100 * float(np.std(calibration.gain)),
        "gain_known_percent": 100 * known("gain"),
        "zero_mV": 1e3 * float(np.std(calibration.offset)),
        "zero_known_mV": 1e3 * known("offset"),
        "sheet_percent": 100 * float(np.linalg.norm(waves)),
        "sheet_known_percent": 100 * unsure,
        "ground_ohm": float(np.mean(calibration.ground)),
        "ground_known_ohm": known("ground"),
        "electrodes_mm": 1e3 * float(np.sqrt((moved**2).sum(1).mean())),
        "relative_known_mm": 1e3 * relative,
        "whole_known_mm": 1e3 * whole,
        "errors_left_percent": 100 * calibration.error,
        "own_errors_left_percent": 100 * calibration.own,
        "not_told": not_told(sensor, found),
    }


def text(sensor: Sensor, found: Calibrated) -> str:
    """Writes the summary in lines, and where to rub more."""
    told = summary(sensor, found)
    lines = [
        "{frames} frames with one contact; {squares_touched} of {squares} squares touched",
        "gains {gain_percent:.3f} % rms, each known to {gain_known_percent:.3f} %",
        "zeros {zero_mV:.2f} mV rms, each known to {zero_known_mV:.2f} mV",
        "sheet uneven by {sheet_percent:.1f} % rms, known to {sheet_known_percent:.2f} %",
        "ground paths {ground_ohm:+.0f} Ω from nominal in the mean, known to "
        "{ground_known_ohm:.0f} Ω",
        "electrodes {electrodes_mm:.2f} mm rms off their places; each is known to "
        "{relative_known_mm:.3f} mm, the whole array to {whole_known_mm:.2f} mm",
        "of the nominal model's errors are left: {errors_left_percent:.0f} % of those that "
        "channels share, {own_errors_left_percent:.0f} % of each channel's own",
    ]
    if told["not_told"]:
        names = ", ".join(told["not_told"])
        lines.append(f"not told by these frames, held by what is usual: {names}")
    more = rub_more(sensor, squares_touched(sensor, found.places))
    return "\n".join([line.format(**told) for line in lines] + more)


def not_told(sensor: Sensor, found: Calibrated) -> list[str]:
    """Names moves of many values together that the frames hardly show.

    A move d is named if dᵀCd, its variance now, is more than half of dᵀP⁻¹d, its variance
    before any frame.
    """
    xy = np.asarray(sensor.electrode_xy, float)
    x, y = (xy - xy.mean(0)).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    moves = {
        "all gains together": ("gain", one),
        "all zeros together": ("offset", one),
        "all ground paths together": ("ground", one),
        "a shift of all electrodes along x": ("electrodes", np.append(one, zero)),
        "a shift of all electrodes along y": ("electrodes", np.append(zero, one)),
        "a turn of all electrodes": ("electrodes", np.append(-y, x)),
        "a stretch of all electrodes": ("electrodes", np.append(x, y)),
    }
    before = np.linalg.inv(found.unknowns.prior)

    def kept(name: str, along: np.ndarray) -> float:
        at = found.parts[name]
        now, then = (along @ c[at, at] @ along for c in (found.covariance, before))
        return float(now / then)

    return [name for name, move in moves.items() if kept(*move) > _KEPT]


def rub_more(sensor: Sensor, touched: np.ndarray) -> list[str]:
    """Says where to rub, by how often each square was `touched`, (rows, columns).

    Returns no line if all of the sheet was touched.
    """
    missing = touched < _FEW
    if not missing.any():
        return []
    size = 1e3 * np.asarray(sensor.size, float)
    sides = {
        "x = 0": missing[0],
        f"x = {size[0]:.0f} mm": missing[-1],
        "y = 0": missing[:, 0],
        f"y = {size[1]:.0f} mm": missing[:, -1],
    }
    lines = [
        f"rub more: along the edge {name}, {some.sum()} of {some.size} squares missing"
        for name, some in sides.items()
        if some.mean() > 0.25
    ]
    inside = missing[1:-1, 1:-1].sum()
    if inside:
        lines.append(f"rub more: inside, {inside} squares of a pitch missing")
    return lines or ["rub more: at single squares of the edges"]


def squares_touched(sensor: Sensor, places: np.ndarray) -> np.ndarray:
    """Counts frames that touch each square of about a pitch, (rows, columns)."""
    size = np.asarray(sensor.size, float)
    shape = np.maximum(1, np.round(size / sensor.mean_pitch)).astype(int)
    at = np.clip((places / size * shape).astype(int), 0, shape - 1)
    count = np.zeros(shape, int)
    np.add.at(count, tuple(at.T), 1)
    return count


def _certainty(sensor: Sensor, found: Calibrated) -> tuple[float, float]:
    """Computes 1 σ of a place by an affine map of all electrodes, and by all else, m."""
    at = found.parts["electrodes"]
    covariance = found.covariance[at, at]
    whole = affine(np.asarray(sensor.electrode_xy, float))
    inside = float(np.trace(whole.T @ covariance @ whole))
    rest = max(float(np.trace(covariance)) - inside, 0.0)
    known, relative = np.sqrt(np.array([inside, rest]) / sensor.electrode_count).tolist()
    return known, relative


def picture(sensor: Sensor, found: Calibrated) -> Any:
    """Draws the sheet's resistance, the contacts, and how far electrodes are off."""
    from matplotlib.figure import Figure

    calibration = found.calibration
    size, m = np.asarray(sensor.size, float), sensor.electrode_count
    figure = Figure(figsize=(7.2, 6.0), layout="constrained")
    axes = figure.subplots()
    grid = cell_centres((60, 60)) * size
    factor = 100 * (calibration.sheet_factor(grid, size).reshape(60, 60) - 1)
    most = max(np.abs(factor).max(), 0.1)
    label = "sheet resistance beside its mean, %"
    show_image(axes, factor, size, label, cmap=SIGNED, vmin=-most, vmax=most)
    axes.plot(*1e3 * found.places.T, ".", color="0.4", ms=1.5, label="contacts")
    xy = 1e3 * np.asarray(sensor.electrode_xy, float)
    moved = 1e3 * np.broadcast_to(calibration.electrodes, (m, 2))
    largest = max(np.hypot(*moved.T).max(), 1e-6)
    room = 0.4e3 * sensor.mean_pitch / largest
    whole = 10 ** np.floor(np.log10(room))
    enlarged = whole * max(k for k in (1, 2, 5) if k * whole <= room)
    look = {"angles": "xy", "scale_units": "xy", "scale": float(1 / enlarged)}
    axes.quiver(*xy.T, *moved.T, width=0.004, **look)
    lay_sheet(axes, size, sensor.electrode_xy, float(sensor.electrode_diameter), "k")
    axes.set_title(
        "The sheet's resistance; arrows: how far the electrodes\n"
        f"are off their nominal places, enlarged {enlarged:g} times"
    )
    axes.plot([], [], "o", mfc="none", mec="k", ms=5, label="electrodes, nominal")
    below = {"loc": "upper left", "bbox_to_anchor": (0, -0.1), "frameon": False}
    axes.legend(fontsize=8, ncols=2, **below)
    return figure
