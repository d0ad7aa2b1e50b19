"""Measures what flags are worth: far-off places without a doubt, on faulty rigs.

    python tests/benchmarks/doubt.py [--seed N] [--only matrix|signs] [--each 8]

Lone contacts are on rigs of resistor networks. Each fault comes alone, and then pairs of
faults. A place is far off if it is half a pitch from the contact or further. The default
seed is for judging: no threshold was set on it. The part signs judges what `tomojax info`
finds in recordings of touches, with each of five faults of wiring and with none. Writes
doubt.json and doubt.png.
"""

import argparse
import itertools
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
RESULTS = HERE.parents[1] / "notebooks" / "results"

SENSORS = {
    "8 × 8": ((8, 8, 0.02), {}),
    "6 × 5": ((6, 5, 0.012), {"sheet_resistance": 1e3, "drive_voltage": 1.0}),
    "4 × 4": ((4, 4, 0.02), {"drive_voltage": -4.5}),
    "3 × 3": ((3, 3, 0.03), {"sheet_resistance": 5e4}),
    "2 × 2": ((2, 2, 0.04), {}),
    "1 × 3": ((1, 3, 0.03), {}),
}
METHODS = {
    "8 × 8": ("source", "linear", "points", "auto", "shape"),
    "6 × 5": ("source", "points", "auto", "shape"),
    "4 × 4": ("source", "points", "auto"),
}
FEWER = ("source", "points")
SLOTS = (2, 10)

# In the signs' recordings: seeds are rigs of their own.
KINDS = {"index off by one": "ground", "rolled channels": "channels",
         "swapped pair": "channels", "constant offset": "offset",
         "sign of the drive": "drive", "sound": None}  # fmt: skip


@dataclass
class Wrong:
    """A rig's wiring and chain, which faults change."""

    m: int
    drive: float
    rng: np.random.Generator
    asked: np.ndarray
    lines: np.ndarray = field(init=False)
    channels: np.ndarray = field(init=False)
    also: int | None = None  # grounded all the time
    settling: float = 0.0
    late: int = 0  # channels read before the ground is switched
    after: list[Callable[[np.ndarray], np.ndarray]] = field(default_factory=list)

    def __post_init__(self):
        self.lines, self.channels = np.arange(self.m), np.arange(self.m)

    def read(self, made: Any) -> np.ndarray:
        """Every touch of a rig, as measured (n, S, M)."""
        exact = []
        for touch in range(len(made.volts)):
            slots = []
            for asked in self.asked:
                line = int(self.lines[asked])
                grounds = [line] if line >= 0 else []
                grounds += [self.also] if self.also not in (None, *grounds) else []
                slots.append(made.under(touch, grounds))
            exact.append(slots)
        v = np.array(exact, float)
        before = np.roll(v, 1, 1)
        v = (1 - self.settling) * v + self.settling * before
        v[..., : self.late] = before[..., : self.late]
        v = made.rig.chain.read(v[..., self.channels], self.rng)
        for change in self.after:
            v = change(v)
        return v

    def channel(self, change: Callable[[np.ndarray], Any]) -> None:
        """Changes one channel after it is read."""
        e = int(self.rng.integers(self.m))

        def changed(v: np.ndarray) -> np.ndarray:
            v = v.copy()
            v[..., e] = change(v[..., e])
            return v

        self.after.append(changed)


def index(rig: Wrong) -> None:
    rig.lines = np.roll(rig.lines, -int(rig.rng.choice([-1, 1])))


def rolled(rig: Wrong) -> None:
    rig.channels = np.roll(rig.channels, int(rig.rng.choice([-1, 1])))


def swapped(rig: Wrong) -> None:
    a, b = rig.rng.choice(rig.m, 2, replace=False)
    rig.channels = rig.channels.copy()
    rig.channels[[a, b]] = rig.channels[[b, a]]


def missing_ground(rig: Wrong) -> None:
    rig.lines = rig.lines.copy()
    rig.lines[rig.asked[0]] = -1


def more_ground(rig: Wrong) -> None:
    rig.also = int(rig.rng.integers(rig.m))


def dead(rig: Wrong) -> None:
    rig.channel(np.zeros_like)


def stuck(rig: Wrong) -> None:
    level = rig.drive * rig.rng.uniform(0.1, 0.9)
    rig.channel(lambda v: level + 0 * v)


