"""`tomojax frontier`: how rows are scored, and how ours stand beside the peers'."""

import numpy as np
import pytest

import tomojax as tx
from bench.frontier import (
    beside_peers,
    mark_front,
    report,
    score,
    Trials,
)


def rows_of(places, image=None):
    """Rows with these contacts, each (C, 2) m."""
    n, most = len(places), 3
    xy, count = np.full((n, most, 2), np.nan), [len(p) for p in places]
    for k, found in enumerate(places):
        xy[k, : len(found)] = np.reshape(found, (-1, 2))
    nan = np.where(np.isfinite(xy[..., 0]), 1.0, np.nan)
    flags = np.where(np.array(count) == 0, tx.Flag.NO_CONTACT.value, 0)
    covariance = np.full((n, most, 3), np.nan)
    return tx.methods.Rows(
        *(np.array(count), xy, nan, nan, nan, 2e-4 * nan, covariance),
        *(np.zeros(n), flags, np.zeros(n, int), image, None),
    )


def trials_of(kind, places, image=None):
    xy = np.full((len(places), 3, 2), np.nan)
    total = np.full((len(places), 3), np.nan)
    for k, there in enumerate(places):
        xy[k, : len(there)], total[k, : len(there)] = there, 1e-4
    image = np.ones((len(places), 64, 64)) if image is None else image
    return Trials(
        np.full(len(places), kind), np.zeros((len(places), 64, 0)), xy, total, image
    )


def test_scores_of_places():
    size = np.array([0.16, 0.16])
    there = [[[0.05, 0.05]]] * 4
    found = [[[0.05, 0.051]], [[0.053, 0.05]], [[0.05, 0.09]], []]
    got = score(rows_of(found), trials_of("one", there), size)
    assert got["place_median_mm"] == pytest.approx((3 + 40) / 2)
    assert got["place_p90_mm"] is None  # one of four is lost
    assert got["far"] == 2 and got["far_undoubted"] == 1 and got["doubted"] == 0.25
    assert got["count_right"] == 0.75 and got["conductance_error"] is None
    got = score(rows_of(found[:3]), trials_of("one", there[:3]), size)
    assert got["conductance_error"] == pytest.approx(1.0)
    two = [[[0.05, 0.05], [0.08, 0.05]]] * 3
    seen = [[[0.08, 0.052], [0.05, 0.05]], [[0.065, 0.05]], [[0.05, 0.05], [0.1, 0.05]]]
    got = score(rows_of(seen), trials_of("two", two), size)
    assert got["told_apart"] == pytest.approx(1 / 3)
    assert got["place_median_mm"] == pytest.approx(15)  # of the worst contact
    # A bar is where the mean of what was found is.
    got = score(rows_of([two[0]]), trials_of("bar", [[[0.065, 0.05]]]), size)
    assert got["place_median_mm"] == pytest.approx(0, abs=1e-9)
    assert got["with_ghosts_median_mm"] == pytest.approx(0, abs=1e-9)


def test_ghosts_count_as_errors():
    size, there = np.array([0.16, 0.16]), [[[0.05, 0.05]]] * 3
    found = [[[0.05, 0.051], [0.05, 0.09]], [[0.052, 0.05]], [[0.05, 0.053]] * 2]
    got = score(rows_of(found), trials_of("one", there), size)
    assert got["place_median_mm"] == pytest.approx(2) and got["place_p90_mm"] < 3.1
    assert got["with_ghosts_median_mm"] == pytest.approx(3)
    assert got["with_ghosts_p90_mm"] == pytest.approx(40)
    assert got["ghosts"] == pytest.approx(2 / 3)
    # Of three found, the one that is left when both contacts have theirs.
    two = [[[0.05, 0.05], [0.08, 0.05]]]
    seen = [[[0.05, 0.05], [0.055, 0.05], [0.082, 0.05]]]
    got = score(rows_of(seen), trials_of("two", two), size)
    assert got["place_median_mm"] == pytest.approx(2)
    assert got["with_ghosts_median_mm"] == pytest.approx(5)
    # What is missed has no ghosts, and nothing that is found is lost as before.
    got = score(rows_of([[], [[0.05, 0.05]]]), trials_of("two", two * 2), size)
    assert got["ghosts"] == 0 and got["with_ghosts_p90_mm"] is None


