"""Measures how long a step's slot takes, and how each policy follows moving contacts.

    python tests/benchmarks/step.py [--slots 100000] [--out FOLDER]

Latency is from NumPy voltages to NumPy contacts and the next ground, one call after
another. Its percentiles are given for each method. The process is either as it comes, or
tuned (`tomojax.hardware.real_time`). In the closed loop, a contact moves over a rig of
another model (tests/rig.py). Each slot's ground is the one that the policy asked for.
Places are those said in the same slot. Writes step.json and step.png.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

# By name: the method, and how many contacts it looks for.
METHODS = {
    "follow": ("follow", 2),
    "follow one": ("follow", 1),
    "source": ("source", 2),
    "linear": ("linear", 2),
    "points": ("points", 2),
}
QUANTILES = {"p50_us": 0.5, "p99_us": 0.99, "p999_us": 0.999, "p9999_us": 0.9999}
FINE = 57  # pixels of a side: the paper's mesh has 3200 elements
POLICIES = ("around_contacts", "information", "around", "cop_line", "preset", "all")
# Metres a second, and slots a second.
SPEEDS, RATE = (0.05, 0.2, 0.5), 10_000
# Slots that a position holds: 0.2 mm at the highest speed.
HOLD = 4


def child(method: str, tuned: bool, slots: int) -> None:
    """One row, printed: in a process of its own."""
    from contextlib import nullcontext

    from tomojax.hardware import real_time

    with real_time() if tuned else nullcontext([]) as settings:
        if method == "machine":
            machine(settings, slots)
        else:
            measured(method, settings, slots)


def machine(settings: list[str], slots: int) -> None:
    """The same quantiles of a fixed piece of NumPy's work: what is the machine's own."""
    import numpy as np

    a, spent = np.ones((96, 96), np.float32), np.empty(slots)
    for k in range(slots):
        begin = time.perf_counter_ns()
        a.sum(0)
        np.sort(a.ravel())
        spent[k] = time.perf_counter_ns() - begin
    row = {"kind": "machine", "settings": settings, "slots": slots}
    quantiles = {n: float(np.quantile(spent, q)) / 1e3 for n, q in QUANTILES.items()}
    print(json.dumps({**row, **quantiles}))


def measured(name: str, settings: list[str], slots: int) -> None:
    import numpy as np
    from rig import Rig

    import tomojax as tx

    method, contacts = METHODS[name]
    sensor = tx.Sensor.grid(dtype=np.float32, divisions=(32, 32))
    rng = np.random.default_rng(5)
    rig = Rig(rng)
    contact = rig.disc(np.array([0.052, 0.071]), 0.006), 1e-4
    volts = rig.measure(rig.scene(contact)[0]).astype(np.float32)
    start = time.perf_counter()
    step = tx.make_step(sensor, method, "around_contacts", contacts=contacts)
    made = time.perf_counter() - start
    state, ground = step.state, 0
    for _ in range(500):
        state, out = step(state, volts[ground], ground)
        ground = int(out.ground)
    spent = np.empty(slots)
    for k in range(slots):
        v = volts[ground]
        begin = time.perf_counter_ns()
        state, out = step(state, v, ground)
        ground = int(out.ground)
        np.asarray(out.contacts.xy)
        spent[k] = time.perf_counter_ns() - begin
    # The same with an image of as many pixels as the paper's mesh has elements.
    fine = tx.make_step(sensor, method, "around_contacts", contacts=contacts, grid=FINE)
    drawn, state = np.empty(min(slots, 20_000)), fine.state
    for k in range(-100, len(drawn)):
        v = volts[ground]
        begin = time.perf_counter_ns()
        state, out = fine(state, v, ground)
        ground = int(out.ground)
        np.asarray(fine.image(state))
        drawn[k] = time.perf_counter_ns() - begin
    row = {
        "kind": "latency",
        "method": name,
        "contacts": contacts,
        "settings": settings,
        "slots": slots,
        "make_s": made,
        **{n: float(np.quantile(spent, q)) / 1e3 for n, q in QUANTILES.items()},
        "pixels": FINE**2,
        "image_p50_us": float(np.quantile(drawn, 0.5)) / 1e3,
        "image_p99_us": float(np.quantile(drawn, 0.99)) / 1e3,
        "traces": step.traces,
    }
    print(json.dumps(row))


def latencies(slots: int) -> list[dict]:
    table = []
    for method in ("machine", *METHODS):
        for tuned in (False, True):
            # As it comes a tenth: two thirds of the time otherwise.
            count = slots if tuned else slots // 10
            # `points` fits in full: milliseconds a slot.
            count = min(count, 300) if method == "points" else count
            command = [sys.executable, __file__, "--child", method]
            command += ["--slots", str(count)] + ["--tuned"] * tuned
            out = subprocess.run(command, capture_output=True, text=True)
            if out.returncode:
                raise SystemExit(out.stderr)
            table.append(json.loads(out.stdout.splitlines()[-1]))
            print(json.dumps(table[-1]), flush=True)
    return table


def moving() -> list[dict]:
    """Place error and lag of each policy, at each speed; and after a jump."""
    import numpy as np
    from rig import Rig

    import tomojax as tx

    sensor = tx.Sensor.grid(dtype=np.float32, divisions=(32, 32))
    rng = np.random.default_rng(8)
    rig = Rig(rng)
    length = 240
    t = np.linspace(0, 2 * np.pi, length)
    path = 0.08 + np.stack([0.05 * np.sin(t), 0.035 * np.sin(2 * t + 0.5)], 1)
    far = np.hypot(*np.diff(path, axis=0).T)
    print(f"positions {1e3 * far.mean():.2f} mm apart", flush=True)
    volts = np.stack([rig.scene((rig.disc(p, 0.006), 1e-4))[0] for p in path])
    corners = np.asarray(tx.paper.exploration(sensor))
    exploring = rig.measure(volts[0])[corners]
    preset = np.asarray(tx.pattern(sensor, "around", exploring))
    import jax.numpy as jnp

    ground = jnp.asarray(preset)
    same = tx.step.Lookup(ground[None, None], ground, sensor.size)
    step = tx.make_step(sensor, "follow", POLICIES, tables={"preset": same})
    table = []
    for policy in POLICIES:
        for speed in SPEEDS:
            hold = max(1, round(far.mean() / speed * RATE))
            state, ground, errors, along = step.switch(step.state, policy), 0, [], []
            for k in np.repeat(np.arange(length), hold):
                v = rig.measure(volts[k, ground]).astype(np.float32)
                state, out = step(state, v, ground)
                ground = int(out.ground)
                off = np.asarray(out.contacts.xy[0]) - path[k]
                ahead = path[min(k + 1, length - 1)] - path[max(k - 1, 0)]
                errors.append(np.hypot(*off))
                along.append(-off @ ahead / np.hypot(*ahead))
            errors, along = 1e3 * np.array(errors[50:]), 1e3 * np.array(along[50:])
            row = {
                "kind": "moving",
                "policy": policy,
                "speed_m_s": speed,
                "place_median_mm": float(np.nanmedian(errors)),
                "place_p90_mm": float(np.nanquantile(errors, 0.9)),
                "lag_ms": float(np.nanmean(along)) / speed,
                "lost": int(np.isnan(errors).sum()),
            }
            table.append(row)
            print(json.dumps(row), flush=True)
    table.append(jumps(step, rig, volts, path))
    print(json.dumps(table[-1]))
    return table


def jumps(step, rig, volts, path) -> dict:
    """Slots from a jump across the sheet until the place is within 3 mm again."""
    import numpy as np

    taken = []
    for a in range(0, len(path) // 2, 6):
        b = a + len(path) // 2
        state, ground = step.state, 0
        for _ in range(20):
            state, out = step(state, rig.measure(volts[a, ground]), ground)
            ground = int(out.ground)
        errors = []
        for _ in range(10):
            state, out = step(state, rig.measure(volts[b, ground]), ground)
            ground = int(out.ground)
            errors.append(np.hypot(*(np.asarray(out.contacts.xy[0]) - path[b])))
        near = np.array(errors) < 3e-3
        taken.append(int(np.argmax(near)) + 1 if near.any() else len(near) + 1)
    return {"kind": "jump", "jumps": len(taken), "slots_max": max(taken), "slots": taken}


def draw(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import plain, style

    figure = Figure(figsize=(16, 6), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for method in METHODS:
        for row in (r for r in rows if r["kind"] == "latency" and r["method"] == method):
            tuned = bool(row["settings"])
            values = [row[name] for name in QUANTILES]
            label = f"{method}, {'tuned' if tuned else 'as it comes'}"
            look = style(method.split()[0], markersize=6, label=label)
            look |= {"marker": "*"} if method == "follow one" else {}
            look |= {"linestyle": "-" if tuned else ":"}
            look |= {"markerfacecolor": look["color"] if tuned else "w"}
            left.semilogy(range(len(values)), values, **look)
    left.axhline(100, color="0.6", lw=1, label="100 µs: a slot")
    left.set_xticks(range(4), ["50 %", "99 %", "99.9 %", "99.99 %"])
    left.set(ylabel="one slot to contacts and next ground, µs", xlabel="part of the slots")
    left.set_title("Latency of a step")
    for k, policy in enumerate(POLICIES):
        some = [r for r in rows if r["kind"] == "moving" and r["policy"] == policy]
        speed, label = (
            [r["speed_m_s"] for r in some],
            policy.replace("_", " ").replace("cop", "CoP"),
        )
        for axes, name in ((middle, "place_median_mm"), (right, "lag_ms")):
            look = style(k, markersize=6, label=label)
            axes.plot(speed, [r[name] for r in some], **look)
    for axes in (middle, right):
        axes.set(xlabel="speed of the contact, m/s", xscale="log")
        axes.set_xticks(SPEEDS, [f"{speed:g}" for speed in SPEEDS], minor=False)
        axes.set_xticks([], minor=True)
    middle.set(ylabel="place error, mm (median)", ylim=(0, None))
    middle.set_title("Place in a closed loop (follow), by policy")
    right.set(ylabel="mean distance behind / speed, ms")
    right.set_title("Lag along the path, by policy")
    plain(left.yaxis)
    for axes, columns in ((left, 2), (middle, 2)):
        axes.legend(fontsize=9, loc="upper left", bbox_to_anchor=(0, -0.14),
                    ncols=columns, frameon=False)  # fmt: skip
    for axes in (left, middle, right):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--slots", type=int, default=100_000)
    parser.add_argument("--out", type=Path, default=HERE.parents[1] / "notebooks/results")
    parser.add_argument("--only", choices=("latency", "moving"))
    parser.add_argument("--child", choices=(*METHODS, "machine"))
    parser.add_argument("--tuned", action="store_true")
    options = parser.parse_args()
    if options.child:
        child(options.child, options.tuned, options.slots)
        return
    from benchmarks.physics import environment

    path = options.out / "step.json"
    parts = {"latency": ("machine", "latency"), "moving": ("moving", "jump")}
    kinds = parts.get(options.only, ())
    rows = json.loads(path.read_text())["rows"] if options.only else []
    rows = [row for row in rows if row["kind"] not in kinds]
    if options.only != "moving":
        rows += latencies(options.slots)
    if options.only != "latency":
        rows += moving()
    content = {"environment": environment(), "rows": rows}
    path.write_text(json.dumps(content, indent=1) + "\n")
    if {"latency", "moving"} <= {row["kind"] for row in rows}:
        draw(rows, path.with_suffix(".png"))


if __name__ == "__main__":
    main()
