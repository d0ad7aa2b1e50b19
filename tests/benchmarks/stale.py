"""Lists the results that are older than the code that they describe.

    python tests/benchmarks/stale.py [--record NAME …]

`notebooks/results/code.json` names for each result the code that it describes, and that
code's hash when the result was made. An entry is a file, a folder, or `file::name`. A file
counts by its constants, a name by its whole code without docstrings: moved lines and
comments change nothing. `--record` writes today's hash, after a result was made anew. A
result may stay stale where the page `measured/older.md` says why.
"""

import argparse
import ast
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "notebooks" / "results"
CODE = RESULTS / "code.json"
OLDER = ROOT / "notebooks" / "measured" / "older.md"

Read = Callable[[str], str]
Listed = Callable[[str], list[str]]


def read(path: str) -> str:
    return (ROOT / path).read_text()


def listed(folder: str) -> list[str]:
    return [str(p.relative_to(ROOT)) for p in sorted((ROOT / folder).rglob("*.py"))]


def hash_of(entries: list[str], read: Read = read, listed: Listed = listed) -> str:
    """Hashes the constants of files and folders, and the code of names."""
    parts = []
    for entry in entries:
        path, _, name = entry.partition("::")
        for file in [path] if path.endswith(".py") else listed(path):
            parts += _parts(ast.parse(read(file)), name, entry)
    return hashlib.sha256("\n".join(sorted(parts)).encode()).hexdigest()[:16]


def _parts(tree: ast.Module, name: str, entry: str) -> list[str]:
    if name:
        found = [one for one in tree.body if getattr(one, "name", None) == name]
        if not found:
            raise ValueError(f"{CODE.name}: got {entry!r}, expected a name of that file")
        for one in ast.walk(found[0]):
            body: Any = getattr(one, "body", None)
            if isinstance(body, list) and body and isinstance(body[0], ast.Expr):
                if isinstance(body[0].value, ast.Constant):
                    body[:1] = [ast.Pass()]  # a docstring
        return [ast.dump(found[0])]
    told = []
    for one in tree.body:
        targets = one.targets if isinstance(one, ast.Assign) else []
        names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
        if names and all(n.strip("_").isupper() for n in names) and _of_numbers(one):
            told.append(ast.dump(one))
    return told


def _of_numbers(one: ast.stmt) -> bool:
    """Tells whether a constant is made of numbers alone: words change no figure."""
    values = [n.value for n in ast.walk(one) if isinstance(n, ast.Constant)]
    called = any(isinstance(n, ast.Call | ast.Dict) for n in ast.walk(one))
    return not called and bool(values) and all(type(v) in (int, float) for v in values)


def stale() -> list[str]:
    """Returns the names of results whose code has another hash than when they were made."""
    told = json.loads(CODE.read_text())
    there = {n: one for n, one in told.items() if (RESULTS / f"{n}.json").exists()}
    return [name for name, one in there.items() if hash_of(one["of"]) != one["code"]]


def excused() -> dict[str, str]:
    """Returns the results that the page says are older, each with its reason."""
    lines = [line.split("|") for line in OLDER.read_text().splitlines() if "|" in line]
    return {cells[1].strip(" `"): cells[2].strip() for cells in lines[2:]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--record", nargs="*", default=[], metavar="NAME")
    options = parser.parse_args()
    told = json.loads(CODE.read_text())
    for name in options.record:
        told[name]["code"] = hash_of(told[name]["of"])
    if options.record:
        CODE.write_text(json.dumps(told, indent=1) + "\n")
    reasons = excused()
    for name in stale():
        print(f"{name}: {reasons.get(name, 'stale, and no page says why')}")


if __name__ == "__main__":
    main()
