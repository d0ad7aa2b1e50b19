"""Measures seconds to a first answer, and programs compiled for it, beside an older commit.

    git worktree add /tmp/older COMMIT
    python tests/benchmarks/start.py --beside /tmp/older [--seed 7] [--only points auto]
    python tests/benchmarks/start.py --twelve [points] [--beside /tmp/older]

Each row is a new process with JAX's cache in a folder of its own. The cache is empty at
first, and then as the first run left it. A resistor network makes the recordings
(tests/rig.py). One has 16 scans of 64 slots with a bar in each. The other has 2 s of ten
slots a scan with a contact. Writes start.json and start.png; parts that --only leaves out
stay in them. Takes half an hour.

`--twelve` prints seconds of `tomojax reconstruct` on twelve scans of two slots, and of
`import jax` beside: with an empty cache, and the median of five runs after it.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
METHODS = ("source", "points", "auto", "shape")
JOBS = (*METHODS, "auto, ten slots", "make_step")
TEN = tuple(range(0, 64, 7))

# Each process runs this code, which also counts what JAX compiles.
CHILD = """
import json, sys, time
start = time.perf_counter()
from tomojax.cli.compiled import keep_compiled
keep_compiled()  # before JAX is imported, as the command does
import jax
spent = {"lower_s": 0.0, "compile_s": 0.0, "programs": 0, "kept": 0}
def listen(event, seconds, **about):
    name = event.rsplit("/", 1)[-1]
    if name == "backend_compile_duration":
        spent["compile_s"] += seconds
        spent["programs"] += 1
    elif name == "jaxpr_to_mlir_module_duration":
        spent["lower_s"] += seconds
    elif name == "cache_retrieval_time_sec":
        spent["kept"] += 1
jax.monitoring.register_event_duration_secs_listener(listen)
job, path, out = sys.argv[1:]
if job == "make_step":
    import tomojax as tx
    tx.make_step(tx.Sensor.grid(dtype="float32"), "follow")
else:
    from tomojax.cli import main
    sys.argv = ["tomojax", "reconstruct", path, "-o", out, "--overwrite", "--method", job]
    try:
        main()
    except SystemExit as stop:
        assert not stop.code, stop.code
