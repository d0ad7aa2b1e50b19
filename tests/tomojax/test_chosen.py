"""Recordings of all grounds, reconstructed from the slots that a table asks for."""

import h5py
import jax.numpy as jnp
import numpy as np
import pytest

import tomojax as tx
from tomojax.recordings import ArrayRecording, read_chunk, Rig
from tomojax.results import Chosen

PLACES = np.array([[0.022, 0.031], [0.058, 0.047], [0.041, 0.066]])


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid(4, 4, divisions=(16, 16), electrode_diameter=0.005)


@pytest.fixture(scope="module")
def recording(sensor):
    """Four scans of each place, then two of nothing."""
    rng = np.random.default_rng(3)
    discs = [tx.Disc(p, 0.006, 1.0) for p in PLACES]
    each = [np.asarray(tx.voltages(sensor, disc)) for disc in discs]
    volts = np.concatenate([np.repeat(each, 4, 0), np.zeros((2, 16, 16))])
    volts = volts + 3e-4 * rng.normal(size=volts.shape)
    return ArrayRecording(Rig.of(sensor, 1e4), volts, np.arange(16))


@pytest.fixture(scope="module")
def table(sensor, tmp_path_factory):
    """Three grounds and a λ of its own for each of 2 × 2 places."""
    grounds = jnp.asarray([[[0, 1, 2], [4, 5, 6]], [[8, 9, 10], [12, 13, 14]]], jnp.int32)
    lam = jnp.asarray([[1e-5, 1e-4], [1e-3, 1e-2]])
    path = tmp_path_factory.mktemp("table") / "table.npz"
    tx.step.save_policy(tx.step.Lookup(grounds, grounds[0, 0], sensor.size, lam), path)
    return path


@pytest.mark.long
def test_slots_and_lambda_of_each_scan(recording, table):
    chosen = Chosen(table, recording, 2, "linear")
    chunk = read_chunk(recording, 0, 14)
    mask, lams = chosen(chunk, chunk.voltages)
    assert lams is not None
    used = [np.flatnonzero(one) for one in mask]
    for k, (grounds, lam) in enumerate([([0, 1, 2], 1e-5), ([12, 13, 14], 1e-2)]):
        for scan in range(4 * k, 4 * k + 4):
            np.testing.assert_array_equal(used[scan], grounds)
            assert lams[scan] == pytest.approx(lam, rel=1e-5)
    for scan in (12, 13):
        np.testing.assert_array_equal(used[scan], np.arange(16))


def test_lambda_of_another_method_is_its_own(recording, table):
    assert Chosen(table, recording, 2, "points").lam is None


@pytest.mark.long
def test_results_are_those_of_these_slots(recording, table, tmp_path):
    settings = tx.results.Settings(method="linear", grid=16, tare=False, policy=str(table))
    out = tx.reconstruct_recording(recording, tmp_path / "o.h5", settings)
    method = tx.method(recording.rig.sensor(), "linear", 16)
    scans = recording.read(0, 4)
    batch = tx.Batch(method, 1e-5 * method.scale())
    wanted = batch(scans.voltages[:, :3], scans.grounds[:, :3])
    with h5py.File(out) as file:
        np.testing.assert_allclose(file["image"][:4], wanted.image, rtol=2e-3, atol=1e-6)
        # Images of three slots may have a second peak.
        np.testing.assert_array_equal(
            file["contact_count"][:] > 0, [True] * 12 + [False] * 2
        )
        found = file["contact_xy"][:12, 0]
        # The middle of the table's four.
        assert file.attrs["lam_relative"] == pytest.approx((1e-4 + 1e-3) / 2, rel=1e-3)
    assert np.hypot(*(found - np.repeat(PLACES, 4, 0)).T).max() < 0.012


@pytest.mark.long
def test_a_lambda_for_each_frame(recording):
    method = tx.method(recording.rig.sensor(), "linear", 16)
    scans = recording.read(0, 4)
    batch = tx.Batch(method, method.scale())
    lams = method.scale() * np.array([1e-5, 1e-2, 1e-5, 1e-2])
    mixed = batch(scans.voltages, scans.grounds, lams=lams)
    for lam in (1e-5, 1e-2):
        alone = tx.Batch(method, lam * method.scale())(scans.voltages, scans.grounds)
        same = lams == lam * method.scale()
        assert mixed.image is not None and alone.image is not None
        np.testing.assert_allclose(mixed.image[same], alone.image[same], rtol=1e-5)
    with pytest.raises(ValueError, match="lams"):
        batch(scans.voltages, scans.grounds, lams=-lams)


def test_a_recording_that_lacks_grounds(sensor, recording, table, tmp_path):
    scans = recording.read(0, 4)
    few = ArrayRecording(recording.rig, scans.voltages[:, :12], scans.grounds[:, :12])
    with pytest.raises(
        ValueError, match="grounds that the recording lacks: 12, 13, 14, 15"
    ):
        Chosen(table, few, 2, "linear")
    slots = tx.results.Settings(policy=str(table), rate="slot")
    with pytest.raises(ValueError, match="policy: got a row per slot"):
        tx.reconstruct_recording(recording, tmp_path / "o.h5", slots)


def test_a_file_with_wrong_lambdas(sensor, table, tmp_path):
    with np.load(table) as file:
        content = dict(file)
    content["lam"] = -content["lam"]
    np.savez(tmp_path / "bad.npz", **content)
    with pytest.raises(ValueError, match="lam: got no λ for each place"):
        tx.step.load_policy(tmp_path / "bad.npz", sensor)


@pytest.mark.long
def test_designs_for_images_have_a_lambda(sensor):
    found = tx.design.design_policy(sensor, 3, "linear", shape=(3, 3), grid=16)
    assert found.policy.lam is not None
    lam = np.asarray(found.policy.lam)
    assert lam.shape == (3, 3) and (lam > 1e-8).all() and (lam < 1e-1).all()
