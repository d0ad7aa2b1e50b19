"""Lists orders that electrodes may have: those of a grid, of a symmetry, of a plug."""

import numpy as np
from jaxtyping import Integer

from tomojax.bringup.sheet._plane import Plane

# Electrodes in one row or column are in line to this part of a pitch.
_LINE = 0.25


def lattice(plane: Plane) -> tuple[int, int] | None:
    """Returns rows and columns, if electrodes lie on a grid ordered as `Sensor.grid`."""
    m = plane.count
    for columns in range(1, m + 1):
        if m % columns:
            continue
        rows = m // columns
        at = plane.xy.reshape(rows, columns, 2)
        slack = _LINE * plane.pitch
        off = max(np.ptp(at[..., 0], 1).max(), np.ptp(at[..., 1], 0).max())
        steps = np.append(np.diff(at[:, 0, 0]), np.diff(at[0, :, 1]))
        if off < slack and (steps > slack).all():
            return rows, columns
    return None


def symmetries(plane: Plane) -> dict[str, Integer[np.ndarray, " M"]]:
    """Lists symmetries: the electrode at each electrode's image, where all have one.

    The symmetries are images of the sheet onto itself, by name, `identity` first.
    """
    (a, b), (x, y) = plane.size, plane.xy.T
    images = {
        "identity": (x, y),
        "mirrored along x": (a - x, y),
        "mirrored along y": (x, b - y),
        "turned by 180°": (a - x, b - y),
    }
    if abs(a - b) < 1e-3 * max(a, b):
        images |= {
            "mirrored, x and y exchanged": (y, x),
            "turned by 90°": (a - y, x),
            "turned by −90°": (y, a - x),
            "mirrored at the other diagonal": (a - y, a - x),
        }
    found = {}
    for name, image in images.items():
        apart = np.hypot(*(np.stack(image, 1)[:, None] - plane.xy).transpose(2, 0, 1))
        nearest = apart.argmin(1)
        whole = len(np.unique(nearest)) == plane.count
        if whole and apart.min(1).max() < _LINE * plane.pitch:
            found[name] = nearest
    return found


def starts(plane: Plane) -> dict[str, Integer[np.ndarray, " M"]]:
    """Lists orders of channels to begin with: as stated, and those of a plug or a loop."""
    m = np.arange(plane.count)
    found = {"as told": m, "one on": np.roll(m, -1), "one back": np.roll(m, 1)}
    grid = lattice(plane)
    if grid is not None:
        index = m.reshape(grid)
        found["rows for columns"] = index.T.ravel()
        found["columns for rows"] = m.reshape(grid[::-1]).T.ravel()
        for name, first in (("every second row reversed", 1), ("first row reversed", 0)):
            winding = index.copy()
            winding[first::2] = winding[first::2, ::-1]
            found[name] = winding.ravel()
    return found
