"""`tomojax frontier`: its scenes and jobs, and what is kept of a run."""

import json
import sys

import numpy as np
import pytest

import tomojax as tx
from bench.frontier import (
    Job,
    KINDS,
    load_trials,
    make_trials,
    measured,
    method_rows,
    run as run_study,
    save_trials,
)
from bench.network import Network
from tomojax.cli.app import run


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
