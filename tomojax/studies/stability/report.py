"""Prints and draws the results of `tomojax stability`."""

from typing import Any

import numpy as np

from tomojax.studies.frontier.report import COLOURS
from tomojax.studies.stability._study import FLAGGED, SWEEPS

_WIDE, _FAR_AWAY = 5, 300.0  # panels in a line; mm where something lost is drawn


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

    figure = Figure(figsize=(15, 8.5), layout="constrained")
    panels = figure.subplots(2, 3).ravel()
    solvers, gradients, dtypes, resistances, starts, rest = panels
    rest.set_axis_off()
    for name in dict.fromkeys(row["solver"] for row in numbers["solvers"]):
        mine = [row for row in numbers["solvers"] if row["solver"] == name]
        x = [row["relative_lam"] for row in mine]
        solvers.loglog(x, [row["error"] or np.nan for row in mine], "-o", ms=4, label=name)
    solvers.set(xlabel="λ/σ₁²", ylabel="error of an image in float32 (no point: NaN)")
    for k, row in enumerate(numbers["gradients"]):
        names, values = zip(*row["largest_difference"].items())
        at, label = np.arange(len(names)) + 0.4 * k, f"{row['count']} {row['points']}"
        gradients.bar(at, values, 0.4, label=f"{label} points, {row['finite']} finite")
        gradients.set_xticks(np.arange(len(names)) + 0.2, names, rotation=45, ha="right")
    gradients.set(yscale="log", ylabel="derivative beside differences")
    for method in COLOURS:
        x = np.sort(_both([r for r in limits if r["method"] == method]))
        if not len(x):
            continue
        y = (np.arange(len(x)) + 1) / len(x)
        dtypes.plot(x, y, color=COLOURS[method], label=method)
    dtypes.set(xscale="log", xlabel="float32 from float64, mm, at most in a sweep")
    dtypes.set(ylabel="part of the sweeps")
    told = numbers["resistances"]
    _along(resistances, told, "dtype", "resistance", "place_median_mm", named=True)
    resistances.set(xlabel="ρ that J(ρ) is told / sheet resistance")
    resistances.set(ylabel="place error, mm (median; the contacts' ρ is 1)", yscale="log")
    _along(starts, numbers["starts"], "optimiser", "start", "excess")
    starts.set(xscale="log", xlabel="λ/σ₁² of the start", ylim=(-0.05, 1))
    starts.set(ylabel="end above the best end (no point: NaN)")
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
    for name in dict.fromkeys(row[line] for row in rows):
        mine = [row for row in rows if row[line] == name and row[x] is not None]
        values = [np.nan if row[y] is None else row[y] for row in mine]
        at = [f"{row[x]:g}" for row in mine] if named else [row[x] for row in mine]
        axes.plot(at, values, "-o", ms=4, label=name)


def chart(rows: list[dict[str, Any]], limits: list[dict[str, Any]]) -> Any:
    """Draws a panel for each sweep: place error of nine in ten, limits, no-flag errors."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(row["sweep"] for row in rows))
    high = -(-(len(names) + 1) // _WIDE)
    figure = Figure(figsize=(4 * _WIDE, 3.1 * high), layout="constrained")
    panels = figure.subplots(high, _WIDE, squeeze=False).ravel()
    for axes, name in zip(panels, names):
        _panel(axes, [r for r in rows if r["sweep"] == name], name)
        for k, row in enumerate(r for r in limits if r["sweep"] == name):
            at = list(SWEEPS[name].values)
            if row["limit"] is not None and row["limit"] != at[-1]:
                x = at.index(row["limit"]) + 0.42 + 0.04 * k
                axes.axvline(x, color=COLOURS[row["method"]], ls=":", lw=1.2)
    legend, *rest = panels[len(names) :]
    for method in dict.fromkeys(row["method"] for row in rows):
        legend.plot([], [], "-o", ms=4, color=COLOURS[method], label=method)
    legend.plot([], [], "o", ms=10, mfc="none", mec="r", label="far off, not flagged")
    legend.plot([], [], ":", color="0.4", label="limit: 4 of 5 scenes right")
    legend.legend(loc="center", frameon=False)
    for axes in (legend, *rest):
        axes.set_axis_off()
    return figure


def _panel(axes: Any, rows: list[dict[str, Any]], name: str) -> None:
    sweep = SWEEPS[name]
    for method in dict.fromkeys(row["method"] for row in rows):
        mine = [row for row in rows if row["method"] == method]
        x = np.array([sweep.values.index(row["value"]) for row in mine])
        y = np.array([row.get("place_p90_mm") or _FAR_AWAY for row in mine])
        axes.plot(x, y, "-o", ms=4, color=COLOURS[method])
        silent = [
            bool(r.get("far")) and r["far_undoubted"] > (1 - FLAGGED) * r["far"]
            for r in mine
        ]
        axes.plot(x[silent], y[silent], "o", ms=10, mfc="none", mec="r")
    axes.set_xticks(range(len(sweep.values)), [f"{v:g}" for v in sweep.values], fontsize=7)
    axes.set(yscale="log", ylim=(0.05, 1.3 * _FAR_AWAY))
    axes.set_title(sweep.title, fontsize=9)
    axes.set_ylabel("place error, mm (90 %)", fontsize=8)
    axes.grid(alpha=0.3)
