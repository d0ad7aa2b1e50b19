"""Results files as arrays, and as tables of pandas and xarray."""

import sys
from pathlib import Path

import numpy as np
import pytest
import readback

import tomojax as tx
from tomojax.exports import export
from tomojax.results import report

COUNT = 12


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Rows with no contact, with one and with two."""
    folder = tmp_path_factory.mktemp("results")
    sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    one, other = tx.Disc([0.02, 0.05], 0.005, 0.5), tx.Disc([0.06, 0.03], 0.005, 0.5)
    scenes = [tx.Scene(), one, tx.Scene(one, other)]
    volts = np.stack([tx.voltages(sensor, s, [0, 15]) for s in scenes]).repeat(4, 0)
    volts = volts + np.random.default_rng(1).normal(0, 3e-4, volts.shape)
    recording = tx.recordings.ArrayRecording(tx.recordings.Rig.of(sensor), volts, [0, 15])
    settings = tx.results.Settings(method="source", grid=16, contacts=3)
    return tx.reconstruct_recording(recording, folder / "r.h5", settings)


def test_arrays_by_name(path) -> None:
    truth = readback.results_of(path)
    with tx.results.open_results(str(path)) as results:
        assert results.rows == COUNT and results.contacts == 3
        for name in ("t", "contact_xy", "image", "flags"):
            np.testing.assert_array_equal(results[name], truth[name])
        assert results.shape("image") == (COUNT, 16, 16)
        with pytest.raises(ValueError, match="name: got 'xy', expected one of"):
            results["xy"]
        text, html = repr(results), results._repr_html_()
        assert "12 of up to 3 contacts" in text and len(text) < 700
        assert html.count("<tr>") >= 12 and "source" in html
    with pytest.raises(ValueError, match="no results of reconstruct"):
        tx.results.open_results(path.with_name("none.h5"))


def test_a_line_for_each_contact(path, tmp_path) -> None:
    truth = readback.results_of(path)
    with tx.results.open_results(path) as results:
        table = results.to_pandas()
    count = truth["contact_count"].astype(int)
    assert sorted(set(count)) == [0, 1, 2]
    assert len(table) == np.maximum(count, 1).sum()
    assert table.columns[:5].tolist() == ["row", "t_s", "contact", "x_m", "y_m"]
    empty = table[table.contact == 0]
    assert empty.row.tolist() == np.flatnonzero(count == 0).tolist()
    assert empty.x_m.isna().all() and (empty.flag_names.str.contains("NO_CONTACT")).all()
    for line in table[table.contact > 0].itertuples():
        k, c = line.row, line.contact - 1
        assert (line.x_m, line.y_m) == tuple(truth["contact_xy"][k, c])
        assert line.current_A == truth["contact_current"][k, c]
        assert (line.t_s, line.flags) == (truth["t"][k], truth["flags"][k])
        assert line.residual_V == truth["residual"][k]
        assert line.doubt == bool(truth["flags"][k] & int(tx.methods.DOUBT))
    # The columns are those of the CSV, without a contact's number.
    export(path, tmp_path / "a.csv", "csv")
    import pandas as pd

    wide = pd.read_csv(tmp_path / "a.csv").columns
    assert set(table) - {"row", "contact", "doubt"} == {
        c.removeprefix("contact1_") for c in wide
    } - {c for c in wide if c.startswith(("contact2", "contact3"))}


def test_the_dataset_is_that_of_a_netcdf_export(path, tmp_path) -> None:
    import xarray as xr

    export(path, tmp_path / "a.nc", "netcdf")
    with (
        tx.results.open_results(path) as results,
        xr.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as file,
    ):
        data = results.to_xarray()
        for name in file.variables:
            if not str(name).startswith("event"):
                same = data[name]
                assert same.dims == file[name].dims, name
                np.testing.assert_array_equal(same, file[name])
                assert same.attrs["units"] == file[name].attrs["units"]
        assert set(data.variables) <= set(file.variables)
    assert data.image.sel(x=0.02, y=0.05, method="nearest").shape == (COUNT,)


@pytest.mark.parametrize("name", ["pandas", "xarray"])
def test_a_missing_library_is_said(path, name, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    told = rf"{name} is not installed; pip install 'tomojax\[tables\]' brings it"
    with tx.results.open_results(path) as results:
        with pytest.raises(ModuleNotFoundError, match=told):
            getattr(results, f"to_{name}")()


@pytest.mark.parametrize("each", [False, True])
def test_a_dataset_of_voltages_gives_one_of_rows(each) -> None:
    """As `Batch` gives, in chunks too; a ground for each slot of each scan, or of all."""
    xarray = pytest.importorskip("xarray")
    sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    volts = np.asarray(tx.voltages(sensor, tx.Disc([0.03, 0.05], 0.006, 1.0), [0, 15]))
    volts, ground = np.stack([volts, 0 * volts, volts, volts]), np.array([0, 15])
    volts[3, 0, 4] = np.nan
    told = (("time", "slot"), np.tile(ground, (4, 1))) if each else ("slot", ground)
    data = xarray.Dataset(
        {"voltages": (("slot", "time", "electrode"), volts.swapaxes(0, 1)), "ground": told},
        coords={"time": 0.1 * np.arange(4)},
    )
    method = tx.method(sensor, "source", 16)
    rows = tx.results.apply(data, method, contacts=2)
    wanted = tx.Batch(method, contacts=2)(volts, np.tile(ground, (4, 1)))
    np.testing.assert_array_equal(rows.contact_x, wanted.contact_xy[..., 0])
    np.testing.assert_array_equal(rows.image, wanted.image)
    assert rows.image.dims == ("time", "x", "y") and rows.image.units == "A/m^2"
    np.testing.assert_allclose(rows.x, (np.arange(16) + 0.5) * 0.08 / 16)
    np.testing.assert_array_equal(rows.time, data.time)
    lazy = tx.results.apply(data.chunk(time=3), method, contacts=2)
    assert lazy.image.chunks is not None
    xarray.testing.assert_allclose(lazy.compute(scheduler="synchronous"), rows)
    with pytest.raises(ValueError, match="^ground: got"):
        tx.results.apply(data.drop_vars("ground"), method)
    with pytest.raises(ValueError, match="^voltages: got .*, expected dimensions"):
        tx.results.apply(data.rename(slot="turn"), method)


@pytest.mark.parametrize(
    "rows, told", [({"1": 9, "2": 1}, True), ({"0": 9, "1": 1}, False)]
)
def test_zeros_that_are_off_are_told(rows, told) -> None:
    found = {
        "rows_in_all": 10,
        "duration_s": 1.0,
        "method": "source",
        "lam": 1.0,
        "lam_relative": 1e-4,
        "residual_median_V": 0.01,
        "rows_by_contacts": rows,
        "rows_by_flag": {},
        "rows_doubted": 5,
        "rows_without_answer": 0,
        "forces": False,
        "rows": [],
    }
    assert ("higher --threshold" in report.text(found, Path("a.h5"))) == told