def gain(rig: Wrong) -> None:
    factor = float(rig.rng.choice([0.7, 1.3]))
    rig.channel(lambda v: factor * v)


def offset(rig: Wrong) -> None:
    by = abs(rig.drive) * float(rig.rng.choice([-0.1, 0.2]))
    rig.after.append(lambda v: v + by)


def noise(rig: Wrong) -> None:
    rng, rms = rig.rng, 0.01 * abs(rig.drive)
    rig.after.append(lambda v: v + rms * rng.normal(size=v.shape))


def range_end(rig: Wrong) -> None:
    end = 0.3 * abs(rig.drive)
    rig.after.append(lambda v: np.clip(v, -end, end))


def against(rig: Wrong) -> None:
    rig.after.append(np.negative)


def late(rig: Wrong) -> None:
    rig.late = rig.m // 2


def lingering(rig: Wrong) -> None:
    rig.settling = 0.3


def none(rig: Wrong) -> None:
    pass


FAULTS = {
    "none": none, "index off by one": index, "rolled channels": rolled,
    "swapped pair": swapped, "line without a ground": missing_ground,
    "a second ground": more_ground, "dead channel": dead, "stuck channel": stuck,
    "gain of 30 %": gain, "offset": offset, "noise of 1 %": noise,
    "range of 30 %": range_end, "sign of the drive": against,
    "half read before the switch": late, "30 % of the slot before": lingering,
}  # fmt: skip


def sensor_of(name: str) -> Any:
    import faulty

    (rows, columns, pitch), words = SENSORS[name]
    return faulty.grid(rows, columns, pitch, **words)


def rigs_of(sensor: Any, seed: int, rigs: int, each: int) -> list[Any]:
    """Exact voltages of touches on rigs drawn by default."""
    import faulty

    from bench.rigs import draw_touch, make_rig, network_of

    rng, found = np.random.default_rng([seed, sensor.electrode_count]), []
    size, grounds = np.asarray(sensor.size, float), np.arange(sensor.electrode_count)
    for _ in range(rigs):
        made = make_rig(sensor, "usual", rng)
        exact, touches = network_of(made), []
        while len(touches) < each:
            try:
                touches.append(draw_touch(sensor, "usual", rng))
            except ValueError:  # larger than the strip is wide
                continue
        inside = [t for t in touches if max(t.half_axes) < size.min() / 2]
        volts = np.array([exact.touched(t, grounds) for t in inside])
        xy = np.array([t.centre for t in inside])
        found.append(faulty.Voltages(made, xy, volts))
    return found


