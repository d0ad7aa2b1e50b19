"""From a recording to a results file: what is in it, and that nothing ever gets lost."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
import recordings

import tomojax as tx
from tomojax import Flag
from tomojax.results import partial_path

ROOT = Path(__file__).parents[2]
SETTINGS = tx.results.Settings(method="source", chunk=25, grid=16)


@pytest.fixture(scope="module")
def recording_path(tmp_path_factory):
    codes, _ = recordings.touched(scans=300)
    codes[200, :, 9] = 32767
    path = tmp_path_factory.mktemp("rec") / "rec.h5"
    return recordings.write(path, codes, gaps=np.array([[50, 10]]))


def run(path, out, settings=SETTINGS, **options):
    with tx.open_recording(path) as recording:
        return tx.reconstruct_recording(recording, out, settings, **options)


@pytest.fixture(scope="module")
def whole(recording_path):
    return run(recording_path, recording_path.with_name("whole.h5"))


def test_the_default_method_is_auto_but_for_slots():
    assert tx.results.Settings().method == "auto"
    assert tx.results.Settings(rate="slot").method == "source"


def test_what_is_in_the_file(whole, recording_path):
    _, place = recordings.touched()
    with h5py.File(whole) as file:
        assert file.attrs["schema"] == "tomojax-results" and file.attrs["lam"] > 0
        config = json.loads(file.attrs["configuration"])
        assert config["method"] == "source" and config["chunk"] == 25
        assert file["image"].shape == (300, 16, 16)
        assert json.loads(file["flags"].attrs["bits"])["GAP"] == Flag.GAP
        assert [file[n].attrs["unit"] for n in ("t", "contact_xy", "image")] == [
            "s",
            "m",
            "A/m^2",
        ]
        count, flags = file["contact_count"][:], file["flags"][:]
        np.testing.assert_array_equal(count, np.repeat([0, 1, 0], 100))
        touched = file["contact_xy"][100:200, 0]
        assert np.hypot(*(touched - place).T).max() < 6e-3  # a pixel is 10 mm
        with h5py.File(recording_path) as recorded:
            np.testing.assert_array_equal(file["t"][:], recorded["t0"][:])
    expected = np.where(count == 0, Flag.NO_CONTACT, 0)
    expected[50] |= Flag.GAP
    expected[200] |= Flag.SATURATED
    np.testing.assert_array_equal(flags, expected)


@pytest.mark.long
def test_a_row_per_slot(recording_path, tmp_path):
    settings = tx.results.Settings(rate="slot", images=False, grid=16)
    with h5py.File(run(recording_path, tmp_path / "o.h5", settings)) as file:
        assert "image" not in file and len(file["t"]) == 600
        np.testing.assert_allclose(np.diff(file["t"][:]), 1e-4, rtol=1e-6)
        np.testing.assert_array_equal(file["contact_count"][:], np.repeat([0, 1, 0], 200))
        assert np.flatnonzero(file["flags"][:] & Flag.GAP.value).tolist() == [100]


def test_chunks_do_not_show(recording_path, whole, tmp_path):
    """Nothing but the size of compiled calls changes with the chunk."""
    other = run(
        recording_path,
        tmp_path / "o.h5",
        tx.results.Settings(method="source", chunk=300, grid=16),
    )
    with h5py.File(whole) as a, h5py.File(other) as b:
        for name in a:
            np.testing.assert_allclose(a[name], b[name], rtol=1e-4, atol=1e-6)
        np.testing.assert_array_equal(a["flags"], b["flags"])


def test_interrupted_and_resumed(recording_path, whole, tmp_path):
    """By Ctrl-C between any two chunks: the same bytes."""
    out = tmp_path / "o.h5"

    def stop(done: int, total: int) -> None:
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(recording_path, out, progress=stop)
    assert partial_path(out).exists() and not out.exists()
    with pytest.raises(ValueError, match="work begun there, expected --resume"):
        run(recording_path, out)
    with pytest.raises(ValueError, match="grid: begun with 16, now 24"):
        run(
            recording_path,
            out,
            tx.results.Settings(method="source", chunk=25, grid=24),
            resume=True,
        )
    seen = []
    run(recording_path, out, resume=True, progress=lambda done, total: seen.append(done))
    assert seen[0] in (4, 5) and seen[-1] == 12
    assert out.read_bytes() == whole.read_bytes()
    assert sorted(tmp_path.iterdir()) == [out]
    assert run(recording_path, out, resume=True) == out  # nothing to do
    with pytest.raises(ValueError, match="a file, expected a new name, or --overwrite"):
        run(recording_path, out)


def command(path, out, *more):
    line = "import sys; from tomojax.cli import main; sys.argv[0] = 'tomojax'; main()"
    arguments = ["reconstruct", path, "-o", out, "--method", "source"]
    arguments += ["--chunk", "25", "--grid", "16", *more]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [sys.executable, "-c", line, *map(str, arguments)],
        env=environment,
        cwd=out.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def python(script: str, folder: Path, **environment: str):
    return subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        cwd=folder,
        capture_output=True,
        text=True,
    )


def finish(process) -> None:
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors


def wait_for(condition, process, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition() and process.poll() is None and time.monotonic() < end:
        time.sleep(0.005)


@pytest.fixture(scope="module")
def long_path(tmp_path_factory):
    """Enough chunks to be killed among them."""
    codes, _ = recordings.touched(scans=6000)
    return recordings.write(tmp_path_factory.mktemp("long") / "rec.h5", codes)


@pytest.fixture(scope="module")
def uninterrupted(long_path):
    out = long_path.with_name("whole.h5")
    finish(command(long_path, out))
    return out


@pytest.mark.long
def test_killed_and_resumed(long_path, uninterrupted, tmp_path, rng):
    """SIGKILL at random moments; tests/benchmarks/recordings.py does it ten times."""
    out, options = tmp_path / "o.h5", []
    for _ in range(2):
        process = command(long_path, out, *options)
        wait_for(lambda: partial_path(out).exists(), process)
        time.sleep(rng.uniform(0.2, 3.0))
        process.kill()
        process.communicate()
        options = ["--resume"]
    finish(command(long_path, out, "--resume"))
    assert out.read_bytes() == uninterrupted.read_bytes()


def test_ctrl_c_ends_with_a_line_and_130(long_path, tmp_path):
    out = tmp_path / "o.h5"
    process = command(long_path, out)
    wait_for(lambda: partial_path(out).exists(), process)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130 and "--resume goes on" in errors
    assert partial_path(out).exists() and not out.exists()


@pytest.mark.long
def test_two_devices_give_what_one_gives(tmp_path):
    """`jax.sharding` along the scan axis, on two devices that the CPU pretends to be."""
    script = """
