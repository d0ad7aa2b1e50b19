"""Prints and draws the results of `tomojax frontier`."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from bench.frontier._beside import (
    beside_peers,
    error_mm as error_mm,
    front,
    front_of_alike,
)
from bench.frontier._scenes import KINDS
from tomojax._pictures import GREY, METHODS, plain, style

_PEERS = {"pyEIT": "s", "scikit-fem + NumPy": "D", "NumPy sLORETA": "^"}
_TOLD = ("pattern", "slots", "pixels", "dtype", "output", "batch", "p50_us")
_RUNGS = ("nothing", "points", "source", "conductance", "shape")
WORDS = {
    "one": "one contact",
    "two": "two, 15 to 40 mm apart",
    "three": "three contacts",
    "bar": "a bar of 75 mm",
    "large": "a disc of 50 to 80 mm",
}


def text(rows: list[dict[str, Any]]) -> str:
    """Returns each kind's front, slowest first, and the peers' front beside it."""
    lines = [
        "        method       pattern   slots λ        pixels dtype    output   batch "
        "  µs a frame (99 %)  place, mm (90 %)  width"
    ]
    for kind in KINDS:
        ours = [r for r in rows if r["scene"] == kind and r["on_front"]]
        peers = front([r for r in rows if r["scene"] == kind and r["peer"]])
        lines.append(f"{WORDS[kind]}:")
        for row in sorted(ours + peers, key=lambda r: (r["peer"], -r["p50_us"])):
            lines.append(_line(row))
    found = list(beside_peers([r for r in rows if r["scene"] == "one"]))
    return "\n".join(lines + (_verdict(found) if found else []))


def _verdict(found: list[dict[str, Any]]) -> list[str]:
    """Returns lines on who is ahead at single contacts, among rows that are alike."""
    alike = [f for f in found if f["alike"]]
    faster = [f["times_as_fast"] for f in alike if f["times_as_fast"]]
    ahead = [f for f in alike if f["ahead"]]
    lines = ["of one contact, beside rows of ours of the same dtype, output and batch:"]
    if faster:
        lines.append(
            f"  ours reaches the accuracy of {len(faster)} of the peers' {len(alike)} rows,"
            f" {min(faster):.2g} to {max(faster):.2g} times as fast"
        )
    lines.append(
        f"  a peer is ahead in {len(ahead)} of {len(alike)} rows" + ":" * bool(ahead)
    )
    best = front_of_alike([f["peer"] for f in ahead])
    for f in sorted(ahead, key=lambda f: f["peer"]["p50_us"]):
        peer, ours = f["peer"], f["quickest"]
        if not any(peer is row for row in best):
            continue  # another peer that is ahead is as near and as fast
        beside = f"ours as near: {ours['p50_us']:.1f} µs ({ours['method']})" if ours else ""
        lines.append(
            f"    {peer['method']}, {peer['pattern']}, {peer.get('output')}, "
            f"batch {peer['batch']}: {_mm(error_mm(peer))} mm in {peer['p50_us']:.1f} µs; "
            + (beside or "none of ours is as near")
        )
    if len(alike) < len(found):
        none = len(found) - len(alike)
        lines.append(f"  {none} rows of peers have none of ours that is alike")
    return lines


def _line(row: dict[str, Any]) -> str:
    p90 = _mm(row.get("with_ghosts_p90_mm", row["place_p90_mm"]))
    width = f"{row['width_mm']:5.1f}" if row.get("width_mm") else "    -"
    rule = row["lam_rule"].split(" ")[0]
    return (
        f"  {'peer  ' if row['peer'] else '      '}{row['method'][:12]:12s} "
        f"{row['pattern']:10s} {row['slots']:4d} {rule:9s} {row['pixels']:5d} "
        f"{row['dtype']:8s} {row.get('output', '-'):8s} {row['batch']:5d} "
        f"{row['p50_us']:10.1f} ({row['p99_us']:.0f})"
        f"   {_mm(error_mm(row)):>8s} ({p90})  {width}"
    )


def _mm(value: float | None) -> str:
    return "lost" if value is None else f"{value:.2f}"


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Returns how far ahead of the peers we are, or how far behind, and what failed."""
    found = list(beside_peers([r for r in rows if r["scene"] == "one"]))
    alike = [f for f in found if f["alike"]]
    return {
        "place": "of a scene's worst contact, to the nearest that was found, or of its "
        "farthest ghost if that is more",
        "front": "of its kind of scene none is both quicker a frame and nearer the place",
        "peers_beside": "rows of ours of the same scene, dtype, output and batch",
        "peers_compared": len(alike),
        "peers_ahead": sum(f["ahead"] for f in alike),
        "peers": [
            {
                "peer": f["peer"]["method"],
                **{k: f["peer"].get(k) for k in _TOLD},
                "alike": f["alike"],
                "ahead": f["ahead"],
                "times_as_fast_at_its_accuracy": f["times_as_fast"],
                "place_mm": error_mm(f["peer"]),
                "place_at_its_speed_mm": f["nearest"] and error_mm(f["nearest"]),
            }
            for f in found
        ],
        "failed": [r for r in rows if r.get("failed")],
    }


