"""`tomojax frontier`: its scenes, scores and front; one job, and what is kept of it."""

import json
import sys

import numpy as np
import pytest
import references
import scipy.sparse.linalg

import tomojax as tx
from tomojax.cli.app import run
from tomojax.kernels.sheet import nodes as mesh_nodes
from tomojax.sensor import nominal_noise
from tomojax.studies.frontier import (
    beside_peers,
    best_lambda,
    DAY,
    day_rows,
    Job,
    jobs as study_jobs,
    KINDS,
    load_trials,
    make_trials,
    mark_front,
    measured,
    method_rows,
    paper_jacobian,
    peer_rows,
    peer_table,
    peers_of,
    pixel_places,
    rate_rows,
    read_half,
    read_peak,
    report,
    run as run_study,
    save_trials,
    score,
    Trials,
)
from tomojax.studies.network import Network


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


def test_scenes_come_back(kept):
    sensor, trials = load_trials(kept, "float32")
    again = make_trials(sensor, 2, 3)
    np.testing.assert_array_equal(trials.volts, again.volts)
    assert sensor.dtype == np.float32 and sorted(set(trials.kind)) == sorted(KINDS)
    contacts = np.isfinite(trials.conductance).sum(1)
    assert contacts.tolist() == [1, 1, 2, 2, 3, 3, 1, 1, 1, 1]
    total = np.nansum(trials.conductance, 1)
    np.testing.assert_allclose(trials.image.sum((1, 2)), total)


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
        row("conductance", 1000.0, None),
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
    for draw in (report.chart, report.rungs):
        assert draw(rows).axes
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


@pytest.fixture(scope="module")
def small():
    """Electrodes on nodes of the peers' mesh for 16 pixels along a side."""
    return tx.Sensor.grid(4, 4, divisions=(16, 16), dtype=np.float64)


def test_peers_have_the_paper_s_jacobian(small):
    """Voltages with 1 V on a pixel and one electrode grounded, solved at once."""
    jac, loops = paper_jacobian(peer_table(small, 16))
    shape, ground, pixel, m = (64, 64), 9, 100, 16
    nodes = np.asarray(mesh_nodes(shape, small.size))
    places = np.concatenate(
        [np.asarray(small.electrode_xy), pixel_places(16, np.asarray(small.size))]
    )
    at = ((nodes[:, None] - places) ** 2).sum(-1).argmin(0)
    np.testing.assert_allclose(nodes[at], places, atol=1e-12)
    sheet = np.full(2 * 64**2, 1e-4)
    stiffness = references.skfem_stiffness(sheet, shape, small.size)
    # A node of spacing 1.25 mm as a disc of 2.5 mm instead of 0.25: less in series.
    series = 4.0 + 1e4 / (2 * np.pi) * np.log(0.2 * 1.25 / 2.5)
    u = np.zeros(len(nodes))
    u[at[m + pixel]] = 1.0
    free = np.flatnonzero(u == 0)
    system = stiffness.tolil()
    system[at[ground], at[ground]] += 1 / series
    system = system.tocsc()
    right = -(system @ u)[free]
    u[free] = scipy.sparse.linalg.spsolve(system[free][:, free], right)
    current = u[at[ground]] / series
    assert loops[ground, pixel] == pytest.approx(1 / current, rel=1e-6)
    others = np.delete(np.arange(m), ground)
    np.testing.assert_allclose(jac[ground, others, pixel], u[at[others]], atol=1e-7)
    # What the channel itself reads is behind the disc, before the ground path.
    assert jac[ground, ground, pixel] == pytest.approx(4.0 * current, rel=1e-6)


def test_operators_are_what_they_are_named_after(small):
    """Each peer's image beside its formula in full, of random voltages of two slots."""
    rng, grounds, lam = np.random.default_rng(0), np.array([0, 15]), 1e-3
    volts = rng.normal(size=(3, 32))
    found = {(p[1].name, p[1].products): p[1] for p in peers_of(small, 8)}
    assert {p.stands for p in found.values()} == {"mean"}
    table = peer_table(small, 8, "mean")
    jac = paper_jacobian(table)[0][grounds].reshape(32, 64)

    def inverse(rows, damping):
        largest = np.linalg.norm(rows, 2) ** 2
        normal = rows.T @ rows + lam * largest * damping
        return np.linalg.solve(normal, rows.T)

    expected = {("scikit-fem + NumPy", 1): volts @ inverse(jac, np.eye(64)).T}
    weights = np.sqrt((jac**2).sum(0))
    kotre = inverse(jac, np.diag(weights / weights.mean()))
    expected["pyEIT", 1] = volts @ kotre.T
    maps = [table.transfer(int(g)) for g in grounds]
    backs = [inverse(rows, np.eye(64)) for rows in maps]
    seen = np.array([np.diagonal(b @ rows) for b, rows in zip(backs, maps)])
    slots = volts.reshape(3, 2, 16)
    each = [slots[:, k] @ backs[k].T for k in range(2)]
    one = np.mean([image / np.sqrt(d) for image, d in zip(each, seen)], 0)
    expected["NumPy sLORETA", 1] = one
    expected["NumPy sLORETA", 2] = np.mean(each, 0) / np.sqrt(seen.mean(0))
    assert found.keys() == expected.keys()
    for key, images in expected.items():
        got = found[key].prepare(grounds, lam, "float64")(volts)
        np.testing.assert_allclose(got, images, atol=1e-7 * np.abs(images).max())
        single = found[key].prepare(grounds, lam, "float32")(volts.astype("f4"))
        assert single.dtype == np.float32
        np.testing.assert_allclose(single, images, atol=1e-4 * np.abs(images).max())