@pytest.mark.parametrize("pixels", [16, 24, 64])
def test_scores_of_images(pixels):
    size = np.array([0.16, 0.16])
    image, truth = np.zeros((1, pixels, pixels)), np.zeros((1, 64, 64))
    part = pixels // 8
    image[0, 2 * part : 4 * part, 2 * part : 4 * part] = 3.0
    truth[0, 16:32, 16:32] = 1e-6
    rows, trials = (
        rows_of([[[0.06, 0.06]]], image),
        trials_of("one", [[[0.06, 0.06]]], truth),
    )
    got = score(rows, trials, size)
    assert got["image_error"] == pytest.approx(0, abs=1e-6)
    assert got["width_mm"] == pytest.approx(2e3 * np.sqrt(0.04**2 / np.pi))


def row(method, us, mm, scene="one", peer=False):
    return {
        **{"method": method, "scene": scene, "peer": peer, "pattern": "all", "slots": 64},
        **{"p50_us": us, "p99_us": us, "place_median_mm": mm, "place_p90_mm": mm},
        **{"lam_rule": "own", "pixels": 32, "dtype": "float32", "batch": 1},
        **{"doubted": 0.0},
    }


def test_front_and_peers():
    rows = [
        row("source", 5.0, 1.2),
        row("linear", 6.0, 3.0),
        row("points", 900.0, 0.2),
        row("shape", 1000.0, None),
        row("pyEIT", 60.0, 4.0, peer=True),
        row("NumPy sLORETA", 1.0, 0.1, peer=True),
        row("source", 5.0, 20.0, "two"),
    ]
    mark_front(rows)
    assert [r["on_front"] for r in rows] == [True, False, True, False, False, False, True]
    assert [r["ahead"] for r in rows] == [False] * 5 + [True, False]
    far, near = beside_peers(rows)
    assert far["times_as_fast"] == 12 and far["nearest"]["place_median_mm"] == 1.2
    assert near["times_as_fast"] is None and near["nearest"] is None
    text = report.text(rows)
    assert "accuracy of 1 of the peers' 2 rows, 12 to 12 times" in text
    assert "ahead in 1 of 2 rows:" in text and "none of ours is as near" in text
    assert "0.20" in text
    assert report.chart(rows).axes
    told = report.summary(rows)
    assert told["peers"][0]["place_mm"] == 4.0
    assert (told["peers_compared"], told["peers_ahead"]) == (2, 1)


def test_peers_are_compared_with_rows_that_are_alike():
    """As near and faster, but in a larger batch, in another dtype, without an image."""
    alike = {"batch": 256, "dtype": "float32", "output": "contacts"}
    rows = [
        row("source", 2.0, 1.0) | alike | {"batch": 1024},
        row("source", 2.0, 1.0) | alike | {"dtype": "float64"},
        row("source", 2.0, 1.0) | alike | {"output": "image"},
        row("NumPy sLORETA", 3.0, 1.0, peer=True) | alike,
    ]
    (found,) = beside_peers(rows)
    assert found["alike"] == 0 and not found["ahead"] and found["quickest"] is None
    mark_front(rows)
    assert "1 rows of peers have none of ours that is alike" in report.text(rows)
    slower = row("source", 9.0, 1.0) | alike
    (found,) = beside_peers([*rows, slower])
    assert found["ahead"] and found["times_as_fast"] == pytest.approx(1 / 3)
    # A ghost makes the quick one worse than its place.
    ghosts = row("linear", 2.0, 1.0) | alike | {"with_ghosts_median_mm": 30.0}
    (found,) = beside_peers([*rows, slower, ghosts])
    assert found["ahead"] and found["quickest"] is slower
    (found,) = beside_peers([*rows, slower, row("linear", 3.0, 1.0) | alike])
    assert not found["ahead"] and found["times_as_fast"] == 1
