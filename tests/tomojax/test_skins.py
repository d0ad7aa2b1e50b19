"""Skins of other outlines and ground conditions, in the rooms that people use."""

from dataclasses import replace
from functools import cache

import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse.linalg as spla
from scipy.interpolate import RegularGridInterpolator

import tomojax as tx

PLACES = ((0.062, 0.041), (0.031, 0.055), (0.05, 0.08))


@pytest.fixture(scope="module")
def disc(round_skin) -> tx.Sensor:
    return round_skin


@pytest.fixture(scope="module")
def paired(disc) -> tx.Sensor:
    """The same with two electrodes grounded in each slot, one of them partly."""
    table = np.zeros((4, disc.electrode_count))
    for k, row in enumerate(table):
        row[[k, k + 6]] = 0.25, 1e-3
    return replace(disc, conditions=table)


def frames(sensor: tx.Sensor) -> tuple[np.ndarray, np.ndarray]:
    grounds = np.array([0, 4, 8, 12]) if sensor.conditions is None else np.arange(4)
    touches = [tx.Disc.of_total(place, 0.006, 3e-5) for place in PLACES]
    volts = np.stack([np.asarray(tx.voltages(sensor, t, grounds)) for t in touches])
    noise = 3e-4 * np.random.default_rng(0).normal(size=volts.shape)
    return (volts + noise).astype(np.float32), np.tile(grounds, (len(PLACES), 1))


@pytest.fixture(scope="module")
def read(disc, paired):
    """A method and its rows of `frames`, made once for each name and number of grounds."""

    @cache
    def read(name: str, grounds: str):
        sensor = disc if grounds == "one" else paired
        volts, which = frames(sensor)
        # `source` reads peaks off an image, of which 16 electrodes leave some.
        most = {"points": 2, "source": 1}[name]
        method = tx.method(sensor, name, grid=24)
        return method, tx.Batch(method, contacts=most)(volts, which)

    return read


@pytest.mark.parametrize(
    "grounds, name, off",
    [
        pytest.param("several", "points", 0.2e-3, marks=pytest.mark.long),
        ("one", "source", 4e-3),
        pytest.param("one", "points", 0.2e-3, marks=pytest.mark.long),
        pytest.param("several", "source", 4e-3, marks=pytest.mark.long),
    ],
)
def test_a_contact_is_found(read, grounds, name, off) -> None:
    rows = read(name, grounds)[1]
    np.testing.assert_array_equal(rows.contact_count, 1)
    apart = np.hypot(*(rows.contact_xy[:, 0] - np.array(PLACES)).T)
    assert apart.max() < off
    # Off the sheet there is nothing, not 0.
    outside = np.isnan(rows.image)
    assert 0.1 < outside.mean() < 1 - np.pi / 4 + 0.05
    assert (outside == outside[0]).all()


def test_conductance_with_several_grounds(read) -> None:
    rows = read("points", "several")[1]
    np.testing.assert_allclose(rows.contact_conductance[:, 0], 3e-5, rtol=0.03)


def test_a_step_with_conditions(paired) -> None:
    volts, which = frames(paired)
    step = tx.make_step(paired, "follow", "all", contacts=1, grid=16)
    state = step.state
    for v, ground in zip(volts[0], which[0]):
        state, out = step(state, v, int(ground))
    assert np.hypot(*(np.asarray(out.contacts.xy[0]) - PLACES[0])) < 1e-3
    assert int(out.ground) < 4


@pytest.mark.long
def test_policies_of_a_table(disc) -> None:
    """A table of single grounds has the policies, patterns and designs of these grounds."""
    single = replace(disc, conditions=np.eye(disc.electrode_count) / 4.0)
    touch, at = tx.Disc.of_total(PLACES[1], 0.006, 3e-5), np.array([PLACES[1]])
    chosen, patterns, designs = [], [], []
    for sensor in (disc, single):
        every = np.asarray(tx.voltages(sensor, touch))
        explored = every[tx.paper.exploration(sensor)]
        names = ("around", "cop_line", "point", "around_each", "boundary", "edge")
        patterns.append([tx.pattern(sensor, n, explored).tolist() for n in names])
        objective = tx.design.design_objective(sensor, at, "points", "place")
        designs.append(tx.design.design(objective, slots=3).grounds.tolist())
        step = tx.make_step(sensor, "follow", "information", contacts=1, grid=16)
        state, ground = step.state, int(tx.paper.exploration(sensor)[0])
        for _ in range(5):
            state, out = step(state, every[ground], ground)
            ground = int(out.ground)
            chosen.append(ground)
    assert patterns[0] == patterns[1] and designs[0] == designs[1]
    assert chosen[:5] == chosen[5:] and len(set(chosen)) > 2


