"""Files from outside: nothing let in, nothing that hangs, and one line why."""

import ast
import json
import os
import re
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
import recordings

import tomojax as tx
from tomojax.cli.app import run
from tomojax.files import open_container, read_csv, read_json, read_npz

ROOT = Path(__file__).parents[2]
SCANS = 40
# Of another file of the machine; no electrode of a test has these numbers.
CANARY = bytes((37, 41, 43, 47)) * 4096


def command(capsys, *words) -> tuple[int, str, str]:
    """Status, what was printed, and the error."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["tomojax", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            run()
    return end.value.code or 0, *capsys.readouterr()


def without(path: Path, name: str) -> Path:
    codes = recordings.noise(np.random.default_rng(0), SCANS)
    return recordings.write(path, codes, leave_out=(name,))


def external(file, folder):
    file.create_dataset(
        "ground", (SCANS, 2), "u1", external=[(str(folder / "canary"), 0, 80)]
    )


def fifo(file, folder):
    """A reader of it waits for a writer for ever."""
    os.mkfifo(folder / "fifo")
    size = SCANS * 2 * 64 * 2
    file.create_dataset(
        "v", (SCANS, 2, 64), "i2", external=[(str(folder / "fifo"), 0, size)]
    )


def link(file, folder):
    file["ground"] = h5py.ExternalLink(str(folder / "other.h5"), "ground")


def soft(file, folder):
    file["v"] = h5py.SoftLink("/nothing")


def virtual(file, folder):
    layout = h5py.VirtualLayout((SCANS, 2), "u1")
    layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "ground", (SCANS, 2))
    file.create_virtual_dataset("ground", layout)


def virtual_itself(file, folder):
    """HDF5 goes on until its stack has no room left."""
    layout = h5py.VirtualLayout((SCANS, 2, 64), "i2")
    layout[:] = h5py.VirtualSource(".", "v", (SCANS, 2, 64))
    file.create_virtual_dataset("v", layout)


def bomb(file, folder):
    """A chunk of 10 kB that unpacks to 1.3 GB."""
    v = file.create_dataset(
        "v", (SCANS, 2, 64), "i2", chunks=(SCANS, 2, 64), compression="gzip"
    )
    pack, block = zlib.compressobj(1), bytes(1 << 26)
    parts = [pack.compress(block) for _ in range(20)]
    v.id.write_direct_chunk((0, 0, 0), b"".join([*parts, pack.flush()]))


def huge_chunk(file, folder):
    chunks, most = (1 << 24, 2, 64), (None, 2, 64)
    file.create_dataset("v", (SCANS, 2, 64), "i2", chunks=chunks, maxshape=most)


def group(file, folder):
    file.create_group("v")


def declared(file, folder):
    """2^28 times that nobody has written."""
    file.create_dataset("t0", (2**28,), "f8", chunks=(1024,))


ATTACKS = {
    external: "ground: got data in another file",
    fifo: "v: got data in another file",
    link: "ground: got a link that leads elsewhere",
    soft: "v: got a link that leads elsewhere",
    virtual: "ground: got a virtual dataset",
    virtual_itself: "v: got a virtual dataset",
    bomb: "v: scans 0 to 1 cannot be read",
    huge_chunk: "v: got chunks of 4294967296 bytes",
    group: "v: got a group",
    declared: "t0: got shape (268435456,) in 0 bytes",
}


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda a: a.__name__)
def test_nothing_is_let_in(tmp_path, capsys, attack):
    """Neither another file's bytes nor a library's endless loop."""
    (tmp_path / "canary").write_bytes(CANARY)
    recordings.write(
        tmp_path / "other.h5",
        recordings.noise(np.random.default_rng(0), SCANS),
        np.resize(np.frombuffer(CANARY, np.uint8), (SCANS, 2)),
    )
    words = ATTACKS[attack]
    path = without(tmp_path / "a.h5", words.partition(":")[0])
    with h5py.File(path, "r+") as file:
        attack(file, tmp_path)
    status, out, error = command(capsys, "info", path)
    assert status == 2 and not out
    assert error.startswith(f"tomojax: {path}: {words}") and error.count("\n") == 1
    assert "37" not in error.removeprefix(f"tomojax: {path}")


@pytest.fixture(scope="module")
def crashed(tmp_path_factory) -> bytes:
    """What a crash leaves of a recorder: SWMR mode, chunk after chunk; 300 scans."""
    path = tmp_path_factory.mktemp("crash") / "live.h5"
    rng = np.random.default_rng(0)
    with h5py.File(path, "w", libver="latest") as file:
        file.attrs.update(recordings.ATTRIBUTES)
        file["electrode_xy"] = recordings.electrode_xy()
        make = file.create_dataset
        v = make("v", (0, 2, 64), "i2", maxshape=(None, 2, 64), chunks=(16, 2, 64))
        ground = make("ground", (0, 2), "u1", maxshape=(None, 2), chunks=(16, 2))
        t0 = make("t0", (0,), "f8", maxshape=(None,), chunks=(16,), fillvalue=np.nan)
        make("gaps", (0, 2), "i8", maxshape=(None, 2), chunks=(16, 2))
        file.swmr_mode = True
        for start in range(0, 300, 20):
            stop = start + 20
            grounds = np.tile([0, 63], (20, 1))
            for dataset, new in (
                (v, recordings.noise(rng, 20)),
                (ground, grounds),
                (t0, np.arange(start, stop) * 2e-4),
            ):
                dataset.resize(stop, 0)
                dataset[start:] = new
                dataset.flush()
        return path.read_bytes()


@pytest.mark.parametrize("at", [13, 20, 29, 33, 40, 47])
def test_a_bit_of_a_crashed_files_superblock(tmp_path, crashed, at):
    """HDF5 alone tries again for ever, and Ctrl-C does not end it."""
    content = bytearray(crashed)
    content[at] ^= 4
    (tmp_path / "a.h5").write_bytes(content)
    with pytest.raises(ValueError, match="a.h5: file: damaged .*superblock is wrong"):
        tx.open_recording(tmp_path / "a.h5")


@pytest.mark.parametrize("part", [0.2, 0.3, 0.5, 0.7, 0.95])
def test_a_crashed_file_that_is_cut_short(tmp_path, capsys, crashed, part):
    """All scans before the cut are read, and `info` says so."""
    whole, path = tmp_path / "whole.h5", tmp_path / "a.h5"
    whole.write_bytes(crashed)
    path.write_bytes(crashed[: int(part * len(crashed))])
    with tx.open_recording(path) as cut, tx.open_recording(whole) as all_of_it:
        assert all_of_it.scans == 300 and not all_of_it.mended
        assert 0.2 * part < cut.scans / 300 < part + 0.1  # the index is part of it
        for a, b in zip(cut.read(0, cut.scans), all_of_it.read(0, cut.scans)):
            np.testing.assert_array_equal(a, b)
        told = f"cut off: {cut.scans} of 300 scans"
        assert told in " ".join(cut.mended)
    status, out, _ = command(capsys, "info", path)
    assert status == 0 and f"put right: the file is {told}" in out


def test_thin_electrodes(tmp_path, capsys):
    codes = recordings.noise(np.random.default_rng(0), 5)
    path = recordings.write(tmp_path / "a.h5", codes, electrode_diameter=1e-4)
    status, _, error = command(capsys, "info", path)
    assert status == 2 and "electrode_diameter: got 0.0001 m, which takes 2.56e+06" in error
    rig = tx.recordings.Rig.of(tx.Sensor.grid())
    with pytest.raises(ValueError, match="electrode_diameter"):
        type(rig)(**{**vars(rig), "electrode_diameter": 1e-5}).sensor()


def test_matlab_structures_and_characters(tmp_path):
    codes = recordings.noise(np.random.default_rng(0), 5)
    for name, make, words in (
        ("units", lambda f: f.create_group("units"), "units: got a group"),
        ("units", lambda f: f.create_dataset("units", data=[[2**31 - 1]]), "units: got"),
        (
            "size",
            lambda f: f.create_dataset("size", data=np.zeros((1000, 1000))),
            "size: got",
        ),
    ):
        path = recordings.write_matlab(tmp_path / "a.mat", codes, [0, 63])
        with h5py.File(path, "r+") as file:
            del file[name]
            make(file)
            file[name].attrs["MATLAB_class"] = np.bytes_("char")
        with pytest.raises(ValueError, match=f"a.mat: {words}"):
            tx.open_recording(path)


def test_damaged_member(tmp_path):
    """An object header of zeros: h5py has no object for it."""
    codes = recordings.noise(np.random.default_rng(0), 5)
    path = recordings.write(tmp_path / "a.h5", codes)
    with h5py.File(path) as file:
        at = h5py.h5o.get_info(file["ground"].id).addr
    content = bytearray(path.read_bytes())
    content[at : at + 64] = bytes(64)
    path.write_bytes(content)
    with pytest.raises(ValueError, match="a.h5: ground: got what is damaged"):
        tx.open_recording(path)


def test_a_reader_that_dies_is_an_error(tmp_path):
    codes = recordings.noise(np.random.default_rng(0), 5)
    path = recordings.write(tmp_path / "a.h5", codes)
    with open_container(path) as opened:
        assert opened.read("v", np.int64(1), np.int64(3)).shape == (2, 2, 64)
        opened.close()
        with pytest.raises(OSError, match="closed"):
            opened.read("v")
    with pytest.raises(OSError), open_container(tmp_path / "none.h5"):
        pass


# ---- small files ---------------------------------------------------------------------


def test_jsons(tmp_path):
    path = tmp_path / "a.json"
    tx.Calibration().save(path)
    good = json.loads(path.read_text())
    for content, words in (
        ("[" * 200_000, "not a calibration: brackets too deep"),
        ("", "not a calibration: "),
        ('{"a": ' + "1" * 5000 + "}", "not a calibration: "),
        ("[]", "schema: got another"),
        # The runtime type check of the tests is before ours where a type is wrong.
        (json.dumps(good | {"gain": [[1], [1, 2]]}), ".*gain"),
        (json.dumps(good | {"gain": "one"}), ".*gain"),
        (json.dumps(good | {"offset": None, "extra": 1}), "'extra': got this field"),
        (json.dumps(good | {"made": "yesterday"}), "made: got 'yesterday'"),
        (json.dumps(good | {"deviation": {"gain": "x"}}), "deviation of gain: got x"),
    ):
        path.write_text(content)
        with pytest.raises(ValueError, match=rf"^{path}: {words}") as caught:
            tx.Calibration.load(path)
        assert "\n" not in str(caught.value)
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(ValueError, match="no plain file"):
        read_json(tmp_path / "fifo", "not a calibration")


def test_calibration_of_another_rig(tmp_path, capsys):
    """One line before anything is made; then the next run is not in the way of it."""
    codes = recordings.noise(np.random.default_rng(0), 20)
    path = recordings.write(tmp_path / "a.h5", codes)
    known, out = tmp_path / "rig.json", tmp_path / "o.h5"
    tx.Calibration(offset=(0.0,) * 63).save(known)
    words = "reconstruct", path, "-o", out, "--calibration", known
    for given in (words, (*words, "--no-tare"), ("info", path, "--calibration", known)):
        status, _, error = command(capsys, *given)
        assert status == 2 and f"{known}: offset: got (63,) values" in error
        assert error.count("\n") == 1 and not list(tmp_path.glob("o.h5*"))


def test_npz(tmp_path, capsys):
    path = tmp_path / "a.npz"
    np.savez(path, xy=np.zeros((40, 2)))
    good = path.read_bytes()
    big = good.replace(b"(40, 2)", b"(4e9,2)").replace(
        b"'shape': (4e9,2), ", b"'shape': (4000000,),"
    )
    for content in (b"", good[:100], good[:-30], b"PK\x05\x06" + bytes(18), big):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=rf"^{path}: places: ") as caught:
            read_npz(path, "places", ["xy"])
        assert "\n" not in str(caught.value)
    np.savez(path, xy=np.array([[1, {}]], object), allow_pickle=True)
    with pytest.raises(ValueError, match="places: "):
        read_npz(path, "places", ["xy"])
    np.savez_compressed(path, xy=np.zeros(1 << 23))  # 64 MB of zeros in 64 kB
    with pytest.raises(ValueError, match="67108992 bytes packed in"):
        read_npz(path, "places", ["xy"])
    # With an empty file the command ended with status 130, as after Ctrl-C.
    path.write_bytes(b"")
    rec = recordings.write(tmp_path / "a.h5", recordings.noise(np.random.default_rng(0), 5))
    status, _, error = command(capsys, "calibrate", rec, path)
    assert status == 2 and f"{path}: " in error and error.count("\n") == 1


def test_tables(tmp_path):
    path = tmp_path / "a.csv"
    for content in (b"\xff\xfe\x00", b"1,2\n3\n"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=f"^{path}: places: ") as caught:
            read_csv(path, "places")
        assert "\n" not in str(caught.value)


# ---- results -------------------------------------------------------------------------


@pytest.fixture
def results(tmp_path) -> Path:
    path, one = tmp_path / "a.results.h5", np.ones((6, 2), "f4")
    with h5py.File(path, "w") as file:
        file["t"] = np.arange(6) * 1e-4
        file["contact_count"] = np.full(6, 2, "u1")
        file["contact_xy"] = np.full((6, 2, 2), 0.05, "f4")
        for name in ("current", "conductance", "radius", "angle"):
            file[f"contact_{name}"] = 1e-4 * one
        file["contact_covariance"] = one[..., None] * np.float32([1e-8, 1e-8, 0])
        file["residual"], file["flags"] = np.zeros(6, "f4"), np.zeros(6, "u4")
        file.attrs.update(schema="tomojax-results", schema_version=1, size=[0.16, 0.16])
        file.attrs.update(drive_voltage=4.5, sheet_resistance=1e4, method="points")
        file.attrs["electrode_xy"] = recordings.electrode_xy()
    return path


def replaced(name, value):
    def change(file):
        del file[name]
        file[name] = value

    return change


WRONG = {
    "version": (lambda f: f.attrs.update(schema_version=7), "schema_version: got 7"),
    "NaN times": (replaced("t", np.full(6, np.nan)), "t: got NaN"),
    "counts": (replaced("contact_count", np.full(6, 200, "u1")), "contact_count: got 200"),
    "covariance": (
        replaced("contact_covariance", -np.ones((6, 2, 3), "f4")),
        "contact_covariance: got negative ones",
    ),
    "rows": (replaced("flags", np.zeros(5, "u4")), r"flags: got shape \(5,\)"),
    "size": (lambda f: f.attrs.update(size=[0.16, np.nan]), "size: got"),
    "drive": (lambda f: f.attrs.update(drive_voltage="4.5"), "drive_voltage: got 4.5"),
    "group": (lambda f: (f.pop("t"), f.create_group("t")), "t: got a group"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_results_that_are_none(results, capsys, wrong):
    change, words = WRONG[wrong]
    with h5py.File(results, "r+") as file:
        change(file)
    status, _, error = command(capsys, "track", results)
    assert status == 2 and error.count("\n") == 1
    assert re.search(words, error), error
    assert [p.name for p in results.parent.iterdir()] == [results.name]


def test_track_copies_no_other_file(results, tmp_path, capsys):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["secret"] = np.frombuffer(CANARY, np.uint8)
    with h5py.File(results, "r+") as file:
        file["linked"] = h5py.ExternalLink("other.h5", "secret")
        file["own"] = np.arange(3)
    assert command(capsys, "track", results)[0] == 0
    out = tmp_path / "a.results.track.h5"
    assert CANARY[:64] not in out.read_bytes()
    with h5py.File(out) as file:
        assert "linked" not in list(file) and file["own"][()].tolist() == [0, 1, 2]


# ---- sources -------------------------------------------------------------------------


def test_no_source_runs_what_a_file_says():
    wrong = []
    for folder in ("tomojax", "kernels", "hardware"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            name = str(path.relative_to(ROOT))
            for node in ast.walk(ast.parse(path.read_text())):
                names = []
                if isinstance(node, ast.Import):
                    names = [a.name for a in node.names]
                elif isinstance(node, ast.ImportFrom):
                    names = [node.module or ""]
                elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                    names = [f"{node.func.id}()"]
                elif isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                    value = getattr(node.value, "value", True)
                    names = ["allow_pickle"] if value is not False else []
                bad = {"pickle", "marshal", "shelve", "dill", "eval()", "exec()"}
                bad |= {"allow_pickle", "cloudpickle", "joblib"}
                wrong += [f"{name}: {n}" for n in names if n in bad]
    # JAX's executables are pickled; they are read from a folder that is the user's alone.
    assert wrong == ["tomojax/_programs.py: pickle"]
