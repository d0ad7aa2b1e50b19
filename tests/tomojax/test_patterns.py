"""Ground patterns and the adaptive scan, on the paper's array and on any other."""

import json

import equinox as eqx
import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx
from tomojax.kernels.flags import Flag


def explored(sensor, *contacts):
    scene = tx.Scene(*contacts)
    return tx.voltages(sensor, scene, tx.paper.exploration(sensor))


@pytest.fixture(scope="module")
def weight(paper_sensor):
    """A contact nearest to electrode 35, at (0.09, 0.07)."""
    return explored(paper_sensor, tx.Disc([0.0934, 0.0671], 0.006, 1.0))


def test_fixed_patterns_of_the_paper(paper_sensor) -> None:
    sizes = {"all": 64, "boundary": 28, "v_line": 8, "edge": 8, "random_16": 16}
    for name, size in {**sizes, "random_8": 8}.items():
        grounds = np.asarray(tx.pattern(paper_sensor, name))
        assert len(set(grounds.tolist())) == len(grounds) == size, name
    xy = np.asarray(paper_sensor.electrode_xy)
    on_rim = np.isclose(xy, 0.01).any(1) | np.isclose(xy, 0.15).any(1)
    assert on_rim[tx.pattern(paper_sensor, "boundary")].all()
    assert np.ptp(xy[tx.pattern(paper_sensor, "v_line"), 0]) < 1e-9
    np.testing.assert_allclose(xy[tx.pattern(paper_sensor, "edge"), 0], 0.01)
    one, other = (tx.pattern(paper_sensor, "random_8", seed=s) for s in (0, 1))
    assert (one != other).any()
    assert (one == tx.pattern(paper_sensor, "random_8", seed=0)).all()
    assert tx.paper.exploration(paper_sensor).tolist() == [0, 63]


def test_adaptive_patterns(paper_sensor, weight) -> None:
    around = tx.pattern(paper_sensor, "around", weight)
    assert sorted(around.tolist()) == [26, 27, 28, 34, 36, 42, 43, 44]
    point = tx.pattern(paper_sensor, "point", weight).tolist()
    assert sorted(point[:4]) == [0, 7, 56, 63] and point[4] == 35
    assert (tx.pattern(paper_sensor, "balanced", weight) == around).all()
    assert len(tx.pattern(paper_sensor, "spatial")) == 64
    assert tx.pattern(paper_sensor, "temporal", weight).tolist() == point


@pytest.mark.long
@pytest.mark.parametrize("angle", [0.0, np.pi / 4, np.pi / 2, 3 * np.pi / 4, 2.75])
def test_cop_line_lies_along_a_bar(paper_sensor, angle) -> None:
    bar = tx.Bar([0.087, 0.074], 0.06, 0.01, angle, 1.0)
    scan = tx.paper.AdaptiveScan(paper_sensor, "cop_line")
    grounds, region = scan(explored(paper_sensor, bar))
    assert region.direction_class == round(angle / (np.pi / 8)) % 8
    xy = np.asarray(paper_sensor.electrode_xy)
    away = xy[grounds] - xy[region.centre]
    assert (away[0] == 0).all() and len(set(grounds.tolist())) == 8
    theta = float(region.direction_class) * np.pi / 8
    across = np.abs(away @ [-np.sin(theta), np.cos(theta)])
    if angle in (0.0, np.pi / 2):
        assert (across < 1e-9).all()
    # Diagonals are shorter than eight: the rest is from the perpendicular line.
    along = np.abs(away @ [np.cos(theta), np.sin(theta)])
    assert (np.minimum(across, along) < 0.0101).all()


def test_recorded_scenes(shared_data) -> None:
    """Centre of contact within a pitch of every single contact; spanners' directions."""
    with h5py.File(shared_data / "static_all.h5") as file:
        volts = file["v"][:] * file.attrs["scale"] + file.attrs["offset"]
    scenes = json.loads((shared_data / "truth.json").read_text())["static_all"]["scenes"]
    sensor = tx.Sensor.grid()
    scan = eqx.filter_jit(tx.paper.AdaptiveScan(sensor, "cop_line"))
    xy = np.asarray(sensor.electrode_xy)
    seen = []
    for scene in scenes:
        for number in range(*scene["scans"]):
            region = scan(jnp.asarray(volts[number][tx.paper.exploration(sensor)]))[1]
            nothing = bool(region.flags & Flag.NO_CONTACT)
            assert nothing == (not scene["contacts"])
            if len(scene["contacts"]) == 1:
                true = scene["contacts"][0]
                away = np.linalg.norm(xy[region.centre] - true["centre"])
                # A ring has no electrode at its centre: its own radius more.
                assert away <= 0.020 + true.get("r1", 0), scene["name"]
                if true["kind"] == "bar":
                    seen.append(scene["name"])
                    wanted = round(true["angle"] / (np.pi / 8)) % 8
                    assert region.direction_class == wanted, scene["name"]
    assert set(seen) == {"spanner_0deg", "spanner_35deg"}


