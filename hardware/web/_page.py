"""Makes the page's figures once by Bokeh; data come later, by the names given here."""
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false
# pyright: reportOptionalMemberAccess=false
# (Bokeh's properties take more than their types say)

from typing import Any

import numpy as np

from tomojax.kernels.flags import Flag

_GREY, _BLUE, _ORANGE, _RED = "#8a8f98", "#2b6cb0", "#dd7711", "#c53030"

# Columns of each source, by its name: the page puts new ones into them.
SOURCES = {
    "image": ("image",),
    "contacts": ("x", "y", "label"),
    "ellipses": ("x", "y", "w", "h", "angle"),
    "trails": ("x", "y", "age"),
    "line": ("t", "count", "low", "high"),
    "doubts": ("t", "name", "colour"),
    "marks": ("t", "text", "name", "align"),
    "now": ("t",),
    "volts": ("electrode", "volts"),
    "residuals": ("electrode", "residual"),
    "spectrum": ("f", "volts"),
}

_LEVELS = {0: _GREY, 1: _ORANGE, 2: _RED}


def document(
    box: Any,
    electrode_xy: Any,
    image_shape: tuple[int, int] | None,
    image_label: str,
    span: tuple[float, float],
    strength: str,
    lines: Any = None,
) -> dict[str, Any]:
    """Returns what the page embeds: Bokeh's document, and where each figure goes.

    - `box` of the sheet, its size or its lowest and highest corner, and `electrode_xy`: m.
    - `image_shape`: pixels along x and y, or None without an image.
    - `span`: the time line's beginning and end, s.
    - `strength`: the label of the contacts' strength, with the unit.
    - `lines`: closed lines (n, 2) around the sheet and its holes, m; None: it is a box.
    """
    from bokeh.document import Document
    from bokeh.embed.util import standalone_docs_json_and_render_items
    from bokeh.models import ColumnDataSource

    data: dict[str, dict[str, Any]] = {n: {c: [] for c in cs} for n, cs in SOURCES.items()}
    nx, ny = image_shape or (1, 1)
    data["image"] = {"image": [np.zeros((ny, nx), np.float32)]}
    sources = {n: ColumnDataSource(columns, name=n) for n, columns in data.items()}
    figures = {
        "sheet": _sheet(sources, box, electrode_xy, image_shape, image_label, lines),
        **_lines(sources, span, strength),
        **_electrodes(sources, len(electrode_xy)),
    }
    whole = Document()
    for one in figures.values():
        whole.add_root(one)
    docs, (item,) = standalone_docs_json_and_render_items(whole)
    told = item.to_json()
    told["roots"] = {figure.id: name for name, figure in figures.items()}
    return {"docs": docs, "items": [told]}


def _figure(name: str, **given: Any) -> Any:
    from bokeh.plotting import figure

    made = figure(
        name=f"{name}-figure",
        sizing_mode="stretch_both",
        output_backend="canvas",
        toolbar_location=None,
        min_border_right=12,
        **{"tools": ""} | given,
    )
    made.xgrid.grid_line_color = made.ygrid.grid_line_color = "#e2e5ea"
    made.title.text_font_style = "normal"
    for axis in made.axis:
        axis.axis_label_text_font_style = "normal"
    return made


def _sheet(sources, box, electrode_xy, image_shape, image_label, lines) -> Any:
    from bokeh.models import ColorBar, LinearColorMapper, Range1d

    box = 1e3 * np.asarray(box, float)
    (x0, y0), (x1, y1) = box if box.ndim == 2 else (0 * box, box)
    more = 0.03 * max(x1 - x0, y1 - y0)
    sheet = _figure(
        "sheet",
        x_range=Range1d(x0 - more, x1 + more),
        y_range=Range1d(y0 - more, y1 + more),
        x_axis_label="x, mm",
        y_axis_label="y, mm",
    )
    if image_shape is not None:
        colours = LinearColorMapper(
            "Greys256", low=0, high=1, name="colours", nan_color="rgba(0, 0, 0, 0)"
        )
        colours.palette = colours.palette[::-1]
        sheet.image(
            "image", source=sources["image"], x=x0, y=y0, dw=x1 - x0, dh=y1 - y0,
            color_mapper=colours,
        )  # fmt: skip
        sheet.add_layout(ColorBar(color_mapper=colours, title=image_label), "above")
    x, y = (1e3 * np.asarray(electrode_xy, float)).T.tolist()
    names = [str(k) for k in range(len(x))]
    sheet.scatter(x, y, size=5, fill_color=None, line_color="#7aa7d9", line_alpha=0.8)
    if len(x) <= 100:
        sheet.text(
            x, y, names, text_font_size="8px", text_color="#5f86b3", x_offset=4, y_offset=-2
        )
    if lines is None:
        lines = [1e-3 * np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])]
    closed = [1e3 * np.concatenate([line, line[:1]]) for line in lines]
    sheet.multi_line(
        [line[:, 0].tolist() for line in closed], [line[:, 1].tolist() for line in closed],
        line_color=_GREY,
    )  # fmt: skip
    sheet.scatter(
        "x", "y", source=sources["trails"], size=3, color=_ORANGE, alpha="age",
    )  # fmt: skip
    sheet.ellipse(
        "x", "y", width="w", height="h", angle="angle", source=sources["ellipses"],
        fill_color=_RED, fill_alpha=0.15, line_color=_RED,
    )  # fmt: skip
    sheet.scatter(
        "x", "y", source=sources["contacts"], size=13, marker="circle_cross",
        fill_color=None, line_color=_RED, line_width=2,
    )  # fmt: skip
    sheet.text(
        "x", "y", "label", source=sources["contacts"], x_offset=11, y_offset=-9,
        text_color=_RED, text_font_size="13px", text_font_style="bold",
        background_fill_color="white", background_fill_alpha=0.75, padding=2,
    )  # fmt: skip
    return sheet


