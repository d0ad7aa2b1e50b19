"""Chunks and files as tasks of a Dask cluster, whose workers are killed."""

import os
import signal
import threading
from pathlib import Path

import dask
import h5py
import numpy as np
import pytest
import recordings
from click.testing import CliRunner
from distributed import Client, Future, LocalCluster

import tomojax as tx
from tomojax.cli.app import app

SETTINGS = tx.results.Settings(method="source", lam=1e8, chunk=20, grid=8, images=False)


@pytest.fixture(scope="module")
def rec(tmp_path_factory) -> Path:
    codes, _ = recordings.touched(scans=120)
    return recordings.write(tmp_path_factory.mktemp("rec") / "rec.h5", codes)


@pytest.fixture(scope="module")
def client():
    with (
        # Of the killed workers' tasks: a worker's start takes longer than a task.
        dask.config.set({"distributed.scheduler.allowed-failures": 100}),
        LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


def run(rec, out, settings=SETTINGS, **options) -> bytes:
    with tx.open_recording(rec) as recording:
        tx.reconstruct_recording(recording, out, settings, **options)
    return out.read_bytes()


def kill(client) -> None:
    """Kills a worker that is at work: its nanny gives up one that dies as it starts."""
    there = client.nthreads()
    for nanny in client.cluster.workers.values():
        if len(there) > 1 and nanny.worker_address in there:
            os.kill(nanny.pid, signal.SIGKILL)
            return


@pytest.mark.long
def test_a_worker_is_killed_and_a_run_is_stopped(client, rec, tmp_path) -> None:
    """The bytes are those of one process."""
    out = tmp_path / "o.h5"

    def stop(done: int, total: int) -> None:
        if done == 1:
            kill(client)
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(rec, out, client=client, progress=stop)
    there = run(rec, out, client=client, resume=True)
    assert there == run(rec, tmp_path / "here.h5")
    assert len(list(tmp_path.iterdir())) == 2
    # A worker's own words reach the user.
    with tx.open_recording(rec) as recording:
        recording.opener = lambda: tx.open_recording("/no/such/file.h5")
        with pytest.raises(ValueError, match="^/no/such/file.h5: no such file"):
            tx.reconstruct_recording(recording, tmp_path / "n.h5", SETTINGS, client=client)


def test_the_given_client_waits(client, rec, tmp_path, monkeypatch) -> None:
    """Beside another client: a result that is lost is waited for again, by one loop."""
    loops, whole = [], Future.result

    def result(future: Future, *args, **options):
        event = future._state._get_event()
        loops.append(getattr(event, "_loop", None))
        return whole(future, *args, **options)

    with Client(client.scheduler.address, set_as_default=False) as other:
        own = other.loop.asyncio_loop
        with client.as_current():
            monkeypatch.setattr(Future, "result", result)
            run(rec, tmp_path / "o.h5", client=other)
    assert own in loops and set(loops) <= {own, None}


@pytest.mark.long
@pytest.mark.parametrize("method, adapt", [("points", True), ("follow", False)])
def test_chunks_in_order(client, rec, tmp_path, method, adapt) -> None:
    settings = tx.results.Settings(
        method=method, adapt=adapt, chunk=40, contacts=1, lam=None, images=False
    )

    def once(done: int, total: int) -> None:
        if done == 1:
            kill(client)

    there = run(rec, tmp_path / "a.h5", settings, client=client, progress=once)
    run(rec, tmp_path / "b.h5", settings)
    with h5py.File(tmp_path / "a.h5") as a, h5py.File(tmp_path / "b.h5") as b:
        for name in a:
            np.testing.assert_array_equal(a[name], b[name])
    assert there == (tmp_path / "b.h5").read_bytes()


@pytest.mark.long
def test_a_folder_by_the_command(client, rec, tmp_path) -> None:
    """A worker is killed every five seconds; one file is none."""
    folder, tables = tmp_path / "recs", []
    folder.mkdir()
    for k in range(8):
        codes, _ = recordings.touched(scans=60, seed=k)
        recordings.write(folder / f"r{k}.h5", codes)
    (folder / "bad.h5").write_bytes(rec.read_bytes()[:999])
    words = ["reconstruct", str(folder), "--method", "source", "--grid", "16"]
    words += ["--chunk", "10", "--lam", "1e8"]
    ended = threading.Event()

    def torture() -> None:
        while not ended.wait(5.0):
            kill(client)

    torturer = threading.Thread(target=torture)
    torturer.start()
    try:
        for there in (["--cluster", client.scheduler.address], []):
            out = tmp_path / f"out{len(there)}"
            done = CliRunner().invoke(app, [*words, "-o", str(out), *there])
            assert "8 of 9 done" in done.output, done.output
            tables.append({p.name: p.read_bytes() for p in out.glob("*.h5")})
            ended.set()
    finally:
        ended.set()
        torturer.join()
    assert tables[0] == tables[1] and len(tables[0]) == 8


def test_no_scheduler_is_a_line(rec, tmp_path) -> None:
    with dask.config.set({"distributed.comm.timeouts.connect": "0.2s"}):
        words = ["reconstruct", str(rec), "-o", str(tmp_path / "o.h5")]
        done = CliRunner().invoke(app, [*words, "--cluster", "tcp://127.0.0.1:9"])
    assert isinstance(done.exception, OSError) and "127.0.0.1:9" in str(done.exception)
