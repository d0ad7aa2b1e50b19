"""Sheets of triangles: beside flat ones of the same lengths, in files, and mistakes."""

import sys

import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner

import tomojax as tx
from tomojax.cli.app import app

RADIUS = 0.04
SLANT = 0.08


def strips(rows: int, columns: int) -> np.ndarray:
    """Two triangles for each cell of a grid of vertices, anticlockwise."""
    a = np.arange((rows - 1) * columns).reshape(rows - 1, columns)[:, :-1].ravel()
    halves = [[a, a + columns, a + columns + 1], [a, a + columns + 1, a + 1]]
    return np.concatenate([np.stack(half, 1) for half in halves])


def bent(p: np.ndarray) -> np.ndarray:
    """A half cylinder, of which p are places when it is unrolled."""
    angle = p[:, 0] / RADIUS
    return np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), p[:, 1]], 1)


def pointed(p: np.ndarray) -> np.ndarray:
    """A cone with an apex of 60°, cut along a line: its sector is half a disc."""
    slant, angle = np.hypot(*p.T), 2 * np.arctan2(p[:, 1], p[:, 0])
    height = -slant * np.cos(np.pi / 6)
    return np.stack([slant / 2 * np.cos(angle), slant / 2 * np.sin(angle), height], 1)


def half_cylinder() -> tuple[np.ndarray, np.ndarray]:
    axes = np.linspace(0, np.pi * RADIUS, 41), np.linspace(0, 0.1, 11)
    flat = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    return flat, strips(41, 11)


def half_disc() -> tuple[np.ndarray, np.ndarray]:
    angle, slant = np.linspace(0, np.pi, 81), np.linspace(0, SLANT, 31)[1:]
    s, a = np.meshgrid(slant, angle, indexing="ij")
    flat = np.stack([s * np.cos(a), s * np.sin(a)], -1).reshape(-1, 2)
    fan = np.stack([np.full(80, len(flat)), np.arange(80), np.arange(1, 81)], 1)
    return np.vstack([flat, [0, 0]]), np.vstack([strips(30, 81), fan])


def grid_of(nx: int, ny: int, x: float, y: float) -> np.ndarray:
    index = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"), -1)
    return [x, y] + 0.02 * index.reshape(-1, 2)


def rings() -> np.ndarray:
    at = []
    for radius, count in ((0.025, 4), (0.045, 7), (0.067, 10)):
        angle = np.pi * (np.arange(count) + 0.5) / count
        at.append(radius * np.stack([np.cos(angle), np.sin(angle)], 1))
    return np.concatenate(at)


def pairs(sensor: tx.Sensor) -> np.ndarray:
    """Two-point resistances: free of any gauge."""
    ee = np.asarray(tx.sensor.resistances(sensor).electrodes)
    own = np.diagonal(ee)
    return (own[:, None] + own - 2 * ee)[np.triu_indices(len(ee), 1)]


ROWS = {
    "cylinder": (half_cylinder, bent, grid_of(6, 5, 0.0128, 0.01), (60, 48)),
    "cone": (half_disc, pointed, rings(), (76, 38)),
}


@pytest.mark.long
@pytest.mark.parametrize("name", ROWS)
def test_what_unrolls_has_the_flat_sheets_resistances(name) -> None:
    """By triangles and electrodes in space alone, and by a chart that is given."""
    make, wrap, places, divisions = ROWS[name]
    flat, triangles = make()
    own = tx.Sensor.mesh(flat, triangles, places, divisions=divisions)
    assert (
        own.surface is None and np.ptp(np.asarray(own.size) - np.ptp(flat, axis=0)) < 1e-9
    )
    want, space = pairs(own), wrap(flat)
    for uv in (None, flat):
        sensor = tx.Sensor.mesh(space, triangles, wrap(places), uv=uv, divisions=divisions)
        np.testing.assert_allclose(pairs(sensor), want, rtol=2e-3)
        np.testing.assert_allclose(sensor.area, own.area, rtol=2e-3)
        at, normal = sensor.in_space(sensor.electrode_xy)
        np.testing.assert_allclose(at, wrap(places), atol=1e-4)
        # The slopes of the function that bends the sheet, whichever the chart.
        step = 1e-6 * np.eye(2)
        x, y = (wrap(places + by) - wrap(places - by) for by in step)
        truth = np.cross(x, y) / np.linalg.norm(np.cross(x, y), axis=1)[:, None]
        assert np.degrees(np.arccos((np.asarray(normal) * truth).sum(1).min())) < 4


