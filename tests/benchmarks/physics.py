"""Measures time and memory of the table, and speed beside pyEIT and scikit-fem, in one run.

    python tests/benchmarks/physics.py [--quick] [--out notebooks/results]

Writes physics.json and physics.png. Figures are medians and quartiles, compile time apart.
The two sides of a comparison take turns, so that a noisy machine is noisy for both.
"""

import argparse
import json
import platform
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

HERE = Path(__file__).parent
# The checkout's own package: the folder tests/tomojax would pass for one otherwise.
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
DIVISIONS = (20, 40, 80, 160)  # 800 to 51 200 elements


def seconds(run) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def quartiles(times: list[float]) -> dict:
    low, middle, high = np.percentile(times, [25, 50, 75])
    return {"median_s": middle, "q1_s": low, "q3_s": high, "runs": len(times)}


def take_turns(runs: dict, repeats: dict) -> dict:
    """First call apart (compilation, caches), then medians of interleaved calls."""
    first = {name: seconds(run) for name, run in runs.items()}
    times = {name: [] for name in runs}
    for i in range(max(repeats.values())):
        for name, run in runs.items():
            if i < repeats[name]:
                times[name].append(seconds(run))
    return {n: {"first_s": first[n], **quartiles(times[n])} for n in runs}


def jacobian_beside_pyeit(quick: bool) -> dict:
    """J for all 64 ground conditions, from the sensor on, 3200 elements."""
    import references
    from pyeit.eit.fem import EITForward
    from pyeit.eit.protocol import PyEITProtocol
    from pyeit.mesh import PyEITMesh

    import tomojax as tx
    from tomojax.kernels.sheet import nodes as mesh_nodes, triangles

    shape = (40, 40)
    runs = {}
    for dtype in (np.float64, np.float32):
        sensor = tx.Sensor.grid(divisions=shape, dtype=dtype)
        runs[f"tomojax {np.dtype(dtype).name}"] = lambda s=sensor: jax.block_until_ready(
            tx.jacobian(s)
        )
    nodes = np.asarray(mesh_nodes(shape, sensor.size), float)
    places = np.asarray(sensor.electrode_xy)
    at = ((nodes[:, None] - places) ** 2).sum(-1).argmin(0)
    vertices = references.counterclockwise(nodes, triangles(shape))
    mesh = PyEITMesh(node=nodes, element=vertices, perm=1e-4, el_pos=at)
    pairs = np.array([[(g + 1) % 64, g] for g in range(64)])
    reads = np.array([[[e, g] for e in range(64)] for g in range(64)])
    forward = EITForward(mesh, PyEITProtocol(pairs, reads, np.ones(4096, bool)))
    runs["pyEIT compute_jac"] = forward.compute_jac
    n = 3 if quick else 7
    result = take_turns(runs, {k: n if "pyEIT" in k else 4 * n for k in runs})
    return result


def voltages_beside_skfem(quick: bool) -> dict:
    """Exact voltages of one scene for all 64 ground conditions, 3200 elements."""
    import references

    import tomojax as tx
    from tomojax.kernels.sheet import (
        fem_contact,
        ground_voltages,
        Grounds,
        site_conductance,
    )
    from tomojax.sensor import sheet_on_mesh

    sensor = tx.Sensor.grid(divisions=(40, 40))
    fem = sheet_on_mesh(sensor)
    g = tx.sensor.contact_conductance(sensor, tx.Disc([0.0934, 0.0671], 0.008, 2.0))
    # The peer has no contact on an electrode's metal: none in this scene.
    sites = site_conductance(fem._replace(metal=0 * fem.metal), g, (40, 40))
    nodes = np.asarray(sites[: len(fem.feeds)])
    drive = (Grounds(None, sensor.ground_resistance), jnp.arange(64), sensor.drive_voltage)
    solve = jax.jit(lambda s: ground_voltages(fem_contact(fem, s, (40, 40)), *drive))
    from_sensor = jax.jit(lambda s, g: tx.voltages(s, g))
    conductance = jnp.full(sensor.element_count, 1 / sensor.sheet_resistance)
    arrays = [np.asarray(a, float) for a in (conductance, fem.feeds, fem.series)]
    k = references.skfem_stiffness(arrays[0], (40, 40), sensor.size)
    z = float(sensor.ground_resistance)

    def peer(k=k, symmetric=False):
        told = arrays[1], arrays[2], nodes, 4.5, z
        return references.sparse_loaded_voltages(k, *told, symmetric)

    def assembled():
        return references.skfem_stiffness(arrays[0], (40, 40), fem.size)

    for symmetric in (False, True):
        found = peer(symmetric=symmetric)
        difference = np.abs(found - np.asarray(solve(sites))).max()
        assert difference < 1e-9, difference
    runs = {
        "tomojax, solve": lambda: jax.block_until_ready(solve(sites)),
        "scikit-fem + splu, solve": peer,
        "scikit-fem + symmetric splu, solve": lambda: peer(symmetric=True),
        "tomojax, from the sensor": lambda: jax.block_until_ready(from_sensor(sensor, g)),
        "scikit-fem + splu, with assembly": lambda: peer(assembled()),
        "scikit-fem + symmetric splu, with assembly": lambda: peer(assembled(), True),
    }
    n = 10 if quick else 40
    return take_turns(runs, dict.fromkeys(runs, n))


