"""`tomojax stability`: limits from rows, what is kept, pictures, mistakes."""

import json
import sys

import numpy as np
import pytest
from recordings import write

import tomojax as tx
from bench.stability import Bench, HOLDS, limits, report, run, SWEEPS
from tomojax.cli.app import run as run_command


def row(value, near, far=0, undoubted=0, method="points", raised=None, **more):
    told = {"sweep": "white", "method": method, "value": value, "raised": raised}
    counts = {"near": near, "far": far, "far_undoubted": undoubted, "silent": 0}
    return told | counts | {"place_p90_mm": 3.0} | more


def test_a_limit_is_the_last_value_that_holds_from_the_first_on():
    (found,) = limits([row(1, 1.0), row(2, 0.8), row(3, 0.7, 2), row(4, 1.0)])
    assert found["limit"] == 2 and found["last"] == 4 and found["beyond"] == "flag"
    assert "test_points[white]" in found["test"]
    (found,) = limits([row(1, 0.2, 20, 1)])
    assert found["limit"] is None and found["beyond"] == "flag"
    (found,) = limits([row(1, 0.2, 20, 2)])
    assert found["beyond"] == "unflagged" and found["far_undoubted"] == 2
    assert limits([row(1, 1.0)])[0]["beyond"] == "holds"
    assert limits([row(1, 0.5)])[0]["beyond"] == "worse"
    raised = {"sweep": "white", "method": "points", "value": 2, "raised": "no"}
    assert limits([row(1, 1.0), raised])[0]["beyond"] == "error"
    fell = [row(1, 1.0, rungs=[0, 4, 0, 0]), row(2, 0.0, rungs=[0, 0, 0, 4])]
    assert limits(fell)[0]["beyond"] == "fallback"


def test_what_is_far_off_is_counted_over_all_sweeps():
    rows = [row(1, 0, 10, 1), row(1, 0, 10, 3) | {"sweep": "dead"}]
    found = report.flagged(limits(rows))
    assert found["points"]["far"] == 20
    assert found["points"]["flagged"] == pytest.approx(0.8)
    said = report.flagged_text(found)
    assert "80 % flagged" in said and "float64" not in said
    both = limits([row(1, 1.0, dtypes_apart_mm=0.5), row(2, 1.0, dtypes_apart_mm=0.25)])
    said = report.flagged_text(report.flagged(both))
    assert "float32 0.5 mm from float64" in said


def test_sweeps_begin_harmless_and_draw_the_same_each_time():
    bench = Bench(tx.Sensor.grid(4, 4, 0.02, 0.01, divisions=(32, 32)), 2, 3)
    volts, xy = bench.lone
    assert volts.shape == (2, 16, 16) and xy.shape == (2, 1, 2)
    for name, sweep in SWEEPS.items():
        assert len(set(sweep.values)) == len(sweep.values) > 3, name
    for name in ("white", "gain", "dead", "swapped", "late", "jump"):
        sweep = SWEEPS[name]
        made, again = (sweep.make(bench, sweep.values[2]) for _ in range(2))
        np.testing.assert_array_equal(made.volts, again.volts)
        assert (made.volts != volts).any() or name == "jump"
    dead = SWEEPS["dead"].make(bench, 4.0).volts
    assert ((dead == 0).all((0, 1)).sum()) == 4
    swapped = SWEEPS["swapped"].make(bench, 3.0).volts
    assert ((swapped != volts).any((0, 1)).sum()) == 3
    np.testing.assert_allclose(np.sort(swapped, -1), np.sort(volts, -1))
    wrong = SWEEPS["wrong_ground"].make(bench, 1.0).volts
    first = bench.corners[0]
    np.testing.assert_array_equal(wrong[:, first], volts[:, first + 1])
    late = SWEEPS["late"].make(bench, 4.0).volts
    np.testing.assert_array_equal(late[:, first, 4:], volts[:, first, 4:])
    second = bench.corners[1]
    np.testing.assert_array_equal(late[:, first, :4], volts[:, second, :4])


def test_scenes_are_what_a_sweep_says():
    bench = Bench(tx.Sensor.grid(4, 4, 0.02, 0.01, divisions=(32, 32)), 2, 3)
    apart = SWEEPS["apart"].make(bench, 20.0)
    ways = np.hypot(*(apart.xy[:, 0] - apart.xy[:, 1]).T)
    np.testing.assert_allclose(ways, 0.02, atol=1e-3)
    assert apart.near == pytest.approx(0.02 / 3)
    two = SWEEPS["from_electrode"].make(bench, 5.0)
    nearest = np.sqrt(((two.xy - bench.electrodes) ** 2).sum(-1)).min(1)
    np.testing.assert_allclose(nearest, 0.005, atol=1e-3)
    torn, whole = (SWEEPS["tear"].make(bench, value) for value in (40.0, 0.0))
    assert np.abs(torn.volts - whole.volts).max() > 0.05
    # A contact that moves: the first slot where it was, later ones where it is by then.
    still, moving = (SWEEPS["motion"].make(bench, v) for v in (1e-6, 30.0))
    first, last = bench.corners[0], 14
    np.testing.assert_allclose(moving.volts[:, first], still.volts[:, first], atol=3e-3)
    assert np.abs(moving.volts[:, last] - still.volts[:, last]).max() > 0.02


