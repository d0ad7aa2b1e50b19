"""Runs the live loop for minutes: a virtual rig at 10 000 slots/s.

    python tests/benchmarks/live.py [--seconds 600] [--rate 10000] [--out FOLDER]

The rig is at a pseudo-terminal, then for as long at a UDP port.

The loop is closed; recorder and terminal view are on. Counts what was lost, and where.
Measures memory, and the latency from the last byte of a slot to the command with the next
ground. In the scene, a contact moves over a rig of another model (tests/rig.py). Writes
live.json and live.png.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

QUANTILES = {"p50_us": 0.5, "p99_us": 0.99, "p999_us": 0.999, "p9999_us": 0.9999}


def scene(path: Path):
    """A contact of 6 mm that draws an eight in two seconds; its places."""
    import numpy as np
    from rig import Rig

    from tomojax.hardware.sources.virtual_rig import write_scene

    rig = Rig(np.random.default_rng(8))
    t = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    places = 0.08 + np.stack([0.05 * np.sin(t), 0.035 * np.sin(2 * t)], 1)
    volts = [rig.scene((rig.disc(place, 0.006), 1e-4))[0] for place in places]
    write_scene(path, np.stack(volts), 0.02)
    return places


def memory() -> float:
    """Of this process, MB."""
    words = Path("/proc/self/statm").read_text().split()
    return int(words[1]) * resource.getpagesize() / 1e6


def measured(seconds: float, rate: float, link: str, folder: Path) -> dict:
    import numpy as np

    import tomojax as tx
    from tomojax.hardware import open_source, real_time, run, SlotRing
    from tomojax.hardware.loop.recorder import Recorder
    from tomojax.hardware.sources.virtual_rig import VirtualRig
    from tomojax.recordings import attributes

    with real_time() as settings:
        places = scene(folder / "scene.npz")
        sensor = tx.Sensor.grid(dtype=np.float32, divisions=(32, 32))
        step = tx.make_step(sensor, "follow", "around_contacts")
        ring = SlotRing.create(64)
        kept = []
        with (
            VirtualRig(folder / "scene.npz", rate=rate, link=link) as rig,
            open_source(rig.where) as source,
        ):
            told = attributes(
                tx.recordings.Rig.of(sensor, rate), source.scale, source.offset
            )
            recorder = Recorder(ring, folder / "live.h5", told)
            words = [sys.executable, "-m", "tomojax.hardware.loop.view", str(ring.path)]
            view = subprocess.Popen(words, stdout=subprocess.DEVNULL)
            begin = time.perf_counter()
            until = lambda: time.perf_counter() - begin > seconds  # noqa: E731

            def meanwhile() -> None:
                recorder.look()
                kept.append((time.perf_counter() - begin, memory()))

            run(source, step, ring, until=until, meanwhile=meanwhile)
        ring.head["done"][...] = 1
        recorder.close()
        view.wait()
        rows, _, _ = ring.since(int(ring.head["rows"]) - 60_000, 60_000)
        counted, dropped = ring.counted(), int(ring.head["dropped"])
        found = dict(zip(QUANTILES, (1e6 * q for q in ring.latency(*QUANTILES.values()))))
        histogram = ring.head["latency"].tolist()
        ring.remove()
    with tx.open_recording(folder / "live.h5") as recording:
        recorded, gaps = recording.scans, int(recording.gaps[:, 1].sum())
    done = rows[np.isfinite(rows["latency"])]
    # The rig's time is not the scene's: the nearest of its places.
    off = np.linalg.norm(done["xy"][:, 0, None] - places, axis=-1).min(1)
    late, size = (np.array(a) for a in zip(*kept))
    return {
        "settings": settings,
        "link": link,
        "seconds": seconds,
        "rate": rate,
        **counted,
        "dropped_by_recorder": dropped,
        "recorded": recorded,
        "recorded_gaps": gaps,
        "unaccounted": counted["slots"] + counted["lost"] - recorded - gaps,
        "answered": 1 - counted["skipped"] / counted["slots"],
        **found,
        "memory_MB": [float(size[late > 30][0]) if seconds > 60 else None, float(size[-1])],
        "place_median_mm": 1e3 * float(np.nanmedian(off)),
        "traces": step.traces,
        "histogram_us": histogram[:1000],
        "memory": [
            [round(a, 1), round(b, 1)] for a, b in kept[:: max(1, len(kept) // 200)]
        ],
    }


def draw(row: dict, path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import BLUE, style

    figure = Figure(figsize=(12, 4.6), layout="constrained")
    figure.suptitle(f"The live loop at {row['rate']:,.0f} slots a second")
    left, right = figure.subplots(1, 2)
    left.semilogy(row["histogram_us"], drawstyle="steps-mid", lw=1, color=BLUE)
    for k, (name, part) in enumerate(QUANTILES.items(), 1):
        label = f"{100 * part:g} %: {row[name]:.0f} µs"
        look = {"color": style(k)["color"], "ls": style(k)["linestyle"]}
        left.axvline(row[name], lw=1.5, label=label, **look)
    left.legend(fontsize=9, loc="upper left", bbox_to_anchor=(0.47, 1))
    left.set(xlabel="last byte of a slot to ground command, µs", ylabel="slots in a bin")
    left.set(xlim=(0, max(300, 1.2 * row["p9999_us"])), title="Latency, in bins of 1 µs")
    right.plot(*zip(*row["memory"]), color=BLUE)
    right.set(xlabel="time, s", ylabel="memory, MB", title="Memory of the loop")
    right.set(ylim=(0, 1.3 * max(size for _, size in row["memory"])))
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--rate", type=float, default=10e3)
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    options = parser.parse_args()
    rows = []
    for link in ("pty", "udp"):
        with tempfile.TemporaryDirectory() as folder:
            rows.append(measured(options.seconds, options.rate, link, Path(folder)))
        shown = {k: v for k, v in rows[-1].items() if k not in ("histogram_us", "memory")}
        print(json.dumps(shown, indent=1), flush=True)
    from benchmarks.physics import environment

    path = options.out / "live.json"
    content = {"environment": environment(), "rows": rows}
    path.write_text(json.dumps(content) + "\n")
    draw(rows[0], path.with_suffix(".png"))


if __name__ == "__main__":
    main()
