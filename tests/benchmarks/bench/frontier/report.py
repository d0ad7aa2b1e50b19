"""Prints and draws the results of `tomojax frontier`."""

from typing import Any

from bench.frontier._beside import (
    beside_peers,
    error_mm as error_mm,
    front,
    front_of_alike,
)
from bench.frontier._scenes import KINDS
from tomojax._pictures import METHODS, plain

_PEERS = {"pyEIT": "s", "scikit-fem + NumPy": "D", "NumPy sLORETA": "^"}
_TOLD = ("pattern", "slots", "pixels", "dtype", "output", "batch", "p50_us")
ABOVE = ("points", "source", "shape")
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

    A method has one mark for each ground set; its name stands at its nearest.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 9), layout="constrained")
    figure.suptitle("How near, and how fast: down and to the left is better")
    panels = figure.subplots(2, 3).ravel()
    for axes, kind in zip(panels, KINDS):
        some = shown(rows, kind)
        for name in dict.fromkeys(row["method"] for row in some):
            mine = sorted(
                (r for r in some if r["method"] == name), key=lambda r: r["slots"]
            )
            x = [row["p50_us"] for row in mine]
            y = [error_mm(row) for row in mine]
            if mine[0]["peer"]:
                look = {"marker": _PEERS[name], "color": "0.5", "fillstyle": "none"}
            else:
                look = {"marker": METHODS[name].marker, "color": METHODS[name].color}
            axes.plot(x, y, lw=0.6, ms=6, zorder=1 if mine[0]["peer"] else 2, **look)
            if mine[0]["peer"]:
                continue
            best = min(mine, key=lambda r: error_mm(r) or 0)
            at, text = (best["p50_us"], error_mm(best) or 0), {"fontsize": 10}
            text |= {"color": look["color"], "textcoords": "offset points"}
            # Those that lie near each other are named on either side.
            where, side = ((4, 7), "right") if name in ABOVE else ((5, -11), "left")
            axes.annotate(name, at, where, ha=side, **text)
        for peer, line in ((False, "-"), (True, "--")):
            steps = front([r for r in some if r["peer"] == peer])
            if steps:
                at = [(r["p50_us"], error_mm(r)) for r in steps]
                axes.step(*zip(*at), where="post", color="k", lw=1.2, ls=line, zorder=0)
        axes.set(xscale="log", yscale="log", title=WORDS[kind].capitalize())
        axes.set(xlabel="time of a frame, µs (median)", ylabel="place error, mm (median)")
        axes.grid(alpha=0.3)
        plain(axes.yaxis)
    last = panels[len(KINDS)]
    last.plot([], [], "k-", label="front of these methods")
    last.plot([], [], "k--", label="front of the peers")
    for name, marker in _PEERS.items():
        last.plot([], [], marker=marker, color="0.5", ls="", fillstyle="none", label=name)
    last.plot([], [], "0.5", lw=0.6, label="one method, from one slot to all 64")
    last.legend(loc="center", fontsize=11, frameon=False)
    for axes in panels[len(KINDS) :]:
        axes.set_axis_off()
    return figure


def shown(rows: list[dict[str, Any]], kind: str) -> list[dict[str, Any]]:
    """Chooses a row for each method and pattern: contacts alone, most frames in a call."""

    def rank(row: dict[str, Any]) -> tuple:
        return row.get("output") == "contacts", row["batch"], -row["p50_us"]

    found: dict[tuple, dict[str, Any]] = {}
    for row in rows:
        if row["scene"] == kind and error_mm(row) is not None:
            key = row["method"], row["pattern"]
            found[key] = max(found.get(key, row), row, key=rank)
    return list(found.values())
