"""Compares exports of results with the values that other tools read back.

    python tests/benchmarks/exports.py RESULTS… [--json FILE]

For each file and kind, prints how many numbers were compared, and how many differ.
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
from readback import READERS, results_of

from tomojax.exports import ending, export


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", nargs="+", type=Path)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rows = []
    for path in given.results:
        truth = results_of(path)
        for kind, read in READERS.items():
            with tempfile.TemporaryDirectory() as folder:
                out = Path(folder) / f"out{ending(kind)}"
                export(path, out, kind)
                found = read(out)
            compared = differ = 0
            for name, values in found.items():
                same = np.asarray(values) == truth[name]
                same |= np.isnan(values.astype(float)) & np.isnan(truth[name].astype(float))
                compared, differ = compared + same.size, differ + int((~same).sum())
            rows.append(
                {"file": path.name, "kind": kind, "numbers": compared, "differ": differ}
            )
            print(f"{path.name:40s} {kind:8s} {compared:10d} numbers, {differ} differ")
    if given.json:
        given.json.write_text(json.dumps({"rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
