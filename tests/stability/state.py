"""Writes stated.json: limits that hold in the committed run and on the tests' scenes.

    python tests/stability/state.py notebooks/results/stability.json

A limit is the nearer one of the two; "unflagged" is said where either run shows it.
"""

import json
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1])]


def main() -> None:
    from test_sweeps import HOLDS, scenes, SWEEPS, trial, trial_row

    told = json.loads(Path(sys.argv[1]).read_text())["rows"]
    stated: dict = {}
    for row in told:
        name, method = row["sweep"], row["method"]
        if not row["test"] or method == "positive":
            continue
        values = SWEEPS[name].values
        upto = -1 if row["limit"] is None else values.index(row["limit"])
        while upto >= 0:
            found = trial_row(trial(), method, scenes(name, values[upto]), False)
            if found["raised"] is None and found["near"] >= HOLDS:
                break
            upto -= 1
        limit = None if upto < 0 else values[upto]
        beyond = "" if limit == values[-1] else row["beyond"]
        if limit != values[-1]:
            last = trial_row(trial(), method, scenes(name, values[-1]), False)
            if last.get("far_undoubted") and "unflagged" not in beyond:
                beyond += ", unflagged"
        stated.setdefault(name, {})[method] = {"limit": limit, "beyond": beyond}
        print(name, method, limit, beyond, flush=True)
    (HERE / "stated.json").write_text(json.dumps(stated, indent=1) + "\n")


if __name__ == "__main__":
    main()