def test_around_each_contact(paper_sensor) -> None:
    places = [[0.04, 0.04], [0.12, 0.05], [0.085, 0.12]]
    volts = explored(paper_sensor, *[tx.Disc(p, 0.007, 1.0) for p in places])
    grounds, regions = tx.paper.AdaptiveScan(paper_sensor, "around").around_each(volts, 4)
    absent = (regions.flags & Flag.NO_CONTACT) > 0
    assert absent.tolist() == [False] * 3 + [True]
    middles = np.asarray(regions.low + regions.high)[:3] / 2
    away = np.linalg.norm(middles[:, None] - np.array(places), axis=-1)
    assert sorted(away.argmin(1).tolist()) == [0, 1, 2] and (away.min(1) < 0.015).all()
    together = tx.pattern(paper_sensor, "around_each", volts)
    assert set(together.tolist()) == set(np.asarray(grounds[:3]).ravel().tolist())
    assert len(set(together.tolist())) == len(together)


def circle(count: int) -> tx.Sensor:
    angle = 2 * np.pi * np.arange(count) / count
    rim = 0.05 + 0.04 * np.stack([np.cos(angle), np.sin(angle)], 1)
    xy = np.concatenate([rim, [[0.05, 0.05], [0.062, 0.047], [0.04, 0.06]]])
    return tx.Sensor([0.1, 0.1], xy, divisions=(40, 40))


@pytest.mark.parametrize(
    "make",
    [lambda: circle(9), pytest.param(lambda: tx.Sensor.grid(4, 5), marks=pytest.mark.long)],
)
def test_any_array(make) -> None:
    sensor = make()
    volts = explored(sensor, tx.Disc([0.06, 0.05], 0.004, 1.0))
    for name in (*tx.paper.PATTERNS, "around_each"):
        if name == "random_16" and sensor.electrode_count < 16:
            with pytest.raises(ValueError, match="name"):
                tx.pattern(sensor, name)
            continue
        grounds = np.asarray(tx.pattern(sensor, name, volts))
        assert len(set(grounds.tolist())) == len(grounds) >= 1
        assert grounds.min() >= 0 and grounds.max() < sensor.electrode_count
        if name in ("around", "cop_line"):
            assert len(grounds) == 8
    if sensor.electrode_count == 12:
        assert tx.pattern(sensor, "boundary").tolist() == list(range(9))


BOX = [[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]]
HOLE = [[0.04, 0.04], [0.06, 0.04], [0.06, 0.06], [0.04, 0.06]]
LETTER = [[0, 0], [0.12, 0], [0.12, 0.06], [0.06, 0.06], [0.06, 0.12], [0, 0.12]]


def hexagons() -> tx.Sensor:
    rows, columns = np.indices((5, 5)).reshape(2, -1)
    x, y = 0.01 + 0.02 * columns + 0.01 * (rows % 2), 0.012 + 0.0173 * rows
    return tx.Sensor([0.11, 0.1], np.stack([x, y], 1), divisions=(30, 30))


OUTLINES = {
    "rim": lambda: tx.Sensor.disc(0.1, {"rim": 16}, divisions=(30, 30)),
    "letter": lambda: tx.Sensor.polygon(LETTER, {"grid": 0.02}, divisions=(36, 36)),
    "hexagons": hexagons,
    "hole": lambda: tx.Sensor.polygon(BOX, {"grid": 0.02}, [HOLE], divisions=(30, 30)),
}


