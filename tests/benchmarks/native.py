"""Measures a step that runs as C beside the same step as JAX's program.

    python tests/benchmarks/native.py [--slots 100000] [--seed N] [--out FOLDER]

Equal: both are given the same state, slot after slot, with contacts that come and go on a
rig of another model (tests/rig.py; for 4 x 4, a round sheet and two grounds at once, of our
own), and with every fault that a slot can have. Where flags, counts or the next ground
differ, and how far places are apart, are counted. Own: each goes on from its own state, as
does the same in float64, and all are compared with where the contacts are. Time: both in
turn in one process with the settings for real time, from NumPy's voltages to NumPy's
contacts; C from C, by `replay`; and work that is always the same and takes as long as a
slot in C, which shows what the machine adds. Writes native.json.
"""

import argparse
import functools
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

import jax  # noqa: E402
import numpy as np  # noqa: E402
from rig import Rig  # noqa: E402

import tomojax as tx  # noqa: E402
from tomojax.hardware import real_time  # noqa: E402

POLICIES = ("around_contacts", "information", "around", "all")
# Name: method, contacts at most, whether calibrated, and the shape.
CASES = {
    "follow, one": ("follow", 1, False, "grid"),
    "follow, two": ("follow", 2, False, "grid"),
    "follow, three": ("follow", 3, False, "grid"),
    "follow, two, calibrated": ("follow", 2, True, "grid"),
    "follow, two, 4 x 4": ("follow", 2, False, "small"),
    "follow, two, round": ("follow", 2, False, "round"),
    "follow, two, two grounds": ("follow", 2, False, "pairs"),
    "source, two": ("source", 2, False, "grid"),
    "linear, two": ("linear", 2, False, "grid"),
}
QUANTILES = {"p50_us": 0.5, "p99_us": 0.99, "p999_us": 0.999}
# Slots that a scene holds, and scenes in all: seconds each, they are drawn again and again
# with other noise.
HELD, SCENES = 40, 32
# Of scenes, noise and faults. Nothing was changed after this seed had run.
SEED = 20_261_201


def sensor_of(shape: str, dtype: type = np.float32) -> tx.Sensor:
    if shape == "small":
        return tx.Sensor.grid(4, 4, dtype=dtype, divisions=(24, 24))
    if shape == "round":
        return tx.Sensor.disc(
            0.1, {"rim": 16, "grid": 0.018}, dtype=dtype, divisions=(40, 40)
        )
    sensor = tx.Sensor.grid(dtype=dtype, divisions=(32, 32))
    if shape == "pairs":  # each electrode with the one opposite, through 4 Ω each
        return replace(sensor, conditions=(np.eye(64) + np.eye(64)[::-1])[:32] / 4)
    return sensor


def calibration(m: int) -> tx.Calibration:
    rng = np.random.default_rng(3)
    return tx.Calibration(offset=rng.normal(0, 2e-3, m), gain=rng.normal(1, 0.01, m))


def made(name: str, native: bool, dtype: type = np.float32) -> tx.step.Step:
    """A step as C, or as JAX's program."""
    method, contacts, calibrated, shape = CASES[name]
    sensor, known = sensor_of(shape, dtype), calibration(64) if calibrated else None
    good = np.ones(sensor.electrode_count, bool)
    if calibrated:
        good[[5, 20]] = False
    return tx.make_step(
        sensor, method, POLICIES, contacts=contacts, calibration=known, good=good,
        native=native,
    )  # fmt: skip


def pair(name: str) -> tuple[tx.step.Step, tx.step.Step]:
    """The same step twice."""
    return made(name, True), made(name, False)