@pytest.mark.long
def test_adaptive_policies_of_pairs(disc) -> None:
    """Eight conditions of three electrodes each: those about the contact are chosen."""
    m = disc.electrode_count
    table = np.zeros((2 * m, m))
    for k, row in enumerate(table):
        row[[k % m, (k + 1 + k // m) % m, (k + 3) % m]] = 0.25
    sensor = replace(disc, conditions=table)
    every = np.asarray(tx.voltages(sensor, tx.Disc.of_total(PLACES[0], 0.006, 3e-5)))
    explored = every[tx.paper.exploration(sensor)]
    around = np.asarray(tx.pattern(sensor, "around", explored))
    assert len(set(around.tolist())) == 8
    away = np.linalg.norm(np.asarray(sensor.ground_xy()) - PLACES[0], axis=1)
    assert away[around].mean() < away.mean()
    line = np.asarray(tx.pattern(sensor, "cop_line", explored))
    assert len(set(line.tolist())) == 8 and away[line[0]] <= np.sort(away)[3]
    step = tx.make_step(sensor, "follow", "around_contacts", contacts=1, grid=16)
    state, ground = step.state, 0
    for _ in range(4):
        state, out = step(state, every[ground], ground)
        ground = int(out.ground)
    assert 0 <= ground < 2 * m
    places = [PLACES[0]]
    with pytest.raises(ValueError, match="criterion: got 'rigs' of a table"):
        tx.design.design_objective(sensor, places, "points", "rigs")


def test_recordings_tell_outline_and_conditions(paired, tmp_path) -> None:
    hole = [[0.03, 0.03], [0.05, 0.03], [0.04, 0.05]]
    box = [[0, 0], [0.08, 0], [0.08, 0.08], [0, 0.08]]
    xy = [[0.02, 0.02], [0.06, 0.02], [0.02, 0.06], [0.06, 0.06]]
    holed = tx.Sensor.polygon(box, xy, holes=[hole])
    for sensor in (paired, holed):
        rig, path = tx.recordings.Rig.of(sensor), tmp_path / "a.h5"
        count = sensor.condition_count
        with h5py.File(path, "w") as file:
            file["v"] = np.ones((2, count, sensor.electrode_count), "i2")
            ground = np.tile(np.arange(count), (2, 1))
            file["condition"] = ground.astype("u2")
            file["t0"] = np.arange(2) * count / rig.f_switch
            file["electrode_xy"] = rig.electrode_xy
            for name, table in rig.tables().items():
                file[name] = table
            names = "f_switch", "drive_voltage", "ground_resistance", "sheet_resistance"
            file.attrs.update({name: getattr(rig, name) for name in names})
            file.attrs.update(
                schema="tomojax-recording",
                schema_version=rig.version,
                scale=2e-4,
                offset=0.0,
                units="V",
                size=list(rig.size),
                electrode_diameter=rig.electrode_diameter,
                **rig.outline.attributes(),
            )
        with tx.open_recording(path) as recording:
            assert recording.read(0, 1).grounds[0, -1] == count - 1
            again = recording.rig.sensor()
        assert again.condition_count == count
        points = np.random.default_rng(0).uniform(0, 0.08, (50, 2))
        np.testing.assert_array_equal(again.on_sheet(points), sensor.on_sheet(points))


def test_patterns_of_a_sheet_with_a_hole() -> None:
    """*Boundary* goes along every edge, a hole's and an inner corner's too."""
    angle = 2 * np.pi * np.arange(40) / 40
    hole = 0.08 + 0.025 * np.stack([np.cos(angle), np.sin(angle)], 1)
    corners = [[0, 0], [0.16, 0], [0.16, 0.16], [0, 0.16]]
    sensor = tx.Sensor.polygon(corners, {"grid": 0.02}, holes=[hole])
    chosen = set(np.asarray(tx.pattern(sensor, "boundary")).tolist())
    outer = tx.pattern(tx.Sensor.grid(), "boundary")
    assert len(chosen) > len(outer)
    away = np.hypot(*(np.asarray(sensor.electrode_xy) - 0.08).T)
    assert set(np.flatnonzero(away < 0.035).tolist()) <= chosen


@pytest.mark.parametrize(
    "make, said",
    [
        (lambda: tx.sensor.PolygonEdge([[0, 0], [1, 1], [1, 0], [0, 1]]), "crosses side"),
        (lambda: tx.Sensor.disc(0.1, [[0.05, 0.05], [0.004, 0.004]]), "off the sheet"),
        (lambda: tx.Sensor.disc(0.1, [[0.05, 0.05], [0.052, 0.05]]), "apart"),
        (lambda: tx.Sensor.disc(-0.1, {"rim": 8}), "diameter"),
        (lambda: tx.Sensor.disc(0.1, {"rim": 0}), "electrodes: got 0"),
        (lambda: _two_parts(), "another part"),
        (lambda: tx.Sensor.grid(conditions=np.zeros((1, 64))), "ungrounded"),
        (lambda: tx.Sensor.polygon([[0, 0], [1, 1]], {"rim": 4}), "2 vertices"),
        (lambda: tx.Sensor.polygon(_fork(1e-4), FINGERS), "a gap or a neck 0.0001 m"),
        (
            lambda: _square([[0.13, 0.03], [0.2, 0.03], [0.13, 0.05]]),
            "holes.0.: got a c",
        ),
        (
            lambda: _square(_INNER, [[0.04, 0.04], [0.05, 0.04], [0.04, 0.05]]),
            "holes.1.: got",
        ),
        (
            lambda: tx.sensor.PolygonEdge([[0, 0], [1, 1], [2, 2]]),
            "an area of 0 m²",
        ),
        (lambda: tx.Sensor.disc(100, {"rim": 8}, electrode_diameter=5), "size: got 100 m"),
        (lambda: tx.Sensor.grid(4, 4, 20, 10), "size: got 80 m"),
        (
            lambda: tx.Sensor.disc(0.1, {"rim": 8}, electrode_diameter=[0.005, 0.003]),
            "expected one number, m, of every electrode; `told` has",
        ),
        (
            lambda: tx.Sensor.disc(0.1, {"rim": 8}, electrode_diameter=None),
            "_diameter:",
        ),
        (
            lambda: tx.Sensor.disc(0.1, {"rim": 8}, dtype=np.float16),
            "float32 or",
        ),
    ],
)
def test_mistakes_are_named(make, said) -> None:
    with pytest.raises(ValueError, match=said):
        make()


_INNER = [[0.03, 0.03], [0.06, 0.03], [0.06, 0.06], [0.03, 0.06]]


def _square(*holes: list) -> tx.sensor.PolygonEdge:
    corners = [[0, 0], [0.08, 0], [0.08, 0.08], [0, 0.08]]
    return tx.sensor.PolygonEdge(corners, holes)


def test_corners_that_are_drawn_twice_count_once() -> None:
    edge, plain = _square(_INNER + _INNER[:1]), _square(_INNER)
    twice = tx.sensor.PolygonEdge(
        [[0, 0], [0, 0], [0.08, 0], [0.08, 0.08], [0, 0.08]], [_INNER]
    )
    at = jnp.asarray([[0.01, 0.02], [0.045, 0.045]])
    for other in (edge, twice):
        np.testing.assert_array_equal(other.distance(at), plain.distance(at))


FINGERS = np.array([[0.005, 0.026], [0.025, 0.026], [0.015, 0.005]])


def _fork(gap: float) -> np.ndarray:
    """Two fingers of 25 mm on a palm, and the gap between them."""
    low, high = (30 - 1e3 * gap) / 2, (30 + 1e3 * gap) / 2
    corners = [[0, 0], [30, 0], [30, 35], [high, 35], [high, 10], [low, 10]]
    return 1e-3 * np.array([*corners, [low, 35], [0, 35]])


def test_a_gap_between_fingers_stays_open() -> None:
    """A mesh that suits electrodes alone would join them, and be two thirds off."""

    def between(sensor: tx.Sensor) -> float:
        ee = np.asarray(tx.sensor.resistances(sensor).electrodes)
        return ee[0, 0] + ee[1, 1] - 2 * ee[0, 1]

    fork = tx.Sensor.polygon(_fork(1.2e-3), FINGERS, electrode_shunt=1.0)
    assert (np.asarray(fork.size) / fork.divisions < 0.4e-3 + 1e-6).all()
    assert abs(between(fork) / 31653.5 - 1) < 5e-3


@pytest.mark.long
def test_a_corner_that_points_inwards_costs_no_digit() -> None:
    """Both tests' figures are those of quadratic elements on an unstructured mesh."""
    corners = 1e-3 * np.array([[0, 0], [40, 0], [40, 20], [20, 20], [20, 40], [0, 40]])
    xy = 1e-3 * np.array([[14, 14], [32, 10], [10, 32]])
    letter = tx.Sensor.polygon(corners, xy, electrode_shunt=1.0)
    ee = np.asarray(tx.sensor.make_field(letter).electrodes, float)
    found = ee[[0, 1], [0, 1]] + ee[[1, 2], [1, 2]] - 2 * ee[[0, 1], [1, 2]]
    np.testing.assert_allclose(found, [9477.55, 17236.4], rtol=8e-4)


def _two_parts() -> tx.Sensor:
    class Two(tx.sensor.AbstractEdge):
        def distance(self, points):
            return 0.01 - jnp.abs(points[..., 0] - 0.04)

    xy = [[0.01, 0.04], [0.07, 0.04]]
    return tx.Sensor([0.08, 0.08], xy, outline=Two(), divisions=(32, 32))


@pytest.fixture(scope="module")
def worn():
    """A sheet that is worn at a place, as a resistor network; and what is nominal."""
    from bench.network import Network

    sensor = tx.Sensor.grid(4, 4, divisions=(32, 32), dtype=np.float32)
    sensor = replace(sensor, electrode_shunt=1.0)
    m = sensor.electrode_count
    rig = Network.built(
        sensor,
        lambda at: 1e4 * (1 + np.exp(-((at - [0.03, 0.05]) ** 2).sum(1) / 4e-4)),
        np.asarray(sensor.electrode_xy, float),
        np.full(m, 2.5e-3),
        np.zeros(m),
        np.full(m, 4.0),
    )
    return sensor, rig


@pytest.mark.long
def test_a_sheet_that_another_code_tells(worn) -> None:
    sensor, rig = worn
    # Every 4 mm, in the gauge where electrode 3 is the zero; a corner is unknown.
    m = sensor.electrode_count
    solve = spla.splu(rig.network[:, np.arange(rig.count) != 3][np.arange(rig.count) != 3])
    fed = np.delete(np.eye(rig.count, m), 3, 0)
    potentials = np.insert(solve.solve(fed), 3, 0, 0)  # (nodes, M)
    nodes = potentials[rig.node].reshape(*rig.shape, m)
    centres = [np.unique(axis.round(6)) for axis in rig.cells.T]
    finer = RegularGridInterpolator(centres, nodes, bounds_error=False, fill_value=None)
    axes = [np.linspace(0, s, 21) for s in np.asarray(sensor.size)]
    coarse = finer(np.stack(np.meshgrid(*axes, indexing="ij"), -1)).transpose(2, 0, 1)
    coarse[:, 0, 0] = np.nan
    told = replace(sensor, told=tx.sensor.ToldSheet(potentials[:m].T, coarse))
    volts, grounds, places = [], np.array([0, 3, 9, 12]), []
    for place in ((0.031, 0.044), (0.052, 0.023)):
        inside = rig.disc(place, 0.006)
        volts.append(rig.under(grounds, (inside, 3e-5)))
        places.append(rig.cells[inside].mean(0))
    off = {}
    for name, which in (("nominal", sensor), ("told", told)):
        batch = tx.Batch(tx.method(which, "points", grid=16), contacts=2)
        rows = batch(np.float32(volts), np.tile(grounds, (2, 1)))
        off[name] = np.hypot(*(rows.contact_xy[:, 0] - places).T).max()
    assert off["told"] < 2e-4 < off["nominal"] / 2, off
    # Eq. 1 by the same numbers, and what a table alone cannot tell is refused.
    table, nominal = (tx.sensor.resistances(s).electrodes for s in (told, sensor))
    apart = lambda r: np.diag(r)[:, None] + np.diag(r) - 2 * np.asarray(r)  # noqa: E731
    np.testing.assert_allclose(apart(table), apart(potentials[:m].T), rtol=1e-3, atol=1)
    assert np.abs(apart(table) - apart(nominal)).max() > 500
    with pytest.raises(ValueError, match="told: got resistances of electrodes alone"):
        tx.voltages(told, tx.Disc([0.03, 0.03], 0.006, 0.5))


def test_no_peak_is_off_the_sheet(read) -> None:
    method = read("source", "one")[0]
    outside = ~np.asarray(method.inside).ravel()
    assert outside.any() and (np.asarray(method.basis)[:, outside] == 0).all()


@pytest.mark.long
def test_a_larger_model_reads_a_table_of_conditions() -> None:
    """Four contacts are no one contact: `auto` asks `source` and `shape`."""
    table = np.zeros((4, 16))
    for row, two in zip(table, [(0, 3), (12, 15), (0, 15), (3, 12)]):
        row[list(two)] = 0.25
    sensor = tx.Sensor.grid(4, 4, conditions=table, divisions=(16, 16))
    four = [
        tx.Disc.of_total([x, y], 4e-3, 5e-5) for x in (0.02, 0.06) for y in (0.02, 0.06)
    ]
    volts = np.asarray(tx.voltages(sensor, tx.Scene(*four), sensor.all_grounds()))
    batch = tx.Batch(tx.method(sensor, "auto", grid=16), contacts=1)
    rows = batch(volts[None], sensor.all_grounds()[None])
    assert rows.rung[0] > tx.methods.Rung.POINTS and rows.flags[0]


def test_contacts_by_linear_lie_on_the_sheet(disc) -> None:
    grounds = np.array([0, 3, 6, 9])
    touches = [tx.Disc.of_total(place, 0.005, 5e-5) for place in PLACES]
    volts = np.stack([np.asarray(tx.voltages(disc, t, grounds)) for t in touches])
    method = tx.method(disc, "linear", grid=24)
    rows = tx.Batch(method, contacts=3)(volts, np.tile(grounds, (len(volts), 1)))
    pixels = (rows.contact_xy[np.isfinite(rows.contact_xy[..., 0])] / method.cell).astype(
        int
    )
    assert len(pixels) and np.asarray(method.inside)[tuple(pixels.T)].all()
    # Readings in millivolts are beyond what the drive can make.
    rows = tx.Batch(method)(1e3 * volts, np.tile(grounds, (len(volts), 1)))
    assert (rows.flags & tx.Flag.SATURATED.value).all()


def _bend(places: jax.Array) -> jax.Array:
    x, y = places[..., 0] / 0.03, places[..., 1]
    return jnp.stack([0.03 * jnp.cos(x), 0.03 * jnp.sin(x), y], -1)


def test_pixels_of_a_bent_sheet_are_small_enough_in_space() -> None:
    xy = [[0.02 + 0.02 * k, 0.02 + 0.04 * (k % 2)] for k in range(7)]
    sensor = tx.Sensor(
        [0.16, 0.08], xy, surface=jax.tree_util.Partial(_bend), divisions=(100, 50)
    )
    assert tx.method(sensor, "source").shape == (32, 32)


@pytest.mark.long
def test_a_bar_on_a_round_skin_has_its_conductance_and_no_doubt(disc) -> None:
    bar = tx.Bar([0.045, 0.055], 0.036, 0.014, 0.4, 0.3)
    grounds = np.array([0, 3, 6, 9, 11, 15])
    volts = np.float32(tx.voltages(disc, bar, grounds))
    rows = tx.Batch(tx.method(disc, "shape", 32), contacts=2)(volts[None], grounds[None])
    assert not rows.flags[0] & tx.Flag.PLACE_UNCERTAIN
    np.testing.assert_allclose(
        rows.contact_conductance[0, 0], 0.3 * 0.036 * 0.014, rtol=0.2
    )
    assert np.isnan(rows.touch[0]).any()


@pytest.mark.long
def test_eq_1_of_a_skin_in_float32(disc) -> None:
    # Elements off the sheet have a loop of 10^6 times the others, which must not count.
    grounds = [0, 4, 12]
    single = np.asarray(tx.jacobian(disc, grounds))
    with jax.enable_x64(True):
        wide = jax.tree.map(lambda a: np.asarray(a, float), disc)
        double = np.asarray(tx.jacobian(wide, grounds))
        part = np.asarray(wide.parts())
    # Rounding decides of the thinnest slivers whether they are there.
    assert np.abs(single - double)[:, :, part > 1e-3].max() < 1e-3
    assert np.median(np.abs(double[:, :, part == 1]).max((0, 1))) > 0.5
    assert (double[:, :, part == 0] == 0).all()
    # Eq. 3's image is highest near the contact, not along the edge.
    every = disc.all_grounds()
    touch = tx.Disc.of_total(PLACES[0], 0.006, 3e-5)
    method = tx.method(disc, "linear", 24)
    batch = tx.Batch(method, method.choose_lambda([]), contacts=1)
    image = batch(np.float32(tx.voltages(disc, touch))[None], every[None]).image[0]
    at = (np.array(np.unravel_index(np.nanargmax(image), image.shape)) + 0.5) / 24 * 0.1
    assert np.hypot(*(at - PLACES[0])) < disc.mean_pitch
