"""Compares the live loop alone with the loop beside each sink and beside the page.

    python tests/benchmarks/beside.py [--seconds 20] [--rounds 3] [--rate 10000]

A virtual rig sends 10 000 slots a second; the loop is closed and a recorder is on. Each
round runs the loop alone, and then with each companion, one after another. Counts the slots
that were lost or skipped. Measures the latency from the last byte of a slot to the next
ground. Writes beside.json and beside.png.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

COMPANIONS = {
    "alone": [],
    "terminal": ["loop.view"],
    "udp": ["sinks.run", "udp://127.0.0.1:45454"],
    "jsonl": ["sinks.run", "jsonl:FOLDER/rows.jsonl"],
    "osc": ["sinks.run", "osc://127.0.0.1:45455"],
    "lsl": ["sinks.run", "lsl:tomojax-beside"],
    "foxglove": ["sinks.run", "foxglove:45456"],
    "page": ["web.live"],
}


def one(step, sensor, name: str, seconds: float, rate: float, folder: Path) -> dict:
    """The loop for some seconds beside one companion."""
    import tomojax as tx
    from tomojax.hardware import open_source, run, SlotRing
    from tomojax.hardware.loop.recorder import Recorder
    from tomojax.hardware.sources.virtual_rig import VirtualRig
    from tomojax.recordings import attributes

    ring = SlotRing.create(64)
    with (
        VirtualRig(folder / "scene.npz", rate=rate, link="udp") as rig,
        open_source(rig.where) as source,
    ):
        told = attributes(tx.recordings.Rig.of(sensor, rate), source.scale, source.offset)
        place = folder / f"{name}-{time.monotonic_ns()}.h5"
        recorder = Recorder(ring, place, told)
        beside = None
        if COMPANIONS[name]:
            module, *words = COMPANIONS[name]
            words = [w.replace("FOLDER", str(folder)) for w in words]
            (folder / "rows.jsonl").unlink(missing_ok=True)
            whole = [sys.executable, "-m", f"tomojax.hardware.{module}", str(ring.path)]
            told_it = [] if module == "loop.view" else [json.dumps(told)]
            quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
            beside = subprocess.Popen([*whole, *told_it, *words], text=True, **quiet)
        # Starting takes a core for some seconds, in which nothing is counted.
        begin = time.perf_counter()
        warm, counted_from = 5.0, {}

        def look() -> None:
            recorder.look()
            if not counted_from and time.perf_counter() - begin > warm:
                counted_from.update(ring.counted())
                ring.head["latency"][...] = 0

        until = lambda: time.perf_counter() - begin > warm + seconds  # noqa: E731
        run(source, step, ring, until=until, meanwhile=look)
    ring.head["done"][...] = 1
    said = beside.communicate(timeout=60)[1] if beside else ""
    recorder.close()
    counted = {n: k - counted_from.get(n, 0) for n, k in ring.counted().items()}
    p50, p99, p999 = (1e6 * q for q in ring.latency(0.5, 0.99, 0.999))
    dropped = int(ring.head["dropped"])
    ring.remove()
    return {
        "beside": name,
        **{n: k for n, k in counted.items() if k or n in ("lost", "skipped")},
        "dropped_by_recorder": dropped,
        "p50_us": p50,
        "p99_us": p99,
        "p999_us": p999,
        "said": " ".join(said.split())[-200:],
    }


def draw(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import style

    figure = Figure(figsize=(11, 4.6), layout="constrained")
    figure.suptitle("The loop alone, and with a sink beside it; a mark for each run")
    left, right = figure.subplots(1, 2)
    names = list(COMPANIONS)
    at = [names.index(row["beside"]) for row in rows]
    lost = {"lost": "lost", "skipped": "skipped: a later one was there"}
    late = {"p50_us": "median", "p99_us": "99 %"}
    for axes, fields in ((left, lost), (right, late)):
        for k, (field, label) in enumerate(fields.items()):
            look = style(k, linestyle="none", markersize=6, markerfacecolor="none")
            axes.plot(at, [row[field] for row in rows], **look, label=label)
        axes.set_xticks(range(len(names)), names, rotation=45)
        axes.set(ylim=(-0.02 * max(axes.get_ylim()), 1.25 * max(axes.get_ylim())))
        axes.grid(alpha=0.3)
        axes.legend(fontsize=9, loc="upper right", ncols=2)
    left.set(ylabel="slots", title="Slots without an answer")
    left.yaxis.set_major_formatter("{x:,.0f}")
    right.set(ylabel="last byte of a slot to ground command, µs", title="Latency")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--rate", type=float, default=10e3)
    parser.add_argument("--only", nargs="*", default=list(COMPANIONS))
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    options = parser.parse_args()
    import numpy as np
    from benchmarks.live import scene
    from benchmarks.physics import environment

    import tomojax as tx

    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene(folder / "scene.npz")
        sensor = tx.Sensor.grid(dtype=np.float32, divisions=(32, 32))
        step = tx.make_step(sensor, "follow", "around_contacts")
        for number in range(options.rounds):
            for kind in options.only:
                row = one(step, sensor, kind, options.seconds, options.rate, folder)
                rows.append({"round": number, **row})
                print(json.dumps(rows[-1]), flush=True)
    path = options.out / "beside.json"
    content = {"environment": environment(), "rows": rows}
    path.write_text(json.dumps(content, indent=1) + "\n")
    draw(rows, path.with_suffix(".png"))


if __name__ == "__main__":
    main()
