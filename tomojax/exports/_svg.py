"""Writes SVG: contacts' paths on the sheet and their strength, as a figure of a paper."""

from pathlib import Path

import numpy as np

from tomojax._pictures import lay_sheet, style
from tomojax._whole import whole
from tomojax.exports._overview import draw_overview, overview
from tomojax.exports._source import Progress, Source
from tomojax.results import outlines_of
from tomojax.results.loading import strength

# Points of a path that a picture shows.
_POINTS = 20_000


def write(source: Source, out: Path, progress: Progress) -> None:
    """Draws one picture; each contact has one colour from touch-down to lift-off."""
    from matplotlib.figure import Figure

    told = overview(source)
    figure = Figure(figsize=(6.0, 7.0), layout="constrained")
    sheet, line = figure.subplots(2, 1, height_ratios=(4, 1))
    lay_sheet(sheet, source.box, source.electrode_xy, outline=source.outline)
    tracked = "contact_track" in source.names
    step = max(1, -(-source.rows // _POINTS))
    xy = 1e3 * source.thinned("contact_xy", step)
    progress(source.rows, source.rows)
    if tracked:
        track = source.thinned("contact_track", step)
        for number in np.unique(track[track > 0]):
            sheet.plot(*xy[track == number].T, lw=1, color=style(int(number))["color"])
    else:
        for c in range(xy.shape[1]):
            look = style(c, linestyle="none", markersize=2, label=f"{c + 1}")
            sheet.plot(*xy[:, c].T, **look)
        if xy.shape[1] > 1 and np.isfinite(xy[:, 1]).any():
            sheet.legend(title="by strength", fontsize=8, markerscale=3)
    words = "Paths of contacts"
    if "touch" in source.names:
        k = _most(source)
        words += f"; outlines at {float(source.row('t', k)):.3f} s"
        for one in outlines_of(source.row("touch", k), source.size):
            for ring in one.rings:
                sheet.plot(*(1e3 * ring.T), color="k", lw=1)
    sheet.set_title(words)
    draw_overview(line, told)
    with whole(out) as part:
        figure.savefig(part, metadata={"Date": None})


def _most(source: Source) -> int:
    """Returns the row with the largest sum over contacts."""
    name = strength(source.names)[0]
    totals = [np.nansum(b[name].astype(float), 1) for b in source.blocks([name])]
    return int(np.concatenate(totals).argmax())
