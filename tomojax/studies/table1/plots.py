"""Draws Table I: widths and speed beside the paper's, what they depend on, images."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tomojax._pictures import (
    BLUE,
    DENSITY,
    Look,
    LOOKS,
    name_points,
    ORANGE,
    plain,
    SKY,
    style,
)
from tomojax.studies.table1._study import PAPER, SHOWN, Study
from tomojax.studies.table1.report import rows, score, sensitivity

_LABELS = [name.replace("_", " ") for name in PAPER]


def table(study: Study) -> Figure:
    """Draws widths, place errors and Fig. 4's weighted score."""
    figure = Figure(figsize=(15, 9), layout="constrained")
    figure.suptitle("The nine patterns: the paper's Table I and what the physics predicts")
    (widths, places), (trade, scores) = figure.subplots(2, 2)
    found = rows(study)
    column = lambda key: np.array([r[key] for r in found])  # noqa: E731
    x = np.arange(len(found))
    spread = column("width_spread_mm")
    own = {"color": BLUE, "label": "predicted: voltages of J(0)"}
    exact = {"color": ORANGE, "hatch": "//", "edgecolor": "w"}
    exact["label"] = "predicted: exact voltages with noise"
    widths.bar(x - 0.27, column("paper_width_mm"), 0.27, color="0.7", label="the paper")
    widths.bar(x, column("width_mm"), 0.27, yerr=spread, **own)
    widths.bar(x + 0.27, column("exact_width_mm"), 0.27, **exact)
    widths.set(ylabel="half width at half maximum, mm", title="Width of a contact's image")
    places.bar(x - 0.2, column("place_error_mm"), 0.4, **own)
    places.bar(x + 0.2, column("exact_place_error_mm"), 0.4, **exact)
    tops = column("place_error_p90_mm"), column("exact_place_error_p90_mm")
    places.plot(x - 0.2, tops[0], "k_", x + 0.2, tops[1], "k_", markersize=10)
    places.plot([], [], "k_", markersize=10, label="nine in ten are nearer")
    places.set(ylabel="place error, mm (median)", title="Place of a contact")
    for axes in (widths, places):
        axes.set_ylim(0, 1.35 * axes.get_ylim()[1])  # room for the legend
        axes.set_xticks(x, _LABELS, rotation=30, ha="right")
        axes.legend(loc="upper right")
    _trade(trade, column)
    _scores(scores, column)
    return figure


def _trade(axes: Axes, column) -> None:
    dt = column("dt_ms")
    axes.plot(dt, column("paper_width_mm"), "s", color="0.6", label="the paper")
    axes.plot(dt, column("width_mm"), "o", color=BLUE, label="predicted")
    axes.set(xscale="log", xlabel="time of a scan, ms", ylabel="half width, mm")
    axes.set_title("Width against time")
    plain(axes.xaxis)
    axes.legend()
    axes.grid(alpha=0.3)
    name_points(axes, list(zip(_LABELS, dt, column("width_mm"))), size=8)


def _scores(axes: Axes, column) -> None:
    weight = np.linspace(0, 1, 101)
    for key, line in (("width_mm", "-"), ("paper_width_mm", ":")):
        values = score(column("dt_ms"), column(key), weight)
        for i, label in enumerate(_LABELS):
            name = label if line == "-" else None
            # Nine patterns: the last is grey.
            look = LOOKS[i] if i < len(LOOKS) else Look("0.5", "*")
            mark = look.marker if line == "-" else None
            axes.plot(weight, values[:, i], line, color=look.color, label=name,
                      marker=mark, markevery=(2 * i, 20), ms=5)  # fmt: skip
    axes.set(xlabel="weight of resolution (1 − weight of speed)", ylabel="weighted score")
    axes.set_title("The paper's score (Fig. 4), predicted; dotted: of the paper's numbers")
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1, 1), frameon=False)


def dependence(study: Study) -> Figure:
    """Draws the two figures of agreement over λ, contact position and definition."""
    figure = Figure(figsize=(15, 8.4), layout="constrained")
    figure.suptitle("Agreement with Table I, by λ, by where contacts are, by definition")
    grid = figure.subplots(2, 2, sharey="row")
    found = sensitivity(study)
    names = ("half_width", "half_area_radius")
    titles = ("Width along ±x, ±y (the table's)", "Radius of the area above half")
    words = ("rms relative error of\nthe ratios of widths", "rank correlation of widths")
    keys = ("width_ratio_rms_relative_error", "width_rank_correlation")
    bars = (0.08, 0.90)
    for j, (name, title) in enumerate(zip(names, titles)):
        for n, margin in enumerate(sorted({r["margin_mm"] for r in found})):
            kept = [r for r in found if r["width"] == name and r["margin_mm"] == margin]
            kept.sort(key=lambda r: r["lam"])
            label = f"≥ {margin:.0f} mm from the edge ({kept[0]['contacts']})"
            for axes, key in zip(grid[:, j], keys):
                width = [r["all_width_mm"] for r in kept]
                wide = 2.5 if margin == 40 else 1
                axes.plot(width, [r[key] for r in kept], **style(n, lw=wide, label=label))
        for axes, word, bar in zip(grid[:, j], words, bars):
            axes.axhline(bar, color="k", lw=0.8, ls="--", label="to be held")
            axes.axvline(PAPER["all"][0], color="k", lw=0.8, ls=":", label="the paper's")
            axes.set(xlabel="width of 'all' at this λ, mm", ylabel=word)
            axes.grid(alpha=0.3)
        grid[0, j].set_title(title)
    handles = grid[0, 0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside right upper", fontsize=9, frameon=False)
    return figure


def images(study: Study) -> Figure:
    """Draws one contact under every pattern, with the grounds (the paper's Fig. 3)."""
    from tomojax.sensor import Sensor

    figure = Figure(figsize=(12, 11.4), layout="constrained")
    figure.suptitle("One contact under the nine patterns; width of its image")
    i = int(((study.places - SHOWN) ** 2).sum(1).argmin())
    xy = 1e3 * np.asarray(Sensor.grid().electrode_xy)
    w, h = 1e3 * study.size
    for axes, (name, image) in zip(figure.subplots(3, 3).flat, study.images.items()):
        extent = (0, w, 0, h)
        axes.imshow(image.T / image.max(), origin="lower", extent=extent, cmap=DENSITY)
        grounds = study.patterns[name]
        at = xy[grounds if grounds.ndim == 1 else grounds[i]]
        for colour, size in (("k", 7.5), ("w", 6)):
            axes.plot(*at.T, "s", color="none", markeredgecolor=colour, markersize=size)
        axes.plot(*(1e3 * study.places[i]), "+", color=SKY, mew=2, markersize=12)
        width = 1e3 * float(study.own[name].half_width[i, -1])
        axes.set_title(f"{name.replace('_', ' ')}: {width:.0f} mm")
    figure.colorbar(
        figure.axes[0].images[0], ax=figure.axes, label="image / maximum", shrink=0.6
    )
    figure.supxlabel("x, mm; squares: grounded electrodes, cross: the contact")
    figure.supylabel("y, mm")
    return figure
