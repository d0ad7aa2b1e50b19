"""Pictures of `shapes.py`."""

from pathlib import Path
from typing import Any

import numpy as np

from bench.plots import gallery as lines_of_images
from tomojax._pictures import name_points, style

OTHERS = ("linear", "source")
SHOWN, HATCHES = (2, 10, 64), ("", "//", "..", "xx")
# Lines of the gallery below the truth: method, values told, slots.
GALLERY = {
    ("linear", "nominal", "64"): "the paper's Eq. 3, 64 slots",
    ("shape", "nominal", "64"): "shape, 64 slots",
    ("shape", "nominal", "10"): "shape, ten slots",
    ("shape", "nominal", "2"): "shape, two slots",
}


def gallery(shown: list[tuple], path: Path, most: int = 9) -> None:
    """The first usual scenes: truth, the paper's method, the shape from 64, ten, two."""
    from matplotlib.figure import Figure

    first = [(0, 2 * k) for k in range(5)] + [(1, 2 * k) for k in range(4)]
    found = {(n, k, *rest[:3]): rest[3] for n, k, *rest in shown}
    truths = {(n, k): rest[4] for n, k, *rest in shown}
    lines = {"what touched": [truths[key] for key in first[:most]]}
    for what, title in GALLERY.items():
        lines[title] = [found[*key, *what] for key in first[:most]]
    figure = Figure(figsize=(1.5 * most + 1.2, 1.75 * len(lines)), layout="constrained")
    figure.suptitle("Nine shapes on the sheet, and their images")
    lines_of_images(figure, lines, (0.16, 0.16))
    figure.savefig(path, dpi=80)


def draw(content: dict, path: Path) -> None:
    """Overlaps by slots, reliability, digits, and the smallest gaps and holes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(16, 9.4), layout="constrained")
    figure.suptitle("Images of shapes: how well they overlap, are told, and are resolved")
    overlaps, stated, digits, gaps, holes, sets = figure.subplots(2, 3).ravel()
    _draw_overlaps(overlaps, content["images"])
    _draw_stated(stated, content["images"])
    _draw_digits(digits, content["digits"])
    for axes, kind in ((gaps, "gap"), (holes, "hole")):
        _draw_seen(axes, [r for r in content["gaps"] if r["kind"] == kind], kind)
    gaps.set_title("Gaps between two bars of 40 × 12 mm")
    holes.set_title("Holes of rings of 12 mm")
    named = []
    for k, designed in enumerate((False, True)):
        rows = [r for r in content.get("patterns", []) if r["designed"] == designed]
        at = [r["slots"] for r in rows], [r["overlap"] for r in rows]
        label = "designed" if designed else "the paper's patterns"
        sets.plot(*at, **style(k, linestyle="none", markersize=6, label=label))
        named += [(words(r["pattern"]), *xy) for r, *xy in zip(rows, *at)]
    sets.set(xscale="log", xlabel="slots of a scan", ylabel="overlap (median)")
    sets.set_title("Patterns, and designed sets")
    _slots(sets, (2, 4, 8, 16, 28, 64))
    sets.legend(loc="lower right", fontsize=8)
    name_points(sets, named)
    figure.savefig(path, dpi=80)


def words(pattern: str) -> str:
    """Returns a pattern's name as it is written beside a mark."""
    return pattern.removeprefix("designed ").replace("_", " ").replace("cop", "CoP")


def _slots(axes: Any, slots: tuple) -> None:
    axes.set_xticks(slots, [str(s) for s in slots])
    axes.set_xticks([], minor=True)
    axes.grid(alpha=0.3)


