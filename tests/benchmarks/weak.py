"""Counts rows of `source` that miss a weak contact beside a strong one without a doubt.

    python tests/benchmarks/weak.py [--seed N] [--rigs 4] [--each 18] [--method source]

Rigs of resistor networks; contacts two pitches apart or further, one with a tenth to a
hundredth of the other's conductance. Lone contacts on the same kind of rigs tell how many
rows are doubted needlessly. No threshold was set on the default seed. Writes weak.json.
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

RATIOS = 1, 10, 30, 100  # 1: a lone contact


def measured(options: argparse.Namespace) -> list[dict[str, Any]]:
    import faulty
    from attacks import grounds_of

    import tomojax as tx
    from bench import attacked

    rows = []
    for side in (6, 8):
        sensor = faulty.grid(side, side)
        model = tx.method(sensor, options.method)
        batch = tx.Batch(model, model.choose_lambda([]), 3, images=False)
        rigs, each, apart = options.rigs, options.each, 2 * sensor.mean_pitch
        for ratio in RATIOS:
            if ratio == 1:
                scenes = attacked.lone(sensor, options.seed, rigs, each)
            else:
                scenes = attacked.pairs(sensor, options.seed, rigs, each, apart, ratio)
            for slots in (2, 10):
                grounds = grounds_of(sensor, slots)
                rng = np.random.default_rng([options.seed, ratio])
                v = np.array([attacked.sound(s, grounds, rng) for s in scenes], np.float32)
                found = batch(v, np.tile(grounds, (len(v), 1)))
                doubt = found.flags & int(tx.methods.DOUBT) > 0
                right = found.contact_count == (1 if ratio == 1 else 2)
                rows.append(
                    {
                        "electrodes": side * side,
                        "ratio": ratio,
                        "slots": slots,
                        "scenes": len(v),
                        "count_right": int(right.sum()),
                        "wrong_undoubted": int((~right & ~doubt).sum()),
                        "right_doubted": int((right & doubt).sum()),
                    }
                )
                print(json.dumps(rows[-1]), flush=True)
    return rows


def main() -> None:
    from bench.rigs import JUDGING

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=JUDGING + 511)
    parser.add_argument("--rigs", type=int, default=4)
    parser.add_argument("--each", type=int, default=18)
    parser.add_argument("--method", default="source")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    about = {k: str(v) for k, v in vars(options).items() if k != "out"}
    whole = {"rows": measured(options), "options": about}
    (options.out / "weak.json").write_text(json.dumps(whole, indent=1) + "\n")


if __name__ == "__main__":
    main()
