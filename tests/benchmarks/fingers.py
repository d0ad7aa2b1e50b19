"""Counts two and three fingers by `follow`: at once, one after another, and as taps.

    python tests/benchmarks/fingers.py [--seed N] [--rigs 4] [--each 2] [--out FILE]

Half of the rigs are resistor networks of `tests/rig.py`, half are drawn by `bench.rigs`.
The nearest two fingers are 20 to 120 mm apart. Grounds are fixed: two corners, or ten. Each
scene holds 60 slots after the last finger. The count is right where every slot from the
20th on has it. The place is that of the farthest finger, its median over these slots. Taps
are all fingers down for 40 slots, up for 40, four times over: `touch_down` is counted. No
threshold was set on the default seed. Writes fingers.json.
"""

import argparse
import json
import sys
from itertools import permutations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
RESULTS = HERE.parents[1] / "notebooks" / "results"

APART = 20, 30, 40, 60, 80, 100, 120  # mm
EMPTY, BETWEEN, WITHIN, HELD, TAPS, TAP = 20, 40, 20, 60, 4, 40  # slots


class Scene(NamedTuple):
    """Exact voltages (M grounds, M) without fingers, with the first, with two, …"""

    apart: int  # mm
    xy: np.ndarray  # (n, 2) m
    volts: list[np.ndarray]
    read: Any  # from exact voltages (S, M) to readings


def places(count: int, apart: float, size: np.ndarray, rng) -> np.ndarray:
    """Fingers on the sheet; two of them `apart`, m, no two nearer."""
    while True:
        angle, first = rng.uniform(0, 2 * np.pi), rng.uniform(0.01, size - 0.01)
        second = first + apart * np.array([np.cos(angle), np.sin(angle)])
        more = rng.uniform(0.01, size - 0.01, (count - 2, 2))
        xy = np.array([first, second, *more])
        far = np.hypot(*(xy[:, None] - xy).transpose(2, 0, 1))[np.triu_indices(count, 1)]
        if (xy > 0.01).all() and (xy < size - 0.01).all() and far.min() > apart - 1e-9:
            return xy


def scenes(sensor: Any, count: int, grounds: np.ndarray, options) -> list[Scene]:
    from rig import Rig

    from bench.rigs import make_rig, network_of

    found, size = [], np.asarray(sensor.size, float)
    for k in range(options.rigs):
        rng = np.random.default_rng([options.seed, count, k])
        if k % 2:
            drawn = make_rig(sensor, "usual", rng)
            network = network_of(drawn).network

            def read(v, rng, chain=drawn.chain):
                return chain.read(v, rng)
        else:
            network = Rig(rng)

            def read(v, rng, network=network):
                return network.measure(v)

        for apart in APART:
            for _ in range(options.each):
                xy = places(count, apart / 1e3, size, rng)
                total = 10 ** rng.uniform(-5, -3.5) * 10 ** rng.uniform(0, 0.5, count)
                touch = [
                    (network.disc(p, r).astype(float), float(g))
                    for p, r, g in zip(xy, rng.uniform(0.003, 0.008, count), total)
                ]
                volts = [np.zeros((len(grounds), sensor.electrode_count))]
                volts += [network.under(grounds, *touch[: n + 1]) for n in range(count)]
                found.append(Scene(apart, xy, volts, read))
    return found


def slots_of(scene: Scene, stages: list[tuple[int, int]], which: np.ndarray, rng) -> Any:
    """Readings of (fingers, slots) in order; `which` of the exact grounds take turns."""
    n = np.repeat(*np.array(stages).T)
    turn = which[np.arange(len(n)) % len(which)]
    return scene.read(np.array(scene.volts)[n, turn], rng), turn


def farthest(found: np.ndarray, xy: np.ndarray) -> float:
    ways = permutations(range(len(xy)))
    return min(float(np.hypot(*(found[list(p)] - xy).T).max()) for p in ways)


