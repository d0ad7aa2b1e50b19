"""The same recording in the formats of other tools."""

import subprocess
import sys

import h5py
import numpy as np
import pytest
from recordings import (
    SIDECAR,
    slot_times,
    touched,
    volts,
    write,
    write_csv,
    write_matlab,
    write_mcap,
    write_npz,
    write_tdms,
)

import tomojax as tx

GROUNDS = [0, 63]
CODES, PLACE = touched(scans=12)


def _volts_npz(path, v, grounds):
    np.savez(path, v=volts(v), ground=np.broadcast_to(grounds, v.shape[:2]))
    path.with_suffix(".toml").write_text(SIDECAR)
    return path


def _codes_csv(path, v, grounds):
    head = ",".join(["number", "ground", *(f"e{e}" for e in range(64))])
    rows = np.concatenate(
        [np.arange(24)[:, None], np.tile(grounds, 12)[:, None], v.reshape(24, 64)], 1
    )
    np.savetxt(path, rows, "%d", ",", header=head, comments="")
    path.with_suffix(".toml").write_text(f"{SIDECAR}slots = 2\nscale = {5 / 32768!r}\n")
    return path


def _excel(path, v, grounds):
    made = write_csv(path, v, grounds, ";", ",")
    made.write_bytes(b"\xef\xbb\xbf" + made.read_bytes().replace(b"\n", b"\r\n"))
    return made


def _pandas(path, v, grounds):
    """With a column that counts the lines, and one that a last comma makes."""
    made = write_csv(path, v, grounds)
    head, *lines = made.read_text().splitlines()
    lines = [f"{k},{line}," for k, line in enumerate(lines)]
    made.write_text("\n".join(["sep=,", f",{head},", *lines]), encoding="utf-16")
    return made


def _twice_and_late(path, v, grounds):
    made = _codes_csv(path, v, grounds)
    head, *lines = made.read_text().splitlines()
    lines[4:6] = lines[5], lines[4]
    made.write_text("\n".join([head, *lines[:9], lines[2], lines[8], *lines[9:]]))
    return made


def _doubles(path, v, grounds):
    """MATLAB's own type for all numbers."""
    made = write_matlab(path, v, grounds)
    with h5py.File(made, "r+") as file:
        for name in ("v", "ground"):
            values = file[name][()].astype(float)  # pyright: ignore
            del file[name]
            file[name] = values
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    return made


def _volts_hdf5(path, v, grounds):
    made = write(path, v, grounds, leave_out=("v", "scale", "offset"))
    with h5py.File(made, "r+") as file:
        file["v"] = volts(v)
    return made


FORMS = {
    "mat of doubles": ("a.mat", _doubles),
    "hdf5 of volts": ("a.h5", _volts_hdf5),
    "csv of pandas": ("a.csv", _pandas),
    "csv with slots twice and late": ("a.csv", _twice_and_late),
    "mat": ("a.mat", write_matlab),
    "tdms": ("a.tdms", write_tdms),
    "csv": ("a.csv", write_csv),
    "csv of codes": ("a.csv", _codes_csv),
    "csv of a spreadsheet": ("a.csv", _excel),
    "npz": ("a.npz", write_npz),
    "npz of volts": ("a.npz", _volts_npz),
    "mcap": ("a.mcap", write_mcap),
}


def rows_of(path, folder) -> dict[str, np.ndarray]:
    out = folder / "out.h5"
    settings = tx.results.Settings(method="source", images=False, contacts=2)
    with tx.open_recording(path) as recording:
        tx.reconstruct_recording(recording, out, settings, overwrite=True)
    with h5py.File(out) as file:
        return {name: data[()] for name, data in file.items()}  # pyright: ignore


@pytest.mark.parametrize("form", FORMS)
def test_readings_are_identical(form, tmp_path) -> None:
    name, make = FORMS[form]
    path = make(tmp_path / name, CODES, np.array(GROUNDS))
    with tx.open_recording(write(tmp_path / "truth.h5", CODES, GROUNDS)) as want:
        with tx.open_recording(path) as found:
            for one, other in zip(found.read(0, 99), want.read(0, 99)):
                np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
            for field in ("size", "electrode_xy", "drive_voltage", "ground_resistance"):
                one, other = (getattr(r.rig, field) for r in (found, want))
                np.testing.assert_allclose(one, other, rtol=1e-12)
            assert found.interval == pytest.approx(want.interval)


def test_lost_slots_are_gaps_or_faults(tmp_path) -> None:
    # Of scans 2 and 3 all, of scan 5 the first slot.
    lost = (4, 5, 6, 7, 10)
    path = write_mcap(tmp_path / "a.mcap", CODES, np.array(GROUNDS), lost)
    with tx.open_recording(path) as recording:
        assert recording.gaps.tolist() == [[2, 2]] and recording.scans == 10
        read = recording.read(0, 10)
        assert read.grounds[3].tolist() == [-1, 63]
        assert np.isnan(read.voltages[3, 0]).all()
        times = slot_times(CODES)[::2][[0, 1, 4, 5, 6, 7, 8, 9, 10, 11]]
        np.testing.assert_allclose(read.t0, times, atol=1e-9)