@pytest.mark.long
def test_a_mesh_and_a_function_are_the_same_sheet() -> None:
    """A cylinder by its function: the voltages of a contact, and where `points` puts it."""
    flat, triangles = half_cylinder()
    places = grid_of(6, 5, 0.0128, 0.01)
    mesh = tx.Sensor.mesh(bent(flat), triangles, places, uv=flat)
    bend = jax.tree_util.Partial(
        lambda p: jnp.concatenate(
            [RADIUS * f(p[..., :1] / RADIUS) for f in (jnp.cos, jnp.sin)] + [p[..., 1:]], -1
        )
    )
    same = tx.Sensor.cut([np.pi * RADIUS, 0.1], None, places, surface=bend)
    touch, grounds = (
        tx.Disc.of_total([0.0641, 0.0432], 0.006, 3e-5),
        np.array([0, 4, 25, 29]),
    )
    volts, want = (np.asarray(tx.voltages(s, touch, grounds)) for s in (mesh, same))
    np.testing.assert_allclose(volts, want, atol=2e-3)
    rows = tx.Batch(tx.method(mesh, "points", grid=16), contacts=2)(
        want[None], grounds[None]
    )
    assert rows.contact_count[0] == 1
    assert np.hypot(*(rows.contact_xy[0, 0] - np.array([0.0641, 0.0432]))) < 0.3e-3


def test_a_chart_of_a_dome() -> None:
    """A third of a sphere has no chart that keeps lengths: angles and the area are kept."""
    polar, around = np.meshgrid(
        np.linspace(0.02, 1, 30), np.linspace(0, 2 * np.pi, 61)[:-1]
    )
    dome = 0.05 * np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1
    )
    closed = np.vstack(
        [strips(61, 30) % 1800, [[0, 30 * k + 30, 30 * k] for k in range(1, 59)]]
    )
    sensor = tx.Sensor.mesh(dome.reshape(-1, 3), closed, {"grid": 0.02})
    size = sensor.size
    across = np.sqrt(4 / np.pi * 2 * np.pi * 0.05**2 * (1 - np.cos(1)))
    np.testing.assert_allclose(size, across, rtol=5e-3)  # a disc
    assert not sensor.outline.loops()[1:] and 20 < len(sensor.outline.start) <= 60
    assert abs(sensor.area / (2 * np.pi * 0.05**2 * (1 - np.cos(1))) - 1) < 5e-3


def test_a_hole_and_corners_between() -> None:
    """A plate with a square hole: what lies along a side is no corner."""
    at = np.stack(np.meshgrid(np.arange(9), np.arange(9), indexing="ij"), -1).reshape(-1, 2)
    triangles = strips(9, 9)
    middle = at[triangles].mean(1)
    plate = triangles[(np.abs(middle - 4) > 1).any(1)]
    sensor = tx.Sensor.mesh(0.01 * at + 3.0, plate, {"grid": 0.02})  # away from 0
    outer, hole = sensor.outline.loops()
    assert len(outer) == len(hole) == 4
    np.testing.assert_allclose(sensor.area, 0.08**2 - 0.02**2, rtol=1e-3)
    assert sensor.on_sheet([[0.02, 0.02], [0.04, 0.04]]).tolist() == [True, False]


def test_files(tmp_path) -> None:
    meshio = pytest.importorskip("meshio")
    flat, triangles = half_cylinder()
    space, places = bent(flat), bent(grid_of(3, 2, 0.03, 0.03))
    sensor = tx.Sensor.mesh(space, triangles, places)
    loose = 1e3 * space[triangles].reshape(-1, 3)  # each triangle its own corners
    mesh = meshio.Mesh(loose, [("triangle", np.arange(len(loose)).reshape(-1, 3))])
    for name in ("a.stl", "a.obj"):
        mesh.write(tmp_path / name)
        again = tx.Sensor.from_file(tmp_path / name, places)
        np.testing.assert_allclose(again.size, sensor.size, rtol=1e-5)
        at, normal = again.in_space(again.electrode_xy)
        np.testing.assert_allclose(at, places, atol=2e-4)
        np.testing.assert_allclose(
            normal, sensor.in_space(sensor.electrode_xy)[1], atol=1e-2
        )
    quads = meshio.Mesh([[0, 0], [1, 0], [1, 1], [0, 1]], [("quad", [[0, 1, 2, 3]])])
    quads.write(tmp_path / "q.vtk")
    assert abs(tx.Sensor.from_file(tmp_path / "q.vtk", {"grid": 0.2}, 1).area - 1) < 1e-6
    meshio.Mesh([[0, 0, 0], [1, 0, 0]], [("line", [[0, 1]])]).write(tmp_path / "l.vtk")
    (tmp_path / "bad.msh").write_bytes(b"no mesh")
    for name, said in [
        ("l.vtk", "line"),
        ("bad.msh", "not a mesh"),
        ("none.stl", "no file"),
    ]:
        with pytest.raises(ValueError, match=said):
            tx.Sensor.from_file(tmp_path / name, places)


