"""`follow` on a recording: what the step says slot by slot, whatever the chunks are."""

import h5py
import numpy as np
import pytest
import recordings

import tomojax as tx
from tomojax import cli, Flag
from tomojax.results import partial_path, ResultsFile, Settings

SCANS, SLOTS = 220, 2
FIELDS = ("contact_count", "flags", "contact_xy", "contact_current", "residual")


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A contact in the middle third; lost scans, an unknown ground, channels gone."""
    codes, _ = recordings.touched(scans=SCANS)
    codes[100, 1, 9] = 32767
    grounds = np.broadcast_to(np.array([0, 63], np.uint8), (SCANS, SLOTS)).copy()
    grounds[120, 0] = 200
    codes[130:160, :, 7] = codes[130, 0, 7]
    t0 = np.arange(SCANS) * SLOTS / 10e3
    t0[90:] += 12 * SLOTS / 10e3
    file = tmp_path_factory.mktemp("follow") / "rec.h5"
    return recordings.write(file, codes, grounds, t0=t0, gaps=np.array([[90, 12]]))


STEPS: dict[str, tx.step.Step] = {}


@pytest.fixture(scope="module", autouse=True)
def few_steps():
    """Runs of this rig share a step, which is pure, until one asks for a new one."""

    def made(sensor, **given):
        told = repr((given, np.asarray(sensor.electrode_xy).tobytes()))
        if told not in STEPS:
            STEPS[told] = tx.make_step(sensor, **given)
        return STEPS[told]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tomojax.results._following.make_step", made)
        yield
    STEPS.clear()


def rows(path, out, *, resume=False, progress=None, **settings):
    chosen = Settings(method="follow", contacts=2, tare=False, **settings)
    more = {} if progress is None else {"progress": progress}
    with tx.open_recording(path) as recording:
        tx.reconstruct_recording(recording, out, chosen, resume=resume, **more)
    with h5py.File(out) as file:
        assert file.attrs["rate"] == "slot" and "image" not in file
        return {name: file[name][:] for name in (*FIELDS, "t", "contact_covariance")}


@pytest.fixture(scope="module")
def whole(path):
    return rows(path, path.with_name("whole.h5"), chunk=200)


def same(one, other) -> None:
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], err_msg=name)


@pytest.mark.long
def test_as_the_step_says_slot_by_slot(path, whole):
    with tx.open_recording(path) as recording:
        rig = recording.rig
        step = tx.make_step(rig.sensor(), contacts=2, f_switch=rig.f_switch)  # its own
        scans = recording.read(0, SCANS)
        chunk = tx.recordings.read_chunk(recording, 0, SCANS, "slot")
    volts = np.where(chunk.good[:, 0], chunk.voltages[:, 0], np.nan)
    state, told = step.state, []
    for k, ground in enumerate(scans.grounds.ravel()):
        lost = 12 * SLOTS if k == 90 * SLOTS else 0
        state, out = step(state, volts[k], int(ground), lost)
        told.append(out)
    count = np.array([int(out.contacts.count) for out in told])
    np.testing.assert_array_equal(whole["contact_count"], count)
    places = np.stack([out.contacts.xy for out in told])
    np.testing.assert_allclose(whole["contact_xy"], places, atol=1e-6)
    spread = np.stack([out.contacts.covariance for out in told])
    np.testing.assert_allclose(whole["contact_covariance"], spread, rtol=1e-3)
    own = np.array([int(out.flags) for out in told]) & ~Flag.BAD_VOLTAGES.value
    np.testing.assert_array_equal(whole["flags"], own | chunk.flags)
    assert whole["flags"][90 * SLOTS] & Flag.GAP
    assert whole["flags"][100 * SLOTS + 1] & Flag.SATURATED
    unknown = Flag.UNKNOWN_GROUND | Flag.NO_DATA
    assert whole["flags"][120 * SLOTS] & unknown == unknown
    assert (whole["flags"][140 * SLOTS : 150 * SLOTS] & Flag.STUCK_CHANNEL).all()
    _, place = recordings.touched()
    near = whole["contact_xy"][80 * SLOTS : 140 * SLOTS, 0]
    assert np.nanmax(np.hypot(*(near - place).T)) < 2e-3


@pytest.mark.long
@pytest.mark.parametrize("chunk", [7, 16])
def test_chunks_do_not_show(path, whole, tmp_path, chunk):
    same(rows(path, tmp_path / "o.h5", chunk=chunk), whole)


@pytest.mark.long
def test_chunks_of_one_scan(path, whole, tmp_path):
    """Takes the first scans alone: each chunk costs the time of several files."""
    with h5py.File(path) as file:
        codes, grounds = file["v"][:60], file["ground"][:60]
    few = recordings.write(tmp_path / "few.h5", codes, grounds)
    once = rows(few, tmp_path / "one.h5")
    same(rows(few, tmp_path / "o.h5", chunk=1), once)


@pytest.mark.parametrize("last", [1, pytest.param(9, marks=pytest.mark.long)])
def test_interrupted_and_resumed(path, whole, tmp_path, last):
    """Also where what the step remembers is of before what is marked as done."""
    out = tmp_path / "o.h5"

    def stop(done: int, total: int) -> None:
        if done == last:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rows(path, out, chunk=16, progress=stop)
    if last == 1:
        partial = partial_path(out)
        partial.with_name(partial.name + ".state").unlink(missing_ok=True)
    STEPS.clear()  # another process goes on, with a step of its own
    same(rows(path, out, chunk=16, resume=True), whole)
    assert sorted(tmp_path.iterdir()) == [out]


def test_a_state_that_is_none_of_the_run_is_a_line(path, whole, tmp_path):
    """And nothing is lost: with what was there the run goes on."""
    out = tmp_path / "o.h5"

    def stop(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rows(path, out, chunk=16, progress=stop)
    partial = partial_path(out)
    state = partial.with_name(partial.name + ".state")
    content = state.read_bytes()
    with np.load(state) as arrays:
        kept = dict(arrays)
    marks = partial.with_name(partial.name + ".done").read_bytes()
    file, own = ResultsFile(out, len(marks)), {k: kept[k] for k in ("numbers", "whole")}
    for name, value in (
        ("chunk", None),
        ("chunk", np.array(2.5)),
        ("chunk", kept["chunk"] + 1),  # not marked as done: its rows would be missing
        ("numbers", kept["numbers"][1:]),
        ("whole", None),
    ):
        wrong = {k: v for k, v in (kept | {name: value}).items() if v is not None}
        with state.open("wb") as raw:
            np.savez(raw, **wrong)
        said = f"o.h5.partial.state: {name}: got .*; begin anew with --overwrite$"
        with pytest.raises(ValueError, match=said):
            file.kept(own)
    with pytest.raises(ValueError, match=said):  # of the last, as a run says it
        rows(path, out, chunk=16, resume=True)
    state.write_bytes(content)
    same(rows(path, out, chunk=16, resume=True), whole)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--rate", "scan"), "rate: got 'scan', expected 'slot': follow goes"),
        (("--images",), "images: got True, expected none with follow"),
        (("--lam", "2"), "lam: got 2.0, expected none with follow"),
        (("--contacts", "9"), "contacts: got 9, expected a whole number from 1 to 8"),
    ],
)
def test_what_cannot_be_is_said_in_a_line(
    path, tmp_path, capsys, monkeypatch, options, told
):
    words = ("tomojax", "reconstruct", path, "--method", "follow", "-o", tmp_path / "o.h5")
    monkeypatch.setattr("sys.argv", [str(w) for w in (*words, *options)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    lines = capsys.readouterr().err.strip().splitlines()
    assert ended.value.code == 2 and len(lines) == 1 and told in lines[0]
    assert not (tmp_path / "o.h5").exists()