@functools.cache
def scenes(shape: str, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Volts of all grounds, and where contacts are: up to three, or none."""
    sensor, rng = sensor_of(shape), np.random.default_rng(seed)
    side = float(np.asarray(sensor.size)[0])
    rig = Rig(rng) if shape == "grid" else None
    found = []
    for k in range(SCENES):
        count = (1, 2, 0, 1, 3, 2, 1, 2)[k % 8]
        places = rng.uniform(0.08 * side, 0.92 * side, (count, 2))
        if shape == "round":  # towards the middle, so that none is off the sheet
            places = side / 2 + 0.65 * (places - side / 2)
        radii, given = rng.uniform(0.003, 0.009, count), rng.uniform(2e-5, 3e-4, count)
        if rig is not None:
            contacts = [(rig.disc(p, r), g) for p, r, g in zip(places, radii, given)]
            volts = rig.measure(rig.scene(*contacts)[0])
        else:
            discs = [tx.Disc(p, r, 1.0) for p, r in zip(places, radii)]
            discs = discs or [tx.Disc([side / 2, side / 2], 0.004, 1e-9)]
            every = sensor.all_grounds()
            exact = np.asarray(tx.voltages(sensor, tx.Scene(*discs), every))
            volts = exact + rng.normal(0, 1e-3, exact.shape)
        found.append((volts.astype(np.float32), places))
    return found


def slots(rng: np.random.Generator, name: str, count: int):
    """Yields volts of a slot by ground, slots lost, whether hurried, and the places."""
    drawn = scenes(CASES[name][3], SEED)
    if CASES[name][2]:  # readings as a rig with these zeros and gains has them
        rig = calibration(drawn[0][0].shape[1])
        read = [(v * rig.gain + rig.offset).astype(np.float32) for v, _ in drawn]
        drawn = [(v, places) for v, (_, places) in zip(read, drawn)]
    volts, places = drawn[0]
    for k in range(count):
        if k % HELD == 0:
            volts, places = drawn[rng.integers(len(drawn))]
        fault = rng.choice(9) if rng.random() < 0.08 else -1
        slot = functools.partial(faulty, rng, volts, fault)
        yield slot, places, fault


def faulty(rng, volts, fault, ground):
    """A slot's volts, the ground that it says it had, and how many were lost."""
    v, lost = volts[ground].copy(), 0
    v += rng.normal(0, 3e-4, v.shape).astype(np.float32)
    m = len(v)
    if fault == 0:
        v[rng.integers(m)] = np.nan
    elif fault == 1:
        v[rng.integers(m, size=m // 2 + 2)] = np.inf
    elif fault == 2:
        v[:] = 0
    elif fault == 3:
        v[rng.integers(m)] = 40.0
    elif fault == 4:
        ground = int(rng.choice([-1, m, 2**31 - 1]))
    elif fault == 5:
        lost = int(rng.integers(1, 1000))
    elif fault == 6:
        v[rng.integers(m)] *= 0.5
    elif fault == 7:
        v = rng.normal(0, 2, m).astype(np.float32)
    elif fault == 8:
        v[:] = v.mean()
    return v, ground, lost


def equal(name: str, count: int) -> dict:
    """Runs both from the same state."""
    native, jax_ = pair(name)
    rng = np.random.default_rng([SEED, 1])
    state, ground = tuple(map(np.asarray, jax_.state)), 0
    apart, differs, faults = [], 0, 0
    for k, (volts_of, _, fault) in enumerate(slots(rng, name, count)):
        if k % (count // len(POLICIES) + 1) == 0:
            policy = POLICIES[k // (count // len(POLICIES) + 1)]
            state = tuple(map(np.asarray, jax_.switch(state, policy)))
        slot = volts_of(ground)
        faults += fault >= 0
        after, a = native(state, *slot)
        state, b = jax_(state, *slot)
        same = all(int(x) == int(y) for x, y in (
            (a.flags, b.flags), (a.ground, b.ground),
            (a.contacts.count, b.contacts.count)))  # fmt: skip
        differs += not same
        if same and int(b.contacts.count):
            gap = np.asarray(a.contacts.xy) - np.asarray(b.contacts.xy)
            apart.append(float(np.nanmax(np.hypot(*gap.T))))
        state, ground = tuple(map(np.asarray, state)), int(b.ground)
    quantiles = {
        f"place_p{q}_um": 1e6 * float(np.quantile(apart, q / 100)) for q in (50, 99)
    }
    return {
        "kind": "equal", "case": name, "slots": count, "faulty": int(faults),
        "differ": int(differs), **quantiles, "place_max_um": 1e6 * max(apart),
    }  # fmt: skip


def own(name: str, count: int) -> list[dict]:
    """Runs each from its own state, beside the truth; float64 as well."""
    rows = [own_state(name, count, made(name, native)) for native in (True, False)]
    with jax.enable_x64(True):
        rows.append(own_state(name, count, made(name, False, np.float64)))
    return rows


def own_state(name: str, count: int, step: tx.step.Step) -> dict:
    rng = np.random.default_rng([SEED, 2])
    state, ground = step.state, 0
    away, right, doubted, seen = [], 0, 0, 0
    for k, (volts_of, places, fault) in enumerate(slots(rng, name, count)):
        v, told, lost = volts_of(ground)
        state, out = step(state, v, told, lost)
        ground = int(out.ground)
        if fault >= 0 or k % HELD < 10 or len(places) > CASES[name][1]:
            continue
        seen += 1
        found = int(out.contacts.count)
        right += found == len(places)
        doubted += int(out.flags) != 0
        if found == len(places) > 0:
            gap = np.asarray(out.contacts.xy)[:found, None] - places
            away += np.hypot(*gap.T).min(0).tolist()
    return {
        "kind": "own", "case": name, "as": "C" if step.native else "JAX",
        "dtype": str(step.dtype), "rows": seen,
        "count_right": right / seen, "doubted": doubted / seen,
        "place_median_mm": 1e3 * float(np.median(away)),
        "place_p90_mm": 1e3 * float(np.quantile(away, 0.9)),
    }  # fmt: skip


def times(name: str, count: int) -> dict:
    """Times both in turn, some 3700 slots of each; then C alone.

    The process has the settings for real time, which both gain from. The first slot of a
    turn finds the processor's memory full of the other's numbers: turns of a thousand
    slots would show that one alone at 99.9 %.
    """
    with real_time() as allowed:
        return {**timed(name, count), "settings": allowed}


def timed(name: str, count: int) -> dict:
    steps = dict(zip(("C", "JAX"), pair(name)))
    rng = np.random.default_rng([SEED, 3])
    recorded = [f(0) for f, _, fault in slots(rng, name, 4000) if fault < 0]
    spent = {as_: [] for as_ in steps}
    states = {as_: step.state for as_, step in steps.items()}
    while len(spent["C"]) < count:
        for as_, step in steps.items():
            state = states[as_]
            for v, ground, _ in recorded:
                begin = time.perf_counter_ns()
                state, out = step(state, v, ground)
                spent[as_].append(time.perf_counter_ns() - begin)
            states[as_] = state
    row = {"kind": "time", "case": name, "slots": len(spent["C"])}
    for as_, values in spent.items():
        row[as_] = {n: float(np.quantile(values, q)) / 1e3 for n, q in QUANTILES.items()}
    row["fixed work"] = fixed_work(row["C"]["p50_us"], count)
    volts = np.stack([v for v, _, _ in recorded])
    grounds = np.array([g for _, g, _ in recorded])
    each = []
    for _ in range(20):
        begin = time.perf_counter_ns()
        steps["C"].replay(states["C"], volts, grounds)
        each.append((time.perf_counter_ns() - begin) / 1e3 / len(volts))
    row["C from C"] = {"mean_us": float(np.median(each))}
    return row


def fixed_work(us: float, count: int) -> dict:
    """Times work that is always the same and takes so long: the rest is the machine's."""
    memory = np.zeros(1 << 12)

    def spent(turns: int) -> int:
        begin = time.perf_counter_ns()
        for _ in range(turns):
            memory.fill(0)
        return time.perf_counter_ns() - begin

    one = float(np.median([spent(100) for _ in range(100)])) / 1e5
    turns = max(1, round(us / one))
    each = [spent(turns) for _ in range(count)]
    return {n: float(np.quantile(each, q)) / 1e3 for n, q in QUANTILES.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--slots", type=int, default=100_000)
    parser.add_argument("--timed", type=int, help="Slots that are timed. [--slots]")
    parser.add_argument("--scenes", type=int, default=SCENES)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--case", choices=CASES, action="append")
    parser.add_argument("--part", choices=("equal", "own", "time"), action="append")
    parser.add_argument(
        "--out", type=Path, default=HERE.parents[1] / "notebooks" / "results"
    )
    given = parser.parse_args()
    globals().update(SCENES=given.scenes, SEED=given.seed)
    parts = given.part or ["equal", "own", "time"]
    table = []
    for name in given.case or CASES:
        if "equal" in parts:
            table.append(equal(name, given.slots))
        if "own" in parts:
            table += own(name, given.slots // 5)
        if "time" in parts:
            table.append(times(name, given.timed or given.slots))
        for row in table[-4:]:
            print(json.dumps(row), flush=True)
        kept(given.out / "native.json", table)


def kept(path: Path, rows: list[dict]) -> None:
    """Writes rows; those of other cases and parts stay in the file."""
    about = {(row["kind"], row["case"]) for row in rows}
    old = json.loads(path.read_text())["rows"] if path.exists() else []
    rows = [row for row in old if (row["kind"], row["case"]) not in about] + rows
    rows.sort(key=lambda row: list(CASES).index(row["case"]))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"rows": rows}, indent=1))


if __name__ == "__main__":
    main()
