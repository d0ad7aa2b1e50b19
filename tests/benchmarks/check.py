"""Tries `tomojax check` on faulty rigs of two models, and on sound ones.

    python tests/benchmarks/check.py [--seed N] [--only WORD]

Each fault of the list comes alone, on rigs of finite elements and on resistor networks.
Sensors have other grids, pitches, sheets and drives. Scans have one, ten or all slots, at 1
to 10 kHz. Pairs of faults follow, and sound rigs, some of other kinds than drawn by
default. A fault is found if its kind and its channels are named. A name that was not made
is a false one. The default seed is for judging. Writes check.json and check.png.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
RESULTS = HERE.parents[1] / "notebooks" / "results"

SENSORS = {
    "8 × 8, 20 mm": {"rows": 8, "columns": 8},
    "6 × 5, 12 mm, 1 kΩ": {"rows": 6, "columns": 5, "pitch": 0.012,
                           "sheet_resistance": 1e3},
    "5 × 5, 30 mm, 50 kΩ, 1 V": {"rows": 5, "columns": 5, "pitch": 0.03,
                                  "sheet_resistance": 5e4, "drive_voltage": 1.0,
                                  "ground_resistance": 100.0},
    "7 × 9, 15 mm, 3 V": {"rows": 7, "columns": 9, "pitch": 0.015, "drive_voltage": 3.0},
}  # fmt: skip

# Faults of the wiring, the chain and the header: made on rigs that are sound otherwise.
WIRED = (
    "dead", "stuck", "rail", "swapped", "wires", "cycle", "row", "mirrored", "turned",
    "all mirrored", "all turned", "permuted", "off by", "never", "always", "drive low",
    "drive high", "sheet low", "sheet high", "gain", "gain small", "settling",
    "settling long", "slow channel", "hum", "hum 60", "noise", "noise all",
)  # fmt: skip
# Faults of the sheet and its electrodes: each has a rig of its own.
SHEETS = "tear", "joint", "misplaced"


class Draw:
    """Draws faults for one rig; what was made is kept, so that pairs do not overlap."""

    def __init__(self, sensor: Any, rng: np.random.Generator):
        self.sensor, self.rng = sensor, rng
        self.m = sensor.electrode_count
        self.free = list(rng.permutation(self.m))
        xy = np.asarray(sensor.electrode_xy, float)
        self.rows = len(np.unique(np.round(xy[:, 0], 6)))
        self.columns = self.m // self.rows
        self.given: dict[str, Any] = {}
        self.truth: set[tuple[str, tuple[int, ...]]] = set()

    def some(self, count: int) -> list[int]:
        return [int(self.free.pop()) for _ in range(count)]

    def _order(self, name: str) -> np.ndarray:
        return self.given.setdefault(name, np.arange(self.m))

    def _symmetry(self, name: str) -> np.ndarray:
        import faulty

        square = self.rows == self.columns
        mirrors = [(False, True, False), (False, False, True)]
        turns = [(False, True, True)]
        if square:
            mirrors.append((True, False, False))
            turns += [(True, True, False), (True, False, True)]
        among = mirrors if "mirrored" in name else turns
        return faulty.symmetry(
            self.rows, self.columns, *among[self.rng.integers(len(among))]
        )

    def fault(self, name: str) -> None:
        rng, m = self.rng, self.m
        drive = float(self.sensor.drive_voltage)
        channels: tuple[int, ...] = ()
        kind = name.split()[0]
        if name in ("dead", "stuck", "rail", "noise", "gain", "gain small", "slow channel"):
            channels = tuple(self.some(1))
        if name == "dead":
            self.given["dead"] = list(channels)
            self.given["whole"] = bool(rng.integers(2))
        elif name in ("stuck", "rail"):
            kind, level = "stuck", drive * rng.uniform(0.05, 0.95)
            level = drive / 0.9 if name == "rail" else level
            self.given["stuck"] = {channels[0]: level}
        elif name in ("swapped", "wires", "cycle"):
            kind = "swapped"
            channels = tuple(self.some(3 if name == "cycle" else 2))
            for each in ("channels", "lines") if name == "wires" else ("channels",):
                order = self._order(each)
                order[list(channels)] = order[list(np.roll(channels, 1))]
        elif name == "row":
            kind = "mirrored"
            start = int(rng.integers(self.rows)) * self.columns
            channels = tuple(range(start, start + self.columns))
            order = self._order("channels")
            order[list(channels)] = order[list(channels)][::-1]
        elif name in ("mirrored", "turned", "all mirrored", "all turned"):
            kind, image = name.split()[-1], self._symmetry(name)
            for each in ("channels", "lines") if "all" in name else ("channels",):
                self.given[each] = np.where(
                    self._order(each) >= 0, image[self._order(each)], -1
                )
        elif name in ("permuted", "never"):
            kind = "ground_permuted" if name == "permuted" else "ground_stuck"
            channels = tuple(self.some(2 if name == "permuted" else 1))
            order = self._order("lines")
            order[list(channels)] = -1 if name == "never" else order[list(channels)[::-1]]
        elif name == "off by":
            kind, step = "ground_off_by", int(rng.choice([-1, 1]))
            lines = self._order("lines") + step
            inside = (lines >= 0) & (lines < m)
            self.given["lines"] = np.where(
                inside, lines, -1 if rng.integers(2) else lines % m
            )
        elif name == "always":
            kind, channels = "ground_stuck", tuple(self.some(1))
            self.given["on"] = channels[0]
        elif kind in ("drive", "sheet"):
            field = "drive_voltage" if kind == "drive" else "sheet_resistance"
            small = (0.5, 0.8) if kind == "drive" else (0.3, 0.55)
            large = (1.25, 2.0) if kind == "drive" else (1.8, 3.0)
            span = small if name.endswith("low") else large
            self.given.setdefault("told", {})[field] = float(rng.uniform(*span))
            kind = "drive" if kind == "drive" else "sheet_resistance"
        elif kind == "gain":
            by = rng.uniform(0.02, 0.04) if "small" in name else rng.uniform(0.05, 0.5)
            self.given.setdefault("gain", {})[channels[0]] = 1 + by * rng.choice([-1, 1])
        elif name in ("settling", "settling long"):
            self.given["settling"] = float(
                rng.uniform(0.2, 0.42) if "long" in name else rng.uniform(0.02, 0.15)
            )
        elif name == "slow channel":
            kind = "settling"
            part = np.zeros(m)
            part[channels[0]] = rng.uniform(0.1, 0.6)
            self.given["settling"] = part
        elif kind == "hum":
            self.given["hum"] = drive * float(rng.uniform(8e-4, 5e-3))
            self.given["hum_frequency"] = 60.0 if "60" in name else 50.0
        elif name == "noise":
            self.given["noise"] = {channels[0]: drive * float(rng.uniform(5e-4, 5e-3))}
        elif name == "noise all":
            every = drive * float(rng.uniform(1e-3, 3e-3))
            self.given["noise"] = {c: every for c in range(m)}
        self.truth.add((kind, channels))

    def sheet(self, name: str) -> dict[str, Any]:
        """Words for a rig of its own, and the fault's truth; electrodes near a tear."""
        rng, size = self.rng, np.asarray(self.sensor.size, float)
        pitch = float(self.sensor.mean_pitch)
        if name == "misplaced":
            (e,) = self.some(1)
            turn, far = rng.uniform(0, 2 * np.pi), pitch * rng.uniform(0.18, 0.35)
            self.truth.add(("misplaced", (e,)))
            return {"misplaced": {e: (far * np.cos(turn), far * np.sin(turn))}}
        if name == "joint":
            (e,) = self.some(1)
            square = float(np.mean(np.asarray(self.sensor.sheet_resistance)))
            self.truth.add(("tear", (e,)))
            return {"joint": {e: square * rng.uniform(1.0, 5.0)}}
        middle = size * rng.uniform(0.3, 0.7, 2)
        angle, half = rng.uniform(0, np.pi), pitch * rng.uniform(1.0, 1.8)
        along = np.array([np.cos(angle), np.sin(angle)])
        more = float(rng.uniform(20, 100))
        self.torn = middle
        self.truth.add(("tear", ("near",)))  # pyright: ignore[reportArgumentType]

        def tear(points: np.ndarray) -> np.ndarray:
            t = np.clip((points - middle) @ along, -half, half)
            away = np.hypot(*(points - middle - t[:, None] * along).T)
            return np.where(away < 0.06 * pitch, more, 1.0)

        return {"tear": tear}


