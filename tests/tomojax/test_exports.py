"""Exports, read back by tools that are not ours."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from readback import READERS, results_of

import tomojax as tx
from tomojax.cli.app import app
from tomojax.exports import ending, export, KINDS

SHARED = Path(__file__).parents[3] / "shared" / "data"


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    """Two fingers of which one lifts, in 40 scans, with images and all kinds of flags."""
    rng = np.random.default_rng(0)
    sensor = tx.Sensor.grid(4, 4, divisions=(16, 16))
    one, two = (tx.Disc(xy, 0.006, 1.0) for xy in ([0.03, 0.05], [0.06, 0.02]))
    scenes = [tx.Scene(one, two)] * 15 + [tx.Scene(one)] * 15
    volts = np.stack([np.asarray(tx.voltages(sensor, s, [0, 15])) for s in scenes])
    volts = np.concatenate([volts, 0 * volts[:10]])
    volts = volts + rng.normal(0, 1e-4, volts.shape)
    volts[20, 0, 3] = np.nan
    rig = tx.recordings.Rig.of(sensor, f_switch=1000.0)
    recording = tx.recordings.ArrayRecording(rig, volts, [0, 15])
    out = tmp_path_factory.mktemp("results") / "two.h5"
    tx.reconstruct_recording(
        recording, out, tx.results.Settings(method="points", grid=8, contacts=4)
    )
    return out


@pytest.fixture(scope="module")
def tracked(results) -> Path:
    out = results.with_name("two.track.h5")
    done = CliRunner().invoke(app, ["track", str(results), "-o", str(out)])
    assert done.exit_code == 0
    return out


def run(*words) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["export", *map(str, words)])
    assert done.exception is None or isinstance(done.exception, SystemExit | ValueError)
    return done.exit_code, done.output + str(done.exception or "")


def differ(found: dict, truth: dict, rows: slice) -> list[str]:
    """Fields that are not the same, NaN being so."""
    wrong = []
    for name, values in found.items():
        if name not in truth:  # MCAP's messages have all numbers, NaN where there is none
            assert np.isnan(values).all()
            continue
        want = truth[name][rows]
        same = np.array_equal(values.astype(float), want.astype(float), equal_nan=True)
        wrong += [] if same else [name]
    return wrong


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize("which", ["results", "tracked"])
def test_values_are_equal(kind, which, request, tmp_path) -> None:
    path = request.getfixturevalue(which)
    truth = results_of(path)
    out = tmp_path / f"out{ending(kind)}"
    export(path, out, kind)
    found = READERS[kind](out)
    assert len(found) >= 10 and differ(found, truth, slice(None)) == []
    # Scans of two slots follow each other after 2 ms.
    export(path, out, kind, since=0.02, until=0.0305)
    assert differ(READERS[kind](out), truth, slice(10, 16)) == []


@pytest.mark.parametrize("kind", READERS)
def test_shared_results_are_equal(kind, tmp_path) -> None:
    recording = SHARED / "bounce_spanner_corners.h5"
    if not recording.exists():
        pytest.skip("needs ../shared/data")
    settings = tx.results.Settings(method="source", grid=16)
    with tx.open_recording(recording) as opened:
        part = tx.recordings.ArrayRecording(
            opened.rig, *opened.read(1400, 1500)[:2], t0=opened.read(1400, 1500).t0
        )
        tx.reconstruct_recording(part, tmp_path / "r.h5", settings)
    out = tmp_path / f"out{ending(kind)}"
    export(tmp_path / "r.h5", out, kind)
    truth = results_of(tmp_path / "r.h5")
    assert differ(READERS[kind](out), truth, slice(None)) == []


@pytest.mark.parametrize("which", ["results", "tracked"])
def test_events_are_beside_the_table(which, request, tmp_path) -> None:
    import pandas as pd

    path = request.getfixturevalue(which)
    export(path, tmp_path / "a.csv", "csv")
    export(path, tmp_path / "a.parquet", "parquet")
    events = pd.read_csv(tmp_path / "a.events.csv")
    kinds = events.groupby("event")["contact"].nunique()
    assert kinds["touch_down"] == kinds["lift_off"] == 2
    ends = events[events.event == "lift_off"].t_s
    assert ends.min() == pytest.approx(0.028, abs=0.003)
    assert ends.max() == pytest.approx(0.058, abs=0.003)
    other = pd.read_parquet(tmp_path / "a.events.parquet")
    pd.testing.assert_frame_equal(
        events.assign(text=""), other, check_dtype=False, check_exact=False
    )


def test_marks_are_events(results, tmp_path) -> None:
    import pandas as pd

    marked = tmp_path / "marked.h5"
    marked.write_bytes(results.read_bytes())
    with h5py.File(marked, "r+") as file:
        file.attrs["marks"] = json.dumps([[0.011, "here, \n"], [9.0, "after the end"]])
    export(marked, tmp_path / "a.csv", "csv")
    events = pd.read_csv(tmp_path / "a.events.csv")
    (mark,) = events[events.event == "mark"].itertuples()
    assert (mark.t_s, mark.text) == (0.011, "here, \n")


def test_netcdf_says_what_flags_mean(results, tmp_path) -> None:
    import xarray as xr

    export(results, tmp_path / "a.nc", "netcdf")
    with xr.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as data:
        flags = data["flags"].attrs
        names = dict(zip(flags["flag_meanings"].split(), flags["flag_masks"]))
        assert names == {f.name: f.value for f in tx.Flag}
        assert data["contact_x"].attrs["units"] == "m" and data["image"].dims[1:] == (
            "x",
            "y",
        )


def test_a_dataset_for_learners(results, tmp_path) -> None:
    """By the layout's own words: LeRobot itself needs PyTorch."""
    import pandas as pd

    code, said = run(results, results, "--to", "lerobot", "-o", tmp_path / "set")
    assert code == 0, said
    info = json.loads((tmp_path / "set/meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0" and info["fps"] == 50
    episodes = pd.read_parquet(tmp_path / "set/meta/episodes/chunk-000/file-000.parquet")
    assert episodes["dataset_to_index"].tolist() == [4, 8]
    data = pd.concat(
        pd.read_parquet(
            tmp_path / "set" / info["data_path"].format(chunk_index=0, file_index=k)
        )
        for k in range(2)
    )
    assert data["index"].tolist() == list(range(8))
    np.testing.assert_allclose(data["timestamp"][:4], np.arange(4) / 50, rtol=1e-6)
    truth = results_of(results)
    # Each 20 ms, of scans of 2 ms: of the ten since, the last of those that show most.
    since = [range(max(0, 10 * k - 9), 10 * k + 1) for k in range(4)]
    rows = np.array(
        [max(some, key=lambda r: (truth["contact_count"][r], r)) for some in since]
    )
    images = np.array(
        [[list(r) for r in image] for image in data["observation.tactile_image"]]
    )
    np.testing.assert_array_equal(images[:4], np.nan_to_num(truth["image"][rows]))
    state = np.stack(data["observation.tactile"].to_list())[:4].reshape(4, 4, -1)
    count = truth["contact_count"][rows]
    np.testing.assert_array_equal(state[..., 0].sum(1), count)
    np.testing.assert_array_equal(state[0, :2, 1:3], truth["contact_xy"][0, :2])
    stats = json.loads((tmp_path / "set/meta/stats.json").read_text())
    assert set(stats) == set(info["features"])
    tasks = pd.read_parquet(tmp_path / "set/meta/tasks.parquet")
    assert tasks.loc["touch"].task_index == 0


def test_a_tap_between_two_frames_is_in_the_later(results, tmp_path) -> None:
    import h5py
    import pandas as pd

    path = tmp_path / "tap.h5"
    path.write_bytes(results.read_bytes())
    with h5py.File(path, "r+") as file:
        for name, value in {"contact_count": 0, "contact_xy": np.nan}.items():
            file[name][:] = value
        file["contact_count"][12:15] = 1  # frames are rows 0, 10, 20 and 30
        file["contact_xy"][12:15, 0] = [[0.01, 0.02], [0.03, 0.04], [0.05, 0.06]]
    code, said = run(path, "--to", "lerobot", "-o", tmp_path / "set")
    assert code == 0, said
    data = pd.read_parquet(next((tmp_path / "set/data").rglob("*.parquet")))
    state = np.stack(data["observation.tactile"].to_list()).reshape(4, 4, -1)
    assert state[:, 0, 0].tolist() == [0, 0, 1, 0]
    np.testing.assert_allclose(state[2, 0, 1:3], [0.05, 0.06], rtol=1e-6)


def test_a_film_has_its_pictures(results, tmp_path) -> None:
    from PIL import Image

    export(results, tmp_path / "a.gif", "film", slow=2.0)
    with Image.open(tmp_path / "a.gif") as film:
        # 78 ms, twice as slow, 50 a second; alike ones are one for longer.
        shown = 0
        for k in range(film.n_frames):
            film.seek(k)
            shown += film.info["duration"]
        assert shown == 8 * 20
    code, said = run(results, "--film", tmp_path / "b.gif", "--rate", "60")
    assert code != 0 and "50 pictures a second at most" in said


def test_one_broken_file_stops_no_other(results, tmp_path) -> None:
    broken = tmp_path / "broken.h5"
    broken.write_bytes(results.read_bytes()[:2000])
    code, said = run(broken, results, "--to", "csv", "-o", tmp_path / "tables")
    assert code == 2 and "1 of 2 written" in said and "broken.h5" in said
    assert sorted(p.name for p in (tmp_path / "tables").iterdir()) == [
        "two.csv",
        "two.events.csv",
    ]


@pytest.mark.parametrize(
    "words, says",
    [
        (["--to", "cvs"], "cvs"),
        ([], "expected a kind"),
        (["--to", "csv", "--to", "svg"], "expected one"),
        (["--to", "csv", "--from", "9"], "holds 0 to"),
        (["--to", "csv", "--from", "0.05", "--to", "0.01"], "more than from"),
        (["--to", "csv", "-o", "table.txt"], "a name with .csv"),
    ],
)
def test_mistakes_are_named(results, tmp_path, monkeypatch, words, says) -> None:
    monkeypatch.chdir(tmp_path)
    code, said = run(results, *words)
    assert code != 0 and says in said
    assert not list(tmp_path.iterdir())


def test_files_of_others_are_not_replaced(results, tmp_path) -> None:
    there = tmp_path / "a.csv"
    there.write_text("my own table\n")
    assert run(results, "--to", "csv", "-o", there)[0] != 0
    code, said = run(results, "--to", "csv", "-o", there, "--overwrite")
    assert code != 0 and "something else" in said
    assert there.read_text() == "my own table\n"


def test_every_kind_can_be_written(results, tmp_path) -> None:
    for kind in set(KINDS) - set(READERS) - {"film", "lerobot"}:
        export(results, tmp_path / f"a{ending(kind)}", kind)
        assert (tmp_path / f"a{ending(kind)}").stat().st_size