def grounds_of(sensor: Any, count: int) -> np.ndarray:
    """The two corners, and others spread over the sheet."""
    import tomojax as tx

    corners, m = np.asarray(tx.paper.exploration(sensor)), sensor.electrode_count
    rest = np.setdiff1d(np.arange(m), corners)
    return np.concatenate([corners, rest[:: max(1, len(rest) // (count - 1))]])[:count]


def judged(rows: Any, xy: np.ndarray, half: float) -> dict[str, int]:
    import tomojax as tx

    off = np.hypot(*np.moveaxis(rows.contact_xy - xy[:, None], -1, 0))
    there = np.arange(off.shape[1]) < rows.contact_count[:, None]
    told = rows.contact_count > 0
    far = told & (np.where(there, off, 0).max(1) > half)
    doubt = (rows.flags & int(tx.methods.DOUBT)) > 0
    return {
        "scenes": len(told),
        "told": int(told.sum()),
        "far": int(far.sum()),
        "far_undoubted": int((far & ~doubt).sum()),
        "right": int((told & ~far).sum()),
        "right_doubted": int((told & ~far & doubt).sum()),
    }


def matrix(options: argparse.Namespace) -> list[dict[str, Any]]:
    """A row for each sensor, method, number of slots and fault, or pair of faults."""
    import tomojax as tx

    rng = np.random.default_rng(options.seed)
    single = [(name,) for name in FAULTS]
    every = list(itertools.combinations([f for f in FAULTS if f != "none"], 2))
    rows = []
    for name in SENSORS:
        sensor = sensor_of(name)
        made = rigs_of(sensor, options.seed, options.rigs, options.each)
        xy = np.concatenate([rig.xy for rig in made])
        pairs = [every[k] for k in rng.permutation(len(every))[: options.pairs]]
        batches = {}
        for method in METHODS.get(name, FEWER):
            model = tx.method(sensor, method)
            batches[method] = tx.Batch(model, model.choose_lambda([]), 3, images=False)
        for count in SLOTS:
            grounds = grounds_of(sensor, count)
            for faults in single + (pairs if count == SLOTS[0] else []):
                volts = []
                for k, rig in enumerate(made):
                    seed = [options.seed, count, k, *"+".join(faults).encode()]
                    drive = float(sensor.drive_voltage)
                    wrong = Wrong(
                        sensor.electrode_count, drive, np.random.default_rng(seed), grounds
                    )
                    for fault in faults:
                        FAULTS[fault](wrong)
                    volts.append(wrong.read(rig))
                v = np.concatenate(volts).astype(np.float32)
                for method, batch in batches.items():
                    found = batch(v, np.tile(grounds, (len(v), 1)))
                    about = {"sensor": name, "method": method, "slots": count}
                    about["fault"] = " + ".join(faults)
                    rows.append(about | judged(found, xy, sensor.mean_pitch / 2))
        tell(name, [row for row in rows if row["sensor"] == name])
    return rows


def total(rows: list[dict[str, Any]]) -> dict[str, int]:
    keys = "far", "far_undoubted", "right", "right_doubted"
    return {key: sum(row[key] for row in rows) for key in keys}


def tell(what: str, rows: list[dict[str, Any]]) -> None:
    faulty = total([row for row in rows if row["fault"] != "none"])
    sound = total([row for row in rows if row["fault"] == "none"])
    print(
        f"{what}: {faulty['far']} places far off, {faulty['far_undoubted']} undoubted; "
        f"sound rigs: {sound['right']} right, {sound['right_doubted']} doubted, "
        f"{sound['far']} far off, {sound['far_undoubted']} without a doubt",
        flush=True,
    )


def recordings(options: argparse.Namespace) -> list[dict[str, Any]]:
    """What `find_signs` says of recordings; each has a fault, or none."""
    import faulty

    from tomojax.bringup.signs import find_signs

    names = [name for name in SENSORS if name not in ("3 × 3", "2 × 2", "1 × 3")]
    made = {}
    for name in names:
        sensor = sensor_of(name)
        made[name] = rigs_of(sensor, options.seed + 1, options.rigs, 40)
    rows = []
    for number in range(options.recordings):
        kind = list(KINDS)[min(number // 40, 5)] if number < 200 else "sound"
        rng = np.random.default_rng([options.seed, number, 3])
        name = names[int(rng.integers(len(names)))]
        base = made[name][int(rng.integers(options.rigs))]
        touches = int(rng.integers(12, 40))
        some = base._replace(volts=np.concatenate([base.volts[:touches], base.volts[:4]]))
        recording = faulty.recorded(
            some, number, corners=(), **_words(kind, some.volts.shape[1], rng)
        )
        found = [s.kind for s in find_signs(_changed(kind, recording, rng))]
        expected = KINDS[kind]
        right = expected in found if expected else not found
        told = {"kind": kind, "sensor": name, "touches": touches, "found": found}
        rows.append(told | {"right": right})
    for kind in KINDS:
        mine = [row["right"] for row in rows if row["kind"] == kind]
        print(f"{kind}: {sum(mine)} of {len(mine)} right", flush=True)
    return rows


def _words(kind: str, m: int, rng: np.random.Generator) -> dict[str, Any]:
    """How a recording is made: its pattern, its silence and its wiring."""
    patterns = (
        np.array([0, m - 1]),
        np.concatenate([[0, m - 1], rng.choice(m, 8, replace=False)]),
        np.arange(m),
        rng.integers(0, m, 400),
    )
    pattern = patterns[int(rng.integers(4))]
    hold = int(rng.choice([4, min(len(pattern), 64)]))
    words = {"pattern": pattern, "hold": hold, "quiet": int(rng.choice([0, 400]))}
    wrong = Wrong(m, 1.0, rng, pattern)
    wiring = {"index off by one": index, "rolled channels": rolled, "swapped pair": swapped}
    wiring.get(kind, none)(wrong)
    return words | {"lines": wrong.lines, "channels": wrong.channels}


def _changed(kind: str, recording: Any, rng: np.random.Generator) -> Any:
    import tomojax as tx

    scans, rig = recording.read(0, recording.scans), recording.rig
    drive = rig.drive_voltage
    rig = replace(rig, rails=(-1.6 * abs(drive), 1.6 * abs(drive)))
    volts = scans.voltages
    if kind == "constant offset":
        volts = volts + drive * rng.choice([-1, 1]) * rng.uniform(0.05, 0.3)
    if kind == "sign of the drive":
        volts = -volts
    return tx.recordings.ArrayRecording(rig, volts, scans.grounds)


def plot(rows: list[dict[str, Any]], signs: list[dict[str, Any]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from tomojax._pictures import BLUE, GREY

    singles = [row for row in rows if " + " not in row["fault"]]
    columns = list(dict.fromkeys((r["sensor"], r["method"]) for r in singles))
    names = list(FAULTS)
    share = np.full((len(names) + 1, len(columns)), np.nan)
    words = np.full(share.shape, "", object)
    for j, (sensor, method) in enumerate(columns):
        mine = [r for r in rows if (r["sensor"], r["method"]) == (sensor, method)]
        for i, fault in enumerate([*names, "pairs of them"]):
            some = [r for r in mine if r["fault"] == fault
                    or (i == len(names) and " + " in r["fault"])]  # fmt: skip
            t = total(some)
            part = (t["right_doubted"], t["right"]) if fault == "none" else (
                t["far_undoubted"], t["far"])  # fmt: skip
            if part[1]:
                share[i, j] = part[0] / part[1]
            words[i, j] = f"{part[0]}/{part[1]}"
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(17, 7.6), width_ratios=(3.4, 1), layout="constrained"
    )
    figure.suptitle("What the flags are worth on faulty rigs")
    shown = left.imshow(share, vmin=0, vmax=0.2, cmap="magma_r", aspect="auto")
    figure.colorbar(shown, ax=left, label="part of the places (first number / second)",
                    extend="max", shrink=0.6)  # fmt: skip
    for (i, j), word in np.ndenumerate(words):
        dark = np.nan_to_num(share[i, j]) > 0.1
        colour = "w" if dark else "0.5" if word.endswith("/0") else "k"
        left.text(j, i, word, ha="center", va="center", fontsize=7, color=colour)
    labels = [f"{method}, {sensor}" for sensor, method in columns]
    left.set_xticks(range(len(columns)), labels, rotation=60, ha="right",
                    rotation_mode="anchor", fontsize=8)  # fmt: skip
    left.axhline(0.5, color="k", lw=1)
    first = ["no fault: right places in doubt", *names[1:], "pairs of faults"]
    left.set_yticks(range(len(names) + 1), first, fontsize=8)
    left.set_title("Of places over half a pitch off, those without a doubt, by fault")
    left.set_xlabel("method, electrodes")
    kinds = list(KINDS)
    parts = [[r["right"] for r in signs if r["kind"] == k] for k in kinds]
    height = [100 * np.mean(p) if p else 0 for p in parts]
    right.barh(kinds, height, color=[BLUE] * 5 + [GREY])
    for k, p in enumerate(parts):
        right.text(2, k, f"{sum(p)} of {len(p)}", va="center", color="w", fontsize=9)
    right.invert_yaxis()
    right.set(xlabel="part of the recordings, %")
    right.set_title("Named by tomojax info alone\n(sound: nothing named)")
    figure.savefig(path, dpi=110)


def main() -> None:
    from bench.rigs import JUDGING

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=JUDGING + 300)
    parser.add_argument("--only", choices=("matrix", "signs"))
    parser.add_argument("--rigs", type=int, default=3)
    parser.add_argument("--each", type=int, default=8)
    parser.add_argument("--pairs", type=int, default=30)
    parser.add_argument("--recordings", type=int, default=300)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    path = options.out / "doubt.json"
    whole = json.loads(path.read_text()) if options.only and path.exists() else {}
    if options.only != "matrix":
        whole["signs"] = recordings(options)
    if options.only != "signs":
        whole["rows"] = matrix(options)
    whole["options"] = {k: str(v) for k, v in vars(options).items() if k != "out"}
    rows = whole.get("rows", [])
    if rows:
        tell("all", rows)
    path.write_text(json.dumps(whole, indent=1) + "\n")
    if rows and "signs" in whole:
        plot(rows, whole["signs"], options.out / "doubt.png")


if __name__ == "__main__":
    main()
