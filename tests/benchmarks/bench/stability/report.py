"""Prints and draws the results of `tomojax stability`."""

from typing import Any

import numpy as np

from bench.stability._study import FLAGGED, SWEEPS
from tomojax._pictures import METHODS, plain, style

_WIDE, _FAR_AWAY = 5, 300.0  # panels in a line; mm where something lost is drawn
_ASIDE = 0.05  # by which a method's points stand beside the next one's, of two values


def text(limits: list[dict[str, Any]]) -> str:
    """Returns a line for each sweep and method."""
    lines = [f"{'sweep':34s} {'method':12s} {'holds to':>9s} of {'':9s} beyond"]
    for row in limits:
        limit = "-" if row["limit"] is None else f"{row['limit']:g}"
        said = row["beyond"]
        if row["far"]:
            flagged = row["far"] - row["far_undoubted"]
            said += f" ({flagged} of {row['far']} far off are flagged)"
        title = SWEEPS[row["sweep"]].title
        lines.append(
            f"{title[:33]:34s} {row['method']:12s} {limit:>9s} of {row['last']:<9g} {said}"
        )
    return "\n".join(lines)


def flagged(limits: list[dict[str, Any]]) -> dict[str, Any]:
    """Returns the part of far-off places that is flagged, over all sweeps."""
    found = {}
    for method in dict.fromkeys(row["method"] for row in limits):
        some = [row for row in limits if row["method"] == method]
        far, undoubted, silent = (
            sum(row[key] for row in some) for key in ("far", "far_undoubted", "silent")
        )
        found[method] = {
            "far": far,
            "flagged": 1 - undoubted / far if far else None,
            "not_a_number_unflagged": silent,
            "dtypes_apart_mm": max(_both(some), default=None),
            "dtypes_other_count": sum(row["dtypes_other_count"] for row in some),
        }
    return found


def flagged_text(flagged: dict[str, Any]) -> str:
    """Returns a line for each method."""
    lines = []
    for method, row in flagged.items():
        part = "none" if row["flagged"] is None else f"{100 * row['flagged']:.0f} %"
        line = (
            f"{method}: of {row['far']} places over a pitch off {part} flagged; "
            f"{row['not_a_number_unflagged']} unflagged that are no number"
        )
        if row["dtypes_apart_mm"] is not None:
            line += f"; float32 {row['dtypes_apart_mm']:.2g} mm from float64 at most"
        lines.append(line)
    return "\n".join(lines)


def _both(limits: list[dict[str, Any]]) -> list[float]:
    """Returns how far apart float32 and float64 are, mm, of sweeps run in both."""
    values = [row["dtypes_apart_mm"] for row in limits]
    return [value for value in values if value is not None]


def numbers_text(numbers: dict[str, Any]) -> str:
    """Returns lines on solvers, gradients, ρ and optimisers' starts."""
    lines = []
    for solver in dict.fromkeys(row["solver"] for row in numbers["solvers"]):
        errors = [r["error"] for r in numbers["solvers"] if r["solver"] == solver]
        failed = sum(error is None for error in errors)
        worst = max(error for error in errors if error is not None)
        lines.append(
            f"solver in float32, {solver}: largest error of an image {worst:.1e}, NaN at "
            f"{failed} of {len(errors)} λ"
        )
    for row in numbers["gradients"]:
        largest = max(row["largest_difference"].values())
        lines.append(
            f"gradients at {row['count']} {row['points']} points: {row['finite']} finite, "
            f"{largest:.1e} from differences at most"
        )
    for kind in dict.fromkeys(row["dtype"] for row in numbers["resistances"]):
        mine = [row for row in numbers["resistances"] if row["dtype"] == kind]
        errors = [r["place_median_mm"] for r in mine if r["place_median_mm"] is not None]
        silent = sum(row["silent"] for row in mine)
        lines.append(
            f"Eq. 3 with J(ρ) in {kind}, ρ from 0 to infinity: places {min(errors):.1f} to "
            f"{max(errors):.1f} mm off, {silent} unflagged that are no number, "
            f"{sum(row['raised'] is not None for row in mine)} a ValueError"
        )
    for name in dict.fromkeys(row["optimiser"] for row in numbers["starts"]):
        mine = [row["excess"] for row in numbers["starts"] if row["optimiser"] == name]
        worst = max(float("inf") if excess is None else excess for excess in mine)
        lines.append(
            f"{name} from {len(mine)} λ, bad ones too: ends {100 * worst:.1f} % above the "
            "best at most"
        )
    return "\n".join(lines)


