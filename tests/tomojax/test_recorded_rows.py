"""Recordings of a rig that is not ours, from file to rows, beside their truth."""

import json

import h5py
import numpy as np
import pytest

import tomojax as tx
from tomojax import Flag

LOST = slice(1200, 1237)


@pytest.fixture(scope="module")
def rows_of(tmp_path_factory):
    """Name and settings to the datasets of its results file."""
    folder = tmp_path_factory.mktemp("rows")
    known = {}

    def run(path, **settings):
        key = (path.name, *settings.items())
        if key not in known:
            with tx.open_recording(path) as recording:
                out = folder / f"{len(known)}.h5"
                tx.reconstruct_recording(recording, out, tx.results.Settings(**settings))
            with h5py.File(out) as file:
                known[key] = {name: data[()] for name, data in file.items()}
        return known[key]

    return run


# The default takes a minute for the 2000 scans.
either = pytest.mark.parametrize(
    "method", ["source", pytest.param("auto", marks=pytest.mark.long)]
)


def drag_truth(folder):
    return np.load(folder / "drag_around.truth.npz")["xy"].reshape(2000, 10, 2).mean(1)


def test_tdms_and_hdf5_give_identical_rows(shared_data, rows_of):
    paths = [shared_data / f"bounce_spanner_copline.{kind}" for kind in ("h5", "tdms")]
    one, other = (rows_of(path, method="source") for path in paths)
    for name, values in one.items():
        assert values.tobytes() == other[name].tobytes(), name


@either
def test_every_fault_where_it_is(shared_data, rows_of, method):
    """README's list of faults, in rows: those after the gap are 37 lower."""
    # That a contact is not all that an image shows is no fault of the recording.
    contact = np.uint32(Flag.CONTACTS_UNEXPLAINED)
    flags = rows_of(shared_data / "faults.h5", method=method)["flags"] & ~contact
    want = np.full(1963, Flag.SATURATED.value)  # channel 17 throughout
    want[400:450] |= Flag.DEAD_CHANNEL
    want[700:705] |= Flag.NO_DATA
    want[900:910] |= Flag.UNKNOWN_GROUND
    want[1200] |= Flag.GAP
    want[1463:1483] |= Flag.STUCK_SCAN | Flag.NO_DATA
    np.testing.assert_array_equal(flags, want)
    clean = rows_of(shared_data / "drag_around.h5", method=method)["flags"]
    assert not (clean & ~contact).any()
    assert (clean > 0).mean() < 0.5, (clean > 0).mean()


@either
def test_bad_channels_do_not_move_the_contact(shared_data, rows_of, method):
    truth = drag_truth(shared_data)
    clean, faulty = (
        rows_of(shared_data / f"{name}.h5", method=method)["contact_xy"][:, 0]
        for name in ("drag_around", "faults")
    )
    clean = clean - truth
    faulty = faulty - np.delete(truth, LOST, 0)
    clean, faulty = (np.hypot(*d.T) for d in (clean, faulty))
    assert np.median(clean) < 2e-3 and np.percentile(clean, 90) < 4e-3
    present = np.isfinite(faulty)
    assert present.sum() == 1963 - 25
    for part in (slice(0, 1963), slice(400, 450), slice(900, 910)):
        same = np.delete(clean, LOST)[part][present[part]]
        assert np.median(faulty[part][present[part]]) < 1.5 * np.median(same)


@pytest.mark.long
def test_static_scenes(shared_data, rows_of):
    """Single contacts: one, in place, with their current; three are three."""
    rows = rows_of(shared_data / "static_all.h5")
    truth = json.loads((shared_data / "truth.json").read_text())["static_all"]["scenes"]
    for scene in truth:
        part = slice(*scene["scans"])
        count, contacts = rows["contact_count"][part], scene["contacts"]
        if scene["name"] in ("nothing", "three_contacts", "two_weights_60mm"):
            assert (count == len(contacts)).all(), scene["name"]
        if len(contacts) == 1 and contacts[0]["kind"] == "disc":
            assert (count == 1).all(), scene["name"]
            apart = rows["contact_xy"][part, 0] - contacts[0]["centre"]
            # Over the grounded electrode itself one slot of 64 outweighs the others.
            limit = 8e-3 if scene["name"] == "hard_short" else 3e-3
            assert np.hypot(*apart.T).max() < limit, scene["name"]
            if scene["name"] != "hard_short":
                current = rows["contact_current"][part, 0]
                # How much a slot carries is half in its offset, which is not used.
                np.testing.assert_allclose(current, np.mean(scene["current"]), rtol=0.15)


@pytest.mark.long
def test_points_count_every_scene(shared_data):
    """Discs, bars, a rim and a short: as many as there are, from all 64 slots."""
    truth = json.loads((shared_data / "truth.json").read_text())["static_all"]["scenes"]
    firsts = [scene["scans"][0] for scene in truth]
    with tx.open_recording(shared_data / "static_all.h5") as recording:
        zeros = tx.calibration.tare(recording)
        chunk = recording.read(0, recording.scans)
        method = tx.method(recording.rig.sensor(), "points", 32)
    volts = zeros.voltages(chunk.voltages[firsts]).astype(np.float32)
    rows = tx.Batch(method, 1.0, contacts=3, images=False)(volts, chunk.grounds[firsts])
    for k, scene in enumerate(truth):
        places = [c["centre"] for c in scene["contacts"]]
        assert rows.contact_count[k] == len(places), scene["name"]
        xy = rows.contact_xy[k, : len(places)]
        for place in places:
            apart = np.hypot(*(xy - place).T).min()
            assert apart < 1e-3, scene["name"]
            assert not rows.flags[k] & Flag.HIGH_RESIDUAL, scene["name"]


@pytest.mark.long
@either
@pytest.mark.parametrize("pattern", ["all", "copline", "corners"])
@pytest.mark.parametrize("thing", ["spanner", "orange"])
def test_contact_and_none_in_a_bounce(shared_data, rows_of, thing, pattern, method):
    """As the truth has it, but for scans in which it begins, ends or is feeble."""
    path = shared_data / f"bounce_{thing}_{pattern}.h5"
    count = rows_of(path, method=method)["contact_count"]
    truth = np.load(path.with_name(path.stem + ".truth.npz"))["total_conductance"]
    slots = len(truth) // len(count)
    truth = truth[: slots * len(count)].reshape(len(count), slots)
    clear = (truth > 0.05 * truth.max()).all(1)
    assert (count[clear] > 0).all()
    assert (count[(truth == 0).all(1)] == 0).all()
