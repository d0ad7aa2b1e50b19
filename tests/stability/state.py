"""Writes stated.json: limits that hold in the committed run and on seeds of its own.

    python tests/stability/state.py notebooks/results/stability.json

A limit is the nearest of all; "unflagged" is said where one of them shows it. The
tests then hold what is stated against scenes of another seed. To be run when a method
changes what it can do, not when a test fails.
"""

import json
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent), str(HERE.parent / "benchmarks")]
SEEDS = (2026, 4711, 90210, 1618)


def main() -> None:
    from sweeps import row

    from bench.stability import holds, SWEEPS

    told = json.loads(Path(sys.argv[1]).read_text())["rows"]
    stated: dict = {}
    for said in told:
        name, method = said["sweep"], said["method"]
        if not said["test"]:
            continue
        values = SWEEPS[name].values
        upto = -1 if said["limit"] is None else values.index(said["limit"])
        for seed in SEEDS:
            while upto >= 0 and not holds(row(method, name, values[upto], seed)):
                upto -= 1
        limit = None if upto < 0 else values[upto]
        beyond = "" if limit == values[-1] else said["beyond"]
        if limit != values[-1]:
            last = [row(method, name, values[-1], seed) for seed in SEEDS]
            far = any(found.get("far_undoubted") for found in last)
            if far and "unflagged" not in beyond:
                beyond += ", unflagged"
        stated.setdefault(name, {})[method] = {"limit": limit, "beyond": beyond}
        print(name, method, limit, beyond, flush=True)
    (HERE / "stated.json").write_text(json.dumps(stated, indent=1) + "\n")


if __name__ == "__main__":
    main()