def test_places_are_read_between_pixels():
    size, pixels = np.array([0.16, 0.08]), 16
    centres = pixel_places(pixels, size)
    places = np.array([[0.083, 0.041], [0.02, 0.061], [0.0, 0.08]])
    away = ((centres - places[:, None]) / size) ** 2
    bowl = (1 - away.sum(-1)).astype("f4")
    np.testing.assert_allclose(read_peak(bowl, pixels, size), places, atol=2e-5)
    hill = np.exp(-away.sum(-1)[:2] / 0.01).astype("f4")
    np.testing.assert_allclose(read_half(hill, pixels, size), places[:2], atol=1e-3)
    # Nothing to be seen is a place on the sheet, not a number that is none.
    flat = np.zeros((2, pixels**2), "f4")
    assert np.isfinite([read(flat, pixels, size) for read in (read_peak, read_half)]).all()


@pytest.mark.parametrize(
    "best, at_end", [(-3.0, False), (-11.5, False), (4.0, False), (40.0, True)]
)
def test_the_range_of_lambda_has_the_best_inside(best, at_end):
    lam, end = best_lambda(lambda x: 1 + abs(np.log10(x) - best))
    assert end == at_end and (at_end or lam == pytest.approx(10.0**best))
    # Where it no longer matters, nothing is won by going on.
    lam, end = best_lambda(lambda x: max(1.0, 2 + np.log10(x)))
    assert not end and lam <= 0.1


def test_rows_of_peers(small, monkeypatch):
    monkeypatch.setattr("tomojax.studies.frontier._measure._SECONDS", 0.0)
    trials = make_trials(small, 2, 3)
    job = Job("peers", ("corners", "around"), batches=(1, 4), pixels=8)
    rows = list(peer_rows(job, small, trials))
    json.dumps(rows)
    told = {(r["method"], r["products"], r["pattern"]) for r in rows}
    assert len(told) == 4 + 3 and ("pyEIT", 1, "around") not in told
    # Outputs, batches, kinds; each says what it is of.
    assert len(rows) == len(told) * 2 * 2 * len(KINDS) and all(r["peer"] for r in rows)
    assert {(r["output"], r["batch"], r["dtype"]) for r in rows} == {
        (output, batch, "float32") for output in ("contacts", "image") for batch in (1, 4)
    }
    ones = [r for r in rows if r["scene"] == "one" and r["method"] == "NumPy sLORETA"]
    assert all(r["with_ghosts_median_mm"] < 10 and not r["lam_at_end"] for r in ones)
    single = [r for r in rows if r["output"] == "contacts"]
    assert all(r["ghosts"] == 0 and "image_error" not in r for r in single)
    assert all(r["count_right"] == 0 for r in single if r["scene"] == "three")


def test_peers_get_what_ours_get():
    for quick in (True, False):
        some = study_jobs(quick, (0, 1))
        peers = [j for j in some if j.method == "peers"]
        assert peers and all(j.dtype == "float32" for j in peers)
        for peer in peers:
            ours = [j for j in some if (j.method, j.dtype) == ("source", "float32")]
            batches = {b for j in ours for b in j.batches}
            assert set(peer.batches) <= batches
            assert set(peer.patterns) <= {p for j in ours for p in j.patterns}


def test_a_run_goes_on_where_it_was(kept, tmp_path, monkeypatch):
    sensor = tx.Sensor.grid(dtype=np.float32)
    jobs = [Job("linear", ("all",)), Job("source", ("all",)), Job("points", ("all",))]
    monkeypatch.setattr("tomojax.studies.frontier._study.jobs", lambda *_: jobs)
    monkeypatch.setattr(
        "tomojax.studies.frontier._study.make_trials",
        lambda *_: load_trials(kept, "float32")[1],
    )
    asked = []

    def measured(path, job):
        if job.method == "points" and len(asked) < 3:
            raise KeyboardInterrupt
        asked.append(job.method)
        return [row(job.method, 1.0, 1.0)]

    monkeypatch.setattr("tomojax.studies.frontier._study.measured", measured)
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


def test_what_failed_is_tried_again(kept, tmp_path, monkeypatch):
    sensor, tried = tx.Sensor.grid(dtype=np.float32), []
    monkeypatch.setattr(
        "tomojax.studies.frontier._study.jobs", lambda *_: [Job("linear", ("all",))]
    )
    monkeypatch.setattr(
        "tomojax.studies.frontier._study.make_trials",
        lambda *_: load_trials(kept, "float32")[1],
    )

    def measured(path, job):
        tried.append(job.method)
        return [{"failed": "killed"} if len(tried) == 1 else row("linear", 1.0, 1.0)]

    monkeypatch.setattr("tomojax.studies.frontier._study.measured", measured)
    assert run_study(sensor, tmp_path, True)[0]["failed"] == "killed"
    for _ in range(2):
        assert run_study(sensor, tmp_path, True)[0]["method"] == "linear"
    assert len(tried) == 2
    # Another method alone: nothing new, and what is there already.
    rows = run_study(sensor, tmp_path, True, only=("source",))
    assert len(rows) == 1 and len(tried) == 2


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


def test_rates_stay_below_the_machine_s(kept, monkeypatch):
    sensor, trials = load_trials(kept, "float32")
    monkeypatch.setattr(
        "tomojax.studies.frontier._rates.machine", lambda dtype: (1e15, 1e18)
    )
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


def test_a_day_is_the_same_frames_for_both(kept, monkeypatch):
    """Two quick methods stand in; frames and figures are compared with the trials."""
    sensor, trials = load_trials(kept, "float32")
    quick = {
        "auto": tx.method(sensor, "source", 16),
        "conductance": tx.method(sensor, "linear", 16),
    }
    rates, given, told = "tomojax.studies.frontier._rates", [], []

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
