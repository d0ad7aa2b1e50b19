"""Designs of ground conditions: gradients, bounds, and all sets where those are few."""

import itertools
import json
import sys
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import recordings
from click.testing import CliRunner
from jaxtyping import Array, Float

import tomojax as tx
from tomojax.cli.app import app, run
from tomojax.design import exchange, ImageVariance, relax
from tomojax.methods import method as make_method

KINDS = [
    ("points", "place"),
    ("points", "a"),
    ("points", "d"),
    ("points", "worst"),
    ("linear", "a"),
    ("linear", "d"),
    ("linear", "worst"),
    ("source", "a"),
    ("source", "d"),
]


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid(4, 4, divisions=(16, 16), electrode_diameter=0.005)


@pytest.fixture(scope="module")
def objectives(sensor):
    places = tx.design.design_places(sensor, count=12)
    made = {}

    def one(method, criterion):
        if (method, criterion) not in made:
            found = tx.design.design_objective(sensor, places, method, criterion, grid=16)
            made[method, criterion] = found
        return made[method, criterion]

    return one


# One program each for all tests of an objective.
VALUE = jax.jit(lambda objective, w: objective.value(w))
SLOPE = jax.jit(lambda objective, w: jax.grad(objective.value)(w))
VALUES = jax.jit(lambda objective, sets: jax.lax.map(objective.value, sets))


def central(objective, w, k, h=1e-5):
    step = h * jnp.zeros(len(w)).at[k].set(1.0)
    return float((VALUE(objective, w + step) - VALUE(objective, w - step)) / (2 * h))


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
@pytest.mark.parametrize("start", ["symmetric", "random"])
def test_slopes_in_weights(objectives, rng, kind, start):
    objective = objectives(*kind)
    w = np.full(16, 0.25) if start == "symmetric" else rng.uniform(0.1, 1, 16)
    slope = np.asarray(SLOPE(objective, jnp.asarray(w)))
    assert np.isfinite(slope).all()
    if kind[1] == "worst" and start == "symmetric":
        return  # two places can be the worst at once: no derivative there
    wanted = np.array([central(objective, jnp.asarray(w), k) for k in range(0, 16, 5)])
    np.testing.assert_allclose(slope[::5], wanted, rtol=1e-5, atol=1e-7 * abs(wanted).max())


@pytest.mark.parametrize("method", ["linear", "source"])
def test_slope_in_lambda(objectives, method):
    objective = objectives(method, "a")
    assert isinstance(objective, ImageVariance)
    w = jnp.linspace(0.2, 1, 16)
    f = jax.jit(lambda t: replace(objective, lam=jnp.exp(t)).value(w))
    t, h = jnp.log(objective.lam), 1e-4
    slope = jax.jit(jax.grad(f))(t)
    np.testing.assert_allclose(slope, (f(t + h) - f(t - h)) / (2 * h), rtol=1e-5)


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_all_sets_of_three_are_above_the_bound_and_the_best_is_found(objectives, kind):
    objective = objectives(*kind)
    sets = np.array(list(itertools.combinations(range(16), 3)))
    weights = np.zeros((len(sets), 16))
    np.put_along_axis(weights, sets, 1, 1)
    best = float(VALUES(objective, jnp.asarray(weights)).min())
    found = tx.design.design(objective, 3)
    assert found.bound <= best * (1 + 1e-9)
    assert found.value <= 1.01 * best
    chosen = np.zeros(16)
    chosen[found.grounds] = 1
    assert float(VALUE(objective, jnp.asarray(chosen))) == pytest.approx(found.value)
    assert found.relaxed <= found.value * (1 + 1e-9) and found.value <= found.greedy


def test_relaxed_weights(objectives):
    objective = objectives("points", "place")
    partly = 0
    for count in (3, 5, 6):
        found = relax(objective, 16, count)
        w = np.asarray(found.weights)
        assert abs(w.sum() - count) < 1e-9 and w.min() >= 0 and w.max() <= 1
        assert 0 <= found.value - found.bound < 1e-3 * found.value
        # Slots that are not taken in full have the same slope.
        slope = np.asarray(SLOPE(objective, found.weights))
        between = (w > 0.05) & (w < 0.95)
        partly += between.sum()
        if between.any():
            assert np.ptp(slope[between]) < 0.05 * abs(slope).max()
    assert partly > 1


