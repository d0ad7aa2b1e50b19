"""One look for all pictures: a method has the same colour and marker everywhere.

The colours are those of Okabe and Ito (2008), which colour-blind eyes tell apart. Markers
and dashes differ too, so that a grey print can be read. matplotlib is an extra: it is
imported inside the functions.
"""

from typing import Any, NamedTuple

import numpy as np

BLUE, SKY, GREEN, ORANGE = "#0072B2", "#56B4E9", "#009E73", "#E69F00"
VERMILION, PURPLE, WINE, BLACK = "#D55E00", "#CC79A7", "#882255", "#000000"
GREY = "0.55"  # peers, older commits, what is told and not found

# Colour maps: of densities, which are 0 where nothing is; of other values; of two signs.
DENSITY, VALUE, SIGNED = "magma", "viridis", "PuOr_r"


class Look(NamedTuple):
    """How the points and the line of one thing are drawn."""

    color: str
    marker: str
    linestyle: Any = "-"


METHODS = {
    "linear": Look(VERMILION, "v"),
    "source": Look(ORANGE, "s"),
    "points": Look(BLUE, "o"),
    "shape": Look(WINE, "P"),
    "auto": Look(BLACK, "X", (0, (4, 2))),
    "follow": Look(SKY, "d", "-."),
    # In runs of before `shape` took their place.
    "positive": Look(PURPLE, "D", "--"),
    "conductance": Look(GREEN, "^"),
}

# Looks of things that are no methods, in this order.
LOOKS = (
    Look(BLUE, "o"),
    Look(ORANGE, "s", "--"),
    Look(GREEN, "^", "-."),
    Look(VERMILION, "v", ":"),
    Look(PURPLE, "D", (0, (5, 1, 1, 1, 1, 1))),
    Look(BLACK, "X", (0, (1, 1))),
    Look(SKY, "d", (0, (4, 2))),
    Look(WINE, "P", (0, (6, 2))),
)


def style(name: str | int, **more: Any) -> dict[str, Any]:
    """Returns what `Axes.plot` needs to draw a method, or the thing of that number."""
    look = METHODS[name] if isinstance(name, str) else LOOKS[name % len(LOOKS)]
    return {"markersize": 4, **look._asdict(), **more}


def plain(*axes: Any) -> None:
    """Labels logarithmic axes (`Axes.xaxis`, …) with plain numbers, as 0.5 for 5 × 10⁻¹.

    The limits have to be set before. Beyond six decades powers of ten stay.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis in axes:
        low, high = sorted(axis.get_view_interval())
        decades = np.log10(high / low)
        if decades > 6 or low < 1e-4 or high > 1e7:
            continue
        steps = (1, 2, 5) if decades < 2 else (1, 3) if decades < 3 else (1,)
        axis.set_major_locator(LogLocator(subs=steps, numticks=20))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
        axis.set_minor_formatter(NullFormatter())


def lay_sheet(
    axes: Any,
    box: Any,
    electrode_xy: Any,
    diameter: float = 0.0,
    color: str = "0.6",
    outline: Any = None,
) -> Any:
    """Sets the axes to a sheet seen from above, in mm, with the outlines of its electrodes.

    Returns the outlines. Lengths in m. `box`: its size, or its lowest and its highest
    corner. Without a diameter an electrode is a small ring.
    `outline`: closed lines of a sheet that does not fill its box.
    """
    from matplotlib.collections import EllipseCollection

    low, high = 1e3 * corners(box)
    xy = 1e3 * np.asarray(electrode_xy, float).reshape(-1, 2)
    across = np.full(len(xy), 1e3 * diameter or 0.02 * (high - low).min())
    outlines = EllipseCollection(
        across, across, np.zeros(len(xy)), units="xy", offsets=xy,
        offset_transform=axes.transData, facecolors="none", edgecolors=color,
        linewidths=0.6,
    )  # fmt: skip
    axes.add_collection(outlines)
    draw_outline(axes, outline, color)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set(xlabel="x, mm", ylabel="y, mm")
    return outlines


def corners(box: Any) -> np.ndarray:
    """Returns the lowest and the highest corner of a box that its size may stand for."""
    box = np.asarray(box, float)
    return box if box.ndim == 2 else np.stack([0 * box, box])


def draw_outline(axes: Any, lines: Any, color: str = "0.6") -> None:
    """Draws closed lines, m, on axes in mm."""
    for line in lines or ():
        closed = 1e3 * np.concatenate([line, line[:1]])
        axes.plot(*closed.T, color=color, lw=0.9, zorder=1.2, scalex=False, scaley=False)


def show_image(
    axes: Any, image: Any, size: Any, label: str, extend: str = "neither", /, **more: Any
) -> Any:
    """Draws an image (nx, ny) of the whole sheet, in mm, and its colour bar; size in m."""
    width, height = 1e3 * np.asarray(size, float)
    look = {"cmap": DENSITY, "origin": "lower", "extent": (0, width, 0, height)}
    shown = axes.imshow(np.asarray(image).T, **(look | more))
    axes.set(xlabel="x, mm", ylabel="y, mm")
    axes.figure.colorbar(shown, ax=axes, label=label, extend=extend)
    return shown


def name_points(
    axes: Any, points: list[tuple[str, Any, Any]], size: int = 7, aside: float = 6.0
) -> None:
    """Writes names beside points, a little higher or lower where they would overlap.

    `aside`: how far from a point's middle its name begins; `size`: of letters, both points.
    """
    from matplotlib.transforms import Bbox

    axes.figure.draw_without_rendering()
    at = [axes.transData.transform((x, y)) for _, x, y in points]
    mark = 0.8 * aside * axes.figure.dpi / 72
    taken = [Bbox.from_extents(x - mark, y - mark, x + mark, y + mark) for x, y in at]
    left, right = axes.bbox.x0, axes.bbox.x1
    for (name, *xy), (x, _) in zip(points, at):
        late = x > left + 0.75 * (right - left)
        beside, side = (-aside, "right") if late else (aside, "left")
        text = axes.annotate(
            name, xy, (beside, 0), textcoords="offset points", fontsize=size, ha=side,
            va="center",
        )  # fmt: skip
        # 0, 1, -1, 2, -2, … points up.
        for step in range(1, 200):
            text.set_position((beside, step // 2 * (-1) ** step))
            if not any(text.get_window_extent().overlaps(other) for other in taken):
                break
        taken.append(text.get_window_extent())