def test_what_is_assumed_is_said(tmp_path) -> None:
    path = write_csv(tmp_path / "a.csv", CODES, GROUNDS)
    path.with_suffix(".toml").unlink()
    with tx.open_recording(path) as recording:
        said = " ".join(recording.mended)
        assert recording.slots == 2 and recording.rig.sheet_resistance == 10e3
        assert recording.rig.f_switch == pytest.approx(10e3)  # by the times
    assert "the period of the grounds" in said and "8 × 8" in said
    with tx.open_recording(path, header={"sheet_resistance": "2e3"}) as recording:
        assert recording.rig.sheet_resistance == 2000


def test_cells_without_a_number_are_flagged(tmp_path) -> None:
    path = write_csv(tmp_path / "a.csv", CODES, GROUNDS)
    lines = path.read_text().splitlines()
    cells = lines[3].split(",")
    cells[5], cells[7] = "", "open"
    lines[3] = ",".join(cells)
    path.write_text("\n".join(lines))
    with tx.open_recording(path) as recording:
        chunk = tx.recordings.read_chunk(recording, 0, 12)
    assert np.argwhere(~np.isfinite(chunk.voltages)).tolist() == [[1, 0, 3], [1, 0, 5]]
    assert tx.Flag.BAD_VOLTAGES in tx.Flag(int(chunk.flags[1]))


def test_a_file_that_is_cut_off_has_its_whole_scans(tmp_path) -> None:
    path = write_tdms(tmp_path / "a.tdms", CODES, np.array(GROUNDS))
    raw = path.read_bytes()
    # The same segment again: its channels have values in turn, and some lose their last.
    path.write_bytes(raw + raw[: len(raw) - 300])
    with tx.open_recording(path) as recording:
        assert 12 <= recording.scans < 24 and "cut off" in recording.mended[0]
        assert np.isfinite(recording.read(0, recording.scans).voltages).all()


@pytest.mark.parametrize("name", ["Time [s]", "time(s)", "T (s)"])
def test_times_may_have_their_unit_in_brackets(name, tmp_path) -> None:
    path = write_csv(tmp_path / "a.csv", CODES, np.array(GROUNDS))
    with tx.open_recording(path) as recording:
        t0 = recording.t0
    text = path.read_text()
    first = text.partition("\n")[0]
    names = [name if one == "t" else one for one in first.split(",")]
    assert name in names
    path.write_text(text.replace(first, ",".join(names), 1))
    with tx.open_recording(path) as recording:
        assert recording.electrodes == 64
        np.testing.assert_array_equal(recording.t0, t0)


def test_tdms_names_may_count_with_zeros_before(tmp_path) -> None:
    path = write_tdms(tmp_path / "a.tdms", CODES, np.array(GROUNDS), "ch{:02d} V")
    with tx.open_recording(path, channels="ch{:02d} V") as recording:
        np.testing.assert_allclose(recording.read(0, 1).voltages[0], volts(CODES)[0], 1e-6)
    with pytest.raises(ValueError, match="channels: got 'ch{:x}', expected a name with"):
        tx.open_recording(path, channels="ch{:x}")


DIES = """
import os, sys, h5py
with h5py.File(sys.argv[1]) as old:
    new = h5py.File(sys.argv[2], "w", libver="latest")
    for name in old:
        old.copy(name, new)
    new.attrs.update(old.attrs)
    new.flush()
    os._exit(0)
"""


def test_a_writer_that_died_leaves_its_scans(tmp_path) -> None:
    path = write(tmp_path / "a.h5", CODES, GROUNDS)
    subprocess.run([sys.executable, "-c", DIES, path, tmp_path / "died.h5"], check=True)
    with pytest.raises(OSError):
        h5py.File(tmp_path / "died.h5")
    with tx.open_recording(tmp_path / "died.h5") as recording:
        assert recording.scans == 12


def _small(text: str):
    def make(folder):
        path = folder / "a.csv"
        path.write_text(text)
        return path

    return make


def _other_program(folder):
    with h5py.File(folder / "a.h5", "w") as file:
        file["log/raw"] = np.zeros((4, 3))
    return folder / "a.h5"


def _other_alphabet(folder):
    (folder / "a.csv").write_bytes("ground,21 °C\n0,1\n".encode("latin-1"))
    return folder / "a.csv"


@pytest.mark.parametrize(
    "make, says",
    [
        (_small("1,2,4\n"), "a first line that names them"),
        (_small("t,v0,v1\n0,1,2\n"), "one named ground"),
        (_small("ground,v0,v1\n"), "lines: got none of numbers"),
        (_small("ground,v0,v1\n0,1,2\n1,2\n"), "columns"),
        (_small("ground,v0,v1\n0,1,2\n1,2,3\n"), "slots"),
        (_small("# nothing\n"), "lines: got none, expected a line of"),
        (_small("ground,,v0\n0,3,1\n1,3,2\n0,4,1\n"), "no name for column"),
        (_small("number,ground,v0\n0,0,1\n1,1,2\n1,1,3\n"), "one number of slots"),
        (_small("Logger;7\nground;v0;v1\n0;1;2\n"), "expected 2, as the first line"),
        (_other_program, "in a file with ..log', 'log/raw'"),
        (_other_alphabet, "expected CSV in UTF-8 or UTF-16"),
    ],
)
def test_mistakes_are_one_line(make, says, tmp_path) -> None:
    path = make(tmp_path)
    with pytest.raises(ValueError, match=says) as error:
        tx.open_recording(path)
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)


