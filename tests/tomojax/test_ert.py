"""Pairs of electrodes: voltages against closed forms, recordings, commands."""

from pathlib import Path

import h5py
import jax
import numpy as np
import pytest
import references
from click.testing import CliRunner
from pyeit.eit.fem import Forward
from pyeit.mesh import PyEITMesh

import tomojax as tx
from tomojax.cli.app import app
from tomojax.ert import PairRecording, Pairs
from tomojax.kernels.sheet import nodes as mesh_nodes, triangles

RADIUS = 0.05


def rim(count: int) -> np.ndarray:
    angle = 2 * np.pi * (np.arange(count) + 0.3) / count
    return RADIUS * np.stack([np.cos(angle), np.sin(angle)], 1)


def disc(count: int = 8, diameter: float = 0.005, **others) -> tx.Sensor:
    given = {"electrode_diameter": diameter, "sheet_resistance": 100.0} | others
    return tx.Sensor.disc(2 * RADIUS, rim(count) + RADIUS, dtype=float, **given)


@pytest.fixture(scope="module")
def recorded() -> PairRecording:
    """Presses at known places: frames of the physics itself, some noise."""
    rng = np.random.default_rng(1)
    pairs, sensor = Pairs.opposite(8), disc(diameter=0.01)
    places = 0.03 * rng.uniform(-1, 1, (40, 2))
    volts = np.asarray(tx.ert.sensitivities(sensor, pairs, places + RADIUS))
    volts = volts * (1 + 0.01 * rng.normal(size=volts.shape))
    outline = tx.recordings.Outline("disc", 2 * RADIUS)
    return PairRecording(volts, pairs, rim(8), 0.01, outline=outline, places=places)


def test_opposite_pairs_are_those_of_a_measured_skin(shared_data) -> None:
    with h5py.File(shared_data / "skin_nopattern.h5") as file:
        inject, read = file["conditions/inject"][:], file["conditions/read"][:]
    pairs = Pairs.opposite(16)
    assert (pairs.inject == inject).all()
    for ours, theirs in zip(pairs.read.tolist(), read.tolist()):
        assert sorted(ours) == sorted(theirs)


@pytest.mark.parametrize(
    "inject, read, told",
    [
        ([[0, 0]], [[[1, 2]]], "inject: got one electrode twice"),
        ([[0, 1]], [[[1, 2]], [[1, 2]]], "read: got 2 conditions"),
        ([[0, 1]], [[1, 2]], "read: got shape"),
        ([[0, -1]], [[[1, 2]]], "inject: got"),
        ([[0, 1]], [[[1, 2.5]]], "read: got"),
    ],
)
def test_pairs_that_are_none_are_refused(inject, read, told) -> None:
    with pytest.raises(ValueError, match=told):
        Pairs(inject, read)
    with pytest.raises(ValueError, match="read: got electrode 8, expected 0 to 7"):
        tx.ert.background(disc(), Pairs([[0, 1]], [[[7, 8]]]))


@pytest.mark.long
def test_voltages_and_slopes_are_the_closed_form_of_points_on_a_rim() -> None:
    # u = (ρ/π)·ln(1/|x − e|) of balanced currents: an electrode and its image coincide.
    sensor, pairs = disc(), Pairs.opposite(8)
    apart = np.sqrt(((rim(8)[:, None] - rim(8)) ** 2).sum(-1)) + np.eye(8)
    table = -100.0 / np.pi * np.log(apart)
    wanted = np.array(
        [
            [
                table[p, a] - table[p, b] - table[m, a] + table[m, b]
                for p, m in pairs.read[c]
            ]
            for c, (a, b) in enumerate(pairs.inject)
        ]
    )
    got = np.asarray(tx.ert.background(sensor, pairs))
    assert abs(got - wanted).max() < 0.01 * abs(wanted).max()
    places = np.array([[0.0, 0.0], [0.02, -0.01], [-0.015, 0.03]])
    away = places[:, None] - rim(8)
    slopes = -100.0 / np.pi * away / (away**2).sum(-1, keepdims=True)
    currents = slopes[:, pairs.inject[:, 0]] - slopes[:, pairs.inject[:, 1]]
    reads = slopes[:, pairs.read[..., 0]] - slopes[:, pairs.read[..., 1]]
    wanted = -(reads * currents[:, :, None]).sum(-1)
    got = np.asarray(tx.ert.sensitivities(sensor, pairs, places + RADIUS))
    assert abs(got - wanted).max() < 0.01 * abs(wanted).max()


