"""Measures what an installation costs: `tomojax`, `[app]`, and each extra beside it.

    python tests/benchmarks/install.py [--only app web …] [--out FOLDER]

Each is installed in a new virtual environment. The figures are pip's seconds, megabytes on
the disk, packages, and seconds of `import tomojax`. An installation with a command line
also has seconds of `tomojax --help`. That is the second call, because the first one
compiles Python's files. The cache of pip stays as it is: cached packages need not be
fetched. Writes install.json and install.png.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(ROOT), str(HERE.parent)]

# Extras of those who work on the package itself.
_OURS = ("test", "dev", "peers")


def size(folder: Path) -> float:
    """Of all files, MB."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]
    return sum(path.stat().st_size for path in files) / 1e6


def seconds(command: list) -> float:
    """Of the second call."""
    for _ in range(2):
        began = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, cwd="/")
    return time.perf_counter() - began


def installed(extras: list[str], wheel: Path) -> dict:
    """One environment with these extras."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        bare = size(folder)
        python = folder / "bin/python"
        what = f"{wheel}[{','.join(extras)}]" if extras else str(wheel)
        began = time.perf_counter()
        subprocess.run([python, "-m", "pip", "install", "-q", what], check=True)
        took = time.perf_counter() - began
        listed = subprocess.run(
            [python, "-m", "pip", "list", "--format", "json"],
            check=True,
            capture_output=True,
        )
        row = {
            "extras": extras,
            "install_s": round(took, 1),
            "size_MB": round(size(folder) - bare, 1),
            "packages": len(json.loads(listed.stdout)) - 2,  # pip and setuptools
            "import_s": round(seconds([python, "-c", "import tomojax"]), 2),
        }
        if "app" in extras:
            row["help_s"] = round(seconds([folder / "bin/tomojax", "--help"]), 2)
        return row


def draw(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    from tomojax._pictures import BLUE

    figure = Figure(figsize=(10, 4.8), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    names = ["+".join(row["extras"]) or "tomojax" for row in rows]
    names = [name if name.count("+") < 2 else "all" for name in names]
    names = [name.replace("+", " + ") for name in names]
    for axes, key in ((left, "size_MB"), (right, "install_s")):
        bars = axes.barh(names, [row[key] for row in rows], color=BLUE)
        axes.bar_label(bars, fmt="%.0f", padding=2, fontsize=8)
        axes.margins(x=0.12)
    figure.suptitle("What an installation costs, by its extras")
    left.set(xlabel="size on the disk, MB", title="Size")
    right.set(xlabel="time to install, s", title="Time, pip's cache filled")
    left.invert_yaxis()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--out", type=Path, default=ROOT / "notebooks/results")
    given = parser.parse_args()
    told = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    names = [n for n in told["optional-dependencies"] if n not in (*_OURS, "app")]
    sets = [[], ["app"], *(["app", name] for name in names), ["app", *names]]
    if given.only is not None:
        sets = [s for s in sets if s and s[-1] in given.only]
    rows = []
    with tempfile.TemporaryDirectory() as name:
        command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", name]
        subprocess.run([*command, str(ROOT)], check=True)
        (wheel,) = Path(name).glob("*.whl")
        for extras in sets:
            rows.append(installed(extras, wheel))
            print(json.dumps(rows[-1]), flush=True)
    from benchmarks.physics import environment

    path = given.out / "install.json"
    content = {"environment": environment(), "rows": rows}
    path.write_text(json.dumps(content, indent=1) + "\n")
    draw(rows, path.with_suffix(".png"))


if __name__ == "__main__":
    main()
