"""Draws pictures of a results file."""
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportCallIssue=false, reportOptionalMemberAccess=false, reportOperatorIssue=false
# (h5py does not say whether a name is a group or a dataset)

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tomojax._pictures import GREY, lay_sheet, show_image, style, VALUE, VERMILION
from tomojax.kernels.flags import DOUBT, Flag
from tomojax.plots import ellipses
from tomojax.results.loading import LoadedResults

_POINTS = 20_000  # more than a picture shows

_LARGEST = 40.0  # square points; the area of the dot of the largest current
_SMALLEST = 2.0  # square points; of the smallest dot


def timeline(path: Path) -> Figure:
    """Draws contacts' places and currents over time, the path on the sheet, and flags."""
    with LoadedResults(path) as file:
        step = max(1, -(-file.rows // _POINTS))  # so many rows as a picture shows
        pressed = "contact_strength" in file.names
        strength = "contact_strength" if pressed else "contact_current"
        names = ["t", "contact_xy", strength, "flags", "residual"]
        names += {"contact_covariance"} & set(file.names)
        rows = {name: file.thinned(name, step) for name in names}
        rows["strength"] = abs(rows[strength]) * (1 if pressed else 1e6)
        rows["residual"] = rows["residual"] * (1 if pressed else 1e3)
        shown = _largest(file) if "image" in file.names else {}
        size, box, electrodes = file.size(), file.box(), np.zeros((0, 2))
        if "electrode_xy" in file.attributes:
            electrodes = file.electrode_xy()
        method, outline = str(file.attributes.get("method", "")), file.outline()
    figure = Figure(figsize=(14, 9), layout="constrained")
    of = f", found by {method}" if method else ""
    figure.suptitle(f"Contacts in {path.name}{of}")
    left, right = figure.subfigures(1, 2, width_ratios=(3, 2), squeeze=False)[0]  # pyright: ignore
    flags = _flags_of(rows["flags"])
    # A line of flags needs less height than a curve.
    heights = [1, 1, 1, 1, min(1.0, 0.15 + 0.12 * len(flags))]
    panels = left.subplots(5, 1, sharex=True, height_ratios=heights)
    told = "strength", "residual, deviations"
    _over_time(panels, rows, told if pressed else ("current, µA", "residual, mV rms"))
    maps = [n for n in ("image", "residual_by_electrode") if n in shown]
    sheets = right.subplots(1 + len(maps), 1, squeeze=False).ravel()
    right = dict(zip(("places", *maps), sheets))
    # A bar is as tall as its map: one map alone does not fill its column.
    tall = 0.9 if maps else 0.5
    _on_sheet(right["places"], rows, box, electrodes, outline, tall)
    if "image" in right:
        label = f"image, {shown['unit'].replace('^2', '²')}"
        show_image(right["image"], shown["image"], size, label)
        title = f"Image at {shown['t']:.3f} s, the largest current"
        right["image"].set_title(title, fontsize=11)
    if "residual_by_electrode" in right:
        each = shown["residual_by_electrode"]
        _on_electrodes(right["residual_by_electrode"], each, size, electrodes)
    return figure


def _largest(file: LoadedResults) -> dict[str, Any]:
    """Returns the image of the row of the largest current; sound rows come first."""
    current = np.nan_to_num(file.read("contact_current")).sum(1)
    sound = np.where(file.read("flags") & int(DOUBT), 0, current)
    k = int((sound if sound.any() else current).argmax())
    names = ("t", "image", "residual_by_electrode")
    told = {name: file.row(name, k) for name in names if name in file.names}
    return told | {"unit": file.unit("image")}


def _over_time(panels: Any, rows: dict[str, np.ndarray], words: tuple[str, str]) -> None:
    """Draws places, strengths, residuals and flags against time, one below the other."""
    t, xy, strength = rows["t"], rows["contact_xy"], rows["strength"]
    most = max(1, int(np.isfinite(strength).any(0).sum()))
    for c in range(most):
        look = style(c, linestyle="none", markersize=3, label=f"{c + 1}")
        panels[0].plot(t, 1e3 * xy[:, c, 0], **look)
        panels[1].plot(t, 1e3 * xy[:, c, 1], **look)
        panels[2].plot(t, strength[:, c], **look)
    panels[3].plot(t, rows["residual"], ".", color=GREY, markersize=3)
    for axes, label in zip(panels, ("x, mm", "y, mm", *words)):
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    title = "Contacts of each row" + ", 1 is the strongest" * (most > 1)
    panels[0].set_title(title, loc="left")
    if most > 1:
        place = {"loc": "lower right", "bbox_to_anchor": (1, 1), "ncols": 8}
        panels[0].legend(**place, markerscale=2, frameon=False)
    _flags(panels[4], t, rows["flags"])


def _flags_of(flags: np.ndarray) -> list[Flag]:
    return [flag for flag in Flag if (flags & flag.value).any()]


def _flags(axes: Any, t: np.ndarray, flags: np.ndarray) -> None:
    found = _flags_of(flags)
    for k, flag in enumerate(found):
        when = t[flags & flag.value > 0]
        look = {"color": VERMILION, "ms": 10} if flag.level else {"color": GREY, "ms": 5}
        axes.plot(when, np.full(len(when), k), "|", **look)
    names = [str(flag.name).lower().replace("_", " ") for flag in found]
    axes.set_yticks(range(len(found)), names, fontsize=8)
    axes.set(xlabel="time, s", ylim=(-0.5, max(0.5, len(found) - 0.5)))
    words = "Flags; high and red: the row is in doubt" if found else "No row has a flag"
    axes.set_title(words, loc="left", fontsize=10)


def _on_sheet(
    axes: Any,
    rows: dict,
    box: np.ndarray,
    electrodes: np.ndarray,
    outline: Any,
    tall: float,
) -> None:
    """Draws where contacts were: by time, the larger the stronger; rows in doubt grey."""
    lay_sheet(axes, box, electrodes, outline=outline)
    xy, strength = rows["contact_xy"], np.nan_to_num(rows["strength"])
    there = np.isfinite(xy).all(-1)
    doubt = there & (rows["flags"] & int(DOUBT) > 0)[:, None]
    axes.plot(*(1e3 * xy[doubt].T), "x", color=GREY, ms=3, mew=0.5, zorder=1)
    sound = there & ~doubt
    time = np.broadcast_to(rows["t"][:, None], sound.shape)[sound]
    area = _LARGEST * strength[sound] / max(float(strength.max(initial=0)), 1e-30)
    dots = axes.scatter(
        *(1e3 * xy[sound].T), c=time, s=np.maximum(area, _SMALLEST), cmap=VALUE, lw=0,
        zorder=2,
    )  # fmt: skip
    axes.figure.colorbar(dots, ax=axes, label="time, s", shrink=tall)
    crosses = "; crosses: in doubt" if doubt.any() else ""
    axes.set_title(f"Where contacts were{crosses}", fontsize=11)
    if enlarge(axes, 1e3 * xy[sound if sound.any() else there], 1e3 * box):
        axes.set_title(f"Where contacts were, enlarged{crosses}", fontsize=11)
    if "contact_covariance" in rows:
        ellipses(axes, xy[:, 0], rows["contact_covariance"][:, 0])


def enlarge(axes: Any, places: np.ndarray, box: np.ndarray) -> bool:
    """Shows only the part of the sheet with the places, where that is small; mm."""
    if not len(places):
        return False
    low, high = places.min(0), places.max(0)
    least, most = box
    half = 0.6 * float((high - low).max()) + 0.08 * float((most - least).max())
    small = 2 * half < 0.7 * (most - least).min()
    if small:
        # The window stays on the sheet.
        middle = np.clip((low + high) / 2, least + half, most - half)
        for limit, at in zip((axes.set_xlim, axes.set_ylim), middle):
            limit(at - half, at + half)
    return bool(small)


def _on_electrodes(axes: Any, each: np.ndarray, size: np.ndarray, xy: np.ndarray) -> None:
    """Draws what the model leaves unexplained at each electrode, in the image's row."""
    lay_sheet(axes, size, xy[:0])
    dots = axes.scatter(*(1e3 * xy.T), c=1e3 * each, s=40, cmap=VALUE, ec="0.5", lw=0.5)
    axes.figure.colorbar(dots, ax=axes, label="residual, mV rms")
    axes.set_title("Residual of each electrode in that row", fontsize=11)


def still(figure: Figure, moving: list) -> Callable[[], np.ndarray]:
    """Draws all but the artists `moving`; returns what draws these, and gives pixels.

    The pixels (height, width, 4) are overwritten by the next picture's. Matplotlib lays a
    figure out anew for each drawing, in 0.4 s; this function does so once.
    """
    canvas = FigureCanvasAgg(figure)
    for _ in range(2):  # the second layout starts from the sizes that the first one found
        canvas.draw()
    figure.set_layout_engine("none")  # what is laid out stays where it is
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)

    def draw() -> np.ndarray:
        canvas.restore_region(background)
        for artist in moving:
            artist.axes.draw_artist(artist)
        return np.asarray(canvas.buffer_rgba())

    return draw
