"""The limits that are stated, and what a method says beyond them.

Each sweep at the stated limit and at its last value, on scenes of their own. A limit that
moves in, or a place far off that comes without a flag, fails here.
"""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import tomojax as tx
from tomojax.studies.stability import (
    Bench,
    CONTACTS,
    FLAGGED,
    HOLDS,
    SLOW_TESTS,
    SWEEPS,
    takes_part,
    Trial,
    trial_row,
)

STATED = json.loads((Path(__file__).parent / "stated.json").read_text())
SCENES, SEED = 5, 2026


@cache
def trial() -> Trial:
    sensor = tx.Sensor.grid(divisions=(64, 64), dtype=np.float32)
    return Trial(Bench(sensor, SCENES, SEED))


@cache
def scenes(name: str, value: float):
    return SWEEPS[name].make(trial().bench, value)


def stated(method: str) -> list[str]:
    return [name for name in SWEEPS if method in STATED.get(name, {})]


def check(method: str, name: str) -> None:
    values, limit = SWEEPS[name].values, STATED[name][method]["limit"]
    if limit is not None:
        row = trial_row(trial(), method, scenes(name, limit), False)
        assert row["raised"] is None and row["near"] >= HOLDS, row
        assert row["silent"] == 0
    if values[-1] != limit:
        row = trial_row(trial(), method, scenes(name, values[-1]), False)
        said = STATED[name][method]["beyond"]
        if "error" in said:
            assert row["raised"]
        else:
            assert row["raised"] is None and row["silent"] == 0
            assert row["far_undoubted"] <= (1 - FLAGGED) * row["far"] or "unflagged" in said


@pytest.mark.parametrize("name", stated("linear"))
def test_linear(name):
    check("linear", name)


@pytest.mark.parametrize("name", stated("source"))
def test_source(name):
    check("source", name)


@pytest.mark.parametrize("name", stated("points"))
def test_points(name):
    check("points", name)


@pytest.mark.parametrize("name", stated("follow"))
def test_follow(name):
    check("follow", name)


@pytest.mark.parametrize("name", SLOW_TESTS)
def test_conductance(name):
    check("conductance", name)


@pytest.mark.parametrize("name", SLOW_TESTS)
def test_auto(name):
    check("auto", name)


def test_every_sweep_is_stated_and_tested():
    for name, sweep in SWEEPS.items():
        some = scenes(name, sweep.values[0])
        for method in ("linear", "source", "points", "follow"):
            assert (method in STATED[name]) == takes_part(sweep, method, some), name
    assert CONTACTS == 3
