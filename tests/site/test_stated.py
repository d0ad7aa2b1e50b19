"""Figures that pages state stand in the committed results.

The sweeps of tests/stability hold the limits of stated.json against new scenes. Here the
pages are held against that file, and the file against the committed run.
"""

import json
import re
from collections.abc import Iterator
from functools import cache

import pytest
from pages import page, ROOT

RESULTS = ROOT / "notebooks" / "results"
LIMITS = "notebooks/measured/limits.md"
METHODS = ("source", "points", "follow")

# Rows of the page's table: the sweep of stated.json, and what the page's unit is of its.
SWEEPS = {
    "contact's conductance, at least": ("conductance_low", 1e-6),  # µS in S
    "contact's radius, at most": ("size", 1),
    "distance from a corner, to both edges, at least": ("from_corner", 1),
    "distance from the grounded electrode's centre, at least": ("from_ground", 1),
    "contacts at once (3 asked for), at most": ("contacts", 1),
    "distance at which two contacts are told apart, at least": ("apart", 1),
    "white noise, at most": ("white", 1e-3),  # mV in V
    "errors of the channels' gains, at most": ("gain", 1e-2),  # %
    "readings that are wild, at most": ("impulses", 1e-2),
    "dead channels, not told, at most": ("dead", 1),
    "missing channels, told, at most": ("missing", 1),
    "channels read before the ground was switched, at most": ("late", 1),
    "unevenness of the sheet, rms, at most": ("uneven", 1e-2),
    "length of a tear from an edge inwards, at most": ("tear", 1),
    "displacement of electrodes that is not told, rms, at most": ("misplaced", 1),
    "motion within a scan, at most": ("motion", 1),
}


@cache
def result(name: str) -> dict:
    return json.loads((RESULTS / f"{name}.json").read_text())


def stated() -> dict:
    return json.loads((ROOT / "tests" / "stability" / "stated.json").read_text())


def rows(name: str, heading: str) -> Iterator[list[str]]:
    """Cells of the first table below a heading, without its own."""
    lines = [said.text for said in page(name).plain]
    lines = lines[lines.index(heading) :]
    begin = next(k for k, line in enumerate(lines) if line.startswith("|"))
    for line in lines[begin + 2 :]:
        if not line.startswith("|"):
            return
        yield [cell.strip() for cell in line.strip("|").split("|")]


def number(cell: str) -> float:
    found = re.search(r"[\d.]+", cell)
    assert found, cell
    return float(found[0])


def test_the_page_states_the_limits_that_the_sweeps_hold() -> None:
    told, seen = stated(), set()
    for what, *cells in rows(LIMITS, "## Limits of three methods"):
        if what not in SWEEPS:
            assert what == "contact on electrodes and edges" and set(cells) == {"yes"}
            continue
        sweep, unit = SWEEPS[what]
        seen.add(what)
        for method, cell in zip(METHODS, cells):
            limit = told[sweep].get(method, {"limit": None})["limit"]
            if limit is None:
                # Another sweep, whose figure the page gives in words.
                jump = told["jump"][method]["limit"]
                assert cell in ("not swept", f"a jump of {jump:.0f} mm"), (what, method)
            else:
                assert number(cell) * unit == pytest.approx(limit), (what, method)
    assert seen == set(SWEEPS)
    for sweep in ("from_electrode", "from_edge"):
        assert not any(told[sweep][method]["limit"] for method in METHODS)


def test_no_limit_is_stated_beyond_that_of_the_committed_run() -> None:
    committed = {(row["sweep"], row["method"]): row for row in result("stability")["rows"]}
    values: dict[tuple[str, str], list[float]] = {}
    for row in result("stability")["summary"]["values"]:
        values.setdefault((row["sweep"], row["method"]), []).append(row["value"])
    wrong = []
    for sweep, methods in stated().items():
        for method, said in methods.items():
            key = sweep, method
            limit = committed[key]["limit"]
            if limit is None or said["limit"] is None:
                fine = said["limit"] is None
            else:
                # Values of a sweep get worse from first to last.
                order = values[key]
                fine = order.index(said["limit"]) <= order.index(limit)
            wrong += [] if fine else [f"{sweep}, {method}: {said['limit']} beyond {limit}"]
    assert not wrong


def test_places_off_without_a_flag_are_counted_on_the_pages() -> None:
    told = result("stability")["summary"]["flagged"].values()
    far = sum(one["far"] for one in told)
    silent = sum(round(one["far"] * (1 - one["flagged"])) for one in told)
    text = " ".join((ROOT / LIMITS).read_text().split())
    assert f"{far} places were over a pitch off. All but" in text
    assert silent == 2 and "All but two came with a flag." in text
    text = " ".join((ROOT / "notebooks" / "explain" / "fails.md").read_text().split())
    assert f"{far - silent} of {far} such places" in text


def test_wiring_faults_are_named_as_often_as_the_page_says() -> None:
    kinds = {
        "ground index off by one": "index off by one",
        "channels rolled": "rolled channels",
        "a pair swapped": "swapped pair",
        "a constant offset": "constant offset",
        "wrong sign of the drive": "sign of the drive",
        "none, a sound rig": "sound",
    }
    signs = result("doubt")["signs"]
    for what, cell in rows(LIMITS, "## What the flags are worth"):
        kind = kinds.pop(what)
        right = [one["right"] for one in signs if one["kind"] == kind]
        assert cell == f"{sum(right)} of {len(right)}", what
    assert not kinds


# The rows of README's table that the frontier's run made: kind of scene, method, pattern.
CHOICES = {
    "one contact, fast": ("one", "source", "corners"),
    "one contact": ("one", "points", "corners"),
    "two contacts, 15 to 40 mm apart": ("two", "points", "corners"),
    "three contacts": ("three", "points", "corners"),
    "a bar of 75 mm": ("bar", "points", "corners"),
    "a robot's loop, slot by slot": ("one", "follow", None),
}


def near(cell: str, exact: float) -> bool:
    """Whether a cell is the figure to the digits that it has."""
    digits = len(cell.split()[0].partition(".")[2])
    return abs(number(cell) - exact) <= 0.5001 * 10**-digits


def test_readme_has_the_places_of_the_committed_run() -> None:
    seen = set()
    told = [row for row in result("frontier")["rows"] if not row["peer"]]
    for what, _, median, worst, _ in rows("README.md", "## Which method for my scene"):
        if what not in CHOICES:
            continue
        seen.add(what)
        scene, method, pattern = CHOICES[what]
        found = [
            row
            for row in told
            if (row["scene"], row["method"]) == (scene, method)
            and row["dtype"] == "float32"
            and (pattern is None or row["pattern"] == pattern)
        ]
        assert any(
            near(median, row["place_median_mm"]) and near(worst, row["place_p90_mm"])
            for row in found
        ), what
    assert seen == set(CHOICES)


def test_results_that_are_committed_are_shown_by_a_page() -> None:
    """A result that nobody shows grows old unseen."""
    text = "\n".join(
        path.read_text()
        for pattern in ("README.md", "notebooks/**/*.md", "notebooks/**/*.py")
        for path in ROOT.glob(pattern)
    )
    shown = {path.stem for path in RESULTS.iterdir() if path.name in text}
    assert not {path.name for path in RESULTS.iterdir() if path.stem not in shown}