def test_what_is_done_is_not_done_again(tmp_path, monkeypatch):
    done = []

    def rows(trial, name, methods):
        done.append(name)
        return [row(1, 1.0) | {"sweep": name}]

    monkeypatch.setattr("bench.stability._study.sweep_rows", rows)
    sensor = tx.Sensor.grid(dtype=np.float32)
    first = run(sensor, tmp_path, True, ("white",))
    both = run(sensor, tmp_path, True, ("white", "dead"))
    assert done == ["white", "dead"] and both[:1] == first
    with pytest.raises(ValueError, match="another seed"):
        run(sensor, tmp_path, True, seed=1)


@pytest.mark.long
def test_the_command_from_end_to_end(tmp_path, monkeypatch, capsys):
    """One sweep of one method on two scenes of a small rig, told by its recording."""
    near = np.array([[0.01, 0.01], [0.05, 0.01], [0.03, 0.03], [0.01, 0.05], [0.05, 0.05]])
    codes = np.zeros((4, 2, 5), np.int16)
    told = {"electrode_xy": near, "size": [0.06, 0.06], "settle_delay": 2e-5}
    write(tmp_path / "rig.h5", codes, [0, 4], **told)
    monkeypatch.setattr("bench.stability._study.QUICK", ("source",))
    words = ["tomojax", "stability", "--quick", "--only", "saturated", "--scenes", "2"]
    words += ["--like", str(tmp_path / "rig.h5"), "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as stop:
        run_command()
    assert not stop.value.code
    said = capsys.readouterr().out
    told = json.loads((tmp_path / "out" / "stability.json").read_text())
    (limit,), values = told["rows"], told["summary"]["values"]
    assert [row["value"] for row in values] == list(SWEEPS["saturated"].values)
    assert all(row["scenes"] == 2 and row["raised"] is None for row in values)
    assert all(row["method"] == "source" for row in values)
    # Clipped at 0.05 V nothing is left of a place; below the drive nothing is clipped.
    assert values[0]["near"] == 1 and values[-1]["near"] < HOLDS
    assert values[-1]["place_p90_mm"] is None or values[-1]["place_p90_mm"] > 10
    assert f"{limit['limit']:g} of 0.05" in said and told["summary"]["numbers"] is None
    assert (tmp_path / "out" / "stability.png").stat().st_size > 10_000
    kept = json.loads((tmp_path / "out" / "stability-saturated.json").read_text())
    assert kept == values


def test_the_command_draws_and_says(tmp_path, monkeypatch, capsys):
    values = SWEEPS["white"].values
    made = [row(v, 1.0 if v < 0.1 else 0.0, 2 * (v > 0.2)) for v in values]
    monkeypatch.setattr("bench.stability._study.sweep_rows", lambda *_: made)
    numbers = {
        "solvers": [
            {"solver": "double", "relative_lam": 0.1, "error": 1e-6},
            {"solver": "double", "relative_lam": 0.01, "error": None},
        ],
        "gradients": [
            {"points": "random", "count": 3, "finite": 3, "largest_difference": {"x": 1e-9}}
        ],
        "resistances": [
            {"dtype": "float32", "resistance": 1.0, "place_median_mm": 2.5, "silent": 0}
            | {"raised": None},
            {"dtype": "float32", "resistance": None, "place_median_mm": None, "silent": 0}
            | {"raised": "no"},
        ],
        "starts": [
            {"optimiser": "tune", "start": 1e-3, "excess": 0.25},
            {"optimiser": "tune", "start": 1.0, "excess": None},
        ],
    }
    monkeypatch.setattr("bench.stability.numbers", lambda *_: numbers)
    monkeypatch.setattr("bench.stability._study.SWEEPS", {"white": SWEEPS["white"]})
    words = ["tomojax", "stability", "--quick", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as stop:
        run_command()
    assert not stop.value.code
    said = capsys.readouterr().out
    assert "0.03 of 0.3" in said and "2 of 2 far off are flagged" in said
    assert "3 finite" in said and "NaN at 1 of 2" in said
    assert "places 2.5 to 2.5 mm off" in said and "1 a ValueError" in said
    assert "tune from 2 λ, bad ones too: ends inf %" in said
    report = json.loads((tmp_path / "stability.json").read_text())
    assert set(report) == {"rows", "summary", "environment"}
    expected = {"sweep", "method", "limit", "beyond", "test"}
    assert expected <= set(report["rows"][0])
    for name in ("stability.png", "stability_numbers.png"):
        assert (tmp_path / name).stat().st_size > 10_000


@pytest.mark.parametrize(
    "words, message",
    [
        (["--only", "wind"], "--only: got 'wind', expected one of"),
        (["--scenes", "0"], "--scenes: got 0, expected 1 to 1000"),
        (["--seed", "-1"], "--seed: got -1"),
        (["--like", "none.h5"], "none.h5"),
    ],
)
def test_mistakes(words, message, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["tomojax", "stability", *words])
    with pytest.raises(SystemExit) as stop:
        run_command()
    said = capsys.readouterr().err.strip().splitlines()
    assert stop.value.code == 2 and len(said) == 1 and message in said[0]