def test_all_slots_and_one(objectives):
    objective = objectives("points", "place")
    whole = tx.design.design(objective, 16)
    assert sorted(whole.grounds) == list(range(16))
    assert whole.value == pytest.approx(whole.bound, rel=1e-6)
    single = tx.design.design(objective, 1)
    values = VALUES(objective, jnp.eye(16))
    assert single.grounds.tolist() == [int(np.argmin(values))]


def test_few_swaps_by_slope(objectives):
    objective = objectives("linear", "a")
    start = jnp.zeros(16).at[:4].set(1)
    some = VALUE(objective, exchange(objective.value, start, 4, tried=8))
    assert VALUE(objective, exchange(objective.value, start, 4)) <= some
    assert some < 0.95 * VALUE(objective, start)


def test_noise_that_is_stated(sensor):
    """A channel that is all noise is none; a common mode changes what is best."""
    places = tx.design.design_places(sensor, count=6)
    plain = tx.design.design_objective(sensor, places, noise=1e-3)
    same = tx.design.design_objective(sensor, places, noise=1e-6 * np.eye(16))
    np.testing.assert_allclose(same.information, plain.information, rtol=1e-9)
    deaf = np.full(16, 1e-3)
    deaf[5] = 1e3
    less = tx.design.design_objective(sensor, places, noise=deaf)
    w = jnp.full(16, 0.5)
    assert (less(w) > plain(w)).all()
    common = 1e-6 * np.eye(16) + 1e-2 * np.ones((16, 16))
    shifted = tx.design.design_objective(sensor, places, noise=common)
    assert (shifted(w) > plain(w)).all()


@pytest.mark.long
def test_single_precision(sensor, objectives):
    places = np.asarray(tx.design.design_places(sensor, count=12))
    words = {"divisions": (16, 16), "electrode_diameter": 0.005}
    single = tx.Sensor.grid(4, 4, dtype=np.float32, **words)
    for kind in (("points", "place"), ("linear", "a")):
        wide = objectives(*kind)
        narrow = tx.design.design_objective(single, places, *kind, grid=16)
        a, b = tx.design.design(wide, 3), tx.design.design(narrow, 3)
        chosen = jnp.zeros(16).at[jnp.asarray(b.grounds)].set(1)
        assert float(VALUE(wide, chosen)) <= 1.01 * a.value
        assert b.value == pytest.approx(a.value, rel=0.02)


def test_patterns_beside(sensor, objectives):
    objective = objectives("points", "place")
    places = tx.design.design_places(sensor, count=12)
    explored = tx.design.exploratory_voltages(sensor, places)
    assert explored.shape == (12, 2, 16)
    rows = {
        row["name"]: row for row in tx.design.patterns_beside(sensor, objective, explored)
    }
    assert list(rows) == list(tx.paper.PATTERNS)
    every = float(VALUE(objective, jnp.ones(16)))
    assert rows["all"]["value"] == pytest.approx(every)
    assert all(row["value"] >= every * (1 - 1e-9) for row in rows.values())


@pytest.fixture(scope="module")
def simulated(sensor):
    places = tx.design.design_places(sensor, count=8)
    scenes = tx.design.simulate_scenes(sensor, places, rigs=2)
    linear = make_method(sensor, "linear", 16)
    return {
        smooth: tx.design.ImageError.of(linear, scenes, 0.008, smooth=smooth)
        for smooth in (False, True)
    }