print(json.dumps({"seconds": time.perf_counter() - start, **spent}))
"""


def recordings(seed: int, folder: Path) -> None:
    """bars.h5 and ten.h5."""
    sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
    from recordings import write
    from rig import Rig

    rng = np.random.default_rng(seed)
    volts = []
    for _ in range(16):
        rig = Rig(rng)
        sides = rng.uniform(0.065, 0.085), rng.uniform(0.008, 0.012)
        place, angle = rng.uniform(0.055, 0.105, 2), rng.uniform(0, np.pi)
        exact, _ = rig.scene((rig.bar(place, *sides, angle), 10 ** rng.uniform(-2, 1)))
        volts.append(rig.measure(exact))
    codes = np.clip(np.round(np.array(volts) * 32768 / 5), -32768, 32767).astype(np.int16)
    write(folder / "bars.h5", codes, np.arange(64))
    # 2 s, of which the contact is there for 0.3 s; its 300 scans are 30, ten times.
    rig, still = Rig(rng), np.zeros((2000, 10, 64))
    for k in range(30):
        place = np.array([0.05, 0.07]) + 1e-3 * k
        exact, _ = rig.scene((rig.disc(place, 0.006), 1e-4))
        still[600 + 10 * k : 610 + 10 * k] = rig.measure(exact)[list(TEN)]
    noisy = still + rng.normal(0, 3e-4, still.shape)
    codes = np.clip(np.round(noisy * 32768 / 5), -32768, 32767).astype(np.int16)
    write(folder / "ten.h5", codes, np.array(TEN))


def measured(job: str, root: Path, folder: Path) -> list[dict]:
    """The rows of one job at one commit: with an empty cache, and again."""
    method, *ten = job.split(", ")
    path = folder / ("ten.h5" if ten else "bars.h5")
    rows = []
    with tempfile.TemporaryDirectory() as cache:
        set_ = {"PYTHONPATH": str(root), "XDG_CACHE_HOME": cache}
        set_ |= {"OPENBLAS_NUM_THREADS": "1"}
        kept_out = ("JAX_COMPILATION_CACHE_DIR", "TOMOJAX_NO_CACHE")
        env = {k: v for k, v in os.environ.items() if k not in kept_out} | set_
        for again in (False, True):
            command = [sys.executable, "-P", "-c", CHILD, method, str(path)]
            command.append(str(folder / "out.h5"))
            found = subprocess.run(
                command, stdout=subprocess.PIPE, check=True, text=True, env=env
            )
            rows.append({"again": again, **json.loads(found.stdout.splitlines()[-1])})
    return rows


def twelve(method: str, root: Path, folder: Path) -> dict:
    """Seconds of whole processes: `import jax`, the first run and those after it."""
    path, out = folder / "twelve.h5", folder / "out.h5"
    main = "from tomojax.cli import main; main()"
    words = ["reconstruct", str(path), "-o", str(out), "--overwrite", "--method", method]

    def seconds(*command: str) -> float:
        began = time.perf_counter()
        subprocess.run(
            [sys.executable, "-P", "-c", *command],
            env=env,
            check=True,
            capture_output=True,
        )
        return time.perf_counter() - began

    with tempfile.TemporaryDirectory() as cache:
        env = os.environ | {"PYTHONPATH": str(root), "XDG_CACHE_HOME": cache}
        env.pop("JAX_COMPILATION_CACHE_DIR", None)
        first = seconds(main, *words)
        both = [(seconds("import jax"), seconds(main, *words)) for _ in range(6)][1:]
    unit, again = np.median(both, 0)
    told = {"import_jax_s": unit, "first_s": first, "again_s": again}
    return told | {"first": first / unit, "again": again / unit}


# How the bars of both commits are drawn; the blue is `tomojax._pictures.BLUE`.
COMMITS = {
    "older": {"color": "0.75", "hatch": "//", "edgecolor": "w", "label": "older commit"},
    "now": {"color": "#0072B2", "edgecolor": "w", "label": "now"},
}


def draw(rows: list[dict], path: Path) -> None:
    """Seconds of each job: older and now, at first and again."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    names = list(dict.fromkeys(r["job"] for r in rows))
    figure, both = plt.subplots(1, 2, figsize=(9, 3.8), sharey=True, layout="constrained")
    for axes, again in zip(both, (False, True)):
        for k, (commit, look) in enumerate(COMMITS.items()):
            mine = {
                r["job"]: r for r in rows if (r["commit"], r["again"]) == (commit, again)
            }
            at = [i + 0.4 * k for i, name in enumerate(names) if name in mine]
            seconds = [mine[name]["seconds"] for name in names if name in mine]
            bars = axes.barh(at, seconds, 0.38, **look)
            axes.bar_label(bars, fmt="%.1f", padding=2, fontsize=8)
        axes.set_yticks([i + 0.2 for i in range(len(names))], names)
        axes.set(title="Again" if again else "First run", xlabel="time to the end, s")
        axes.margins(x=0.15)
    both[0].invert_yaxis()
    both[0].legend(loc="lower right")
    figure.suptitle("A command on a short recording, start and compiling included")
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--beside", type=Path, help="Checkout of an older commit.")
    parser.add_argument("--only", nargs="*", choices=JOBS, default=list(JOBS))
    parser.add_argument("--twelve", nargs="*", metavar="METHOD")
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    options = parser.parse_args()
    commits = {"now": HERE.parents[1]}
    sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
    if options.beside:
        commits = {"older": options.beside.resolve()} | commits
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        if options.twelve is not None:
            from recordings import touched, write

            write(Path(folder) / "twelve.h5", touched(scans=12)[0], [0, 63])
            for method in options.twelve or ("source", "points", "auto", "follow"):
                for commit, root in commits.items():
                    told = {"method": method, "commit": commit}
                    told |= twelve(method, root, Path(folder))
                    print(json.dumps(told), flush=True)
            return
        recordings(options.seed, Path(folder))
        for job in options.only:
            for commit, root in commits.items():
                for row in measured(job, root, Path(folder)):
                    named = {"job": job, "commit": commit, "seed": options.seed}
                    rows.append(named | row)
                    print(json.dumps(rows[-1]), flush=True)
    from benchmarks.physics import environment

    path = options.out / "start.json"
    before = json.loads(path.read_text())["rows"] if path.exists() else []
    kept = [r for r in before if r["job"] not in options.only]
    rows = sorted(kept + rows, key=lambda r: JOBS.index(r["job"]))
    report = {"environment": environment(), "rows": rows}
    path.write_text(json.dumps(report, indent=1) + "\n")
    draw(rows, options.out / "start.png")


if __name__ == "__main__":
    main()
