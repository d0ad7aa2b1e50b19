"""Tries every model on recorded scenes with their truth, and shows what `auto` takes.

    python tests/benchmarks/ladder.py FOLDER [--out FOLDER]

FOLDER holds static_all.h5 with truth.json, and bounce_*.h5 with their .truth.npz. These are
recordings of a rig of another model. Writes ladder.json, ladder.png (images of the scenes
by each model) and drops.png (the drops' conductance over time). Takes ten minutes.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import h5py
import jax
import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

from benchmarks.contacts import errors, grounds_of  # noqa: E402
from benchmarks.physics import environment  # noqa: E402

import tomojax as tx  # noqa: E402
from bench.plots import gallery  # noqa: E402
from tomojax._pictures import style  # noqa: E402
from tomojax.results.track_file import track_results  # noqa: E402

MODELS = ("linear", "source", "points", "shape", "auto")
SLOTS = ("corners", "ten", "all")
PATTERNS = {"corners": "two corners", "copline": "CoP line", "all": "every ground"}


def load(folder: Path):
    """Name: volts (64, 64), truth (centre, S) of each contact, of the static scenes."""
    truth = json.loads((folder / "truth.json").read_text())["static_all"]["scenes"]
    with tx.open_recording(folder / "static_all.h5") as recording:
        calibration = tx.calibration.tare(recording)
        chunk = recording.read(0, recording.scans)
        sensor = recording.rig.sensor()
    volts = calibration.voltages(chunk.voltages).astype(np.float32)
    return sensor, {
        s["name"]: (
            volts[s["scans"][0]],
            [(np.array(c["centre"]), c["total_conductance"]) for c in s["contacts"]],
        )
        for s in truth
    }


def static(sensor, scenes: dict) -> tuple[list[dict], dict]:
    """A row for each model, slots and scene; and the images from all slots."""
    table, images = [], {}
    for name in MODELS:
        # A process may not map as much compiled code as all models have.
        jax.clear_caches()
        model = tx.method(sensor, name, 32)
        for slots in SLOTS:
            for scene, (volts, truth) in scenes.items():
                grounds = grounds_of(sensor, slots, volts)
                v, g = volts[grounds][None], grounds[None]
                lam = model.choose_lambda([tx.methods.Frame(v[0], g[0], np.isfinite(v[0]))])
                batch = tx.Batch(model, lam)
                batch(v, g)  # compiles
                spent = []
                for _ in range(3):
                    start = time.perf_counter()
                    rows = batch(v, g)
                    spent.append(time.perf_counter() - start)
                right, error = (
                    errors(rows, 0, truth)
                    if truth
                    else (
                        rows.contact_count[0] == 0,
                        np.nan,
                    )
                )
                total, found = sum(g for _, g in truth), rows.contact_conductance[0]
                told = truth and np.isfinite(found).any()
                row = {
                    "scene": scene,
                    "method": name,
                    "slots": len(grounds),
                    "count_right": bool(right),
                    "place_mm": None if np.isnan(error) else float(error),
                    "conductance_ratio": float(np.nansum(found) / total) if told else None,
                    "residual_mV": 1e3 * float(rows.residual[0]),
                    "unexplained": bool(rows.flags[0] & tx.Flag.HIGH_RESIDUAL.value),
                    "rung": tx.methods.Rung(int(rows.rung[0])).name.lower(),
                    "ms": 1e3 * float(np.median(spent)),
                }
                print(json.dumps(row), flush=True)
                table.append(row)
                if slots == "all":
                    images[name, scene] = rows.image[0]
    return table, images


def drops(folder: Path, scratch: str) -> tuple[list[dict], dict]:
    """Conductance over time, slot by slot, beside the paper's *CoP line* at its rate."""
    table, curves = [], {}
    for thing in ("spanner", "orange"):
        for pattern in ("corners", "copline", "all"):
            path = folder / f"bounce_{thing}_{pattern}.h5"
            truth = np.load(path.with_name(path.stem + ".truth.npz"))
            g = truth["total_conductance"].ravel()
            out, tracked = (Path(scratch) / name for name in ("rows.h5", "tracks.h5"))
            with tx.open_recording(path) as recording:
                slots, rig = recording.slots, recording.rig
                settings = tx.results.Settings(
                    "points", rate="slot", images=False, contacts=2
                )
                tx.reconstruct_recording(recording, out, settings, overwrite=True)
                with h5py.File(out) as file:
                    mine = np.nan_to_num(file["contact_conductance"][:, 0])
                _, touches = track_results(out, tracked, overwrite=True)
                followed = follow(recording)
                settings = tx.results.Settings("linear", images=False, contacts=1)
                tx.reconstruct_recording(recording, out, settings, overwrite=True)
                with h5py.File(out) as file:
                    theirs = np.nan_to_num(file["contact_current"][:, 0]).repeat(slots)
            g = g[: len(mine)]
            on = g > 0
            # Eq. 3 tells no conductance: its sum of φ by whatever factor suits it best.
            theirs = fitted(theirs, g)
            for name, values in (("points", mine), ("follow", followed)):
                row = {
                    "scene": thing,
                    "method": f"{name} per slot, {pattern}",
                    "slots": slots,
                    "rms_uS": rms(values - g),
                    "rms_fitted_uS": rms(fitted(values, g) - g),
                    "linear_rms_fitted_uS": rms(theirs - g),
                    "contacts": len(touches) if name == "points" else None,
                    "true_contacts": int((np.diff(on.astype(int), prepend=0) == 1).sum()),
                }
                print(json.dumps(row), flush=True)
                table.append(row)
            curves[thing, pattern] = g, mine, followed, theirs, rig.f_switch
    return table, curves


