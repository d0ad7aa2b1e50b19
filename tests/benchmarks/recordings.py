"""Measures long recordings: rate, memory, chunk size, kills; images beside pyEIT's.

    python tests/benchmarks/recordings.py [--quick] [--only hour …] [--out FOLDER]

Writes recordings.json and recordings.png. An hour of recording takes 4.6 GB of disk, and
its results 6.5 GB. All lie in a temporary folder (--folder).
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import jax
import jax.numpy as jnp
import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

import recordings  # noqa: E402
from benchmarks.physics import environment, quartiles, seconds  # noqa: E402

import tomojax as tx  # noqa: E402
from bench.frontier import best_lambda, peers_of, read_peak  # noqa: E402
from tomojax.methods import Part  # noqa: E402

SLOT_RATE, BASE = 10e3, 1500  # slots/s; scans that are computed, then repeated
SHARED = HERE.parents[2] / "shared" / "data"


def base_codes() -> np.ndarray:
    """1500 scans of 64 slots: nothing, one and two contacts, exact voltages."""
    sensor = tx.Sensor.grid(divisions=(40, 40))
    solve = jax.jit(lambda g: tx.voltages(sensor, g))
    volts = np.zeros((BASE, 64, 64), np.float32)
    for k in range(BASE):
        turn = 2 * np.pi * k / BASE
        if k % 500 < 100:  # a fifth of the time nothing
            continue
        place = 0.08 + 0.05 * np.array([np.cos(3 * turn), np.sin(5 * turn)])
        conductance = 10 ** (0.5 * np.sin(4 * turn) - 0.3)
        scene = [tx.Disc(place, 0.006 + 0.002 * np.sin(7 * turn), conductance)]
        if k % 500 >= 450:  # a tenth of it two
            scene.append(tx.Disc(0.16 - place, 0.006, 1.0))
        volts[k] = solve(tx.sensor.contact_conductance(sensor, tx.Scene(*scene)))
    return np.round(volts / recordings.ATTRIBUTES["scale"]).astype(np.int16)


def synthetic(path: Path, scans: int, base: np.ndarray) -> None:
    """The base over and over, with noise of 0.3 mV that does not repeat with it."""
    rng = np.random.default_rng(0)
    pool = np.round(rng.normal(0, 2, (BASE + 64) * 4096)).astype(np.int16)
    recordings.write(path, base[:1], np.arange(64))
    with h5py.File(path, "r+") as file:
        for name in ("v", "ground", "t0"):
            del file[name]
        file["ground"] = np.broadcast_to(np.arange(64, dtype=np.uint8), (scans, 64))
        file["t0"] = np.arange(scans) * 64 / SLOT_RATE
        v = file.create_dataset("v", (scans, 64, 64), "i2", chunks=(64, 64, 64))
        for start in range(0, scans, len(base)):
            count = min(len(base), scans - start)
            at = rng.integers(64 * 4096)
            noise = pool[at : at + count * 4096].reshape(count, 64, 64)
            v[start : start + count] = base[:count] + noise


def command(*arguments) -> subprocess.Popen:
    line = "import sys; from tomojax.cli import main; sys.argv[0] = 'tomojax'; main()"
    return subprocess.Popen(
        [sys.executable, "-c", line, "reconstruct", *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(HERE.parents[1])},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )


def measured(*arguments) -> tuple[float, float]:
    """Seconds and peak memory (GB) of one command, start and compilation included."""
    start = time.perf_counter()
    process = command(*arguments)
    errors = process.stderr.read()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    process.stderr.close()
    assert process.returncode == 0, errors.decode()
    return time.perf_counter() - start, used.ru_maxrss / 1e6


KINDS = {
    "contacts for each slot": ["--rate", "slot", "--no-images"],
    "images for each scan": ["--rate", "scan", "--images"],
}


def hour(folder: Path, base: np.ndarray, quick: bool) -> list[dict]:
    """Both kinds over an hour of recording: real time over computing time."""
    scans = int((60 if quick else 3600) * SLOT_RATE / 64)
    path = folder / "hour.h5"
    synthetic(path, scans, base)
    rows = []
    for kind, options in KINDS.items():
        out = folder / "out.h5"
        took, memory = measured(path, "-o", out, *options)
        rows.append(
            {
                "kind": kind,
                "recording_GB": path.stat().st_size / 1e9,
                "results_GB": out.stat().st_size / 1e9,
                "seconds": took,
                "times_real_time": scans * 64 / SLOT_RATE / took,
                "peak_memory_GB": memory,
            }
        )
        print(rows[-1], flush=True)
        out.unlink()
    path.unlink()
    return rows


def chunks(folder: Path, base: np.ndarray, quick: bool) -> list[dict]:
    """Rate and memory against chunk size, three minutes of recording."""
    scans = int((20 if quick else 180) * SLOT_RATE / 64)
    path = folder / "minutes.h5"
    synthetic(path, scans, base)
    rows = []
    for kind, options in KINDS.items():
        for size in (16, 64, 256, 1024, 4096):
            out = folder / "out.h5"
            took, memory = measured(path, "-o", out, "--chunk", size, *options)
            rows.append(
                {
                    "kind": kind,
                    "chunk_slots": 64 * size,
                    "seconds": took,
                    "times_real_time": scans * 64 / SLOT_RATE / took,
                    "peak_memory_GB": memory,
                }
            )
            print(rows[-1], flush=True)
            out.unlink()
    path.unlink()
    return rows


def kills(folder: Path, base: np.ndarray, quick: bool) -> dict:
    """SIGKILL at ten random moments, each then resumed: bit for bit the same?"""
    path, whole, out = (folder / name for name in ("r.h5", "whole.h5", "out.h5"))
    synthetic(path, 6000, base)
    options = ["--chunk", 60, "--rate", "slot"]
    took, _ = measured(path, "-o", whole, *options)
    rng = np.random.default_rng()
    same, moments = 0, []
    for _ in range(2 if quick else 10):
        process = command(path, "-o", out, *options)
        moments.append(float(rng.uniform(0.3, 0.9)) * took)
        time.sleep(moments[-1])
        process.kill()
        process.communicate()
        begun = out.with_name("out.h5.partial").exists()
        measured(path, "-o", out, "--resume", *options)
        same += out.read_bytes() == whole.read_bytes()
        print(
            f"killed after {moments[-1]:.1f} s, begun {begun}: {same} the same", flush=True
        )
        out.unlink()
    for left in (path, whole):
        left.unlink()
    return {"kills": len(moments), "identical": same, "moments_s": moments, "whole_s": took}


def beside_pyeit(quick: bool) -> dict:
    """1000 frames of 64 slots to images of 3200 elements, or contacts; in turns; places."""
    import references
    from pyeit.eit.jac import JAC
    from pyeit.eit.protocol import PyEITProtocol
    from pyeit.mesh import PyEITMesh

    from tomojax.kernels.sheet import nodes as mesh_nodes, triangles

    sensor = tx.Sensor.grid(divisions=(40, 40), dtype=np.float32)
    nodes = np.asarray(mesh_nodes((40, 40), sensor.size), float)
    at = ((nodes[:, None] - np.asarray(sensor.electrode_xy)) ** 2).sum(-1).argmin(0)
    vertices = references.counterclockwise(nodes, triangles((40, 40)))
    mesh = PyEITMesh(node=nodes, element=vertices, perm=1e-4, el_pos=at)
    pairs = np.array([[(g + 1) % 64, g] for g in range(64)])
    reads = np.array([[[e, g] for e in range(64)] for g in range(64)])
    solver = JAC(mesh, PyEITProtocol(pairs, reads, np.ones(4096, bool)))
    # Our J on the same elements: pyEIT's has another sign and unit, the size is the same.
    maps = np.asarray(tx.jacobian(sensor))
    solver.setup(p=0.5, lamb=0.01, method="kotre")
    solver.J = -maps.reshape(4096, -1).astype(float)
    linear = tx.method(sensor, "linear", 40)
    good, grounds = np.ones((64, 64), bool), np.arange(64)
    prepared = linear.prepare(grounds, good, linear.choose_lambda([]))
    # Of each cell's two elements the same.
    ours = jax.jit(jax.vmap(lambda v: jnp.repeat(linear.image(prepared, v), 2)))
    scenes, volts, truth = static_singles()

    def place(images):  # the same for all: above half the maximum
        centre = nodes[vertices].mean(1)
        weight = np.maximum(images - images.max(1, keepdims=True) / 2, 0)
        return weight @ centre / weight.sum(1, keepdims=True)

    def errors(places):
        return [float(1e3 * e) for e in np.hypot(*(places - truth).T)]

    zero = np.zeros(4096)
    found = {"scenes": scenes, "tomojax, linear": errors(place(np.asarray(ours(volts))))}
    # pyEIT with the λ that is best for it here; ours is the default.
    tried = {}
    for lamb in (1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0):
        solver.H = solver._compute_h(solver.J, 0.5, lamb, "kotre")
        images = np.asarray(solver.solve(volts.reshape(-1, 4096), zero, normalize=False))
        images = images if images.shape[1] == 3200 else images.T
        tried[lamb] = errors(place(images))
    best = min(tried, key=lambda lamb: float(np.median(tried[lamb])))
    found |= {"pyEIT": tried[best], "pyEIT λ": best}
    solver.H = solver._compute_h(solver.J, 0.5, best, "kotre")
    narrow = solver.H.astype(np.float32)
    # Without pyEIT: Eq. 3 as one product, and sLORETA's contacts, at their best λ.
    flat = volts.reshape(-1, 4096)
    product, errs, best = in_one_product(maps.reshape(4096, -1).astype(float), flat,
                                         lambda images: errors(place(images)))  # fmt: skip
    found |= {"NumPy, one product": errs, "NumPy, one product λ/σ₁²": best}
    locate = {}
    for two, name in enumerate(("NumPy sLORETA", "NumPy sLORETA, two products")):
        locate[name], errs, best = sloreta(sensor, two + 1, flat, errors)
        found |= {name: errs, f"{name} λ/σ₁²": best}
    # `source`: its image alone, and whole, with contacts, residual and checks.
    source = tx.method(sensor, "source", 40)
    recorded = [tx.methods.Frame(v, grounds, good) for v in volts]
    ready = source.prepare(grounds, good, source.choose_lambda(recorded))
    current = jax.jit(jax.vmap(lambda v: source.image(ready, v)))
    batch = tx.Batch(source, source.choose_lambda(recorded))
    rows = batch(volts, np.tile(grounds, (len(volts), 1)))
    found["tomojax, source"] = errors(rows.contact_xy[:, 0])
    for name, errs in found.items():
        if name != "scenes" and "λ" not in name:
            print(f"{name:30s} {np.round(errs, 1)} mm, median {np.median(errs):.1f}")
    # Recorded scenes with noise: what a frame holds decides what reading it costs.
    rng = np.random.default_rng(0)
    frames = np.resize(volts, (1000, 64, 64)) + rng.normal(0, 3e-4, (1000, 64, 64))
    single = jnp.asarray(frames, np.float32)
    flat = frames.reshape(1000, -1)
    narrow_flat, narrow_zero = flat.astype(np.float32), zero.astype(np.float32)
    many = np.tile(grounds, (1000, 1))
    good_all = np.ones((64, 64), bool)
    alone = source.prepare(grounds, good_all, source.choose_lambda(recorded))

    def contacts_alone() -> None:
        part = Part(jnp.asarray(narrow_flat.reshape(single.shape)), many)
        told = source.block(alone, part, 3, False)
        jax.block_until_ready([a for a in told if a is not None])

    wide = solver.H

    def pyeit(matrix, volts, nothing) -> None:
        solver.H = matrix
        solver.solve(volts, nothing, normalize=False)

    runs = {
        "pyEIT, one call": lambda: pyeit(wide, flat, zero),
        "pyEIT, one call, float32": lambda: pyeit(narrow, narrow_flat, narrow_zero),
        "NumPy, one product, float32": lambda: narrow_flat @ product,
        **{
            f"{name}, contacts": lambda of=of: of(narrow_flat)
            for name, of in locate.items()
        },
        "tomojax, linear": lambda: jax.block_until_ready(ours(single)),
        "tomojax, source": lambda: jax.block_until_ready(current(single)),
        "tomojax, source with contacts": lambda: batch(np.asarray(single), many),
        "tomojax, source, contacts alone": contacts_alone,
    }
    times: dict[str, list] = {name: [] for name in runs}
    first = {name: seconds(run) for name, run in runs.items()}
    for _ in range(3 if quick else 9):
        for name, run in runs.items():
            times[name].append(seconds(run))
    rate = {n: {"first_s": first[n], **quartiles(t)} for n, t in times.items()}
    for row in rate.values():
        row["frames_per_s"] = 1000 / row["median_s"]
    peer = rate["pyEIT, one call"]["median_s"]
    ratio = {n: peer / row["median_s"] for n, row in rate.items()}
    print({n: round(r, 1) for n, r in ratio.items()}, flush=True)
    return {"place_errors_mm": found, "rates": rate, "ratios": ratio}


def in_one_product(rows: np.ndarray, volts: np.ndarray, errors) -> tuple:
    """Eq. 3 by NumPy: the float32 matrix that maps frames to images, at the best λ."""
    normal = rows.T @ rows
    largest = float(np.linalg.eigvalsh(normal)[-1])

    def operator(relative: float) -> np.ndarray:
        damped = normal + relative * largest * np.eye(len(normal))
        return np.linalg.solve(damped, rows.T).T.astype(np.float32)

    tried = {lam: errors(volts @ operator(lam)) for lam in 10.0 ** np.arange(-8, 2)}
    best = min(tried, key=lambda lam: float(np.median(tried[lam])))
    return np.ascontiguousarray(operator(best)), tried[best], best


def sloreta(sensor: tx.Sensor, products: int, volts: np.ndarray, errors) -> tuple:
    """The peer of `tomojax frontier` on 40 × 40 pixels: contacts from frames, best λ."""
    grounds, size = np.arange(64), np.asarray(sensor.size, float)
    tried = {}
    for variants in peers_of(sensor, 40):
        for peer in variants:
            if (peer.name, peer.products) != ("NumPy sLORETA", products):
                continue

            def contacts(lam: float, peer=peer):
                images = peer.prepare(grounds, lam, "float32")
                return lambda frames: read_peak(images(frames), 40, size)

            def median(lam: float, contacts=contacts) -> float:
                return float(np.median(errors(contacts(lam)(volts))))

            lam, _ = best_lambda(median)
            tried[median(lam)] = contacts(lam), lam
    call, lam = tried[min(tried)]
    return call, errors(call(volts)), lam


def static_singles() -> tuple[list[str], np.ndarray, np.ndarray]:
    """First scans of the recorded scenes of one round contact, and where they are."""
    with tx.open_recording(SHARED / "static_all.h5") as recording:
        volts = recording.read(0, recording.scans).voltages
    listed = json.loads((SHARED / "truth.json").read_text())["static_all"]["scenes"]
    one = [
        s for s in listed if len(s["contacts"]) == 1 and s["contacts"][0]["kind"] == "disc"
    ]
    truth = np.array([s["contacts"][0]["centre"] for s in one])
    return [s["name"] for s in one], volts[[s["scans"][0] for s in one]], truth


def draw(found: dict, path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import BLUE, GREY, plain, style

    figure = Figure(figsize=(16, 5), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for k, kind in enumerate(KINDS):
        rows = [r for r in found.get("chunks", []) if r["kind"] == kind]
        if rows:
            x = [r["chunk_slots"] for r in rows]
            left.plot(x, [r["times_real_time"] for r in rows], **style(k, label=kind))
            middle.plot(x, [r["peak_memory_GB"] for r in rows], **style(k, label=kind))
    left.axhline(20, color="0.6", lw=0.8, label="asked for")
    left.set(ylabel="speed, × real time", title="Speed: three minutes, start included")
    middle.axhline(1.5, color="0.6", lw=0.8)
    middle.set(ylabel="peak memory, GB", title="Memory")
    for axes in (left, middle):
        axes.set(xscale="log", xlabel="slots in a chunk", ylim=(0, None))
        axes.grid(alpha=0.3)
        plain(axes.xaxis)
    left.legend(fontsize=9)
    if "pyeit" in found:
        rates = found["pyeit"]["rates"]
        ours = [name.startswith("tomojax") for name in rates]
        values = [row["frames_per_s"] for row in rates.values()]
        colours = [BLUE if own else GREY for own in ours]
        bars = right.barh(list(rates), values, color=colours, edgecolor="w")
        for bar, own in zip(bars, ours):
            bar.set_hatch("" if own else "//")
        right.bar_label(bars, [f"{value:,.0f}" for value in values], padding=2, fontsize=8)
        right.set(xscale="log", xlabel="frames of 64 slots a second")
        right.margins(x=0.2)
        right.set_title(
            "Images beside peers (grey): 3200 elements,\nwith contacts, and sLORETA: 1600"
        )
        right.invert_yaxis()
        plain(right.xaxis)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="*", default=["pyeit", "chunks", "kills", "hour"])
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args()
    path = options.out / "recordings.json"
    found = json.loads(path.read_text()) if path.exists() else {}
    found["environment"] = environment()
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = Path(name)
        work = {"chunks": chunks, "kills": kills, "hour": hour}
        base = base_codes() if set(work) & set(options.only) else np.zeros(0)
        for part in options.only:
            if part == "pyeit":
                found[part] = beside_pyeit(options.quick)
            else:
                found[part] = work[part](folder, base, options.quick)
            path.write_text(json.dumps(found, indent=1) + "\n")
    draw(found, path.with_suffix(".png"))


if __name__ == "__main__":
    main()