def _draw_overlaps(axes: Any, images: list[dict]) -> None:
    kinds = [("shape", "nominal"), ("shape", "calibrated")]
    kinds += [(name, "nominal") for name in OTHERS]
    for k, (method, values) in enumerate(kinds):
        own = [
            r for r in images
            if (r["method"], r["values"], r["set"]) == (method, values, "usual")
        ]  # fmt: skip
        x = sorted({r["slots"] for r in own})
        each = [[r["overlap"] for r in own if r["slots"] == s] for s in x]
        low, middle, high = np.array([np.quantile(e, [0.25, 0.5, 0.75]) for e in each]).T
        look = style(method, markersize=6)
        if values == "calibrated":
            look |= {"linestyle": ":", "markerfacecolor": "w"}
        hindsight = "" if method == "shape" else ", best threshold"
        axes.errorbar(
            np.array(x) * 1.03 ** (k - 2.5), middle, (middle - low, high - middle),
            capsize=3, label=f"{method}, {values}{hindsight}", **look,
        )  # fmt: skip
    axes.set(xscale="log", xlabel="slots", ylabel="overlap: median, quartiles", ylim=(0, 1))
    axes.set_title("Strokes of 12 to 16 mm, 0.02 to 2 S/m²")
    _slots(axes, SHOWN)
    axes.legend(fontsize=7, loc="lower right")


def _draw_stated(axes: Any, images: list[dict]) -> None:
    for k, s in enumerate(SHOWN):
        for values, line in (("nominal", "-"), ("calibrated", ":")):
            told = [
                r["reliability"]
                for r in images
                if (r["method"], r["values"], r["slots"]) == ("shape", values, s)
            ]
            count, said, true = np.array(told).sum(0)
            look = style(k, linestyle=line, label=f"{s} slots, {values}")
            look["markerfacecolor"] = look["color"] if line == "-" else "w"
            axes.plot(said / count, true / count, **look)
    axes.plot([0, 1], [0, 1], "k", lw=0.8, label="as it should be")
    axes.set(xlabel="stated probability of touch", ylabel="part that touches")
    axes.set_title("Probabilities that shape states")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def _draw_digits(axes: Any, rows: list[dict]) -> None:
    methods, width = ("shape", "source", "linear"), 0.2
    for k, method in enumerate(methods):
        right = [
            np.mean([
                r["digit"] == r["told"]
                for r in rows
                if (r["method"], r["slots"]) == (method, s)
            ])
            for s in SHOWN
        ]  # fmt: skip
        look = {"color": style(method)["color"], "edgecolor": "w", "hatch": HATCHES[k]}
        axes.bar(np.arange(3) + width * (k - 1), right, width, **look, label=method)
    axes.set_xticks(range(3), [f"{s} slots" for s in SHOWN])
    axes.set(ylabel="part told right by the nearest outline", ylim=(0, 1.25))
    axes.set_yticks([0, 0.25, 0.5, 0.75, 1])
    axes.set_title("Ten digits of 80 mm, turned by up to 20°")
    axes.legend(fontsize=8, ncols=4, loc="upper center")


def _draw_seen(axes: Any, rows: list[dict], kind: str) -> None:
    """The part of the rigs on which `shape` shows a gap or a hole."""
    sizes, pressed = (sorted({r[key] for r in rows}) for key in ("mm", "S_per_m2"))
    for s, line in zip(SHOWN, (":", "--", "-")):
        for k, g in enumerate(pressed):
            seen = [
                np.mean([
                    r["seen"]
                    for r in rows
                    if (r["method"], r["slots"], r["S_per_m2"], r["mm"])
                    == ("shape", s, g, mm)
                ])
                for mm in sizes
            ]  # fmt: skip
            # Parts of five: lines beside each other.
            y = np.array(seen) + 0.012 * (k - 1)
            axes.plot(sizes, y, **style(k, linestyle=line, label=f"{s} slots, {g:g} S/m²"))
    axes.axvline(20, color="0.5", lw=0.8)
    axes.annotate("the pitch ", (20, 0.02), ha="right", color="0.4", fontsize=8)
    axes.set(xlabel=f"width of the {kind}, mm", ylabel="part of five rigs that show it")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, loc="upper left")