def follow(recording: tx.recordings.Recording) -> np.ndarray:
    """The conductance by `follow`, each slot with what was known before it, S."""
    scans = recording.read(0, recording.scans)
    step = tx.make_step(recording.rig.sensor(), "follow", "all", contacts=1)
    volts, grounds = (a.reshape(-1, *a.shape[2:]) for a in scans[:2])
    _, out = step.replay(step.state, volts, grounds)
    return np.nan_to_num(np.asarray(out.contacts.conductance))[:, 0]


def fitted(values: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """By the factor that suits it best."""
    return values * (values @ truth) / (values @ values)


def rms(values: np.ndarray) -> float:
    return 1e6 * float(np.sqrt(np.mean(values**2)))


def draw(images: dict, path: Path) -> None:
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(scene for _, scene in images))[1:]
    figure = Figure(figsize=(2 * len(scenes), 2.2 * len(MODELS) + 1), layout="constrained")
    figure.suptitle(
        "Images of the recorded scenes by each model, every ground", fontsize=16
    )
    lines = {model: [images[model, scene] for scene in scenes] for model in MODELS}
    gallery(figure, lines, (0.16, 0.16), [scene.replace("_", " ") for scene in scenes])
    figure.savefig(path, dpi=70)


def draw_drops(curves: dict, path: Path) -> None:
    """The first bounces of both things under each pattern."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(16, 9), layout="constrained")
    figure.suptitle("Conductance as a spanner and an orange fall and bounce")
    axes_of = figure.subplots(2, 3, squeeze=False).ravel()
    for axes, ((thing, pattern), told) in zip(axes_of, curves.items()):
        g, mine, followed, theirs, rate = told
        t = np.arange(len(g)) / rate
        lines = {
            "linear": (theirs, "linear, per scan (fitted)"),
            "points": (mine, "points, per slot"),
            "follow": (followed, "follow, per slot"),
        }
        for method, (values, label) in lines.items():
            look = style(method, marker="none", lw=1.2, label=label)
            axes.plot(t, 1e6 * values, **look)
        axes.plot(t, 1e6 * g, "k:", lw=1, label="truth")
        first = np.flatnonzero(g > 0)[0] / rate
        axes.set(xlim=(first - 0.01, first + 0.4), ylabel="conductance, µS")
        axes.set(xlabel="time, s", title=f"{thing.capitalize()}, {PATTERNS[pattern]}")
        axes.grid(alpha=0.3)
    axes_of[0].legend(loc="upper right", fontsize=9)
    figure.savefig(path, dpi=80)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    options = parser.parse_args()
    sensor, scenes = load(options.folder)
    table, images = static(sensor, scenes)
    path = options.out / "ladder.json"
    draw(images, path.with_suffix(".png"))
    with tempfile.TemporaryDirectory() as scratch:
        fallen, curves = drops(options.folder, scratch)
    content = {"environment": environment(), "rows": table + fallen}
    path.write_text(json.dumps(content, indent=1) + "\n")
    draw_drops(curves, options.out / "drops.png")


if __name__ == "__main__":
    main()
