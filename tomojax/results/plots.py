"""Pictures of a results file."""
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportCallIssue=false, reportOptionalMemberAccess=false, reportOperatorIssue=false
# (h5py does not say whether a name is a group or a dataset)

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tomojax.kernels.flags import Flag
from tomojax.plots import ellipses as ellipses
from tomojax.results.loading import LoadedResults

_POINTS = 20_000  # more than a picture shows


def timeline(path: Path) -> Figure:
    """Places and currents of the contacts over time, the path on the sheet, and flags."""
    with LoadedResults(path) as file:
        step = max(1, -(-file.rows // _POINTS))
        t, xy, current, flags, residual = (
            file.thinned(name, step)
            for name in ("t", "contact_xy", "contact_current", "flags", "residual")
        )
        image, unit, each, electrodes = None, "", None, np.zeros((0, 2))
        if "image" in file.names:
            strongest = _strongest(file)
            image = file.stretch("image", strongest, strongest + 1)[0]
            unit = file.unit("image").get("unit", "")
            name = "residual_by_electrode"
            if name in file.names and "electrode_xy" in file.attributes:
                each = 1e3 * file.stretch(name, strongest, strongest + 1)[0]
                electrodes = 1e3 * file.electrode_xy()
        covariance = None
        if "contact_covariance" in file.names:
            covariance = file.thinned("contact_covariance", step)
        width, height = 1e3 * file.size()
    figure = Figure(figsize=(14, 8), layout="constrained")
    grid = figure.add_gridspec(4, 3)
    left = [figure.add_subplot(grid[k, :2]) for k in range(4)]
    for c in range(max(1, int(np.isfinite(current).any(0).sum()))):
        style = {"ls": "none", "marker": ".", "ms": 3, "color": f"C{c}"}
        left[0].plot(t, 1e3 * xy[:, c, 0], **style)
        left[1].plot(t, 1e3 * xy[:, c, 1], **style)
        left[2].plot(t, 1e6 * current[:, c], **style, label=f"{c + 1}")
    for axes, label in zip(left, ("x, mm", "y, mm", "current, µA")):
        axes.set_ylabel(label)
        axes.sharex(left[3])
    left[2].legend(title="contact", loc="upper right", markerscale=3, fontsize=8)
    found = [f for f in Flag if (flags & f.value).any()]
    for k, flag in enumerate(found):
        when = t[flags & flag.value > 0]
        left[3].plot(when, np.full(len(when), k), "|", color="C3" if flag.level else "0.5")
    left[3].set_yticks(range(len(found)), [str(f.name) for f in found], fontsize=7)
    left[3].set(xlabel="s", ylim=(-0.5, max(0.5, len(found) - 0.5)))
    path_axes = figure.add_subplot(grid[:2, 2])
    dots = path_axes.scatter(*(1e3 * xy[:, 0].T), c=t, s=4)
    figure.colorbar(dots, ax=path_axes, label="s")
    path_axes.set(xlabel="x, mm", ylabel="y, mm", aspect="equal", title="strongest contact")
    if covariance is not None:
        ellipses(path_axes, xy[:, 0], covariance[:, 0])
    path_axes.set(xlim=(0, width), ylim=(0, height))
    other = figure.add_subplot(grid[2:, 2])
    if image is None:
        other.plot(t, 1e3 * residual, ".", ms=2)
        other.set(xlabel="s", ylabel="residual, mV")
    else:
        shown = other.imshow(image.T, origin="lower", extent=(0, width, 0, height))
        figure.colorbar(shown, ax=other, label=unit)
        title = "image at the largest current"
        if each is not None:
            shown = other.scatter(*electrodes.T, c=each, s=18, cmap="cool", lw=0)
            figure.colorbar(shown, ax=other, label="residual of each electrode, mV")
        other.set(title=title, xlabel="x, mm", ylabel="y, mm")
    return figure


def _strongest(file: LoadedResults) -> int:
    current = np.nan_to_num(file.read("contact_current")[:, 0])
    return int(current.argmax())


def still(figure: Figure, moving: list):
    """Draws all but the artists `moving`; returns the canvas and its pixels.

    Matplotlib lays a figure out anew for each drawing, in 0.4 s: here it does so once.
    """
    canvas = FigureCanvasAgg(figure)
    for _ in range(2):  # the second layout starts from the sizes that the first one found
        canvas.draw()
    figure.set_layout_engine("none")  # what is laid out stays where it is
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    return canvas, canvas.copy_from_bbox(figure.bbox)
