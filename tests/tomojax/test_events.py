"""Touch-down and lift-off."""

import numpy as np
import pytest

import tomojax as tx
from tomojax.events import EventFinder, find_events


def told(found) -> list:
    return [(event.kind, event.contact, round(event.t, 6)) for event in found]


def test_two_contacts_that_swap_places_in_the_rows_keep_their_numbers() -> None:
    finder = EventFinder(reach=0.01, hold=0.01)
    a, b = (0.02, 0.02), (0.08, 0.02)
    finder.row(0.0, [a, b], [2e-4, 1e-4])
    numbers, found = finder.row(0.001, [a, b], [2e-4, 1e-4])
    assert numbers == [1, 2] and told(found) == [("touch_down", 1, 0), ("touch_down", 2, 0)]
    assert finder.row(0.002, [b, a], [2e-4, 1e-4]) == ([2, 1], [])


def test_one_row_alone_is_noise() -> None:
    finder = EventFinder(reach=0.01, hold=0.01)
    assert finder.row(0.0, [(0.02, 0.02)], [1e-4]) == ([0], [])
    assert finder.row(1.0, [], []) == ([], []) and finder.finish() == []


def test_rows_without_an_answer_end_nothing() -> None:
    finder = EventFinder(reach=0.01, hold=0.0025)
    for k in range(3):
        finder.row(0.001 * k, [(0.02, 0.02)], [1e-4])
    for k in range(3, 6):
        assert finder.row(0.001 * k, [], [], int(tx.Flag.NO_DATA)) == ([], [])
    assert finder.row(0.0045, [(0.02, 0.02)], [1e-4]) == ([1], [])
    assert told(finder.row(1.0, [], [])[1]) == []
    assert told(finder.row(1.001, [], [])[1]) == [("lift_off", 1, 0.0045)]


def test_time_without_a_row_ends_nothing() -> None:
    """Slots that were skipped, and a gap: each row that exists shows the contact."""
    finder = EventFinder.of_rows(pitch=0.02, interval=0.005)
    found = []
    for slot in (0, 1, 2, 3, 8, 9, 10, 15, 110, 111):
        found += finder.row(slot * 0.005, [(0.09, 0.07)], [1e-4])[1]
    for slot in (210, 211, 212):
        assert finder.row(slot * 0.005, [], [])[1] == []
    found += finder.row(213 * 0.005, [], [])[1]
    assert told(found) == [("touch_down", 1, 0.0), ("lift_off", 1, 0.555)]
    assert [event.text for event in found] == ["", "no row for 0.49 s"]
    # Another place after a gap is another contact.
    found = [finder.row(t, [(0.01, 0.01)], [1e-4])[1] for t in (2.0, 2.005)][1]
    assert [(e.contact, e.text) for e in found] == [(2, "no row for 0.94 s")]


def test_rows_of_a_file_are_as_rows_one_by_one() -> None:
    rng = np.random.default_rng(0)
    t, there = 0.01 * np.arange(200), np.zeros(200, int)
    there[20:60] = there[100:180] = 1
    xy = 0.05 + rng.normal(0, 1e-4, (200, 1, 2))
    found = find_events(t, there, xy, np.full((200, 1), 1e-4), pitch=0.02)
    at = [("touch_down", 1, 0.2), ("lift_off", 1, 0.59)]
    assert told(found) == [*at, ("touch_down", 2, 1.0), ("lift_off", 2, 1.79)]


def test_a_wrong_reach_is_named() -> None:
    with pytest.raises(ValueError, match=r"^reach: got nan"):
        EventFinder(float("nan"), 0.1)