def numbers_chart(numbers: dict[str, Any], limits: list[dict[str, Any]]) -> Any:
    """Draws solvers, gradients, float32 beside float64, told ρ, optimisers' starts."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 9), layout="constrained")
    figure.suptitle("Numbers of single and double precision, gradients, and bad starts")
    panels = figure.subplots(2, 3).ravel()
    solvers, gradients, dtypes, resistances, starts, rest = panels
    rest.set_axis_off()
    _along(solvers, numbers["solvers"], "solver", "relative_lam", "error")
    solvers.set(xscale="log", xlabel="λ/σ₁²", yscale="log", ylabel="relative error")
    solvers.set_title("Image in float32 by each solver (no point: NaN)")
    for k, row in enumerate(numbers["gradients"]):
        names, values = zip(*row["largest_difference"].items())
        at, label = np.arange(len(names)) + 0.4 * k, f"{row['count']} {row['points']}"
        gradients.bar(
            at, values, 0.4, color=style(k)["color"], hatch="//" * k, edgecolor="w",
            label=f"{label} points, {row['finite']} finite",
        )  # fmt: skip
        words = [name.replace("_", " ").replace("lam", "λ") for name in names]
        gradients.set_xticks(np.arange(len(names)) + 0.2, words, rotation=45, ha="right")
    gradients.set(yscale="log", ylabel="largest relative difference")
    gradients.set_title("Derivatives beside finite differences, by variable")
    for method in METHODS:
        x = np.sort(_both([r for r in limits if r["method"] == method]))
        if len(x):
            y = (np.arange(len(x)) + 1) / len(x)
            dtypes.plot(x, y, **style(method, label=method))
    dtypes.set(xscale="log", xlabel="largest difference in a sweep, mm")
    dtypes.set(ylabel="part of the sweeps, up to this difference")
    dtypes.set_title("Places of float32 beside those of float64")
    told = numbers["resistances"]
    _along(resistances, told, "dtype", "resistance", "place_median_mm", named=True)
    resistances.set(xlabel="ρ that J(ρ) is told / sheet resistance (the contacts' is 1)")
    resistances.set(ylabel="place error, mm (median)", yscale="log")
    resistances.set_title("Eq. 3 told another contact resistance")
    plain(resistances.yaxis)
    _along(starts, numbers["starts"], "optimiser", "start", "excess")
    starts.set(xscale="log", xlabel="λ/σ₁² of the start", ylim=(-0.05, 1))
    starts.set(ylabel="(value at the end)/(best end) − 1")
    starts.set_title("Searches for λ and sets, from bad starts (no point: NaN)")
    for axes in panels[:5]:
        if axes.has_data():
            axes.legend(fontsize=8)
        axes.grid(alpha=0.3)
    return figure


def _along(
    axes: Any, rows: list[dict[str, Any]], line: str, x: str, y: str, named: bool = False
) -> None:
    """Draws a line for each value of one key; missing numbers leave gaps.

    If `named`, the values of x stand one after another, at equal distances.
    """
    # What lies on another line shows beneath it.
    for k, name in enumerate(dict.fromkeys(row[line] for row in rows)):
        mine = [row for row in rows if row[line] == name and row[x] is not None]
        values = [np.nan if row[y] is None else row[y] for row in mine]
        at = [_number(row[x]) for row in mine] if named else [row[x] for row in mine]
        look = style(k, label=name, linewidth=3 - 0.6 * k, markersize=8 - 1.5 * k)
        axes.plot(at, values, **look)


def _number(value: float) -> str:
    """Returns 1e-8 for 1e-08."""
    return f"{value:g}".replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")


def chart(rows: list[dict[str, Any]], limits: list[dict[str, Any]]) -> Any:
    """Draws a panel for each sweep: place error of nine in ten, limits, no-flag errors."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(row["sweep"] for row in rows))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    high = -(-(len(names) + 1) // _WIDE)
    figure = Figure(figsize=(4 * _WIDE, 3.1 * high + 0.4), layout="constrained")
    figure.suptitle(
        "Place errors as one thing gets worse, from left to right: full points up to the "
        "limit of a method, hollow ones beyond it",
        fontsize=14,
    )
    panels = figure.subplots(high, _WIDE, squeeze=False).ravel()
    for k, (axes, name) in enumerate(zip(panels, names)):
        within = {r["method"]: r["limit"] for r in limits if r["sweep"] == name}
        _panel(axes, [r for r in rows if r["sweep"] == name], name, methods, within)
        if k % _WIDE == 0:
            axes.set_ylabel("place error, mm: nine in\nten are nearer", fontsize=9)
    legend, *rest = panels[len(names) :]
    for method in methods:
        legend.plot([], [], **style(method, label=method))
    legend.plot([], [], "o", color="0.4", label="4 of 5 scenes right")
    legend.plot([], [], "o", color="0.4", mfc="w", label="fewer: beyond the limit")
    legend.plot([], [], "o", ms=12, mfc="none", mec="k", mew=2, label="far off, no flag")
    legend.legend(loc="center", frameon=False, ncols=2)
    for axes in (legend, *rest):
        axes.set_axis_off()
    return figure


def _panel(
    axes: Any, rows: list[dict], name: str, methods: list[str], within: dict
) -> None:
    """One sweep; `within`: the last value at which each method holds, or None."""
    sweep = SWEEPS[name]
    for k, method in enumerate(methods):
        mine = [row for row in rows if row["method"] == method]
        at = np.array([sweep.values.index(row["value"]) for row in mine])
        x = at + _ASIDE * (k - (len(methods) - 1) / 2)
        y = np.array([row.get("place_p90_mm") or _FAR_AWAY for row in mine])
        limit = within.get(method)
        held = at <= (-1 if limit is None else sweep.values.index(limit))
        look = style(method)
        axes.plot(x, y, **look, markerfacecolor="w", lw=1.2)
        axes.plot(x[held], y[held], **look | {"linestyle": "none"})
        silent = [
            bool(r.get("far")) and r["far_undoubted"] > (1 - FLAGGED) * r["far"]
            for r in mine
        ]
        axes.plot(x[silent], y[silent], "o", ms=12, mfc="none", mec="k", mew=2)
    axes.set_xticks(range(len(sweep.values)), map(_number, sweep.values), fontsize=8)
    axes.set(yscale="log", ylim=(0.05, 1.5 * _FAR_AWAY))
    axes.set_yticks((0.1, 1, 10, 100, _FAR_AWAY), ("0.1", "1", "10", "100", "lost"))
    axes.set_yticks([], minor=True)
    words, _, unit = sweep.title.rpartition(", ")
    words = words[:1].upper() + words[1:] if words.isascii() else words  # λ stays
    axes.set_title(words, fontsize=11)
    axes.set_xlabel(unit, fontsize=9)
    axes.grid(alpha=0.3)