@pytest.mark.parametrize(
    "name, sizes",
    [  # of the boundary, the edge and the vertical line
        ("rim", (16, 3, 2)),
        pytest.param("letter", (20, 6, 6), marks=pytest.mark.long),
        pytest.param("hexagons", (13, 5, 3), marks=pytest.mark.long),
        pytest.param("hole", (24, 5, 4), marks=pytest.mark.long),
    ],
)
def test_patterns_on_other_outlines(name, sizes) -> None:
    sensor, places = OUTLINES[name](), {"letter": [0.03, 0.09], "hole": [0.07, 0.05]}
    place = np.array(places.get(name, [0.06, 0.04]))
    xy, touch = np.asarray(sensor.electrode_xy), tx.Disc.of_total(place, 0.006, 3e-5)
    volts = explored(sensor, touch)
    fixed = [np.asarray(tx.pattern(sensor, n)) for n in ("boundary", "edge", "v_line")]
    assert tuple(map(len, fixed)) == sizes
    if name == "letter":  # the arm's middle is half-way between two edges
        assert not (np.abs(xy[fixed[0]] - [0.03, 0.09]) < 1e-6).all(1).any()
    away = np.linalg.norm(xy - place, axis=1)
    for adaptive, count in (("around", 8), ("cop_line", 8), ("point", 6)):
        grounds = np.asarray(tx.pattern(sensor, adaptive, volts))
        assert len(set(grounds.tolist())) == len(grounds) == count
    # *CoP line* begins at the contact; *Point* ends with the two next to it.
    line = np.asarray(tx.pattern(sensor, "cop_line", volts))
    assert away[line[0]] <= np.sort(away)[1] + 1e-6
    around = np.asarray(tx.pattern(sensor, "around", volts))
    assert away[around].mean() < away.mean()


@pytest.mark.long
@pytest.mark.parametrize("name", ["around", "cop_line", "point"])
def test_scenes_without_a_region(paper_sensor, name) -> None:
    """Nothing, one electrode, the edge, the whole sheet, NaN: defined and flagged."""
    scan = tx.paper.AdaptiveScan(paper_sensor, name)
    run = eqx.filter_jit(scan)
    flag = Flag
    whole = tx.sensor.Mask(np.full((32, 32), 50.0))
    cases = {
        "nothing": (jnp.zeros((2, 64)), flag.NO_CONTACT),
        "noise": (1e-3 * jax.random.normal(jax.random.key(0), (2, 64)), flag.NO_CONTACT),
        "nan": (jnp.zeros((2, 64)).at[1, 5].set(jnp.nan), flag.BAD_VOLTAGES),
        "one": (explored(paper_sensor, tx.Disc([0.07, 0.09], 0.003, 1.0)), 0),
        "edge": (explored(paper_sensor, tx.Disc([0.151, 0.15], 0.004, 1.0)), 0),
        "corner": (explored(paper_sensor, tx.Disc([0.012, 0.149], 0.004, 1.0)), 0),
        "whole": (jnp.full((2, 64), 4.49), flag.WHOLE_SHEET),
        "pressed": (explored(paper_sensor, whole), 0),
    }
    for case, (volts, wanted) in cases.items():
        grounds, region = run(volts)
        count = 6 if name == "point" else 8
        assert len(set(grounds.tolist())) == count, case
        assert int(region.flags) & int(wanted) == wanted, case
        if case in ("nothing", "noise", "nan"):
            assert region.centre in (27, 28, 35, 36)
            assert bool(jnp.isfinite(region.low).all())
    assert run(cases["one"][0])[1].centre == 28
    assert run(cases["edge"][0])[1].centre == 63


def test_one_trace_for_all_voltages(paper_sensor, weight) -> None:
    scan = tx.paper.AdaptiveScan(paper_sensor, "around")
    run = eqx.filter_jit(eqx.debug.assert_max_traces(lambda v: scan(v)[0], max_traces=1))
    batch = jnp.stack([weight, weight[:, ::-1], 0 * weight])
    singles = jnp.stack([run(v) for v in batch])
    np.testing.assert_array_equal(jax.vmap(lambda v: scan(v)[0])(batch), singles)


@pytest.mark.long
def test_float32(weight) -> None:
    sensor = tx.Sensor.grid(dtype=np.float32)
    for name in ("around", "cop_line", "point"):
        single = tx.pattern(sensor, name, weight.astype(np.float32))
        double = tx.pattern(tx.Sensor.grid(), name, weight)
        assert single.tolist() == double.tolist()


def test_bad_input(paper_sensor, weight) -> None:
    for name, arguments in [
        ("name", dict(name="spiral")),
        ("voltages", dict(name="around")),
        ("voltages", dict(name="around", voltages=np.ones((2, 63)))),
        ("voltages", dict(name="around", voltages=np.full((2, 64), np.nan))),
        ("alpha", dict(name="around", voltages=weight, alpha=0.0)),
        ("alpha", dict(name="around", voltages=weight, alpha=100.5)),
        ("alpha", dict(name="around", voltages=weight, alpha=np.nan)),
        ("threshold", dict(name="around", voltages=weight, threshold=np.nan)),
    ]:
        with pytest.raises(ValueError, match=name):
            tx.pattern(paper_sensor, **arguments)