def peak_kb() -> int:
    """This program's own peak (getrusage carries the parent's over into a child)."""
    status = Path("/proc/self/status").read_text()
    return int(next(x for x in status.splitlines() if x.startswith("VmHWM")).split()[1])


def table_of(route: str, n: int, dtype: str, repeats: int) -> dict:
    """One size in this process: run apart, so that the peak memory is its own."""
    import tomojax as tx
    from tomojax.sensor import compiled_resistances

    diameter = max(0.005, 1.001 * 0.16 / n)
    make = lambda: tx.Sensor.grid(  # noqa: E731
        divisions=(n, n), electrode_diameter=diameter, dtype=dtype
    )
    sensor = make()
    before = peak_kb()
    run = lambda: jax.block_until_ready(compiled_resistances(sensor, route))  # noqa: E731
    first = seconds(run)
    times = [seconds(run) for _ in range(repeats)]
    peak = peak_kb()
    return {
        "route": route,
        "dtype": dtype,
        "elements": 2 * n * n,
        "compile_s": first - float(np.median(times)),
        **quartiles(times),
        "peak_mb": peak / 1024,
        "added_mb": (peak - before) / 1024,
    }


def growth(quick: bool) -> tuple[list, dict]:
    rows = []
    for route in ("fem", "series"):
        for n in DIVISIONS[: 3 if quick else 4]:
            arguments = ["--one", route, str(n), "float64", "3" if quick else "9"]
            command = [sys.executable, __file__, *arguments]
            run = subprocess.run(command, check=True, capture_output=True, text=True)
            rows.append(json.loads(run.stdout.splitlines()[-1]))
            print(rows[-1])
    exponents = {}
    for route in ("fem", "series"):
        mine = [r for r in rows if r["route"] == route][1:]  # without the smallest
        x = np.log([r["elements"] for r in mine])
        for key in ("median_s", "added_mb"):
            y = np.log([max(r[key], 1e-9) for r in mine])
            exponents[f"{route} {key}"] = float(np.polyfit(x, y, 1)[0])
    return rows, exponents


ROUTES = {"fem": "finite elements", "series": "cosine series"}


def draw(report: dict, path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import BLUE, GREY, plain, style

    figure = Figure(figsize=(16, 4.8), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for k, route in enumerate(("fem", "series")):
        mine = [r for r in report["growth"] if r["route"] == route]
        x = [r["elements"] for r in mine]
        units = (left, "median_s", "time, s"), (middle, "added_mb", "memory, MB")
        for axes, key, unit in units:
            slope = report["exponents"][f"{route} {key}"]
            axes.loglog(
                x,
                [r[key] for r in mine],
                **style(k, label=f"{ROUTES[route]}, slope {slope:.2f}"),
            )
            axes.set(xlabel="number of elements", ylabel=unit)
            axes.legend()
            axes.grid(alpha=0.3)
    plain(left.xaxis, left.yaxis, middle.xaxis, middle.yaxis)
    left.set_title("Table of resistances: time")
    middle.set_title("Table of resistances: memory added")
    bars = {**report["jacobian"], **report["voltages"]}
    names = list(bars)
    value = [1e3 * bars[n]["median_s"] for n in names]
    spread = [
        [1e3 * (bars[n]["median_s"] - bars[n]["q1_s"]) for n in names],
        [1e3 * (bars[n]["q3_s"] - bars[n]["median_s"]) for n in names],
    ]
    ours = [BLUE if n.startswith("tomojax") else GREY for n in names]
    jacobians = len(report["jacobian"])
    words = [("J: " if k < jacobians else "voltages: ") + n for k, n in enumerate(names)]
    right.barh(words, value, xerr=spread, color=ours)
    right.set(xscale="log", xlabel="time, ms (median, quartiles)")
    right.invert_yaxis()
    right.set_title("64 grounds, 3200 elements (peers grey)", loc="right")
    plain(right.xaxis)
    figure.savefig(path, dpi=130)


def environment() -> dict:
    packages = ("tomojax", "jax", "numpy", "scipy", "scikit-fem", "pyeit")
    return {
        "device": str(jax.devices()[0].device_kind),
        "machine": platform.machine(),
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    parser.add_argument("--one", nargs=4, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if arguments.one:
        route, n, dtype, repeats = arguments.one
        print(json.dumps(table_of(route, int(n), dtype, int(repeats))))
        return
    report = {
        "jacobian": jacobian_beside_pyeit(arguments.quick),
        "voltages": voltages_beside_skfem(arguments.quick),
    }
    report["growth"], report["exponents"] = growth(arguments.quick)
    report["environment"] = environment()
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "physics.json").write_text(json.dumps(report, indent=1) + "\n")
    draw(report, arguments.out / "physics.png")
    for part in ("jacobian", "voltages"):
        for name, row in report[part].items():
            print(
                f"{name:42s} {1e3 * row['median_s']:9.2f} ms  first {row['first_s']:.2f} s"
            )
    print(report["exponents"])


if __name__ == "__main__":
    main()
