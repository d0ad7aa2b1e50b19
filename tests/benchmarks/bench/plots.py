"""Draws pictures with matplotlib, which is an extra."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tomojax._pictures import DENSITY, lay_sheet, show_image, VALUE
from tomojax.sensor import Sensor


def sheet(axes: Axes, sensor: Sensor, values: np.ndarray, label: str, **style) -> None:
    """Draws one value per element, seen from above, with the electrodes' outlines; mm."""
    image = np.asarray(values).reshape(*sensor.divisions, 2).mean(-1)
    show_image(axes, image, sensor.size, label, **{"cmap": VALUE} | style)
    lay_sheet(axes, sensor.size, sensor.electrode_xy, float(sensor.electrode_diameter))


def gallery(figure: Figure, lines: dict[str, Any], size: Any, names: Any = ()) -> None:
    """Draws lines of images, each by its title; an image is shown as parts of its largest.

    The largest is what one pixel in 500 exceeds; `names` stand above the columns.
    """
    width, height = 1e3 * np.asarray(size, float)
    count = max(len(images) for images in lines.values())
    grid = figure.subplots(len(lines), count, squeeze=False, sharex=True, sharey=True)
    shown = None
    for row, (title, images) in enumerate(lines.items()):
        axes = grid[row]
        for place, image in zip(axes, images):
            image = np.asarray(image, float)
            top = float(np.quantile(image, 0.998)) or 1.0
            shown = place.imshow(
                image.T / top, origin="lower", extent=(0, width, 0, height),
                cmap=DENSITY, vmin=0, vmax=1,
            )  # fmt: skip
            place.set(xticks=(0, width), yticks=(0, height))
        above = "\n" if len(names) and row == 0 else ""  # the column's name is below
        axes[0].set_title(title + above, loc="left", fontsize=10)
    for place in grid[-1, 1:]:  # one picture's labels would stand on the next one's
        place.tick_params(labelbottom=False)
    for place, name in zip(grid[0], names):
        place.set_title(name, fontsize=9)
    figure.supxlabel("x, mm")
    figure.supylabel("y, mm")
    figure.colorbar(shown, ax=grid, label="image / its largest value", shrink=0.5)