def judged(draw: Draw, found: Any) -> tuple[bool, list[str], list[str]]:
    """Whether all is named, what was missed and what was named falsely."""
    named = [(f.kind, tuple(sorted(map(int, f.channels))), f) for f in found.faults]
    left, missed = list(named), []
    pitch = 1e3 * draw.sensor.mean_pitch
    for kind, channels in draw.truth:
        for one in left:
            near = False
            if channels == ("near",) and one[0] == kind:
                at = np.array([one[2].value["x_mm"], one[2].value["y_mm"]])
                near = bool(np.hypot(*(at - 1e3 * draw.torn)) < 1.5 * pitch)
            if one[0] == kind and (one[1] == tuple(sorted(channels)) or near):
                left.remove(one)
                break
        else:
            missed.append(f"{kind} {channels}")
    false = [f"{kind} {channels}" for kind, channels, _ in left]
    return not missed and not false, missed, false


PAIRS = (
    ("dead", "swapped"), ("dead", "gain"), ("stuck", "mirrored"), ("swapped", "permuted"),
    ("swapped", "settling"), ("off by", "gain"), ("never", "dead"), ("always", "gain"),
    ("always", "swapped"), ("drive low", "sheet high"), ("drive high", "mirrored"),
    ("hum", "noise"), ("hum", "gain"), ("settling", "gain"), ("slow channel", "gain"),
    ("row", "dead"), ("all turned", "permuted"), ("off by", "swapped"),
    ("tear", "dead"), ("tear", "gain"), ("misplaced", "gain"), ("misplaced", "swapped"),
    ("joint", "stuck"), ("sheet low", "hum"), ("settling", "drive low"),
)  # fmt: skip
SOUND = (
    "usual", "usual", "usual", "patches", "ellipse", "face_60", "grounds", "gradient",
    "profile", "reading", "bits_18", "faces", "usual", "usual",
)  # fmt: skip