def _lines(sources, span, strength) -> dict[str, Any]:
    from bokeh.models import FactorRange, Range1d

    times = Range1d(*span, name="times")
    tools = "xpan,xwheel_zoom"
    given = {"x_range": times, "tools": tools, "active_scroll": "xwheel_zoom"}
    count = _figure("count", y_axis_label="contacts", **given)
    count.step("t", "count", source=sources["line"], mode="after", color=_BLUE)
    count.y_range.start = 0
    count.yaxis.ticker.desired_num_ticks = 3
    amount = _figure("strength", y_axis_label=strength, **given)
    amount.varea("t", "low", "high", source=sources["line"], color=_BLUE, alpha=0.35)
    amount.line("t", "high", source=sources["line"], color=_BLUE)
    amount.yaxis.ticker.desired_num_ticks = 4
    names = [str(flag.name) for flag in Flag]
    flags = _figure(
        "flags",
        y_range=FactorRange(factors=names[:1], name="names"),
        x_axis_label="time, s",
        **given,
    )
    flags.scatter(
        "t", "name", source=sources["doubts"], marker="dash", angle=np.pi / 2, size=9,
        color="colour",
    )  # fmt: skip
    flags.text(
        "t", "name", "text", source=sources["marks"], text_color="#276749",
        text_align="align", text_baseline="middle", text_font_size="11px",
    )  # fmt: skip
    for figure in (count, amount, flags):
        figure.min_border_left = 200
        figure.vspan("t", source=sources["marks"], line_color="#276749", line_width=2)
        figure.vspan("t", source=sources["now"], line_color=_RED)
    return {"count": count, "strength": amount, "flags": flags}


def _electrodes(sources, electrodes: int) -> dict[str, Any]:
    from bokeh.models import Range1d

    ends = Range1d(-1, electrodes)
    volts = _figure("volts", x_range=ends, x_axis_label="electrode", y_axis_label="V")
    volts.vbar("electrode", 0.8, "volts", source=sources["volts"], color=_BLUE)
    volts.title.text = "voltages of this slot"
    residuals = _figure(
        "residuals", x_range=ends, x_axis_label="electrode", y_axis_label="mV"
    )
    residuals.vbar("electrode", 0.8, "residual", source=sources["residuals"], color=_ORANGE)
    residuals.title.text = "residual by electrode"
    spectrum = _figure(
        "spectrum",
        y_axis_type="log",
        x_axis_label="frequency, Hz",
        y_axis_label="amplitude, V",
    )
    spectrum.line("f", "volts", source=sources["spectrum"], color=_BLUE)
    spectrum.title.text = "spectrum of one electrode's voltages"
    return {"volts": volts, "residuals": residuals, "spectrum": spectrum}


def flag_rows(t: Any, flags: Any) -> dict[str, list]:
    """Returns the times of each flag, as columns of the source `doubts`."""
    found: dict[str, list] = {"t": [], "name": [], "colour": []}
    flags = np.asarray(flags, np.uint32)
    for flag in Flag:
        when = np.asarray(t)[(flags & flag.value) > 0].tolist()
        found["t"] += when
        found["name"] += [str(flag.name)] * len(when)
        found["colour"] += [_LEVELS[int(flag.level)]] * len(when)
    return found