@pytest.mark.parametrize("smooth", [False, True])
def test_slopes_of_simulated_errors(simulated, rng, smooth):
    objective = simulated[smooth]
    w = jnp.asarray(rng.uniform(0.2, 1, 16))
    slope = SLOPE(objective, w)
    wanted = [central(objective, w, k) for k in (0, 7, 15)]
    np.testing.assert_allclose(slope[jnp.array([0, 7, 15])], wanted, rtol=1e-5)
    names = ["log_lam", "log_length"] if smooth else ["log_lam"]
    by_all = jax.jit(jax.grad(lambda o: o.value(w)))(objective)
    for name in names:
        at, h = getattr(objective, name), 1e-4
        ahead, behind = (VALUE(replace(objective, **{name: at + by}), w) for by in (h, -h))
        wanted = (ahead - behind) / (2 * h)
        np.testing.assert_allclose(getattr(by_all, name), wanted, rtol=1e-5, atol=1e-9)


def test_lambda_and_length_by_gradient_against_a_grid(simulated):
    objective = simulated[True]
    w = jnp.zeros(16).at[jnp.array([1, 6, 8, 11])].set(1)
    found = tx.design.tune(objective, w)
    lams = objective.log_lam + jnp.log(10.0) * jnp.linspace(-3, 4, 22)
    lengths = jnp.log(jnp.linspace(0.4, 4, 15))

    def at(lam, length):
        return replace(objective, log_lam=lam, log_length=length).value(w)

    over = jax.jit(jax.vmap(jax.vmap(at, (0, None)), (None, 0)))
    grid = over(lams, lengths)
    assert found.value <= 1.05 * grid.min()
    assert found.solves <= grid.size / 10


def test_sets_by_gradients_through_draws(simulated):
    objective = simulated[False]
    found = tx.design.descend_sets(objective, 4, steps=60)
    assert found.weights.sum() == 4
    rng = np.random.default_rng(0)
    drawn = np.zeros((40, 16))
    np.put_along_axis(drawn, np.array([rng.permutation(16)[:4] for _ in drawn]), 1, 1)
    others = VALUES(found.objective, jnp.asarray(drawn))
    assert VALUE(found.objective, found.weights) < np.quantile(others, 0.25)


class Own(tx.design.AbstractObjective):
    """An objective of one's own: how far weights and λ are from some."""

    goal: Float[Array, " L"]
    log_lam: Float[Array, ""]
    unit = "1"
    worst = False

    @property
    def slots(self):
        return len(self.goal)

    def __call__(self, weights):
        return ((weights - self.goal) ** 2).sum(keepdims=True) + (self.log_lam - 2.0) ** 2

    def alone(self, k):
        return self


class Small(Own):
    """The same in a unit in which figures are small."""

    def __call__(self, weights):
        return 1e-6 * super().__call__(weights)


class Fixed(Own):
    log_lam: None = None


class Broken(Own):
    """No number for weights that are no set, or for all."""

    sets: bool = eqx.field(static=True, default=True)

    def __call__(self, weights):
        whole = self.sets & ((weights == 0) | (weights == 1)).all()
        return jnp.where(whole, super().__call__(weights), jnp.nan * weights.sum())


def test_figures_that_are_no_numbers():
    goal = jnp.zeros(6).at[jnp.array([1, 4])].set(1.0)
    found = tx.design.design(Broken(goal, jnp.array(2.0)), 2)
    assert sorted(found.grounds) == [1, 4] and found.value == 0
    # No slot at all would be less.
    assert len(tx.design.design(Broken(0 * goal, jnp.array(2.0)), 2).grounds) == 2
    with pytest.raises(ValueError, match="objective: got nan"):
        tx.design.design(Broken(goal, jnp.array(2.0), sets=False), 2)


def test_objectives_of_ones_own_are_tuned_and_descended():
    goal = jnp.zeros(9).at[jnp.array([1, 4, 8])].set(1.0)
    found = tx.design.descend_sets(Own(goal, jnp.array(0.5)), 3, steps=60)
    assert found.weights.tolist() == goal.tolist()
    tuned = tx.design.tune(found.objective, found.weights)
    assert tuned.value < 1e-3 and abs(float(tuned.objective.log_lam) - 2) < 0.02
    small = tx.design.tune(Small(goal, jnp.array(0.5)), goal)
    assert abs(float(small.objective.log_lam) - 2) < 0.02
    for search in (tx.design.tune, tx.design.descend_sets):
        with pytest.raises(ValueError, match="objective: got Fixed without log_lam"):
            search(Fixed(goal), goal if search is tx.design.tune else 3)


