"""Draws pictures with matplotlib, which is an extra."""

import numpy as np
from matplotlib.axes import Axes

from tomojax.sensor import Sensor


def sheet(axes: Axes, sensor: Sensor, values: np.ndarray, label: str, **style) -> None:
    """Draws one value per element, seen from above, with the electrodes' outlines; mm."""
    image = np.asarray(values).reshape(*sensor.divisions, 2).mean(-1)
    w, h = 1e3 * np.asarray(sensor.size)
    picture = axes.imshow(
        image.T, origin="lower", extent=(0, w, 0, h), interpolation="nearest", **style
    )
    radius = 500 * float(sensor.electrode_diameter)
    for x, y in 1e3 * np.asarray(sensor.electrode_xy):
        axes.add_patch(_circle(x, y, radius))
    axes.set(xlabel="x, mm", ylabel="y, mm")
    axes.figure.colorbar(picture, ax=axes, label=label, shrink=0.8)


def _circle(x: float, y: float, radius: float):
    from matplotlib.patches import Circle

    return Circle((x, y), radius, fill=False, color="0.6", linewidth=0.6)
