"""Contacts over time: the filter, its smoother, and which contact is which."""

import dataclasses
import json

import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx
from tomojax.cli.app import run
from tomojax.exports import Source
from tomojax.kernels.algebra import filter_levels, Measured, smooth_levels
from tomojax.methods import Rows
from tomojax.results.track_file import track_results

SPREAD = np.array([[9e-8, 3e-8], [3e-8, 4e-8]])
PLACE = np.array([0.08, 0.06])


def measured(rng, n, runs=1):
    return PLACE + rng.normal(size=(runs, n, 2)) @ np.linalg.cholesky(SPREAD).T


def levels(z, kind=filter_levels, drift=0.0, dtype=np.float32):
    n = len(z)
    noise = jnp.broadcast_to(jnp.asarray(SPREAD, dtype), (n, 2, 2))
    ones, zeros = jnp.ones(n, bool), jnp.zeros(n, bool)
    eye = jnp.eye(2, dtype=dtype)
    given = Measured(jnp.asarray(z, dtype), noise, ones, zeros)
    return jax.jit(kind)(given, drift * eye)


def test_a_static_scene_gains_all_slots():
    """The error falls as 1/√n to within 20 %, and the stated one with it."""
    z = measured(np.random.default_rng(0), 1024, runs=60)
    found = [levels(one) for one in z]
    for n in (1, 4, 16, 64, 256, 1024):
        error = np.array([f.mean[n - 1] for f in found]) - PLACE
        rms = np.sqrt((error**2).mean()) * np.sqrt(n)
        assert abs(rms / np.sqrt(np.trace(SPREAD) / 2) - 1) < 0.2, n
        stated = np.trace(np.mean([f.covariance[n - 1] for f in found], 0))
        assert abs(np.sqrt(stated * n / np.trace(SPREAD)) - 1) < 0.2, n


def test_a_step_is_followed_within_its_slot():
    z = measured(np.random.default_rng(1), 400)[0]
    z[200:, 0] += 5e-3
    mean = np.asarray(levels(z).mean)
    assert np.abs(mean[199, 0] - PLACE[0]) < 1e-4
    assert np.abs(mean[200, 0] - PLACE[0] - 5e-3) < 1e-3
    smooth = np.asarray(levels(z, smooth_levels).mean)
    np.testing.assert_allclose(smooth[190:200, 0], PLACE[0], atol=1e-4)
    np.testing.assert_allclose(smooth[200:210, 0], PLACE[0] + 5e-3, atol=1e-4)


def test_float32_is_stable():
    """A hundred thousand measurements: the covariance stays one."""
    z = measured(np.random.default_rng(2), 100_000)[0]
    narrow, wide = levels(z), levels(z, dtype=np.float64)
    assert (np.linalg.eigvalsh(np.asarray(narrow.covariance)) > 0).all()
    np.testing.assert_allclose(narrow.mean, wide.mean, atol=2e-6)


def rows_of(places, currents, spread=1e-7):
    """Rows of C contacts; NaN where there is none."""
    n, most = currents.shape
    nan = np.full((n, most), np.nan)
    covariance = np.where(np.isfinite(places[..., :1]), [spread, spread, 0], np.nan)
    return Rows(
        np.isfinite(currents).sum(1).astype(np.uint8),
        places,
        nan,
        nan,
        currents,
        currents / 2.0,
        covariance,
        np.zeros(n),
        np.zeros(n, np.uint32),
        np.zeros(n, np.uint8),
        None,
        None,
    )


@pytest.fixture
def crossing():
    """One contact throughout that is missing twice, and one from 100 to 299; strongest
    first, so that they change places in the row; a ghost in row 350."""
    rng = np.random.default_rng(3)
    places, currents = np.full((400, 2, 2), np.nan), np.full((400, 2), np.nan)
    places[:, 0], currents[:, 0] = [0.05, 0.05], 1e-4
    places[150:300, 1], currents[150:300, 1] = places[150:300, 0], 1e-4
    places[100:150, 1], currents[100:150, 1] = [0.11, 0.09], 5e-5
    places[150:300, 0], currents[150:300, 0] = [0.11, 0.09], 3e-4
    places[50:52], currents[50:52] = np.nan, np.nan
    places[350, 1], currents[350, 1] = [0.02, 0.14], 1e-6
    return rows_of(places + rng.normal(0, 3e-4, places.shape), currents)


def test_which_is_which(crossing):
    found = tx.track(crossing, 4.5, 10e3)
    assert set(np.unique(found.contact_track)) == {0, 1, 2}
    assert (found.contact_count[50:52] == 1).all()  # there all along
    assert found.contact_count[350] == 1
    touches = tx.results.touches(found, np.arange(400) * 1e-4)
    assert [(round(1e4 * t.start), round(1e4 * t.end)) for t in touches] == [
        (0, 399),
        (100, 299),
    ]
    assert np.hypot(*(np.array(touches[0].xy) - 0.05)) < 1e-4
    first = found.contact_xy[found.contact_track == 1]
    assert np.sqrt(((first - 0.05) ** 2).mean()) < 5e-5  # of 0.3 mm in each row
    assert np.nanmin(found.contact_conductance_error) < 0.02


def test_no_contact_at_all():
    none = rows_of(np.full((5, 2, 2), np.nan), np.full((5, 2), np.nan))
    found = tx.track(none, 4.5, 10e3)
    assert not found.contact_count.any() and np.isnan(found.contact_xy).all()
    assert tx.results.touches(found, np.arange(5.0)) == []


