"""Shows a design: its table as text, and its picture."""

from typing import Any

Rows = list[dict[str, Any]]
Summary = dict[str, Any]

# What a criterion is of, in a picture.
_WORDS = {
    "place": "error of place",
    "a": "variance",
    "d": "volume of what stays unknown",
    "worst": "largest error",
    "rigs": "error on simulated rigs",
}


def _scale(summary: Summary) -> tuple[float, str]:
    """Returns the factor and the unit that figures are shown with."""
    return (1e3, "mm") if summary["unit"] == "m" else (1.0, summary["unit"])


def text(rows: Rows, summary: Summary) -> str:
    """Writes the report for people."""
    s, (scale, unit) = summary, _scale(summary)
    grounds = " ".join(map(str, s["grounds"]))
    bound = f"{scale * s['bound']:.4g} ({100 * s['gap']:.1f} %)"
    beside = f"; no set of as many is below {bound}" if s["gap"] == s["gap"] else ""
    lines = [
        f"grounds: {grounds}",
        *([] if s["lam"] is None else [f"λ: {s['lam']:.4g}"]),
        f"objective: {scale * s['objective']:.4g} {unit}{beside}",
        f"{'pattern':12s} slots  {'its own':>10s}  designed, {unit}",
    ]
    for row in rows:
        mark = "*" if row["adaptive"] else " "
        known = [row[key] for key in ("value", "designed")]
        own, best = (f"{scale * v:.4g}" if v == v else "-" for v in known)
        values = f"{own:>10s}  {best:>8s}"
        lines.append(f"{row['name']:11s}{mark} {row['slots']:5d}  {values}")
    known = "* knows where the contact is, and so does the design beside it: --policy"
    return "\n".join([*lines, known])


def draw(sensor: Any, rows: Rows, summary: Summary, places: Any, figures: Any) -> Any:
    """Draws the sheet with the grounds, and designs beside the paper's patterns.

    `places` are those that were designed for, m; `figures` (nx, ny) a map, or None.
    """
    import numpy as np
    from matplotlib.figure import Figure

    from tomojax import _pictures as look

    s, (scale, unit) = summary, _scale(summary)
    figure = Figure(figsize=(14, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    xy = 1e3 * np.asarray(sensor.electrode_xy)
    word = _WORDS[s["criterion"]]
    figure.suptitle(f"Grounds designed for {s['method']}: the least {word}")
    if figures is not None:
        label, image = f"{word} there, {unit}", scale * figures
        look.show_image(left, image, sensor.size, label, cmap=f"{look.VALUE}_r", norm="log")
    look.lay_sheet(left, sensor.size, sensor.electrode_xy, float(sensor.electrode_diameter))
    left.plot(*1e3 * places.T, "k.", ms=2)
    for order, ground in enumerate(s["grounds"], 1):
        left.plot(*xy[ground], "o", color=look.VERMILION, ms=11)
        left.text(*xy[ground], str(order), color="w", ha="center", va="center", size=8)
    left.set_title(f"{len(s['grounds'])} grounds in order; dots: contacts")
    rows = sorted(rows, key=lambda row: row["slots"])
    for row in rows:
        mark = "^" if row["adaptive"] else "o"
        right.loglog(row["slots"], scale * row["value"], mark, color="0.4", ms=5)
    for adaptive, k, label in ((False, 0, "one for all"), (True, 2, "by place")):
        some = [row for row in rows if row["adaptive"] == adaptive]
        values = [scale * row["designed"] for row in some]
        slots = [row["slots"] for row in some]
        right.loglog(slots, values, **look.style(k, label=f"designed, {label}"))
    right.loglog([], [], "o", color="0.4", ms=5, label="pattern")
    right.loglog([], [], "^", color="0.4", ms=5, label="pattern that knows the contact")
    at = len(s["grounds"]), scale * s["objective"]
    right.loglog(
        *at, "*", color=look.VERMILION, ms=12, ls="none", label="the design on the left"
    )
    names = [row["name"].replace("_", " ") for row in rows]
    look.name_points(
        right, [(n, r["slots"], scale * r["value"]) for n, r in zip(names, rows)]
    )
    right.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1, 1), frameon=False)
    slots = sorted({row["slots"] for row in rows})
    right.set_xticks(slots, [str(n) for n in slots], minor=False)
    right.set_xticks([], minor=True)
    look.plain(right.yaxis)
    right.set(xlabel="slots", ylabel=f"{word}, {unit}")
    right.set_title("Patterns and designs, the lower the better")
    return figure