def test_meshio_may_be_missing(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'tomojax\[mesh\]'"):
        tx.Sensor.from_file("a.stl", {"grid": 0.02})


@pytest.mark.long
def test_recordings_and_results_of_a_curved_sheet(tmp_path) -> None:
    """A recording of the recorder is solved and exported: contacts have places in space."""
    from tomojax.hardware.loop import SlotRing
    from tomojax.hardware.loop.recorder import Recorder
    from tomojax.hardware.sources import Got
    from tomojax.recordings import attributes

    flat, triangles = half_cylinder()
    places = grid_of(4, 4, 0.033, 0.02)
    sensor = tx.Sensor.mesh(bent(flat), triangles, places, uv=flat, dtype=np.float32)
    rig = tx.recordings.Rig.of(sensor)
    assert rig.version == 2
    touch, grounds = tx.Disc.of_total([0.061, 0.043], 0.006, 3e-5), [0, 3, 12, 15]
    volts = np.asarray(tx.voltages(sensor, touch, grounds))
    ring = SlotRing.create(16, folder=tmp_path)
    recorder = Recorder(ring, tmp_path / "a.h5", attributes(rig, 2e-4, 0.0))
    nothing = {"latency": np.nan, "next": -1, "flags": 0, "count": 0}
    for k in range(4):
        codes = np.round(volts[k] / 2e-4).astype("i2")
        ring.put(Got(grounds[k], 0, k, 1e-4 * k, 0.0), codes, nothing)
    ring.head["done"][...] = 1
    recorder.close()
    ring.remove()
    assert not list(tmp_path.glob("*.rig"))
    with tx.open_recording(tmp_path / "a.h5") as recording:
        again = recording.rig.sensor()
        np.testing.assert_array_equal(again.surface.places, sensor.surface.places)
        scan = recording.read(0, 4)
        joined = tx.recordings.ArrayRecording(
            recording.rig, scan.voltages.reshape(1, 4, 16), scan.grounds.reshape(1, 4)
        )
    settings = tx.results.Settings(method="source", grid=16, contacts=2)
    out = tx.reconstruct_recording(joined, tmp_path / "r.h5", settings)
    with tx.results.open_results(out) as results:
        place, normal = results["contact_xyz"][0], results["contact_normal"][0]
        table = results["contact_xy"][0]
    np.testing.assert_allclose(place[0], bent(table[:1])[0], atol=2e-4)
    assert np.hypot(*(table[0] - [0.061, 0.043])) < 6e-3
    np.testing.assert_allclose(np.linalg.norm(normal[0]), 1, atol=1e-5)
    assert np.isnan(place[1]).all() and np.isnan(normal[1]).all()
    run = CliRunner().invoke(app, ["export", str(out), "-o", str(tmp_path / "r.csv")])
    assert run.exit_code == 0, run.output
    head, row = (tmp_path / "r.csv").read_text().splitlines()[:2]
    told = dict(zip(head.split(","), row.split(",")))
    assert float(told["contact1_space_z_m"]) == pytest.approx(place[0, 2])
    assert "contact1_normal_x" in told


def test_a_function_is_written_as_places() -> None:
    bend = jax.tree_util.Partial(
        lambda p: jnp.stack([p[..., 0], p[..., 1], 0.2 * p[..., 0]], -1)
    )
    sensor = tx.Sensor.cut([0.08, 0.08], None, grid_of(4, 4, 0.01, 0.01), surface=bend)
    rig = tx.recordings.Rig.of(sensor)
    assert rig.outline.kind == "rectangle" and rig.outline.attributes() == {
        "outline": "rectangle"
    }
    again = tx.recordings.Outline.read(rig.outline.attributes(), rig.tables().get)
    points = np.random.default_rng(0).uniform(0, 0.08, (20, 2))
    for sheet in (again.sheet(rig.size)["surface"], rig.sensor(float).surface):
        np.testing.assert_allclose(sheet(points), bend(points), atol=1e-9)
    with pytest.raises(ValueError, match="surface: got shape"):
        tx.recordings.Outline.read({}, {"surface": np.zeros((3, 3))}.get)


SQUARE = [[0, 0], [0.08, 0], [0.08, 0.08], [0, 0.08], [0.04, 0.04]]
FOUR = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
TALL = [[0, 0, 0.01], [0.08, 0, 0], [0.08, 0.08, 0.01], [0, 0.08, 0], [0.04, 0.04, 0.02]]


def tube() -> tuple[np.ndarray, np.ndarray]:
    angle, z = np.meshgrid(
        2 * np.pi * np.arange(24) / 24, np.linspace(0, 0.1, 12), indexing="ij"
    )
    at = 0.02 * np.stack([np.cos(angle), np.sin(angle), z / 0.02], -1)
    return at.reshape(-1, 3), strips(25, 12) % (24 * 12)


@pytest.mark.parametrize(
    "vertices, triangles, more, said",
    [
        (SQUARE, [[0, 1, 4], [2, 1, 4], [2, 3, 4], [3, 0, 4]], {}, "turned"),
        (TALL, [*FOUR, [0, 2, 4]], {}, "3 at the edge from vertex"),
        (SQUARE, [FOUR[0], FOUR[2]], {}, "hang together by a vertex"),
        ([*SQUARE, [1, 1], [2, 1], [1, 2]], [*FOUR, [5, 6, 7]], {}, "2 parts"),
        (SQUARE, [[0, 1, 5]], {}, "vertices 0 to 5, expected 0 to 4"),
        (SQUARE, [[0, 1, -1]], {}, "vertices -1 to 1"),
        (SQUARE, [[0.0, 1.0, 2.0]], {}, "numbers of vertices"),
        (SQUARE, np.zeros((0, 3), int), {}, "triangles: got 0"),
        (SQUARE, np.zeros((500_001, 3), int), {}, "a coarser mesh is enough"),
        ([[0, np.nan], *SQUARE[1:]], FOUR, {}, "vertices: got NaN"),
        ("abc", FOUR, {}, "vertices: got str"),
        ([*SQUARE[:4], [0.04, 0]], FOUR, {}, r"\[0\] without an area"),
        (SQUARE, [[0, 1, 1]], {}, "without an area"),
        (
            TALL,
            [[0, 1, 2], [0, 2, 3], [0, 4, 1], [1, 4, 2], [2, 4, 3], [3, 4, 0]],
            {},
            "closed",
        ),
        (*tube(), {}, "cut the sheet along a line, or give `uv`"),
        ([*SQUARE[:4], [0.2, 0.04]], FOUR, {}, "folds at 1 triangles"),
        (
            TALL,
            FOUR,
            {"uv": np.array(SQUARE)[[0, 1, 2, 3, 0]]},
            "uv: got a chart that folds",
        ),
        (TALL, FOUR, {"uv": 1e3 * np.array(SQUARE)}, "about the sheet's area"),
        (TALL, FOUR, {"uv": SQUARE[:4]}, "one for each vertex"),
        (TALL, FOUR, {"electrodes": [[0.02, 0.04, 0.03]] * 2}, "m from the mesh"),
        (TALL, FOUR, {"electrodes": [0.02, 0.04]}, "electrodes: got shape"),
    ],
)
def test_mistakes_are_one_sentence(vertices, triangles, more, said) -> None:
    given = {"electrodes": {"grid": 0.02}} | more
    with pytest.raises(ValueError, match=said) as error:
        tx.Sensor.mesh(vertices, triangles, **given)
    assert "\n" not in str(error.value)


def test_broken_places_of_a_file(tmp_path) -> None:
    """A surface that is none is told by its name."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["surface"] = np.full((4, 4, 3), np.nan)
        with pytest.raises(ValueError, match="surface: got NaN"):
            tx.recordings.Outline.read(
                {}, lambda name: file[name][()] if name in file else None
            )