def measured(options: argparse.Namespace) -> dict[str, Any]:
    from attacks import grounds_of

    import tomojax as tx
    from tomojax.events import EventFinder

    sensor = tx.Sensor.grid(dtype=np.float32)
    grounds, kinds = grounds_of(sensor, 10), {"two": np.arange(2), "ten": np.arange(10)}
    step, rows, taps = tx.make_step(sensor, contacts=4), [], []

    def told(v: np.ndarray, turn: np.ndarray) -> Any:
        lost = np.zeros(len(v), np.int32)
        return step.replay(step.state, v.astype(np.float32), grounds[turn], lost)[1]

    for count in (2, 3):
        drawn = scenes(sensor, count, grounds, options)
        for name, which in kinds.items():
            for way in ("at once", "one after another"):
                stages = [(0, EMPTY), (count, HELD)]
                if way != "at once":
                    some = [(n, BETWEEN) for n in range(1, count)]
                    stages = [(0, EMPTY), *some, (count, HELD)]
                for k, scene in enumerate(drawn):
                    rng = np.random.default_rng([options.seed, count, k, len(which)])
                    out = told(*slots_of(scene, stages, which, rng))
                    late = slice(WITHIN - HELD, None)
                    right = np.asarray(out.contacts.count)[late] == count
                    xy = np.asarray(out.contacts.xy, float)[late][right, :count]
                    off = [farthest(one, scene.xy) for one in xy]
                    doubt = np.asarray(out.flags)[late] & int(tx.methods.DOUBT) > 0
                    rows.append(
                        {
                            "fingers": count,
                            "grounds": name,
                            "way": way,
                            "apart_mm": scene.apart,
                            "scene": k,
                            "count_right": bool(right.all()),
                            "slots_right": round(float(right.mean()), 3),
                            "place_mm": round(1e3 * np.median(off), 3) if off else None,
                            "doubted": round(float(doubt.mean()), 3),
                        }
                    )
            for k, scene in enumerate(drawn):
                rng = np.random.default_rng([options.seed, count, k, len(which), 9])
                stages = [(0, EMPTY), *[(count, TAP), (0, TAP)] * TAPS]
                out = told(*slots_of(scene, stages, which, rng))
                finder = EventFinder.of_rows(sensor.mean_pitch, 1e-4)
                c, t = out.contacts, np.arange(len(out.flags)) * 1e-4
                each = (np.asarray(a) for a in (c.count, c.xy, c.conductance, out.flags))
                events = finder.rows(t, *each) + finder.finish()
                down = sum(event.kind == "touch_down" for event in events)
                taps.append(
                    {
                        "fingers": count,
                        "grounds": name,
                        "apart_mm": scene.apart,
                        "scene": k,
                        "taps": TAPS * count,
                        "touch_downs": down,
                    }
                )
    return {"rows": rows, "taps": taps, "summary": summary(rows, taps)}


def summary(rows: list[dict], taps: list[dict]) -> list[dict]:
    found = []
    for count, name in ((c, g) for c in (2, 3) for g in ("two", "ten")):
        about = {"fingers": count, "grounds": name}
        for way in ("at once", "one after another"):
            mine = [r for r in rows if r.items() >= (about | {"way": way}).items()]
            off = [np.inf if r["place_mm"] is None else r["place_mm"] for r in mine]
            found.append(about | {"way": way, "scenes": len(mine)})
            found[-1] |= {
                "count_right": round(float(np.mean([r["count_right"] for r in mine])), 3),
                "place_median_mm": round(float(np.median(off)), 3),
                "place_p90_mm": round(float(np.quantile(off, 0.9, method="lower")), 3),
                "within_1_mm": round(float(np.mean(np.array(off) <= 1)), 3),
                "doubted": round(float(np.mean([r["doubted"] for r in mine])), 3),
                "wrong_undoubted": sum(
                    not r["count_right"] and r["doubted"] < 0.5 for r in mine
                ),
            }
        mine = [r for r in taps if r.items() >= about.items()]
        same = [r["taps"] == r["touch_downs"] for r in mine]
        each = {key: sum(r[key] for r in mine) for key in ("taps", "touch_downs")}
        found.append(about | {"way": "taps", "scenes": len(mine)} | each)
        found[-1]["as_many"] = round(float(np.mean(same)), 3)
    return found


def main() -> None:
    from bench.rigs import JUDGING

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=JUDGING + 777)
    parser.add_argument("--rigs", type=int, default=4)
    parser.add_argument("--each", type=int, default=2)
    parser.add_argument("--out", type=Path, default=RESULTS / "fingers.json")
    options = parser.parse_args()
    whole = measured(options)
    for row in whole["summary"]:
        print(json.dumps(row))
    whole["options"] = {k: v for k, v in vars(options).items() if k != "out"}
    options.out.write_text(json.dumps(whole, indent=1) + "\n")


if __name__ == "__main__":
    main()