@pytest.mark.long
@pytest.mark.parametrize("shunt", [None, 0.8])
def test_the_jacobian_is_the_derivative_of_the_voltages(shunt, rng) -> None:
    # Readings on driven electrodes too: their own resistances follow the sheet.
    sensor = disc(4, 0.02, electrode_shunt=shunt)
    pairs = Pairs([[0, 2], [1, 2]], [[[1, 3], [0, 3]], [[0, 3], [1, 2]]])
    found = np.asarray(tx.ert.jacobian(sensor, pairs))
    way = rng.normal(size=sensor.divisions)
    step = 1e-4 / 100.0

    def volts(part: float) -> np.ndarray:
        sheet = 1 / 100.0 + part * step * np.repeat(way[..., None], 2, -1).ravel()
        changed = sensor.on_mesh(sensor.divisions, 1 / sheet)
        return np.asarray(tx.ert.background(changed, pairs))

    slope = (8 * (volts(1) - volts(-1)) - volts(2) + volts(-2)) / (12 * step)
    told = (found * way).sum((2, 3))
    assert abs(told - slope).max() < 1e-6 * abs(slope).max()


def test_the_jacobian_is_of_pyeits_stiffness(rng) -> None:
    # Its solution and its elements, with our electrodes: its own are single nodes.
    places = [[0.01, 0.01], [0.05, 0.01], [0.05, 0.03], [0.01, 0.03], [0.03, 0.02]]
    sheet = 100.0 * np.exp(0.3 * rng.standard_normal(2 * 18 * 12))
    given = {"sheet_resistance": sheet, "divisions": (18, 12), "dtype": float}
    sensor = tx.Sensor([0.06, 0.04], places, **given)
    pairs = Pairs([[0, 2], [1, 4]], [[[3, 1], [1, 4]], [[2, 0], [3, 2]]])
    nodes = np.asarray(mesh_nodes(sensor.divisions, sensor.size))
    vertices = references.counterclockwise(nodes, triangles(sensor.divisions))
    theirs = Forward(PyEITMesh(nodes, vertices, 1 / sheet, np.arange(5), 0))
    feeds = np.asarray(jax.jit(tx.sensor.sheet_on_mesh)(sensor).feeds)
    feeds = feeds - feeds[:, :1]  # balanced: their node at 0 V takes nothing
    rows = np.linalg.solve(theirs.kg.toarray(), feeds)[vertices]  # (K, 3, M)
    drive = rows[..., pairs.inject[:, 0]] - rows[..., pairs.inject[:, 1]]
    read = rows[..., pairs.read[..., 0]] - rows[..., pairs.read[..., 1]]
    wanted = -np.einsum("kicr,kij,kjc->crk", read, theirs.se, drive)
    wanted = wanted.reshape(2, 2, 18, 12, 2).sum(-1)
    got = np.asarray(tx.ert.jacobian(sensor, pairs))
    assert abs(got - wanted).max() < 1e-6 * abs(wanted).max()


