"""Runs one job of `tomojax frontier` in its own process: a method on one mesh and dtype.

    python -m bench.frontier._job SCENES.npz JOB

Prints a JSON row for each pattern, kind of scene, batch size and output. The
process's memory is the job's own. A crash loses only this job.
"""

import json
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np

from bench.frontier._measure import Job, kinds_of
from bench.frontier._peers import peer_rows
from bench.frontier._rows import follow_rows, method_rows
from bench.frontier._scenes import load_trials
from bench.memory import peak_mb


def main() -> None:
    path = Path(sys.argv[1])
    words: dict[str, Any] = json.loads(sys.argv[2])
    told: dict[str, Any] = {
        k: tuple(v) if isinstance(v, list) else v for k, v in words.items()
    }
    job = Job(**told)
    sensor, trials = load_trials(path, job.dtype)
    if job.most:
        trials = trials.of(np.concatenate([at[: job.most] for _, at in kinds_of(trials)]))
    if job.method == "follow":
        rows = follow_rows(job, sensor, trials)
    elif job.method == "peers":
        rows = peer_rows(job, sensor, trials)
    else:
        rows = method_rows(job, sensor, trials)
    made = list(rows)
    common = {"dtype": job.dtype, "device": str(jax.devices()[0].device_kind)}
    for row in made:
        print(json.dumps({**common, "peer": False, **row, "memory_mb": peak_mb()}))


if __name__ == "__main__":
    main()
