"""`tomojax frontier`: its scenes and jobs, and what is kept of a run."""

import json
import sys

import numpy as np
import pytest

import tomojax as tx
from bench.frontier import (
    DAY,
    day_rows,
    Job,
    KINDS,
    load_trials,
    make_trials,
    measured,
    method_rows,
    rate_rows,
    report,
    run as run_study,
    save_trials,
)
from bench.network import Network
from tomojax.cli.app import run
from tomojax.sensor import nominal_noise


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A file with two scenes of each kind."""
    path = tmp_path_factory.mktemp("frontier") / "scenes.npz"
    sensor = tx.Sensor.grid(dtype=np.float32)
    told = []
    save_trials(path, sensor, make_trials(sensor, 2, 3, lambda: told.append(1)))
    assert len(told) == 2 * len(KINDS)
    return path


def test_a_network_of_another_sensor_is_like_the_exact_model():
    """Two numbers of electrodes on a sheet that is not square; no errors of a rig."""
    xy = np.array([[0.02, 0.02], [0.08, 0.02], [0.05, 0.05], [0.02, 0.08], [0.1, 0.07]])
    sensor = tx.Sensor(
        [0.12, 0.10], xy, divisions=(96, 80), ground_resistance=20.0, electrode_shunt=1.0
    )
    rig = Network(sensor, np.random.default_rng(0), 0, 0, 0, 0)
    inside = rig.disc([0.065, 0.06], 0.01)
    volts, truth = rig.scene((inside, 2e-4))
    area = inside.sum() * 0.0008**2
    shape = tx.Disc(truth[0][0], np.sqrt(area / np.pi), 2e-4 / area)
    expected = np.asarray(tx.voltages(sensor, shape))
    np.testing.assert_allclose(volts, expected, atol=0.03 * expected.max())


@pytest.mark.long
def test_scenes_come_back(kept):
    sensor, trials = load_trials(kept, "float32")
    again = make_trials(sensor, 2, 3)
    np.testing.assert_array_equal(trials.volts, again.volts)
    assert sensor.dtype == np.float32 and sorted(set(trials.kind)) == sorted(KINDS)
    contacts = np.isfinite(trials.conductance).sum(1)
    assert contacts.tolist() == [1, 1, 2, 2, 3, 3, 1, 1, 1, 1]
    total = np.nansum(trials.conductance, 1)
    np.testing.assert_allclose(trials.image.sum((1, 2)), total)


@pytest.mark.long
def test_one_job(kept):
    sensor, trials = load_trials(kept, "float32")
    job = Job("source", ("corner", "around"), batches=(4,), pixels=16)
    rows = list(method_rows(job, sensor, trials))
    # Patterns, with and without an image; each for every kind.
    assert len(rows) == 2 * 2 * len(KINDS)
    assert {r["slots"] for r in rows} == {1, 8}
    ones = [r for r in rows if r["scene"] == "one"]
    assert all(r["place_median_mm"] < 10 and r["p50_us"] > 0 for r in ones)
    assert all(r["p99_us"] >= r["p50_us"] and r["first_s"] > 0 for r in rows)
    json.dumps(rows)


@pytest.mark.long
def test_a_run_goes_on_where_it_was(kept, tmp_path, monkeypatch):
    sensor = tx.Sensor.grid(dtype=np.float32)
    jobs = [Job("linear", ("all",)), Job("source", ("all",)), Job("points", ("all",))]
    monkeypatch.setattr("bench.frontier._study.jobs", lambda *_: jobs)
    monkeypatch.setattr(
        "bench.frontier._study.make_trials",
        lambda *_: load_trials(kept, "float32")[1],
    )
    asked = []

    def measured(path, job):
        if job.method == "points" and len(asked) < 3:
            raise KeyboardInterrupt
        asked.append(job.method)
        return [{"method": job.method}]

    monkeypatch.setattr("bench.frontier._study.measured", measured)
    with pytest.raises(KeyboardInterrupt):
        run_study(sensor, tmp_path, True)
    path = tmp_path / "frontier-rows.jsonl"
    with path.open("a") as file:
        file.write('{"job": "cut o')  # as a crash leaves it
    asked.append("again")
    rows = run_study(sensor, tmp_path, True)
    assert asked == ["linear", "source", "again", "points"] and len(rows) == 3
    assert all(json.loads(line) for line in path.read_text().splitlines())
    with pytest.raises(ValueError, match="another seed.*or another folder"):
        run_study(sensor, tmp_path, True, seed=5)
    other = tx.Sensor.grid(dtype=np.float32, sheet_resistance=5e3)
    with pytest.raises(ValueError, match="another sensor"):
        run_study(other, tmp_path, True)


@pytest.mark.long
def test_what_failed_is_tried_again(kept, tmp_path, monkeypatch):
    sensor, tried = tx.Sensor.grid(dtype=np.float32), []
    monkeypatch.setattr("bench.frontier._study.jobs", lambda *_: [Job("linear", ("all",))])
    monkeypatch.setattr(
        "bench.frontier._study.make_trials",
        lambda *_: load_trials(kept, "float32")[1],
    )

    def measured(path, job):
        tried.append(job.method)
        return [{"failed": "killed"} if len(tried) == 1 else {"method": "linear"}]

    monkeypatch.setattr("bench.frontier._study.measured", measured)
    assert run_study(sensor, tmp_path, True)[0]["failed"] == "killed"
    for _ in range(2):
        assert run_study(sensor, tmp_path, True)[0]["method"] == "linear"
    assert len(tried) == 2
    # Another method alone: nothing new, and what is there already.
    rows = run_study(sensor, tmp_path, True, only=("source",))
    assert len(rows) == 1 and len(tried) == 2


@pytest.mark.long
def test_a_job_that_fails_says_so(kept):
    bad = Job("linear", ("no_such_pattern",))
    (said,) = measured(kept, bad)
    assert "no_such_pattern" in said["failed"] and said["scene"] is None


@pytest.mark.parametrize(
    "words, message",
    [
        (["--scenes", "1"], "--scenes: got 1, expected 2 to 1000"),
        (["--seed", "-1"], "--seed: got -1"),
        (["--only", "guess"], "--only: got 'guess', expected one of linear"),
        (["--like", "none.h5"], "none.h5"),
    ],
)
def test_mistakes(words, message, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["tomojax", "frontier", *words])
    with pytest.raises(SystemExit) as stop:
        run()
    said = capsys.readouterr().err.strip().splitlines()
    assert stop.value.code == 2 and len(said) == 1 and message in said[0]


def test_missing_peers_are_named(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setattr(sys, "argv", ["tomojax", "frontier"])
    with pytest.raises(SystemExit):
        run()
    assert "tomojax[app,peers]" in capsys.readouterr().err


@pytest.mark.long
def test_rates_stay_below_the_machine_s(kept, monkeypatch):
    sensor, trials = load_trials(kept, "float32")
    monkeypatch.setattr("bench.frontier._rates.machine", lambda dtype: (1e15, 1e18))
    job = Job("rates", ("corner",), batches=(1, 4), pixels=16)
    rates = list(rate_rows(job, sensor, trials))
    assert [(r["method"], r["batch"]) for r in rates] == [
        *(("linear", 1), ("linear", 4), ("source", 1), ("source", 4))
    ]
    assert all(0 < r["part_of_bound"] < 1 and 0 < r["error"] < 1e-5 for r in rates)
    one = rates[2]  # a frame of 64 voltages through 64 rows to 256 pixels
    flops, numbers = 2 * (64 * 64 + 64 * 256), 64 + 256 + 64 * (64 + 256)
    expected = max(flops / 1e18, 4 * numbers / 1e15)
    assert one["bound_frames_per_s"] == pytest.approx(1 / expected)
    assert one["bound"] == "bytes"
    assert report.rate_chart(rates).axes
    lines = list(report.machine_lines(rates, []))
    assert len(lines) == 2 and "256" not in lines[0] and "16 x 16" in lines[0]


@pytest.mark.long
def test_a_day_is_the_same_frames_for_both(kept, monkeypatch):
    """Two quick methods stand in; frames and figures are compared with the trials."""
    sensor, trials = load_trials(kept, "float32")
    quick = {
        "auto": tx.method(sensor, "source", 16),
        "shape": tx.method(sensor, "linear", 16),
    }
    rates, given, told = "bench.frontier._rates", [], []

    def watched(model, *options):
        batch = tx.Batch(model, *options)

        def call(volts, grounds):
            given.append((volts, grounds))
            told.append(batch(volts, grounds))
            return told[-1]

        return call

    monkeypatch.setattr(f"{rates}.make_method", lambda _, name, pixels: quick[name])
    monkeypatch.setattr(f"{rates}.Batch", watched)
    # A process of its own runs a job; here others' programs stay compiled.
    monkeypatch.setattr("jax.clear_caches", lambda: None)
    auto, largest = day_rows(Job("day", ("corners",)), sensor, trials)
    assert auto["frames"] == largest["frames"] == 100
    volts, grounds = given[0]
    for more, same in given[1:]:
        np.testing.assert_array_equal(more, volts)
        np.testing.assert_array_equal(same, grounds)
    assert len(given) == 6 and (grounds == [0, 63]).all()

    # First the scenes of each kind, then frames of nothing but noise.
    chosen, start = [], 0
    for kind, count in DAY.items():
        of_kind = np.flatnonzero(trials.kind == kind)
        some = volts[start : start + count, None]
        same = (some == trials.volts[of_kind][:, [0, 63]].astype("f4")).all((2, 3))
        assert (same.sum(1) == 1).all()
        chosen.append(of_kind[same.argmax(1)])
        start += count
    assert len(volts) == start + 70
    assert np.std(volts[start:]) == pytest.approx(nominal_noise(tx.Sensor.grid()), rel=0.1)

    # Places of single contacts, once more from what each method told.
    ones = trials.xy[chosen[0], 0]
    for said, rows in ((auto, told[0]), (largest, told[3])):
        away = np.full(len(ones), np.inf)
        for k, place in enumerate(ones):
            found = rows.contact_xy[k, : rows.contact_count[k]]
            away[k] = min(np.linalg.norm(found - place, axis=1), default=np.inf)
        figures = said["kinds"]["one"]
        assert figures["place_median_mm"] == pytest.approx(1e3 * np.median(away))
        assert {k: v["scenes"] for k, v in said["kinds"].items()} == DAY
        nothing = int((rows.contact_count[start:] > 0).sum())
        assert said["contacts_where_nothing_is"] == nothing
    assert auto["contacts_where_nothing_is"] == 0
    assert auto["kinds"]["one"] != largest["kinds"]["one"]
    (line,) = report.machine_lines([], [auto])
    assert "a day of frames, auto" in line
