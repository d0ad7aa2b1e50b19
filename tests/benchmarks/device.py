"""Measures the speed of float32 on the device that JAX finds, and on the CPU.

    python tests/benchmarks/device.py [--quick] [--minutes 30] [--out notebooks/results]

The script measures `source`, Eq. 3, the table of resistances and `points`. Scenes are our
own exact voltages with 0.3 mV of noise. Other benchmarks judge accuracy. This one tells how
far float32 here is from float64 on a CPU, with the same method and voltages. On a GPU, a
last pass sets every product's precision to "highest". A call whose error is much smaller
there lacks this setting, and ran in TF32.

Each part has its own process and time limit. A part that fails or hangs therefore leaves
the others' rows. `compile_s` is the first call, with everything that it compiles. Writes
device.json and device.png.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

import tomojax as tx  # noqa: E402
from tomojax._environment import environment  # noqa: E402
from tomojax.kernels.inverse import ReducedSlots  # noqa: E402

PARTS = ("source", "table", "paper", "points")
NOISE, SCENES, KEPT = 3e-4, 64, 256  # V; distinct scenes; frames of a reference
CPU = {"JAX_PLATFORMS": "cpu"}
HIGHEST = {"JAX_DEFAULT_MATMUL_PRECISION": "highest"}


class Case(NamedTuple):
    """A call to measure; it returns arrays by name."""

    what: str
    batch: int
    run: Callable[[], dict[str, Any]]


def scenes(folder: Path, quick: bool) -> None:
    """Voltages of one and of two discs under all grounds, and J reduced to 256 rows."""
    rng, sensor = np.random.default_rng(0), tx.Sensor.grid(divisions=(40, 40))
    near = rng.uniform(0.02, 0.14, (8 if quick else SCENES, 2))
    far = (near + 0.06 - 0.02) % 0.12 + 0.02
    size, made = rng.uniform(0.003, 0.008, near.shape), {}
    for name, places in (("one", near[:, None]), ("two", np.stack([near, far], 1))):

        def volts(each):
            discs = (tx.Disc(xy, radius, 2.0) for xy, radius in zip(*each))
            return tx.voltages(sensor, tx.Scene(*discs))

        given = places, size[:, : places.shape[1]]
        made[name] = np.asarray(jax.jit(partial(jax.lax.map, volts))(given))
    reduced = tx.paper.reduce_jacobian(tx.jacobian(sensor), 256)
    np.savez(folder / "scenes.npz", **made, **reduced._asdict())


def frames(data, kind: str, grounds: np.ndarray, count: int) -> tuple:
    volts = np.resize(data[kind][:, grounds], (count, len(grounds), 64))
    noise = NOISE * np.random.default_rng(1).standard_normal(volts.shape)
    return (volts + noise).astype(np.float32), np.tile(grounds, (count, 1))


def through_batch(method, scene: tuple, images: bool, name: str) -> Case:
    batch = tx.Batch(method, method.choose_lambda([]), contacts=3, images=images)

    def run() -> dict[str, Any]:
        rows = batch(*scene)
        found = {"count": rows.contact_count, "xy": rows.contact_xy}
        return found | ({"image": rows.image} if images else {})

    return Case(name, len(scene[0]), run)


def source(data, dtype, quick: bool) -> Iterator[Case]:
    method = tx.method(tx.Sensor.grid(dtype=dtype), "source", 32)
    corners, every = np.array([0, 63]), np.arange(64)
    sizes = [(corners, 64)] if quick else [(corners, 1024), (corners, 16384), (every, 1024)]
    for grounds, count in sizes:
        scene = frames(data, "one", grounds, count)
        good = np.ones((len(grounds), 64), bool)
        prepared = method.prepare(grounds, good, method.choose_lambda([]))
        volts = jnp.asarray(scene[0], dtype)
        for images in (False, True):
            name = f"source, {len(grounds)} slots, {'images' if images else 'contacts'}"
            yield through_batch(method, scene, images, f"{name}: Batch")

            def alone(prepared, volts, images=images):
                found = method.estimate(prepared, volts, 3)
                told = {"count": found.contacts.count, "xy": found.contacts.xy}
                return told | ({"image": found.image} if images else {})

            program = jax.jit(jax.vmap(alone, (None, 0)))
            run = lambda p=program, a=(prepared, volts): p(*a)  # noqa: E731
            yield Case(f"{name}: program", count, run)


def table(data, dtype, quick: bool) -> Iterator[Case]:
    sensor = tx.Sensor.grid(divisions=(40, 40), dtype=dtype)
    yield Case("table", 1, lambda: tx.sensor.resistances(sensor)._asdict())
    yield Case("table and J", 1, lambda: {"jacobian": tx.jacobian(sensor)})


def paper(data, dtype, quick: bool) -> Iterator[Case]:
    names = ReducedSlots._fields
    reduced = ReducedSlots(*(jnp.asarray(data[n].astype(np.float32), dtype) for n in names))
    largest = np.linalg.eigvalsh(data["grams"].sum(0))[-1]
    weights = jnp.asarray(np.random.default_rng(2).uniform(0.2, 1, 64), dtype)
    log_lam = jnp.asarray(np.log(1e-4 * largest), dtype)
    for count in (8,) if quick else (64, 1024):
        volts = jnp.asarray(frames(data, "one", np.arange(64), count)[0], dtype)
        for route in ("double", "cholesky"):
            used = route if dtype is np.float32 else "cholesky"

            def images(reduced, volts, log_lam, weights=None, route=used):
                told = {"lam": jnp.exp(log_lam), "weights": weights, "route": route}
                return jax.vmap(lambda v: tx.reconstruct(reduced, v, **told).image)(volts)

            def loss(weights, log_lam, reduced, volts, images=images):
                return 1e6 * jnp.mean(images(reduced, volts, log_lam, weights) ** 2)

            name = f"Eq. 3, 64 slots, {route}"
            solve = jax.jit(images)
            given = reduced, volts, log_lam
            run = lambda f=solve, a=given: {"image": f(*a)}  # noqa: E731
            yield Case(name, count, run)
            slope = jax.jit(jax.value_and_grad(loss, (0, 1)))

            def both(slope=slope, volts=volts) -> dict[str, Any]:
                value, (by_weights, by_lam) = slope(weights, log_lam, reduced, volts)
                return {"value": value, "by_weights": by_weights, "by_lam": by_lam}

            yield Case(f"{name}: value, gradient", count, both)


def points(data, dtype, quick: bool) -> Iterator[Case]:
    method, count = tx.method(tx.Sensor.grid(dtype=dtype), "points", 32), 1024
    for kind in ("one",) if quick else ("one", "two"):
        scene = frames(data, kind, np.array([0, 63]), 32 if quick else count)
        yield through_batch(method, scene, False, f"points, 2 slots, {kind}: Batch")


def child(part: str, folder: Path, quick: bool) -> None:
    """Prints rows of a part in float32; in float64, saves what float32 is judged by."""
    if part == "scenes":
        return scenes(folder, quick)
    wide, data = jax.config.jax_enable_x64, dict(np.load(folder / "scenes.npz"))
    dtype, path = np.float64 if wide else np.float32, folder / f"{part}.npz"
    right, saved = dict(np.load(path)) if path.exists() and not wide else {}, {}
    about = {"device": jax.devices()[0].device_kind, "platform": jax.default_backend()}
    about["precision"] = jax.config.jax_default_matmul_precision or "default"
    once = wide or about["precision"] == "highest"
    for case in globals()[part](data, dtype, quick):
        row, key = {"what": case.what, **about, "batch": case.batch}, str(case[:2])
        try:
            spent, found = [], {}
            # The first compiles, the second warms up.
            while not spent or (not once and _wants_more(spent[1:])):
                start = time.perf_counter()
                found = jax.block_until_ready(case.run())
                spent.append(time.perf_counter() - start)
            kept = {k: np.atleast_1d(np.asarray(a))[:KEPT] for k, a in found.items()}
            saved |= {f"{key} {k}": a for k, a in kept.items()}
            if not once:
                each = 1e6 * np.array(spent[2:]) / case.batch
                row |= {"us_a_frame": float(np.median(each)), "us_least": each.min()}
                row |= {"us_most": each.max(), "calls": len(each), "compile_s": spent[0]}
            if not wide:
                row |= judged({k: (a, right.get(f"{key} {k}")) for k, a in kept.items()})
        except Exception as error:
            traceback.print_exc()
            row["failed"] = f"{type(error).__name__}: {error}"[:300]
        print(json.dumps(row), flush=True)
    if wide:
        np.savez(path, **saved)


def _wants_more(spent: list[float]) -> bool:
    return sum(spent) < 0.7 or (len(spent) < 6 and sum(spent) < 30)


def judged(pairs: dict[str, tuple]) -> dict[str, Any]:
    """Largest differences: of places, mm, where counts agree; relative, of all else."""
    if any(b is None for _, b in pairs.values()):
        return {"error": None}
    told: dict[str, Any] = {}
    if "xy" in pairs:
        (count, right), (xy, true) = pairs.pop("count"), pairs.pop("xy")
        apart = np.hypot(*np.moveaxis(xy[:, :, None] - true[:, None], -1, 0))
        there = np.arange(xy.shape[1]) < right[:, None]
        nearest = np.nanmin(np.where(there[:, None], apart, np.inf), -1)
        same = count == right
        error = nearest[same][there[same]]
        told = {"counts_differ": int((~same).sum()), "of": len(same)}
        told["error_mm"] = 1e3 * float(error.max()) if error.size else None
    for name, (a, b) in pairs.items():
        a, b = (np.reshape(x, (len(x) if np.ndim(x) > 1 else 1, -1)) for x in (a, b))
        error = (np.linalg.norm(a - b, axis=1) / np.linalg.norm(b, axis=1)).max()
        told |= {f"error_{name}": float(error) if np.isfinite(error) else None}
    return told | {"error": max((v or 0.0 for k, v in told.items() if "error" in k))}


def draw(rows: list[dict], path: Path) -> None:
    """Microseconds of a frame, and the largest difference from float64."""
    from matplotlib.figure import Figure

    rows = [r | {"name": f"{r['what']}, {r['batch']}"} for r in rows if "error" in r]
    names = list(dict.fromkeys(r["name"] for r in rows))
    from tomojax._pictures import style

    figure = Figure(figsize=(13, 0.3 * len(names) + 1.9), layout="constrained")
    figure.suptitle(
        "Speed and error on an accelerator, and on the processor of its machine"
    )
    left, right = figure.subplots(1, 2, sharey=True)
    kinds = list(dict.fromkeys((r["device"], r["precision"]) for r in rows))
    for k, kind in enumerate(kinds):
        mine = [r for r in rows if (r["device"], r["precision"]) == kind]
        at = [names.index(r["name"]) + 0.3 * (k - 1) for r in mine]
        label = kind[0] + ', all "highest"' * (kind[1] != "default")
        label = label.replace("cpu", "the processor")
        look = {"color": style(k)["color"], "edgecolor": "w", "hatch": ("", "..", "//")[k]}
        left.barh(at, [r.get("us_a_frame", 0) for r in mine], 0.3, **look)
        error = [r["error"] or np.nan for r in mine]
        right.plot(error, at, **style(k, linestyle="none", label=label))
    words = [f"{name.rpartition(', ')[0]}; {name.rpartition(', ')[2]}" for name in names]
    left.set_yticks(range(len(names)), words)
    left.set_ylim(len(names) - 0.4, -0.6)
    left.set(xscale="log", xlabel="time of a frame, µs (table: of a call)")
    left.set_title("Time; frames in a call after the semicolon")
    right.set(xscale="log", xlabel="mm for contacts, else relative")
    right.set_title("Largest difference from float64")
    handles = right.get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=3, frameon=False)
    for axes in (left, right):
        axes.grid(alpha=0.3, axis="x")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument(
        "--minutes", type=float, default=30.0, help="Time for all parts, minutes."
    )
    parser.add_argument("--limit", type=float, default=300.0, help="Time for one part, s.")
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    parser.add_argument("--child", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        return child(options.child[0], Path(options.child[1]), options.quick)
    end, rows = time.monotonic() + 60 * options.minutes, []
    options.out.mkdir(parents=True, exist_ok=True)
    report: dict[str, Any] = {"environment": {}, "rows": rows}

    def part(name: str, folder: str, env: dict[str, str]) -> list[dict[str, Any]]:
        command = [sys.executable, "-P", __file__, "--child", name, folder]
        command += ["--quick"] * options.quick
        limit, ended = max(1, min(options.limit, end - time.monotonic())), "0"
        run = partial(subprocess.run, stdout=subprocess.PIPE, env=os.environ | env)
        try:
            ran = run(command, timeout=limit)
            out, ended = ran.stdout, str(ran.returncode)
        except subprocess.TimeoutExpired as late:
            out, ended = late.stdout or b"", f"after {limit:.0f} s, the limit"
        told = [json.loads(line) for line in out.splitlines() if line[:1] == b"{"]
        failed = [] if ended == "0" else [{"part": name, **env, "failed": f"exit {ended}"}]
        print(*map(json.dumps, told + failed), sep="\n", flush=True)
        return told + failed

    def write() -> None:
        text = json.dumps(report, indent=1) + "\n"
        (options.out / "device.json").write_text(text)

    with tempfile.TemporaryDirectory() as folder:
        wide = CPU | {"JAX_ENABLE_X64": "1"}
        part("scenes", folder, wide)
        with ThreadPoolExecutor(max(1, (os.cpu_count() or 1) // 4)) as pool:
            list(pool.map(lambda name: part(name, folder, wide), PARTS))
        for env in ({}, HIGHEST, CPU):
            if env and all(r.get("platform", "cpu") == "cpu" for r in rows):
                break  # the first pass was the CPU's
            for name in PARTS:
                rows += part(name, folder, env)
                write()
    report["environment"] |= environment() | {"cores": os.cpu_count()}
    write()
    draw(rows, options.out / "device.png")


if __name__ == "__main__":
    main()
