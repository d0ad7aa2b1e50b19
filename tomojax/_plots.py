"""Pictures. matplotlib is an extra and is imported by this module alone."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tomojax._sensor import Sensor


def sheet(axes: Axes, sensor: Sensor, values: np.ndarray, label: str, **style) -> None:
    """One value per element, seen from above, with the electrodes' outlines; mm."""
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


def scene_and_voltages(
    sensor: Sensor, conductance: np.ndarray, volts: np.ndarray, ground: int
) -> Figure:
    """A scene, the electrodes' voltages in one slot, and every slot's as a matrix."""
    figure = Figure(figsize=(14, 4.2), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    area = float(np.prod(np.asarray(sensor.size))) / sensor.element_count
    sheet(left, sensor, conductance / area, "contact, S/m²", cmap="magma_r")
    left.set_title("what touches the sheet")
    x, y = 1e3 * np.asarray(sensor.electrode_xy).T
    dots = middle.scatter(x, y, c=volts[ground], s=160, cmap="viridis", edgecolors="0.5")
    middle.plot(x[ground], y[ground], "rx", markersize=14, markeredgewidth=2)
    w, h = 1e3 * np.asarray(sensor.size)
    middle.set(xlim=(0, w), ylim=(0, h), xlabel="x, mm", ylabel="y, mm", aspect="equal")
    middle.set_title(f"voltages with electrode {ground} grounded (cross)")
    figure.colorbar(dots, ax=middle, label="V", shrink=0.8)
    matrix = right.imshow(volts, cmap="viridis", interpolation="nearest")
    right.set(xlabel="electrode", ylabel="grounded electrode")
    right.set_title("all slots")
    figure.colorbar(matrix, ax=right, label="V", shrink=0.8)
    return figure
