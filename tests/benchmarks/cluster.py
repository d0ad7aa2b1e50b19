"""Measures frames a second by one process and by a Dask cluster's workers; kills workers.

    python tests/benchmarks/cluster.py [--scans 20000] [--workers 1 2] [--method source]

Writes a recording of two slots a scan, touched half of the time. Each line says how many
frames a second came, and whether the file has the bytes of one process. In the last line a
worker is killed every five seconds. The programs are compiled before, on each worker. The
last words say what 20 nodes would do: their rate until the writer is busy all the time.
"""

import argparse
import json
import os
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}  # as the command does

import dask
from distributed import Client, LocalCluster

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

import recordings  # noqa: E402

from tomojax.cli.compiled import keep_compiled  # noqa: E402

NODES = 20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scans", type=int, default=20_000)
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--method", default="source")
    given = parser.parse_args()
    keep_compiled()
    dask.config.set({"distributed.scheduler.allowed-failures": 100})
    import tomojax as tx

    settings = tx.results.Settings(method=given.method, chunk=500)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = recordings.write(
            folder / "rec.h5", recordings.touched(scans=given.scans)[0], [0, 63]
        )
        short = recordings.write(
            folder / "short.h5", recordings.touched(scans=1000)[0], [0, 63]
        )

        def run(name: str, **more) -> bytes:
            for rec, out in ((short, "warm.h5"), (path, "out.h5")):
                began = time.perf_counter()
                with tx.open_recording(rec) as recording:
                    tx.reconstruct_recording(
                        recording, folder / out, settings, overwrite=True, **more
                    )
            seconds = time.perf_counter() - began
            made = (folder / "out.h5").read_bytes()
            rows.append({"by": name, "frames_per_s": given.scans / seconds})
            rows[-1] |= {"same_bytes": made == (alone or made)}
            print(json.dumps(rows[-1]), flush=True)
            return made

        rows: list[dict] = []
        alone = b""
        alone = run("one process")
        for count in given.workers:
            with (
                LocalCluster(count, threads_per_worker=1, silence_logs=50) as cluster,
                Client(cluster) as client,
            ):
                run(f"{count} workers", client=client)
                if count != given.workers[-1]:
                    continue
                ended = threading.Event()

                def torture(cluster=cluster, client=client, ended=ended) -> None:
                    while not ended.wait(5.0):
                        there = client.nthreads()  # one that starts is left alone
                        every = cluster.workers.values()
                        some = [one for one in every if one.worker_address in there]
                        if len(some) > 1:
                            os.kill(some[0].pid, signal.SIGKILL)

                torturer = threading.Thread(target=torture)
                torturer.start()
                run(f"{count} workers, one killed every 5 s", client=client)
                ended.set()
                torturer.join()
        began = time.perf_counter()
        with (folder / "copy.h5").open("wb", buffering=0) as file:
            file.write(alone)
            os.fsync(file.fileno())
        writes = given.scans / (time.perf_counter() - began)
        each = rows[0]["frames_per_s"]
        told = {"frames_per_s": min(NODES * each, writes), "writer_s": writes}
        print(json.dumps({"by": f"{NODES} nodes, on paper", **told}))


if __name__ == "__main__":
    main()
