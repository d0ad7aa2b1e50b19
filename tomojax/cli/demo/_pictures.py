"""Pictures of a demo's scene: what touched, the paper's image, and what was found."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure

from tomojax._pictures import draw_outline
from tomojax.recordings import Recording
from tomojax.results.loading import LoadedResults

_MOMENTS = 4  # of the still picture
_RATE = 12  # pictures a second of the film, as a page needs
_MAP = "cividis"  # it survives a grey print and colour-blind eyes


class Told:
    """The truth of a scan, the image of Eq. 3 and what the results say; all 0 to 1."""

    def __init__(self, recording: Recording, truth: np.ndarray, results: Path):
        self.truth, self.paper = truth.astype(float), _eq3(recording)
        self.grounds = np.asarray(recording.read(0, 1).grounds[0])
        side = truth.shape[1]
        with LoadedResults(results) as file:
            names = ("t", "contact_count", "contact_xy", "contact_radius")
            self.t, self.count, self.xy, radius = (file.read(name) for name in names)
            self.size, self.electrodes = file.size(), file.electrode_xy()
            touch = file.read("touch") if "touch" in file.names else None
            self.outline = file.outline()
        if touch is not None:
            self.found = np.nan_to_num(touch)
        else:
            self.found = _discs(self.xy, radius, self.size, side)
        sensor = recording.rig.sensor()
        for images in (self.truth, self.paper, self.found):
            images[:, ~_on_sheet(sensor, images.shape[1])] = np.nan  # stays empty

    def moments(self) -> list[int]:
        """Rows that show much, one in each part of the recording."""
        parts = np.array_split(np.arange(len(self.t)), _MOMENTS)
        much = np.nansum(self.truth, (1, 2))
        return [int(part[much[part].argmax()]) for part in parts]


def _on_sheet(sensor: Any, side: int) -> Bool[np.ndarray, "side side"]:
    """Tells whose middles are on the sheet, of so many pixels a side."""
    points = np.indices((side, side)).reshape(2, -1).T + 0.5
    inside = sensor.on_sheet(points / side * np.asarray(sensor.size))
    return np.asarray(inside).reshape(side, side)


def _eq3(recording: Recording) -> Float[np.ndarray, "rows nx ny"]:
    """The image of the paper's Eq. 3 of each scan, of its own largest value."""
    import tomojax as tx

    sensor = recording.rig.sensor()
    chunk = recording.read(0, recording.scans)
    frames = tx.methods.Frame
    method = tx.method(sensor, "linear", 32)
    some = chunk.voltages[:: max(1, len(chunk.voltages) // 8)]
    grounds = chunk.grounds[0]
    told = [frames(v, grounds, np.isfinite(v)) for v in np.asarray(some)]
    batch = tx.Batch(method, method.choose_lambda(told))
    image = np.asarray(batch(chunk.voltages, chunk.grounds).image)
    top = np.nanmax(image, (1, 2), keepdims=True)
    # A scan without a contact has noise alone, which is not to be blown up.
    return np.nan_to_num(np.clip(image / np.maximum(top, 0.05 * np.nanmax(top)), 0, 1))


def _discs(xy, radius, size, side: int) -> Float[np.ndarray, "rows side side"]:
    """Contacts as discs; one whose radius is not told has that of a finger, 6 mm."""
    part = (np.arange(side) + 0.5) / side
    x, y = np.meshgrid(part * size[0], part * size[1], indexing="ij")
    far = np.hypot(
        x - np.asarray(xy)[..., 0, None, None], y - np.asarray(xy)[..., 1, None, None]
    )
    wide = np.where(np.isfinite(radius), radius, 0.006)[..., None, None]
    return np.nan_to_num(far < wide).any(1).astype(float)


class _Panels:
    """Three sheets side by side: truth, Eq. 3, found."""

    def __init__(self, told: Told, place, titles: bool = True):
        self.told, self.shown = told, []
        width, height = 1e3 * told.size
        slots = f"{len(told.grounds)} slots a scan"
        words = ("what touches", f"the paper's Eq. 3,\n{slots}", f"tomojax,\n{slots}")
        for axes, title in zip(place, words):
            style = {"origin": "lower", "cmap": _MAP, "vmin": 0, "vmax": 1}
            style["interpolation"] = "bilinear"
            extent = (0, width, 0, height)
            self.shown.append(axes.imshow(told.truth[0].T, extent=extent, **style))
            axes.plot(*(1e3 * told.electrodes.T), ".", color="0.6", ms=2)
            axes.plot(*(1e3 * told.electrodes[told.grounds].T), "v", color="w", ms=3)
            draw_outline(axes, told.outline)
            axes.set(xlim=(0, width), ylim=(0, height), xlabel="x, mm")
            if titles:
                axes.set_title(title, fontsize=10)
        place[0].set_ylabel("y, mm")

    def show(self, row: int) -> None:
        """Sets the images of a row."""
        for shown, images in zip(
            self.shown, (self.told.truth, self.told.paper, self.told.found)
        ):
            shown.set_data(images[row].T)


def still(told: Told, words: str) -> Figure:
    """Draws some moments: a line each, with truth, Eq. 3 and what was found."""
    figure = Figure(figsize=(7.2, 2.35 * _MOMENTS + 0.8), layout="constrained")
    grid = figure.subplots(_MOMENTS, 3, squeeze=False)
    figure.suptitle(words[0].upper() + words[1:], fontsize=12)
    for number, (place, row) in enumerate(zip(grid, told.moments())):
        panels = _Panels(told, place, titles=number == 0)
        panels.show(row)
        place[0].set_ylabel(f"{told.t[row]:.3f} s\ny, mm")
        if number < _MOMENTS - 1:
            for axes in place:
                axes.set_xlabel("")
    label = "touched: 0 no, 1 yes (Eq. 3: of its highest); ▽ grounded electrodes"
    shown = grid[0, 0].images[0]
    bar = figure.colorbar(shown, ax=grid, location="bottom", shrink=0.6)
    bar.set_label(label)
    return figure


def film(told: Told, out: Path, slow: float, progress: Callable[[int, int], None]) -> None:
    """Draws a GIF of truth, Eq. 3 and what was found, `slow` times slower than it was."""
    from PIL import Image

    from tomojax.results.plots import still as keep

    figure = Figure(figsize=(7.2, 3.1), dpi=90, layout="constrained")
    place = figure.subplots(1, 3)
    panels = _Panels(told, place)
    (rings,) = place[2].plot([], [], "+", color="w", ms=9, mew=1.5)
    title = figure.suptitle(" " * 40, fontsize=10)
    time = place[0].text(
        0.5, 0.02, "", transform=place[0].transAxes, color="w", ha="center"
    )
    title.set_text(f"{slow:g} times slower than it was;  + a contact;  ▽ grounded")
    moving = [*panels.shown, *(a for axes in place for a in axes.lines), time]
    pixels = keep(figure, moving)
    due = np.arange(told.t[0], told.t[-1], 1 / (_RATE * slow))
    rows = np.searchsorted(told.t, due + 1e-9, "right") - 1
    frames = []
    for number, row in enumerate(rows.tolist()):
        panels.show(row)
        rings.set_data(*(1e3 * told.xy[row, : told.count[row]].T))
        time.set_text(f"{told.t[row]:.3f} s")
        frame = Image.fromarray(pixels()[..., :3])
        frames.append(frame.quantize(64, dither=Image.Dither.NONE))
        progress(number + 1, len(rows))
    first, *rest = frames
    first.save(out, save_all=True, append_images=rest, duration=1000 // _RATE, loop=0)
