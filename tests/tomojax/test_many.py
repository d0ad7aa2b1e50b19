"""Several recordings at once, and stretches of them, by the command."""

import csv
import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from recordings import touched, write, write_csv

from tomojax.cli.app import app


def run(*words) -> tuple[int, str]:
    done = CliRunner().invoke(app, [*map(str, words)])
    assert done.exception is None or isinstance(done.exception, SystemExit | ValueError)
    return done.exit_code, done.output + str(done.exception or "")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Five recordings, of which one is cut; and what is none."""
    made = tmp_path_factory.mktemp("recordings")
    for k in range(3):
        write(made / f"r{k}.h5", touched(scans=12, seed=k)[0], [0, 63])
    write_csv(made / "s.csv", touched(scans=12)[0], [0, 63])
    (made / "cut.h5").write_bytes((made / "r0.h5").read_bytes()[:3000])
    (made / "notes.txt").write_text("nothing")
    (made / "table.csv").write_text("file,status\n")
    np.savez(made / "r0.truth.npz", xy=np.zeros((3, 2)))
    return made


@pytest.mark.long
def test_each_gets_results_and_all_a_table(folder, tmp_path) -> None:
    out = tmp_path / "out"
    words = ("reconstruct", folder, "-o", out, "--method", "source", "--no-images")
    code, said = run(*words, "--json", tmp_path / "all.json")
    assert code == 2 and "4 of 5 done" in said and said.count("tomojax: ") == 1
    with (out / "table.csv").open() as file:
        rows = {Path(row["file"]).name: row for row in csv.DictReader(file)}
    assert len(rows) == 5 and "damaged" in rows["cut.h5"]["status"] + said or "cut" in said
    assert [rows[f"r{k}.h5"]["touches"] for k in range(3)] == ["1"] * 3
    told = json.loads((tmp_path / "all.json").read_text())
    assert told["summary"] == {"recordings": 5, "done": 4}
    before = {p.name: p.read_bytes() for p in out.glob("*.h5")}
    assert len(before) == 4
    # A second run would destroy them; a resumed one leaves them as they are.
    code, said = run(*words)
    assert code != 0 and "--resume" in said
    (out / "r1.results.h5").unlink()
    code, said = run(*words, "--resume")
    assert code == 2 and "4 of 5 done" in said
    assert {p.name: p.read_bytes() for p in out.glob("*.h5")} == before


def test_results_of_one_name_are_kept_apart(folder, tmp_path) -> None:
    other = tmp_path / "r0.csv"
    write_csv(other, touched(scans=12)[0], [0, 63])
    out = tmp_path / "out"
    words = ("--method", "source", "--no-images", "-o", out)
    code, said = run("reconstruct", folder / "r0.h5", other, *words)
    assert code == 0, said
    assert {p.name for p in out.glob("*.h5")} == {"r0.results.h5", "r0.csv.results.h5"}


@pytest.mark.parametrize(
    "words, says",
    [(["--picture", "a.png"], "--picture"), (["-o", "FILE"], "expected a folder")],
)
def test_mistakes_are_named(folder, tmp_path, words, says) -> None:
    (tmp_path / "FILE").write_text("x")
    words = [str(tmp_path / w) if w in ("FILE", "a.png") else w for w in words]
    code, said = run("reconstruct", folder, *words)
    assert code != 0 and says in said


@pytest.mark.long
def test_a_stretch_in_every_command(folder, tmp_path) -> None:
    rec, out = folder / "r0.h5", tmp_path / "part.h5"
    stretch = ("--from", "0.0004", "--to", "0.0014")
    words = ("--method", "points", "--no-images", "-o", out)
    code, said = run("reconstruct", rec, *words, *stretch)
    assert code == 0, said
    with h5py.File(out) as file:
        t = np.asarray(file["t"])
    np.testing.assert_allclose(t, 2e-4 * np.arange(2, 7))
    assert "5 scans of 2 slots" in run("info", rec, *stretch)[1]
    code, said = run("track", out, "--from", "0.0004", "--to", "0.0009", "--least", "1")
    assert code == 0, said
    with h5py.File(tmp_path / "part.track.h5") as file:
        assert np.asarray(file["t"]).shape == (3,)
    copy = tmp_path / "copy.h5"
    code, said = run("record", rec, "-o", copy, "--view", "none", *stretch)
    assert code == 0, said
    with h5py.File(copy) as file:
        assert np.asarray(file["v"]).shape == (10, 1, 64)
    for command in ("reconstruct", "info", "check", "calibrate", "live"):
        code, said = run(command, rec, "--from", "5")
        assert code != 0 and "holds 0 to 0.0022 s" in said, said