def _sound(sensor: Any, row: str, rng: np.random.Generator, model: Any) -> Any:
    """A sound rig of a kind, and its touches."""
    import faulty

    from bench.rigs import make_rig

    return faulty.touched(make_rig(sensor, row, rng), rng, 70, model, row)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1_000_100)
    parser.add_argument("--only", default="")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    import faulty

    from bench.rigs import Elements, network_of
    from tomojax import bringup

    sensors = {name: faulty.grid(**words) for name, words in SENSORS.items()}
    models = {"elements": Elements, "network": network_of}
    bases: dict[tuple[str, str], Any] = {}
    tasks = [("single", (name,)) for name in WIRED + SHEETS for _ in range(2)]
    tasks += [("single", (name,)) for name in SHEETS]
    tasks += [("pair", pair) for pair in PAIRS] + [("sound", (row,)) for row in SOUND]
    rows: list[dict[str, Any]] = []
    for number, (group, names) in enumerate(tasks):
        if options.only not in " ".join((group, *names)):
            continue
        rng = np.random.default_rng([options.seed, number])
        where, model = list(sensors)[number % 4], list(models)[number // 2 % 2]
        sensor, make = sensors[where], models[model]
        draw = Draw(sensor, rng)
        if group == "sound":
            made = _sound(sensor, names[0], rng, make)
        else:
            words: dict[str, Any] = {}
            for name in names:
                words |= draw.sheet(name) if name in SHEETS else {}
                if name not in SHEETS:
                    draw.fault(name)
            if words:
                made = faulty.voltages_of(
                    sensor, int(rng.integers(1 << 30)), 70, make, **words
                )
            else:
                if (where, model) not in bases:
                    seed = options.seed + len(bases)
                    bases[where, model] = faulty.voltages_of(sensor, seed, 70, make)
                made = bases[where, model]
        m = sensor.electrode_count
        f_switch = float(rng.choice([1e3, 2e3, 5e3, 1e4]))
        slots = int(rng.choice([1, 10, m]))
        pattern = rng.permutation(m) if rng.integers(2) else np.arange(m)
        recording = faulty.recorded(
            made, int(rng.integers(1 << 30)), slots=slots, pattern=pattern,
            f_switch=f_switch, **draw.given,
        )  # fmt: skip
        start = time.perf_counter()
        try:
            found = bringup.check(recording)
            whole, missed, false = judged(draw, found)
        except ValueError as error:
            whole, missed, false = False, [str(error)], []
        rows.append(
            {
                "group": group, "faults": list(names), "sensor": where, "model": model,
                "slots": slots, "f_switch": f_switch, "seed": options.seed,
                "named": whole, "missed": missed, "false": false,
                "seconds": time.perf_counter() - start,
            }
        )  # fmt: skip
        print(json.dumps(rows[-1], ensure_ascii=False), flush=True)
    report(rows, options.out)


def report(rows: list[dict[str, Any]], out: Path) -> None:
    from tomojax._environment import environment

    summary: dict[str, Any] = {}
    for group in ("single", "pair", "sound"):
        own = [row for row in rows if row["group"] == group]
        summary[group] = len(own)
        summary[f"{group}_right"] = sum(row["named"] for row in own)
        summary[f"{group}_missed"] = sum(bool(row["missed"]) for row in own)
        summary[f"{group}_false"] = sum(bool(row["false"]) for row in own)
    print("group    rigs  right  missed  false")
    for group in ("single", "pair", "sound"):
        told = [summary[group + end] for end in ("", "_right", "_missed", "_false")]
        print(f"{group:8} {told[0]:4} {told[1]:6} {told[2]:7} {told[3]:6}")
    report = {"rows": rows, "summary": summary, "environment": environment()}
    out.mkdir(parents=True, exist_ok=True)
    (out / "check.json").write_text(json.dumps(report, indent=1, ensure_ascii=False) + "\n")
    picture(rows).savefig(out / "check.png", dpi=110)


def picture(rows: list[dict[str, Any]]) -> Any:
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(" + ".join(row["faults"]) for row in rows))
    names = [f"sound: {n}" if n in SOUND else n for n in names]
    counts = {n: [0, 0, 0] for n in names}
    for row in rows:
        name = " + ".join(row["faults"])
        name = f"sound: {name}" if row["group"] == "sound" else name
        which = 0 if row["named"] else 1 if row["missed"] else 2
        counts[name][which] += 1
    from tomojax._pictures import BLUE, ORANGE, VERMILION

    figure = Figure(figsize=(8, 0.2 * len(names) + 1.4), layout="constrained")
    axes = figure.subplots()
    at, left = np.arange(len(names)), np.zeros(len(names))
    labels = "all named, nothing else", "something missed", "a false alarm alone"
    looks = (BLUE, ""), (VERMILION, "xx"), (ORANGE, "//")
    for k, (label, (colour, hatch)) in enumerate(zip(labels, looks)):
        wide = np.array([counts[n][k] for n in names])
        look = {"color": colour, "hatch": hatch, "edgecolor": "w", "label": label}
        axes.barh(at, wide, left=left, **look)
        left += wide
    axes.set_yticks(at, [name.replace("_", " ") for name in names], fontsize=8)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set(
        xlabel="number of rigs", title="What tomojax check says of faulty and sound rigs"
    )
    axes.legend(fontsize=9, loc="upper right", title="faults")
    return figure


if __name__ == "__main__":
    main()