import numpy as np, jax, tomojax as tx
assert jax.local_device_count() == 2
method = tx.method(tx.Sensor.grid(), "source", 16)
rng = np.random.default_rng(0)
v = rng.uniform(1, 2, (300, 1, 64)).astype(np.float32)
g = np.zeros((300, 1), int)
batch = tx.Batch(method, 1e8)
assert len(batch._shared(jax.numpy.zeros((32, 1, 64))).sharding.device_set) == 2
both = batch(v, g)
one = tx.Batch(method, 1e8, devices=jax.devices()[:1])(v, g)
for a, b in zip(both, one):
    if a is None and b is None:
        continue
    np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-9)
print("same")
"""
    flags = "--xla_force_host_platform_device_count=2"
    found = python(script, tmp_path, XLA_FLAGS=flags)
    assert found.stdout.strip() == "same", found.stderr


def test_disk_too_small(recording_path, tmp_path):
    """Known before any row is computed, and nothing is left behind."""
    script = f"""
import resource, tomojax as tx
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, resource.RLIM_INFINITY))
import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
with tx.open_recording({str(recording_path)!r}) as recording:
    try:
        settings = tx.results.Settings(method="source", grid=16)
        tx.reconstruct_recording(recording, "o.h5", settings)
    except ValueError as error:
        print(error)
"""
    found = python(script, tmp_path)
    assert found.stdout.startswith("o.h5: ") and "GB are needed" in found.stdout, found
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (dict(lam=-1.0), "lam: got -1.0"),
        (dict(contacts=0), "contacts: got 0"),
        (dict(chunk=0), "chunk: got 0"),
        (dict(threshold=-1.0), "threshold: got -1.0"),
        (dict(method="magic"), "method: got 'magic'"),
        (dict(grid=2), "grid: got 2"),
    ],
)
def test_bad_settings(recording_path, tmp_path, options, words):
    with pytest.raises(ValueError, match=words):
        run(recording_path, tmp_path / "o.h5", tx.results.Settings(**options))
    assert not list(tmp_path.iterdir())


def test_bad_output(recording_path, tmp_path):
    with pytest.raises(ValueError, match="no such folder"):
        run(recording_path, tmp_path / "absent" / "o.h5")
    with pytest.raises(ValueError, match="a folder"):
        run(recording_path, tmp_path)
