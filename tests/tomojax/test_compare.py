"""Patterns compared at equal width, on grids of any size."""

import numpy as np
import pytest

import tomojax as tx

MINE = {"mine": [0, 7, 14], "around": "around", "boundary": "boundary", "all": "all"}


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid(4, 4, dtype=np.float32, divisions=(16, 16))


@pytest.fixture(scope="module")
def table(sensor):
    return tx.design.compare_patterns(sensor, MINE, contacts=16, rigs=2)


@pytest.mark.long
def test_widths_are_equal_and_more_slots_are_nearer(table) -> None:
    rows = {row.pattern: row for row in table.rows}
    assert list(rows) == list(MINE) and table.width_mm == pytest.approx(20)
    for row in rows.values():
        assert row.equally_wide and row.width_mm == pytest.approx(20, rel=0.03)
        assert 1e-8 <= row.lam_relative <= 1 and row.place_median_mm < row.place_p90_mm
    assert [r.slots for r in table.rows] == [3, 8, 12, 16]
    assert [r.exploratory_slots for r in table.rows] == [0, 2, 0, 0]
    assert rows["all"].dt_ms == pytest.approx(1.6)
    assert rows["all"].place_median_mm < rows["mine"].place_median_mm < 20
    assert 0 < rows["all"].place_median_mm < 3


def test_tables_for_people_and_for_pandas(table) -> None:
    text, html, frame = repr(table), table._repr_html_(), table.to_pandas()
    assert len(text.splitlines()) == 7 and "around" in text and "8+2" in text
    assert html.count("<tr>") == 5 and "place_median_mm" in html
    assert frame.pattern.tolist() == list(MINE)
    assert frame.place_p90_mm.tolist() == [row.place_p90_mm for row in table.rows]


def test_a_width_out_of_reach_is_said(sensor) -> None:
    (row,) = tx.design.compare_patterns(sensor, ["all"], width=1e-3, contacts=16).rows
    assert not row.equally_wide and row.width_mm > 1.5


@pytest.mark.parametrize(
    "patterns, told",
    [
        ({}, "patterns: got none"),
        ({"a": "best"}, r"patterns\['a'\]: got 'best', expected grounds or one of all"),
        ({"a": [0, 0]}, r"patterns\['a'\]: .*at most once"),
        ({"a": [0, 16]}, "grounds: got 0 to 16"),
    ],
)
def test_bad_patterns(sensor, patterns, told) -> None:
    with pytest.raises(ValueError, match=told):
        tx.design.compare_patterns(sensor, patterns)
