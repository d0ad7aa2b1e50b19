"""Skins of other outlines and ground conditions, in the rooms that people use."""

from dataclasses import replace

import h5py
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse.linalg as spla
from scipy.interpolate import RegularGridInterpolator

import tomojax as tx

PLACES = ((0.062, 0.041), (0.031, 0.055), (0.05, 0.08))


@pytest.fixture(scope="module")
def disc() -> tx.Sensor:
    """A round skin, its rim and its middle read, in float32."""
    middle = [[0.05, 0.05], [0.03, 0.03], [0.07, 0.03], [0.03, 0.07], [0.07, 0.07]]
    sensor = tx.Sensor.disc(0.1, {"rim": 11, "points": middle}, dtype=np.float32)
    return replace(sensor, electrode_shunt=1.0)


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


@pytest.mark.parametrize("grounds", ["one", "several"])
@pytest.mark.parametrize("name, off", [("points", 0.2e-3), ("source", 4e-3)])
def test_a_contact_is_found(disc, paired, grounds, name, off) -> None:
    sensor = disc if grounds == "one" else paired
    volts, which = frames(sensor)
    # `source` reads peaks off an image, of which 16 electrodes leave some.
    most = {"points": 2, "source": 1}[name]
    rows = tx.Batch(tx.method(sensor, name, grid=24), contacts=most)(volts, which)
    np.testing.assert_array_equal(rows.contact_count, 1)
    apart = np.hypot(*(rows.contact_xy[:, 0] - np.array(PLACES)).T)
    assert apart.max() < off
    # Off the sheet there is nothing, not 0.
    outside = np.isnan(rows.image)
    assert 0.1 < outside.mean() < 1 - np.pi / 4 + 0.05
    assert (outside == outside[0]).all()


def test_conductance_with_several_grounds(paired) -> None:
    volts, which = frames(paired)
    rows = tx.Batch(tx.method(paired, "points", grid=24), contacts=2)(volts, which)
    np.testing.assert_allclose(rows.contact_conductance[:, 0], 3e-5, rtol=0.03)


def test_a_step_with_conditions(paired) -> None:
    volts, which = frames(paired)
    step = tx.make_step(paired, "follow", "all", contacts=1, grid=16)
    state = step.state
    for v, ground in zip(volts[0], which[0]):
        state, out = step(state, v, int(ground))
    assert np.hypot(*(np.asarray(out.contacts.xy[0]) - PLACES[0])) < 1e-3
    assert int(out.ground) < 4
    with pytest.raises(ValueError, match="policy: got 'information'"):
        tx.make_step(paired, "follow", "information", contacts=1, grid=16)


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
    ],
)
def test_mistakes_are_named(make, said) -> None:
    with pytest.raises(ValueError, match=said):
        make()


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