@pytest.mark.long
def test_policy_by_place(sensor, tmp_path):
    found = tx.design.design_policy(sensor, 3, shape=(6, 6), criterion="place")
    assert found.policy.table.shape == (6, 6, 3)
    assert (found.value >= found.bound * (1 - 1e-9)).all()
    assert np.median(found.value / found.bound) < 1.03
    for row in np.asarray(found.policy.table).reshape(-1, 3):
        assert len(set(row.tolist())) == 3
    path = tmp_path / "table.npz"
    tx.step.save_policy(found.policy, path)
    again = tx.step.load_policy(path, sensor)
    np.testing.assert_array_equal(again.table, found.policy.table)
    step = tx.make_step(
        sensor, "follow", "mine", tables={"mine": again}, contacts=1, grid=16
    )
    place = np.array([0.05, 0.033])
    g = tx.sensor.contact_conductance(sensor, tx.Disc(place, 0.006, 1.0))
    volts = np.asarray(tx.voltages(sensor, g))
    state, ground, asked = step.state, 0, []
    for _ in range(12):
        state, out = step(state, volts[ground], ground)
        ground = int(out.ground)
        asked.append(ground)
    assert step.traces == 1
    cell = np.asarray(again.table)[tuple((place / np.asarray(sensor.size) * 6).astype(int))]
    assert set(asked[-6:]) == set(cell.tolist())


def test_a_policy_of_another_sensor(sensor, tmp_path):
    other = tx.Sensor.grid(5, 5, divisions=(20, 20))
    path = tmp_path / "table.npz"
    table = jnp.full((2, 2, 3), 20, jnp.int32)
    tx.step.save_policy(tx.step.Lookup(table, table[0, 0], other.size), path)
    with pytest.raises(ValueError, match="table: got 20 to 20, expected 0 to 15"):
        tx.step.load_policy(path, sensor)
    path.write_bytes(b"not a table")
    with pytest.raises(ValueError, match="no table of grounds"):
        tx.step.load_policy(path, sensor)
    with pytest.raises(ValueError, match="no such file"):
        tx.step.load_policy(tmp_path / "none.npz", sensor)


@pytest.mark.parametrize(
    "words, message",
    [
        ({"region": (0, 0, 0, 0.01)}, "region: .*expected x0 < x1"),
        ({"region": (0, 0, 1, 1)}, "region: .*expected on the sheet"),
        ({"region": (0, 0, np.nan, 1)}, "region: got 1 values NaN"),
        ({"count": 0}, "count: got 0"),
    ],
)
def test_bad_regions(sensor, words, message):
    with pytest.raises(ValueError, match=message):
        tx.design.design_places(sensor, **words)


@pytest.mark.parametrize(
    "words, message",
    [
        ({"places": np.zeros((0, 2))}, "places: got none"),
        ({"places": [[1.0, 1.0]]}, "places: got 1 off the sheet"),
        ({"places": [[np.nan, 0.0]]}, "places: got 1 values NaN"),
        ({"method": "guess"}, "method: got 'guess', expected one of points"),
        ({"criterion": "e"}, "criterion: got 'e', expected one of place"),
        ({"noise": np.nan}, "noise: got 1 values NaN"),
        ({"noise": -1.0}, "noise: got -1, expected values above 0"),
        ({"noise": np.zeros((16, 16))}, "noise: got a least variance of 0"),
        ({"noise": np.triu(np.ones((16, 16)))}, "noise: got no symmetric matrix"),
        ({"noise": np.ones(3)}, r"noise: got shape \(3,\)"),
        ({"method": "linear", "lam": 0.0}, "lam: got 0"),
        ({"radius": -0.1}, "radius: got -0.1"),
        ({"conductance": 0.0}, "conductance: got 0"),
    ],
)
def test_bad_objectives(sensor, words, message):
    with pytest.raises(ValueError, match=message):
        tx.design.design_objective(sensor, **{"places": [[0.03, 0.03]], **words})


