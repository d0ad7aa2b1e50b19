"""Finds the front of our rows, and sets the peers' rows beside our rows that are alike."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from bench.frontier._scenes import KINDS

Row = dict[str, Any]

# What two rows share that may be compared in speed. A contact takes less time than an
# image, a large batch less a frame than a small one, float32 less than float64. In one
# thing the peers are favoured: an "image" of ours comes with its contacts, theirs alone.
ALIKE = ("scene", "dtype", "output", "batch")


def error_mm(row: Row) -> float | None:
    """Returns the median place error with ghosts, mm; rows of old runs count no ghosts."""
    return row.get("with_ghosts_median_mm", row["place_median_mm"])


def mark_front(rows: list[Row]) -> None:
    """Marks each row of ours that no other row beats in both speed and place (`on_front`).

    Only rows of the same kind of scene are compared. The front is of our rows alone, of any
    dtype, output and batch. `ahead` marks rows of the peers: see `beside_peers`.
    """
    for row in rows:
        row["on_front"] = row["ahead"] = False
    for kind in KINDS:
        some = [r for r in rows if r["scene"] == kind and not r["peer"]]
        for row in front(some):
            row["on_front"] = True
    for found in beside_peers(rows):
        found["peer"]["ahead"] = found["ahead"]


def front(rows: list[Row]) -> list[Row]:
    """Returns the rows that no row beats in both speed and place, the quickest first."""
    best, kept = np.inf, []
    told = ((row["p50_us"], error_mm(row), k) for k, row in enumerate(rows))
    placed = [(us, error, k) for us, error, k in told if error is not None]
    for _, error, k in sorted(placed):
        if error < best:
            best = error
            kept.append(rows[k])
    return kept


def front_of_alike(rows: list[Row]) -> list[Row]:
    """Returns the fronts among rows that are alike."""
    groups: dict[tuple, list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row.get(key) for key in ALIKE), []).append(row)
    return [row for group in groups.values() for row in front(group)]


def beside_peers(rows: list[Row]) -> Iterator[dict[str, Any]]:
    """Sets each row of a peer beside our rows that are alike.

    Rows are alike if scene, dtype, output and batch agree. The quickest of our rows is
    chosen among those at least as near as the peer. The nearest is chosen among those at
    least as fast. A peer's row is `ahead` if no such row of ours is both as near and as
    fast. Without any row that is alike, `alike` is 0 and nothing is compared.
    """
    ours: dict[tuple, list[tuple[float, Row]]] = {}
    for row in rows:
        off = error_mm(row)
        if not row["peer"] and off is not None:
            ours.setdefault(tuple(row.get(key) for key in ALIKE), []).append((off, row))
    for peer in rows:
        error = error_mm(peer) if peer["peer"] else None
        if error is None:
            continue
        some = ours.get(tuple(peer.get(key) for key in ALIKE), [])
        near = [r for off, r in some if off <= error]
        fast = [(off, r) for off, r in some if r["p50_us"] <= peer["p50_us"]]
        quickest = min(near, key=lambda r: r["p50_us"], default=None)
        nearest = min(fast, key=lambda told: told[0])[1] if fast else None
        yield {
            "peer": peer,
            "alike": len(some),
            "ahead": bool(some) and not any(r["p50_us"] <= peer["p50_us"] for r in near),
            "times_as_fast": quickest and peer["p50_us"] / quickest["p50_us"],
            "quickest": quickest,
            "nearest": nearest,
        }