def chart(rows: list[dict[str, Any]]) -> Any:
    """Draws a panel for each kind of scene: time of a frame against place error.

    Peers are hollow, and full where they are ahead of all our rows that are alike.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 9.4), layout="constrained")
    figure.suptitle("How near, and how fast: every method on the same frames")
    panels = figure.subplots(2, 3).ravel()
    for axes, kind in zip(panels, KINDS):
        some = [r for r in rows if r["scene"] == kind and error_mm(r) is not None]
        ahead = {id(f["peer"]) for f in beside_peers(some) if f["ahead"]}
        for row in some:
            at = row["p50_us"], error_mm(row)
            if row["peer"]:
                full = GREY if id(row) in ahead else "none"
                look = {"marker": _PEERS[row["method"]], "facecolors": full}
                look |= {"edgecolors": "0.4", "zorder": 1, "linewidths": 0.6}
            else:
                look = METHODS[row["method"]]
                look = {"marker": look.marker, "color": look.color, "zorder": 2}
                look |= {"edgecolors": "w", "linewidths": 0.4, "alpha": 0.8}
            area = _area(row["slots"]) * (0.5 if row["peer"] else 1.0)
            axes.scatter(*at, s=area, **look)
        peers = [r for r in some if r["peer"]]
        ours = [r for r in some if not r["peer"]]
        for them, line in ((ours, "-"), (peers, "--")):
            steps = [(r["p50_us"], error_mm(r)) for r in front(them)]
            if steps:
                axes.step(*zip(*steps), where="post", color="k", lw=1, ls=line, zorder=3)
        axes.set(xscale="log", yscale="log", title=WORDS[kind].capitalize())
        axes.set(xlabel="time of a frame, µs (median)", ylabel="place error, mm (median)")
        axes.grid(alpha=0.3)
        plain(axes.yaxis)
    _legend(panels[-1], {r["method"] for r in rows})
    return figure


def _area(slots: int) -> float:
    """Returns the area of a mark, square points."""
    return 24 + 14 * np.log2(slots)


def _legend(axes: Any, there: set[str]) -> None:
    for method in (name for name in METHODS if name in there):
        look = METHODS[method]
        axes.scatter([], [], s=50, color=look.color, marker=look.marker, label=method)
    axes.plot([], [], "k", lw=1, label="front of these methods")
    for peer, marker in _PEERS.items():
        look = {"marker": marker, "facecolors": "none", "edgecolors": "0.4"}
        axes.scatter([], [], s=50, **look, label=peer)
    axes.scatter([], [], s=50, marker="s", color=GREY, label="peer ahead of all alike")
    axes.plot([], [], "k--", lw=1, label="front of the peers")
    for slots in (1, 8, 64):
        axes.scatter(
            [], [], s=_area(slots), color="0.7", label=f"{slots} slot{'s' * (slots > 1)}"
        )
    axes.legend(loc="center", fontsize=10, ncols=2, frameon=False)
    axes.set_axis_off()


def rungs(rows: list[dict[str, Any]]) -> Any:
    """Draws the rung that each kind of scene needs: error, doubt, time, `auto`'s choice."""
    from matplotlib.figure import Figure

    # Rows of runs before `shape` have `conductance`.
    known = ("linear", "source", "points", "conductance", "shape", "auto")
    models = [name for name in known if any(r["method"] == name for r in rows)]
    patterns = [p for p in ("corners", "all") if any(r["pattern"] == p for r in rows)]
    figure = Figure(figsize=(13, 3.8 * len(patterns) + 0.8), layout="constrained")
    figure.suptitle("Which model each kind of scene needs")
    panels = figure.subplots(len(patterns), 3, squeeze=False)
    for line, pattern in zip(panels, patterns):
        chosen = {}
        for row in rows:
            usual = row["pattern"] == pattern and row["lam_rule"] == "own"
            if usual and row["pixels"] == 32 and row["dtype"] == "float32":
                chosen.setdefault((row["method"], row["scene"]), row)
        x = np.arange(len(KINDS))
        for k, model in enumerate(models):
            some = [chosen.get((model, kind), {}) for kind in KINDS]
            look = {"color": METHODS[model].color, "edgecolor": "w", "label": model}
            errors = [(row and error_mm(row)) or np.nan for row in some]
            line[0].bar(x + 0.16 * (k - 2), errors, 0.16, **look)
            doubt = [100 * row.get("doubted", np.nan) for row in some]
            line[1].bar(x + 0.16 * (k - 2), doubt, 0.16, **look)
        line[0].set(yscale="log", ylabel="place error, mm (median)")
        line[1].set(ylabel="part of the scenes, %", ylim=(0, 100))
        bottom = np.zeros(len(KINDS))
        for k, rung in enumerate(_RUNGS):
            shares = [chosen.get(("auto", kind), {}).get("rungs") for kind in KINDS]
            # Rows of runs before `shape` have four rungs.
            part = [100 * s[k] / sum(s) if s and k < len(s) else 0 for s in shares]
            part = np.array(part)
            if part.any():
                colour = METHODS[rung].color if rung in METHODS else "0.8"
                line[2].bar(x, part, 0.7, bottom=bottom, color=colour, label=rung)
            bottom += part
        line[2].set(ylabel="part of the scenes, %", ylim=(0, 100))
        slots = "two slots, the corners" if pattern == "corners" else "every ground"
        titles = "Place error", "Scenes flagged", "Model that auto took"
        for axes, title in zip(line, titles):
            axes.set_title(f"{title}: {slots}", fontsize=11)
            axes.set_xticks(x, KINDS)
            axes.set_xlabel("what touches")
        plain(line[0].yaxis)
    told = {
        label: handle
        for axes in panels.ravel()
        for handle, label in zip(*axes.get_legend_handles_labels())
    }
    figure.legend(
        told.values(), told, loc="outside lower center", ncols=len(told), frameon=False
    )
    return figure


