"""`tomojax frontier`: compares speed and accuracy of every method, on this machine.

A resistor network makes a scene's voltages, with the errors of a rig. A reconstruction is
told nominal values. Each method, mesh and dtype is a job in a process of its own. Rows are
kept as they come. A run that was cut off therefore goes on where it stopped.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.frontier._measure import Job
from bench.frontier._scenes import (
    identity,
    make_trials,
    save_trials,
)
from tomojax.sensor import Sensor

_HERE = Path(__file__).parents[2]  # the folder of `bench`, for processes of jobs
# Scenes of each kind.
SCENES, QUICK_SCENES = 20, 6

# What each method is measured on: settings that somebody would choose.
_EVERY = ("corner", "corners", "around", "boundary", "all")


def jobs(quick: bool) -> list[Job]:
    """Lists the jobs: a process for each method."""
    if quick:
        return [
            Job("linear", ("around",), (256,)),
            Job("source", ("corner",), (256,)),
            Job("follow", ("around_contacts",)),
            Job("peers", ("corner",), (256,)),
        ]
    return [
        Job("linear", _EVERY),
        Job("source", _EVERY),
        # Slow ones, on some of the scenes.
        Job("points", ("corners", "all"), (64,)),
        Job("shape", ("corners",), (2,), most=6),
        Job("auto", ("corners", "all"), (32,), most=10),
        Job("follow", ("around_contacts",)),
        Job("peers", _EVERY),
    ]


def run(
    sensor: Sensor,
    folder: Path,
    quick: bool = False,
    scenes: int | None = None,
    seed: int = 0,
    progress: Callable[[str], Any] = lambda done: None,
    only: tuple[str, ...] = (),
) -> list[dict[str, Any]]:
    """Returns rows of all jobs; jobs that `folder` has of the same run are not done again.

    If `only` is given, only jobs of these methods are done now. Other methods keep the rows
    that `folder` has.

    **Raises:** `ValueError` where `folder` holds a run with other scenes or of another
    sensor.
    """
    count = scenes or (QUICK_SCENES if quick else SCENES)
    folder.mkdir(parents=True, exist_ok=True)
    told = {"scenes": count, "seed": seed, "quick": quick, "sensor": identity(sensor)}
    same_run(folder / "frontier-run.json", told)
    path = folder / "frontier-scenes.npz"
    if not path.exists():
        new = path.with_name("new-scenes.npz")
        save_trials(new, sensor, make_trials(sensor, count, seed))
        new.rename(path)
    progress("scenes")
    done, rows = _kept(folder / "frontier-rows.jsonl")
    for job in jobs(quick):
        if only and job.method not in only:
            continue
        key = json.dumps(job._asdict())
        if key not in done:
            begin = time.perf_counter()
            made = measured(path, job)
            rows += made
            if not made[0].get("failed"):  # what failed is tried again the next time
                with (folder / "frontier-rows.jsonl").open("a") as file:
                    spent = time.perf_counter() - begin
                    kept = {"job": key, "seconds": spent, "rows": made}
                    file.write(json.dumps(kept) + "\n")
        progress(job.method)
    return rows


def same_run(path: Path, told: dict[str, Any]) -> None:
    """Checks a run against the one that its folder was begun with, which `path` keeps.

    **Raises:** `ValueError` where the two differ.
    """
    if not path.exists():
        new = path.with_suffix(".new")
        new.write_text(json.dumps(told) + "\n")
        new.rename(path)
        return
    was = json.loads(path.read_text())
    other = ", ".join(name for name in told if told[name] != was.get(name))
    if other:
        raise ValueError(
            f"{path.parent}: got a run with another {other}, expected the one that was "
            "begun there, or another folder"
        )


def _kept(path: Path) -> tuple[set[str], list[dict[str, Any]]]:
    """Reads the jobs that are done, and their rows; a cut-off line does not count."""
    done, rows = set(), []
    text = path.read_text() if path.exists() else ""
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole)
    for line in whole.splitlines():
        kept = json.loads(line)
        done.add(kept["job"])
        rows += kept["rows"]
    return done, rows


def measured(path: Path, job: Job) -> list[dict[str, Any]]:
    """Returns a job's rows; a job that fails gives one row that says so."""
    words = [sys.executable, "-m", "bench.frontier._job", str(path)]
    command = [*words, json.dumps(job._asdict())]
    wide = "1" if job.dtype == "float64" else "0"
    paths = [os.environ.get("PYTHONPATH"), str(_HERE)]
    settings = {
        **os.environ,
        "JAX_ENABLE_X64": wide,
        "PYTHONPATH": os.pathsep.join(path for path in paths if path),
    }
    out = subprocess.run(command, capture_output=True, text=True, env=settings)
    if out.returncode:
        why = (out.stderr.strip().splitlines() or ["killed"])[-1]
        return [{**job._asdict(), "scene": None, "failed": why}]
    return [json.loads(line) for line in out.stdout.splitlines() if line.startswith("{")]
