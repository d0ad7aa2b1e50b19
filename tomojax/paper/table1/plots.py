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
from tomojax.paper.table1._study import MARGIN, PAPER, Study
from tomojax.paper.table1.report import rows, score, sensitivity

_LABELS = [name.replace("_", " ") for name in PAPER]


def table(study: Study) -> Figure:
    """Draws widths, place errors and Fig. 4's weighted score."""
    figure = Figure(figsize=(15, 9), layout="constrained")
    figure.suptitle("The nine patterns: the paper's Table I and what the physics predicts")
    (widths, places), (trade, scores) = figure.subplots(2, 2)
    told = rows(study)
    found = {key: np.array([row[key] for row in told]) for key in told[0]}
    x = np.arange(len(told))
    widths.bar(x - 0.27, found["paper_width_mm"], 0.27, color="0.7", label="the paper")
    _bars(widths, found, "width_mm", 0.0, yerr=found["width_spread_mm"])
    _bars(places, found, "place_error_mm", -0.13)
    for shift, key in ((-0.13, "place_error_p90_mm"), (0.14, "exact_place_error_p90_mm")):
        places.plot(x + shift, found[key], "k_", ms=10)
    places.plot([], [], "k_", ms=10, label="nine in ten are nearer")
    widths.set(ylabel="half width at half maximum, mm", title="Width of a contact's image")
    places.set(ylabel="place error, mm (median)", title="Place of a contact")
    for axes in (widths, places):
        axes.set_ylim(0, 1.35 * axes.get_ylim()[1])  # room for the legend
        axes.set_xticks(x, _LABELS, rotation=30, ha="right")
        axes.legend(loc="upper right")
    _trade(trade, found)
    _scores(scores, found)
    return figure


def _bars(axes: Axes, found: dict[str, np.ndarray], key: str, at: float, **more) -> None:
    x = np.arange(len(PAPER)) + at
    axes.bar(x, found[key], 0.27, color=BLUE, label="predicted: voltages of J(0)", **more)
    axes.bar(
        x + 0.27,
        found[f"exact_{key}"],
        0.27,
        color=ORANGE,
        hatch="//",
        edgecolor="w",
        label="predicted: exact voltages with noise",
    )


def _trade(axes: Axes, found: dict[str, np.ndarray]) -> None:
    dt, width = found["dt_ms"], found["width_mm"]
    axes.plot(dt, found["paper_width_mm"], "s", color="0.6", label="the paper")
    axes.plot(dt, width, "o", color=BLUE, label="predicted")
    axes.set(xscale="log", xlabel="time of a scan, ms", ylabel="half width, mm")
    axes.set_title("Width against time")
    plain(axes.xaxis)
    axes.legend()
    axes.grid(alpha=0.3)
    name_points(axes, list(zip(_LABELS, dt, width)), size=8)


def _scores(axes: Axes, found: dict[str, np.ndarray]) -> None:
    weight = np.linspace(0, 1, 101)
    ours = score(found["dt_ms"], found["width_mm"], weight).T
    paper = score(found["dt_ms"], found["paper_width_mm"], weight).T
    looks = (*LOOKS, Look("0.5", "*"))  # nine patterns: the last is grey
    for i, look in enumerate(looks):
        marks = {"marker": look.marker, "markevery": (2 * i, 20), "ms": 5}
        axes.plot(weight, ours[i], color=look.color, label=_LABELS[i], **marks)
        axes.plot(weight, paper[i], ":", color=look.color)
    axes.set(xlabel="weight of resolution (1 − weight of speed)", ylabel="weighted score")
    axes.set_title("The paper's score (Fig. 4), predicted; dotted: of the paper's numbers")
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1, 1), frameon=False)


def dependence(study: Study) -> Figure:
    """Draws the two figures of agreement over λ, contact position and definition."""
    figure = Figure(figsize=(15, 8.4), layout="constrained")
    figure.suptitle("Agreement with Table I, by λ, by where contacts are, by definition")
    grid = figure.subplots(2, 2, sharey="row")
    columns = {
        "half_width": "Width along ±x, ±y (the table's)",
        "half_area_radius": "Radius of the area above half",
    }
    lines = (
        (
            "width_ratio_rms_relative_error",
            "rms relative error of\nthe ratios of widths",
            0.08,
        ),
        ("width_rank_correlation", "rank correlation of widths", 0.90),
    )
    found = sensitivity(study)
    margins = sorted({row["margin_mm"] for row in found})
    for column, (name, title) in zip(grid.T, columns.items()):
        column[0].set_title(title)
        for axes, (key, word, bar) in zip(column, lines):
            for n, margin in enumerate(margins):
                kept = [r for r in found if (r["width"], r["margin_mm"]) == (name, margin)]
                kept.sort(key=lambda row: row["lam"])
                label = f"≥ {margin:.0f} mm from the edge ({kept[0]['contacts']})"
                look = style(n, lw=2.5 if margin == 1e3 * MARGIN else 1, label=label)
                axes.plot([r["all_width_mm"] for r in kept], [r[key] for r in kept], **look)
            axes.axhline(bar, color="k", lw=0.8, ls="--", label="to be held")
            axes.axvline(PAPER["all"][0], color="k", lw=0.8, ls=":", label="the paper's")
            axes.set(xlabel="width of 'all' at this λ, mm", ylabel=word)
            axes.grid(alpha=0.3)
    handles = grid[0, 0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside right upper", fontsize=9, frameon=False)
    return figure


def images(study: Study) -> Figure:
    """Draws one contact under every pattern, with the grounds (the paper's Fig. 3)."""
    figure = Figure(figsize=(12, 11.4), layout="constrained")
    figure.suptitle("One contact under the nine patterns; width of its image")
    i = study.shown
    electrodes = 1e3 * np.asarray(study.sensor.electrode_xy)
    width, height = 1e3 * np.asarray(study.sensor.size)
    grid = figure.subplots(3, 3)
    for axes, (name, image) in zip(grid.flat, study.images.items()):
        look = {"cmap": DENSITY, "vmin": 0, "vmax": 1, "origin": "lower"}
        axes.imshow(image.T / image.max(), extent=(0, width, 0, height), **look)
        at = electrodes[study.grounds[name][i]]
        for colour, size in (("k", 7.5), ("w", 6)):
            axes.plot(*at.T, "s", color="none", markeredgecolor=colour, markersize=size)
        axes.plot(*(1e3 * study.places[i]), "+", color=SKY, mew=2, markersize=12)
        found = study.own[name]["half_width"][i, -1]
        axes.set_title(f"{name.replace('_', ' ')}: {found:.0f} mm")
    figure.colorbar(grid[0, 0].images[0], ax=grid, label="image / maximum", shrink=0.6)
    figure.supxlabel("x, mm; squares: grounded electrodes, cross: the contact")
    figure.supylabel("y, mm")
    return figure
