"""Draws pictures with matplotlib, which is an extra."""

import numpy as np
from matplotlib.axes import Axes

from tomojax._pictures import lay_sheet, show_image, VALUE
from tomojax.sensor import Sensor


def sheet(axes: Axes, sensor: Sensor, values: np.ndarray, label: str, **style) -> None:
    """Draws one value per element, seen from above, with the electrodes' outlines; mm."""
    image = np.asarray(values).reshape(*sensor.divisions, 2).mean(-1)
    show_image(axes, image, sensor.size, label, **{"cmap": VALUE} | style)
    lay_sheet(axes, sensor.size, sensor.electrode_xy, float(sensor.electrode_diameter))