@pytest.mark.parametrize("slots", [0, 17])
def test_bad_numbers_of_slots(sensor, objectives, slots):
    with pytest.raises(ValueError, match=r"slots: got .*, expected a whole number"):
        tx.design.design(objectives("points", "place"), slots)
    with pytest.raises(ValueError, match="slots: got"):
        tx.design.design_policy(sensor, slots)


def test_a_table_of_what_has_one_figure_for_all(sensor):
    with pytest.raises(ValueError, match="criterion: got 'd' of an image"):
        tx.design.design_policy(sensor, 3, "linear", criterion="d")


def small(path):
    """A recording's file of a 4 × 4 sensor, for `--like`."""
    xy = 0.01 + 0.02 * np.indices((4, 4)).reshape(2, -1).T
    codes = np.zeros((1, 2, 16), np.int16)
    recordings.write(path, codes, [0, 15], electrode_xy=xy, size=[0.08, 0.08])
    return tx.Sensor.grid(4, 4, divisions=(16, 16)), ["--like", str(path)]


def paper(path):
    return tx.Sensor.grid(), []


# Eight slots as some patterns have: one search less to compile. Without a criterion the
# table is for errors on rigs, which takes half a minute.
WORDS = ["--region", "20", "20", "60", "60", "--contacts", "4", "--slots", "8"]


@pytest.mark.parametrize("rig", [small, pytest.param(paper, marks=pytest.mark.long)])
def test_the_command(tmp_path, monkeypatch, rig):
    monkeypatch.chdir(tmp_path)
    sensor, like = rig(tmp_path / "rig.h5")
    m = sensor.electrode_count
    own = ["--grounds", ",".join(map(str, range(1, m, m // 8)))]
    words = [*WORDS, *like, *own, "--criterion", "place", "--json", "out/d.json"]
    more = ["--out", "out", "--policy", "out/p.npz"]
    result = CliRunner().invoke(app, ["design", *words, *more])
    assert result.exit_code == 0, result.output
    report = json.loads(Path("out/d.json").read_text())
    summary, (first, *rows) = report["summary"], report["rows"]
    assert len(summary["grounds"]) == 8
    assert summary["bound"] <= summary["objective"] * (1 + 1e-9)
    assert first["name"] == "yours" and first["slots"] == 8
    assert first["designed"] < first["value"]
    assert [row["name"] for row in rows] == list(tx.paper.PATTERNS)
    for row in report["rows"]:
        assert row["designed"] <= row["value"] * 1.02
        assert row["name"] in result.output
    assert Path("out/design.png").stat().st_size > 10_000
    table = tx.step.load_policy("out/p.npz", sensor)
    assert table.table.shape == (32, 32, 8)


@pytest.mark.parametrize(
    "words, message",
    [
        (["--grounds", "0,64"], "--grounds: got '0,64', expected electrodes from 0 to 63"),
        (["--grounds", "0,0"], "--grounds: got '0,0', expected electrodes with commas"),
        (["--grounds", "edge"], "--grounds: got 'edge', expected electrodes with commas"),
        (["--region", "0", "0", "9", "900"], "on the sheet, 0 to 160, 160 mm"),
        (["--policy", "x.txt"], "--policy: got x.txt, expected a name that ends in .npz"),
        (["--place", "1", "2", "--region", "0", "0", "9", "9"], "--place: got a region"),
        (["--like", "none.h5"], "none.h5"),
        (["--region", "0", "0", "0", "9"], "region: got"),
    ],
)
def test_mistakes_in_the_command(words, message, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["tomojax", "design", *words])
    with pytest.raises(SystemExit) as stop:
        run()
    said = capsys.readouterr().err.strip().splitlines()
    assert stop.value.code == 2 and len(said) == 1 and message in said[0]