def machine_lines(rates: list[dict[str, Any]], day: list[dict[str, Any]]) -> Iterator[str]:
    """Yields lines on images a second, beside the bound, and on a day of frames."""
    sets = {(r["method"], r["slots"], r["pixels"], r["threads"]) for r in rates}
    for method, slots, pixels, threads in sorted(sets):
        some = [
            r
            for r in rates
            if (r["method"], r["slots"], r["pixels"], r["threads"])
            == (method, slots, pixels, threads)
        ]
        best = max(some, key=lambda r: r["frames_per_s"])
        yield (
            f"images, {method}, slots {slots}, {pixels} x {pixels}, threads {threads}: "
            f"{best['frames_per_s']:.3g}/s from a batch of {best['batch']}, "
            f"{100 * best['part_of_bound']:.0f} % of the bound ({best['bound']})"
            + (f", {best['error']:.0e} from float64" if "error" in best else "")
        )
    for row in day:
        yield (
            f"a day of frames, {row['method']}, {row['slots']} slots: "
            f"{row['mean_us']:.0f} µs a frame; rungs {row['rungs']}"
        )


def rate_chart(rates: list[dict[str, Any]]) -> Any:
    """Draws images a second against the batch; dashed lines are the machine's bound."""
    from matplotlib.figure import Figure

    panels = sorted({(r["pixels"], r["threads"]) for r in rates})
    figure = Figure(figsize=(4.2 * len(panels) + 1, 4.8), layout="constrained")
    figure.suptitle("Images a second in calls of many frames")
    for axes, (pixels, threads) in zip(
        figure.subplots(1, len(panels), squeeze=False, sharey=True)[0], panels
    ):
        some = [r for r in rates if (r["pixels"], r["threads"]) == (pixels, threads)]
        for method, slots in sorted({(r["method"], r["slots"]) for r in some}):
            mine = [r for r in some if (r["method"], r["slots"]) == (method, slots)]
            x = [r["batch"] for r in mine]
            full = METHODS[method].color if slots > 1 else "w"
            look = style(method, linestyle="-", markerfacecolor=full)
            label = f"{method}, {slots} slot{'s' * (slots > 1)}"
            axes.loglog(x, [r["frames_per_s"] for r in mine], **look, label=label)
            look |= {"linestyle": "--" if slots > 1 else ":", "marker": "none"}
            axes.loglog(x, [r["bound_frames_per_s"] for r in mine], **look)
        axes.set_title(f"{pixels} × {pixels} pixels, threads: {threads}")
        axes.set_xlabel("frames in a call")
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("images a second")
    for line, label in ((":", "bound, 1 slot"), ("--", "bound, more slots")):
        figure.axes[-1].plot([], [], "0.4", ls=line, label=f"the machine's {label}")
    figure.legend(*figure.axes[-1].get_legend_handles_labels(), fontsize=9,
                  loc="outside right center", frameon=False)  # fmt: skip
    return figure
