"""Draws Table I: widths and speed beside the paper's, what they depend on, images."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tomojax.studies.table1._study import PAPER, SHOWN, Study
from tomojax.studies.table1.report import rows, score, sensitivity

_LABELS = [name.replace("_", " ") for name in PAPER]


def table(study: Study) -> Figure:
    """Draws widths, place errors and Fig. 4's weighted score."""
    figure = Figure(figsize=(15, 9), layout="constrained")
    (widths, places), (trade, scores) = figure.subplots(2, 2)
    found = rows(study)
    column = lambda key: np.array([r[key] for r in found])  # noqa: E731
    x = np.arange(len(found))
    spread = column("width_spread_mm")
    widths.bar(x - 0.27, column("paper_width_mm"), 0.27, color="0.7", label="the paper")
    widths.bar(x, column("width_mm"), 0.27, yerr=spread, label="predicted, J(0)")
    widths.bar(x + 0.27, column("exact_width_mm"), 0.27, label="exact voltages, noise")
    widths.set_ylabel("half width at half maximum, mm")
    places.bar(x - 0.2, column("place_error_mm"), 0.4, label="J's own voltages")
    places.bar(x + 0.2, column("exact_place_error_mm"), 0.4, label="exact, noise")
    tops = column("place_error_p90_mm"), column("exact_place_error_p90_mm")
    places.plot(x - 0.2, tops[0], "k_", x + 0.2, tops[1], "k_", markersize=10)
    places.set_ylabel("error of place, mm: median, and 90 % (line)")
    for axes in (widths, places):
        axes.set_xticks(x, _LABELS, rotation=30, ha="right")
        axes.legend()
    _trade(trade, column)
    _scores(scores, column)
    return figure


def _trade(axes: Axes, column) -> None:
    dt = column("dt_ms")
    axes.plot(dt, column("paper_width_mm"), "o", color="0.6", label="the paper")
    axes.plot(dt, column("width_mm"), "o", label="predicted")
    # Names beside the points; several patterns share 0.8 ms and stand one below the other.
    for label, t, w in zip(_LABELS, dt, column("width_mm")):
        axes.annotate(label, (t, w), (6, -3), textcoords="offset points", fontsize=8)
    axes.set(xscale="log", xlabel="scan, ms", ylabel="half width, mm")
    axes.legend()
    axes.grid(alpha=0.3)


def _scores(axes: Axes, column) -> None:
    weight = np.linspace(0, 1, 101)
    for key, style in (("width_mm", "-"), ("paper_width_mm", ":")):
        values = score(column("dt_ms"), column(key), weight)
        for i, label in enumerate(_LABELS):
            name = label if style == "-" else None
            axes.plot(weight, values[:, i], style, color=f"C{i}", label=name)
    axes.set(xlabel="weight of resolution (1 − weight of speed)", ylabel="weighted score")
    axes.set_title("predicted (lines) and from the paper's numbers (dots)")
    axes.legend(fontsize=8, ncols=2)


def dependence(study: Study) -> Figure:
    """Draws the two figures of agreement over λ, contact position and definition."""
    figure = Figure(figsize=(15, 8), layout="constrained")
    grid = figure.subplots(2, 2, sharey="row")
    found = sensitivity(study)
    names = ("half_width", "half_area_radius")
    titles = ("width along ±x, ±y (the table's)", "radius of the area above half")
    keys = ("width_ratio_rms_relative_error", "width_rank_correlation")
    bars = (0.08, 0.90)
    for j, (name, title) in enumerate(zip(names, titles)):
        for margin in sorted({r["margin_mm"] for r in found}):
            kept = [r for r in found if r["width"] == name and r["margin_mm"] == margin]
            kept.sort(key=lambda r: r["lam"])
            label = f"≥ {margin:.0f} mm from the edge ({kept[0]['contacts']})"
            for axes, key in zip(grid[:, j], keys):
                width = [r["all_width_mm"] for r in kept]
                wide = 2.5 if margin == 40 else 1
                axes.plot(width, [r[key] for r in kept], ".-", lw=wide, label=label)
        for axes, key, bar in zip(grid[:, j], keys, bars):
            axes.axhline(bar, color="k", lw=0.8, ls="--")
            axes.axvline(PAPER["all"][0], color="k", lw=0.8, ls=":")
            axes.set(xlabel="width of 'all' at this λ, mm", ylabel=key.replace("_", " "))
            axes.grid(alpha=0.3)
        grid[0, j].set_title(title)
    grid[0, 0].legend(fontsize=8)
    return figure


def images(study: Study) -> Figure:
    """Draws one contact under every pattern, with the grounds (the paper's Fig. 3)."""
    from tomojax.sensor import Sensor

    figure = Figure(figsize=(12, 11), layout="constrained")
    i = int(((study.places - SHOWN) ** 2).sum(1).argmin())
    xy = 1e3 * np.asarray(Sensor.grid().electrode_xy)
    w, h = 1e3 * study.size
    for axes, (name, image) in zip(figure.subplots(3, 3).flat, study.images.items()):
        axes.imshow(image.T / image.max(), origin="lower", extent=(0, w, 0, h))
        grounds = study.patterns[name]
        at = xy[grounds if grounds.ndim == 1 else grounds[i]]
        axes.plot(*at.T, "s", color="none", markeredgecolor="w", markersize=6)
        axes.plot(*(1e3 * study.places[i]), "r+", markersize=12)
        width = 1e3 * float(study.own[name].half_width[i, -1])
        axes.set_title(f"{name.replace('_', ' ')}: {width:.0f} mm")
    figure.colorbar(
        figure.axes[0].images[0], ax=figure.axes, label="image / maximum", shrink=0.6
    )
    figure.supxlabel("x, mm; squares: grounded electrodes, cross: the contact")
    return figure