def test_a_conductance_that_no_row_tells_stays_untold(crossing):
    """`source` names weak contacts without a conductance: none is 1 S."""
    g = np.array(crossing.contact_conductance)
    g[:100] = np.nan
    some = crossing._replace(contact_conductance=g)
    tracks = tx.track(some, 4.5, 10e3)
    assert np.nanmax(tracks.contact_conductance) < 2e-4
    none = crossing._replace(contact_conductance=np.full_like(g, np.nan))
    tracks = tx.track(none, 4.5, 10e3)
    assert tracks.contact_count.any() and np.isnan(tracks.contact_conductance).all()
    assert all(
        np.isnan(touch.conductance)
        for touch in tx.results.touches(tracks, np.arange(400.0))
    )


def test_bad_arguments(crossing):
    blind = crossing._replace(contact_covariance=crossing.contact_covariance * np.nan)
    for rows, options, match in (
        (blind, {}, "rows: got contacts without covariance"),
        (crossing, {"hold": -1}, "hold: got -1"),
        (crossing, {"least": 0}, "least: got 0"),
        (crossing, {"drift": (1.0, -1.0)}, "drift: got"),
    ):
        with pytest.raises(ValueError, match=match):
            tx.track(rows, 4.5, 10e3, **options)
    with pytest.raises(ValueError, match="sheet_resistance: got 0"):
        tx.track(crossing, 4.5, 0.0)


@pytest.fixture
def results(crossing, tmp_path):
    """A results file, as `reconstruct --rate slot --no-images` leaves it."""
    path = tmp_path / "a.results.h5"
    with h5py.File(path, "w") as file:
        for name, values in crossing._asdict().items():
            if values is not None:
                file[name] = values
        file["t"] = np.arange(400) * 1e-4
        file.attrs.update({"schema": "tomojax-results", "schema_version": 1})
        file.attrs.update({"drive_voltage": 4.5, "sheet_resistance": 1e4})
        file.attrs.update({"size": (0.16, 0.16), "electrode_xy": np.zeros((64, 2))})
        file.attrs["size"] = [0.16, 0.16]
    return path


def command(*arguments, capsys):
    """Exit status, what was printed, and the error."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["tomojax", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            run()
    return end.value.code, *capsys.readouterr()


def test_command(results, tmp_path, capsys):
    picture, report = tmp_path / "p.png", tmp_path / "p.json"
    options = "--picture", picture, "--json", report
    status, text, _ = command("track", results, *options, capsys=capsys)
    assert status == 0 and text.startswith("2 contacts\n")
    assert picture.read_bytes()[:4] == b"\x89PNG"
    rows = json.loads(report.read_text())["rows"]
    assert [row["rows"] for row in rows] == [400, 200]
    with h5py.File(tmp_path / "a.results.track.h5") as file:
        assert (file["contact_track"][50:52, 0] == 1).all()
        assert file["t"].shape == (400,) and "contact_angle" not in file
    status, _, error = command("track", results, capsys=capsys)
    assert status == 2 and "expected a new name, or --overwrite" in error
    assert command("track", results, "--overwrite", capsys=capsys)[0] == 0


def test_forces_follow_each_contact(results, tmp_path):
    """The material has a loop: a contact presses harder, then lets go."""
    known = tx.Calibration(pressure=(3e-4, 0.8), hysteresis=1.5)
    with h5py.File(results, "a") as file:
        file.attrs["calibration"] = json.dumps(dataclasses.asdict(known))
        way = 1 + 2 * np.minimum(np.arange(400), np.arange(400)[::-1])[:, None] / 200
        file["contact_conductance"][...] = file["contact_conductance"][()] * way
        file["contact_current"][...] = file["contact_current"][()] * way
        file["contact_radius"][...] = 0.005
        file["contact_force"] = np.ones_like(file["contact_radius"])
    track_results(results, tmp_path / "t.h5")
    with h5py.File(tmp_path / "t.h5") as file:
        one = file["contact_track"][()] == 1
        newtons, g = file["contact_force"][one], file["contact_conductance"][one]
    area = np.pi * 0.005**2
    loading = (g / area / 3e-4) ** 1.25 * area
    np.testing.assert_allclose(newtons[10:190], loading[10:190], rtol=0.1)
    np.testing.assert_allclose(newtons[300:], loading[300:] / 1.5, rtol=0.02)
    with Source(tmp_path / "t.h5") as source:
        first, *_, last = source.events()
    assert first.force == pytest.approx(newtons[0])
    assert last.force == pytest.approx(newtons[-1])


def test_commands_bad_input(results, tmp_path, capsys):
    plain = tmp_path / "plain.h5"
    with h5py.File(results) as file, h5py.File(plain, "w") as other:
        other.attrs.update(file.attrs)
        for name in file:
            if name != "contact_covariance":
                file.copy(name, other)
    for arguments, match in (
        ((tmp_path / "none.h5",), "none.h5: no such file"),
        ((plain,), "expected results of points or auto"),
        ((results, "--drift", "fast"), "expected auto or M,LN_G"),
        ((results, "--hold", "-1"), "hold: got -1"),
        ((results, "--picture", tmp_path / "no" / "p.png"), "no such folder"),
    ):
        status, _, error = command("track", *arguments, capsys=capsys)
        assert status == 2 and match in error and error.count("\n") == 1, arguments
    assert not list(tmp_path.glob("*.partial"))
