"""Counts recordings in which `check` names a leak, a stuck ground or lifted electrodes.

    python tests/benchmarks/leaks.py [--seed N] [--rigs 2]

Each recording has silence, a rub and two corners, under two or ten grounds, on a rig of
another model. Sound recordings beside them show false names. No threshold was set on the
default seed. Writes leaks.json.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent), str(HERE)]
RESULTS = HERE.parents[1] / "notebooks" / "results"

GRIDS = (5, 4), (6, 6), (8, 8)
LEAKS = 3e2, 1e3, 1e4, 1e5  # Ω; the sheet has 10⁴ Ω per square

# Of its voltage: what 10 MΩ, 1 MΩ and 0.2 MΩ to the sheet leave at an input of 1 MΩ.
LIFTED = 1 / 11, 1 / 2, 5 / 6


def cases(sensor: Any, grounds: np.ndarray, rng: np.random.Generator) -> dict[str, Any]:
    """Words for `recorded`, and the kind and channels that are right."""
    m = sensor.electrode_count
    one = int(rng.choice(np.setdiff1d(np.arange(m), grounds)))
    found: dict[str, Any] = {"sound": ({}, None, ())}
    found["ground stuck"] = {"on": one}, "ground_stuck", (one,)
    for ohm in LEAKS:
        found[f"leak of {ohm:g} Ω"] = {"leaks": {one: ohm}}, "leak", (one,)
    xy = np.asarray(sensor.electrode_xy, float)
    four = np.argsort(np.hypot(*(xy - rng.uniform(0.2, 0.8, 2) * xy.max(0)).T))[:4]
    four = tuple(sorted(int(e) for e in np.setdiff1d(four, grounds)))
    for part in LIFTED:
        gain = {"gain": {e: part for e in four}}
        found[f"lifted, {100 * part:.0f} % read"] = gain, "gain", four
    return found


def measured(options: argparse.Namespace) -> list[dict[str, Any]]:
    import faulty
    from attacks import grounds_of

    import tomojax as tx

    counts: dict[tuple[str, int], dict[str, int]] = {}
    for side in GRIDS:
        sensor = faulty.grid(*side)
        for rig in range(options.rigs):
            seed = options.seed + rig
            made = faulty.voltages_of(sensor, seed, touches=40)
            rng = np.random.default_rng([seed, *side])
            for slots in (2, 10):
                grounds = grounds_of(sensor, slots)
                for name, (words, kind, channels) in cases(sensor, grounds, rng).items():
                    given = faulty.recorded(
                        made, seed, slots=slots, pattern=grounds, **words
                    )
                    faults = tx.bringup.check(given).faults
                    told = {c for f in faults if f.kind == kind for c in f.channels}
                    others = [f for f in faults if f.kind != kind]
                    count = counts.setdefault(
                        (name, slots), {"recordings": 0, "named": 0, "others_named": 0}
                    )
                    count["recordings"] += 1
                    count["named"] += kind is None or told == set(channels)
                    count["others_named"] += bool(others)
    return [{"case": n, "slots": s} | c for (n, s), c in counts.items()]


def main() -> None:
    from bench.rigs import JUDGING

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=JUDGING + 512)
    parser.add_argument("--rigs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    about = {k: str(v) for k, v in vars(options).items() if k != "out"}
    whole = {"rows": measured(options), "options": about}
    for row in whole["rows"]:
        print(json.dumps(row, ensure_ascii=False))
    text = json.dumps(whole, indent=1, ensure_ascii=False)
    (options.out / "leaks.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