def test_a_wrong_key_beside_is_named(tmp_path) -> None:
    path = write_csv(tmp_path / "a.csv", CODES, GROUNDS)
    path.with_suffix(".toml").write_text(SIDECAR.replace("drive_", "drvie_"))
    with pytest.raises(ValueError, match="drvie_voltage"):
        tx.open_recording(path)


def test_damaged_mcap_is_one_line(tmp_path) -> None:
    path = write_mcap(tmp_path / "a.mcap", CODES, np.array(GROUNDS))
    whole = path.read_bytes()
    for at in range(0, len(whole), len(whole) // 7):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        try:
            tx.open_recording(path).close()
        except ValueError as error:
            assert "\n" not in str(error)
    path.write_bytes(whole[:300])
    with pytest.raises(ValueError, match="cannot be read as MCAP"):
        tx.open_recording(path)


def test_what_comes_before_a_cut_is_read(tmp_path, monkeypatch) -> None:
    from mcap_ros2 import writer

    real = writer.Writer
    # Chunks of a few slots: of one that is cut nothing can be read.
    monkeypatch.setattr(writer, "Writer", lambda file: real(file, chunk_size=1000))
    path = write_mcap(tmp_path / "a.mcap", CODES, np.array(GROUNDS))
    path.write_bytes(path.read_bytes()[:-3500])
    with tx.open_recording(path) as recording:
        assert "cut off or damaged" in recording.mended[0]
        assert 2 < recording.scans < 12 and recording.rig.f_switch == 10e3
        np.testing.assert_array_equal(recording.read(0, 2).voltages, volts(CODES)[:2])


def test_a_blank_cell_leaves_the_rails(tmp_path) -> None:
    path = _codes_csv(tmp_path / "a.csv", CODES, np.array(GROUNDS))
    lines = path.read_text().splitlines()
    cells = lines[3].split(",")
    cells[5] = ""
    cells[6] = "32767"
    lines[3] = ",".join(cells)
    path.write_text("\n".join(lines))
    with tx.open_recording(path) as recording:
        assert recording.rig.rails == pytest.approx((-5, 5), abs=1e-3)
        chunk = tx.recordings.read_chunk(recording, 0, 12)
    flags = tx.Flag(int(chunk.flags[1]))
    assert tx.Flag.SATURATED in flags and tx.Flag.BAD_VOLTAGES in flags


def test_rails_can_be_told_of_any_converter(tmp_path) -> None:
    path = _codes_csv(tmp_path / "a.csv", CODES, np.array(GROUNDS))
    beside = path.with_suffix(".toml")
    beside.write_text(beside.read_text() + "rails = [-2.5, 2.5]\n")
    with tx.open_recording(path) as recording:
        assert recording.rig.rails == pytest.approx((-2.5, 2.5), abs=1e-3)
        assert recording.rig.resolution == pytest.approx(5 / 32768)


def test_another_rig_beside_is_not_gone_on_with(tmp_path) -> None:
    path = write_csv(tmp_path / "a.csv", CODES, GROUNDS)
    rows_of(path, tmp_path)
    beside = path.with_suffix(".toml")
    beside.write_text(beside.read_text().replace("10e3\n", "5e3\n", 1))
    settings = tx.results.Settings(method="source", images=False, contacts=2)
    with tx.open_recording(path) as recording:
        with pytest.raises(ValueError, match="rig"):
            tx.reconstruct_recording(recording, tmp_path / "out.h5", settings, resume=True)


def test_a_stretch_is_a_recording(tmp_path) -> None:
    gaps = np.array([[3, 5], [9, 2]])  # before rows 3 and 4
    t0 = np.arange(12) * 2e-4 + 1e-3 * (np.arange(12) >= 3) + 4e-4 * (np.arange(12) >= 4)
    path = write(tmp_path / "a.h5", CODES, GROUNDS, gaps=gaps, t0=5 + t0)
    with tx.open_recording(path) as recording:
        part = tx.recordings.between(recording, 0.00155, 0.0028)
        assert part.stretch == (3, 7) and part.scans == 4
        assert part.gaps.tolist() == [[1, 2]]
        assert part.read(0, 99).t0.tolist() == recording.read(3, 7).t0.tolist()
        with pytest.raises(ValueError, match="holds 0 to 0.0036"):
            tx.recordings.between(recording, 1.0, None)
        settings = tx.results.Settings(method="source", images=False)
        tx.reconstruct_recording(part, tmp_path / "out.h5", settings)
        other = tx.recordings.between(recording, 0.0018, 0.003)
        with pytest.raises(ValueError, match="stretch"):
            tx.reconstruct_recording(other, tmp_path / "out.h5", settings, resume=True)