def test_a_place_counts_as_its_cell_does() -> None:
    pairs, sensor = Pairs.opposite(8), disc(diameter=0.01)
    cells = np.array(sensor.divisions)
    at = np.array([[cells[0] // 2, cells[1] // 3]])
    side = np.asarray(sensor.size) / cells
    by_place = np.asarray(tx.ert.sensitivities(sensor, pairs, (at + 0.5) * side))[0]
    by_cell = np.asarray(tx.ert.jacobian(sensor, pairs))[:, :, at[0, 0], at[0, 1]]
    assert abs(by_place * side.prod() - by_cell).max() < 0.01 * abs(by_cell).max()


def test_a_curved_sheet_is_its_lengths_in_space() -> None:
    # A chart that is twice as long along x as the sheet.
    places = np.array([[0.02, 0.02], [0.03, 0.05]])
    electrodes = np.array([[0.01, 0.01], [0.05, 0.01], [0.05, 0.07], [0.01, 0.07]])
    pairs = Pairs([[0, 2]], [[[1, 3]]])
    flat = tx.Sensor([0.06, 0.08], electrodes, divisions=(24, 32), dtype=float)
    long = tx.Sensor(
        [0.12, 0.08],
        electrodes * [2, 1],
        surface=lambda p: jax.numpy.stack([p[..., 0] / 2, p[..., 1], 0 * p[..., 0]], -1),
        divisions=(24, 32),
        dtype=float,
    )
    one = np.asarray(tx.ert.sensitivities(flat, pairs, places))
    other = np.asarray(tx.ert.sensitivities(long, pairs, places * [2, 1]))
    np.testing.assert_allclose(other, one, rtol=1e-3)


def test_a_recording_comes_back(recorded, tmp_path) -> None:
    path = tmp_path / "skin.h5"
    recorded.save(path)
    back = tx.ert.load(path)
    np.testing.assert_allclose(back.voltages, recorded.voltages, rtol=1e-6)
    np.testing.assert_array_equal(back.places, recorded.places)
    assert (back.pairs.read == recorded.pairs.read).all() and not back.magnitude
    assert back.knowing(3).known.sum() == 3 and back.knowing(0).known.sum() == 0
    sensor = back.sensor()
    assert np.asarray(sensor.on_sheet(back.places - back.origin)).all()
    with h5py.File(path, "r+") as file:  # another order of slots, a hole, a word
        file["v"][0] = file["v"][0][::-1]
        file["condition"][0] = file["condition"][0][::-1]
        file["v"][1, 2, 3] = np.inf
        file.attrs["units"] = "change of the magnitude"
        del file.attrs["magnitude"]
    again = tx.ert.load(path)
    np.testing.assert_array_equal(again.voltages[0], back.voltages[0])
    assert np.argwhere(again.bad).tolist() == [[1, 2, 3]] and again.magnitude


def break_file(file: h5py.File, name: str) -> None:
    if name == "kind":
        file.attrs["kind"] = "contact"
    elif name == "electrode_diameter":
        del file.attrs[name]
    elif name == "v":
        values = file["v"][:, :, 1:]
        del file["v"]
        file["v"] = values
    elif name == "places":
        values = file["places"][1:]
        del file["places"]
        file["places"] = values
    elif name == "condition":
        file["condition"][0, 0] = 99
    else:
        del file[f"conditions/{name}"]


@pytest.mark.parametrize(
    "name",
    ["kind", "electrode_diameter", "v", "places", "condition", "read"],
)
def test_bad_files_are_told_in_a_line(recorded, tmp_path, name) -> None:
    path = tmp_path / "skin.h5"
    recorded.save(path)
    with h5py.File(path, "r+") as file:
        break_file(file, name)
    with pytest.raises(ValueError, match=f"^{path}: {name}: got .*, expected .*") as told:
        tx.ert.load(path)
    assert "\n" not in str(told.value)


def test_reciprocity_and_faults_are_told(recorded) -> None:
    pairs = Pairs.adjacent(8)
    assert len(pairs.exchanged()) == 8 * 5 / 2
    assert not len(Pairs.opposite(16).exchanged())
    volts = np.asarray(tx.ert.background(disc(), pairs))[None] * np.ones((3, 1, 1))
    volts[:, 0] *= 1.1 + 0.01 * np.arange(3)[:, None]
    volts[0, 1, 2] = np.nan
    outline = tx.recordings.Outline("disc", 2 * RADIUS)
    recording = PairRecording(volts, pairs, rim(8), 0.005, outline=outline)
    found = tx.ert.summary(recording)
    # All but five of twenty agree.
    assert found["apart_with_exchanged_roles_percent"] < 1e-4
    assert found["readings_that_are_no_numbers"] == 1
    text = tx.ert.info_text(Path("skin.h5"), found)
    assert "readings that never change: 34\n" in text


def run(*words: str | Path) -> str:
    done = CliRunner().invoke(app, ["--no-cache", *map(str, words)])
    if done.exception is not None:
        raise done.exception
    return done.output


def test_commands_calibrate_and_locate(recorded, tmp_path) -> None:
    path, out, cal = (tmp_path / f"{n}.h5" for n in ("skin", "out", "cal"))
    recorded.save(path)
    told = run("info", path)
    assert "frames: 40\n" in told and "injections: 8\n  readings of each: 4\n" in told
    told = run("calibrate", path, "-o", cal, "--response", "--places", "30")
    assert "30 at known places" in told and "stated deviation" in told
    told = run("reconstruct", path, "--calibration", cal, "-o", out)
    assert "places known of 40: off by" in told
    with tx.results.LoadedResults(out) as results:
        assert results.rows == 40 and results.attributes["method"] == "response"
        off = results["contact_xy"][:, 0] - recorded.places
        assert np.isfinite(results["contact_covariance"]).all()
    assert np.median(np.sqrt((off**2).sum(1))) < 0.005
    run("export", out, "--to", "csv", "-o", tmp_path / "out.csv")
    assert "contact1_strength" in (tmp_path / "out.csv").read_text().splitlines()[0]
    run("export", out, "--to", "svg", "-o", tmp_path / "out.svg")
    with pytest.raises(ValueError, match="a file, expected a new name, or --overwrite"):
        run("reconstruct", path, "-o", out)
    told = run(
        "reconstruct", path, "-o", out, "--overwrite", "--picture", cal.with_name("p.png")
    )
    assert "off by" in told and "picture: " in told


@pytest.mark.parametrize(
    "words, told",
    [
        (["track", "REC"], "schema"),
        (["check", "REC", "--corners", "0,7"], "--corners: recordings of kind conduct"),
        (["repair", "REC", "-o", "new.h5"], "kind: got 'conductivity'"),
        (["reconstruct", "REC", "--lam", "3"], "--lam: recordings of kind conduct"),
        (["calibrate", "REC", "--places", "x"], "--places: got 'x', expected a number"),
        (["calibrate", "REC", "--places", "99"], "places: got 99, expected 0 to 40"),
        (["calibrate", "DEMO", "--places", "9"], "--places: got .* of kind 'contact'"),
    ],
)
def test_what_a_command_does_not_take_is_said(recorded, tmp_path, words, told) -> None:
    path = tmp_path / "skin.h5"
    recorded.save(path)
    known = {"REC": path, "DEMO": Path(tx.__file__).with_name("demo.h5")}
    with pytest.raises(ValueError, match=told):
        run(*(known.get(word, word) for word in words))


def test_the_nominal_sheet_places_measured_presses(shared_data, tmp_path) -> None:
    path = shared_data / "skin_nopattern.h5"
    with h5py.File(path) as file:
        places = file["places"][:100]
        recording = tx.ert.load(path)
        few = recording.voltages[:100]
    found = tx.ert.nominal(recording).locate(few)
    error = np.sqrt(((found.xy - places) ** 2).sum(1))
    assert np.median(error) < 0.012  # always the centre: 27 mm


def made_of(places: np.ndarray, strength: float = -1e-9, noise: float = 1e-3):
    """A recording of frames whose changes are at places (n, C, 2), and its noise."""
    pairs, sensor = Pairs.opposite(8), disc(diameter=0.01)
    at = places.reshape(-1, 2) + RADIUS
    each = np.asarray(tx.ert.sensitivities(sensor, pairs, at)).reshape(
        *places.shape[:2], 8, 4
    )
    volts = strength * each.sum(1) * (1e4 / 100.0) ** 2  # of a recording's nominal sheet
    deviation = noise * float(np.std(volts))
    volts = volts + deviation * np.random.default_rng(2).normal(size=volts.shape)
    outline = tx.recordings.Outline("disc", 2 * RADIUS)
    return PairRecording(volts, pairs, rim(8), 0.01, outline=outline), deviation


def test_one_and_two_changes_are_told_apart() -> None:
    rng = np.random.default_rng(3)
    start = 0.015 * rng.uniform(-1, 1, (24, 2))
    turn = rng.uniform(0, 2 * np.pi, 24)
    apart = 0.016 * np.stack([np.cos(turn), np.sin(turn)], 1)
    lone, deviation = made_of(start[:, None])
    found = tx.ert.changes(lone, noise=deviation)
    assert (np.isfinite(found.strength).sum(1) == 1).all()
    assert np.linalg.norm(found.xy[:, 0] - start, axis=1).max() < 5e-4
    np.testing.assert_allclose(found.strength[:, 0], -1e-9, rtol=0.05)
    assert found.xy.shape == (24, 2, 2) and np.isnan(found.xy[:, 1]).all()
    two = np.stack([start, start + apart], 1)
    both, deviation = made_of(two)
    for noise in (deviation, None):
        found = tx.ert.changes(both, noise=noise)
        assert (np.isfinite(found.strength).all(1)).mean() > 0.9
        away = np.linalg.norm(found.xy[:, :, None] - two[:, None], axis=3)
        worst = np.minimum(
            np.maximum(away[:, 0, 0], away[:, 1, 1]),
            np.maximum(away[:, 0, 1], away[:, 1, 0]),
        )
        assert np.nanmedian(worst) < 1e-3
        moments = found.covariance[np.isfinite(found.strength)]
        assert (np.diagonal(moments, axis1=1, axis2=2) > 0).all()
        sure = (found.flags & tx.Flag.PLACE_UNCERTAIN == 0).any()
        assert sure == (noise is not None)


@pytest.mark.long
def test_changes_follow_the_full_model() -> None:
    # A disc whose conductance is halved, on the mesh of the whole sheet.
    sensor = disc(diameter=0.01, divisions=(60, 60))
    pairs, radius = Pairs.opposite(8), 0.005
    nodes = np.asarray(mesh_nodes(sensor.divisions, sensor.size))
    middle = nodes[triangles(sensor.divisions)].mean(1) - RADIUS
    before = np.asarray(tx.ert.background(sensor, pairs))
    places, volts, area = np.array([[0.0, 0.0], [0.02, 0.01], [-0.01, -0.025]]), [], []
    for place in places:
        within = np.hypot(*(middle - place).T) < radius
        changed = sensor.on_mesh(sensor.divisions, np.where(within, 200.0, 100.0))
        volts.append(np.asarray(tx.ert.background(changed, pairs)) - before)
        area.append(within.sum() * (2 * RADIUS / 60) ** 2 / 2)
    outline = tx.recordings.Outline("disc", 2 * RADIUS)
    recording = PairRecording(np.stack(volts), pairs, rim(8), 0.01, outline=outline)
    found = tx.ert.changes(
        recording, noise=1e-3 * np.std(volts), sheet=sensor, radius=radius
    )
    assert np.linalg.norm(found.xy[:, 0] - places, axis=1).max() < 5e-4
    wanted = 2 * np.array(area) / 100.0 * (0.5 - 1) / (0.5 + 1)  # 2πa²σ·(κ − 1)/(κ + 1)
    np.testing.assert_allclose(found.strength[:, 0], wanted, rtol=0.05)
    assert np.isnan(found.strength[:, 1]).all()


def test_changes_with_faults() -> None:
    places = np.array([[0.01, 0.0], [-0.02, 0.01], [0.0, 0.0]])
    recording, deviation = made_of(places[:, None], noise=1e-2)
    recording.voltages[2] = deviation * np.random.default_rng(0).normal(size=(8, 4))
    recording.voltages[1, 3, 2] = np.nan
    found = tx.ert.changes(recording, noise=deviation)
    assert np.linalg.norm(found.xy[:2, 0] - places[:2], axis=1).max() < 2e-3
    assert found.flags[1] & tx.Flag.DEAD_CHANNEL and not found.flags[0]
    assert found.flags[2] == tx.Flag.NO_CONTACT and np.isnan(found.xy[2]).all()
    with pytest.raises(ValueError, match="most: got 3, expected 1 or 2"):
        tx.ert.changes(recording, 3)
    with pytest.raises(ValueError, match="v: got 3 frames, expected 20 or more"):
        tx.ert.changes(recording)
    with pytest.raises(ValueError, match="noise: got"):
        tx.ert.changes(recording, noise=0.0)


def test_the_command_finds_two_changes(tmp_path) -> None:
    rng = np.random.default_rng(5)
    places = np.stack([[-0.015, 0.0], [0.015, 0.0]]) + 0.01 * rng.uniform(-1, 1, (30, 2, 2))
    recording, _ = made_of(places)
    path, out = tmp_path / "skin.h5", tmp_path / "out.h5"
    recording.save(path)
    assert "30 rows, 30 with a contact" in run(
        "reconstruct", path, "-o", out, "--contacts", "2"
    )
    with tx.results.LoadedResults(out) as results:
        assert results.attributes["method"] == "changes"
        assert results["contact_xy"].shape == (30, 2, 2)
        assert np.median(results["contact_count"]) == 2
    with pytest.raises(ValueError, match="most: got 3"):
        run("reconstruct", path, "-o", out, "--contacts", "3", "--overwrite")
