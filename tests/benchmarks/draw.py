"""Draws pictures anew from the rows that are kept: nothing is measured.

    python tests/benchmarks/draw.py [NAME …] [--out notebooks/results]

A name is that of a JSON file in the folder: all without one. Pictures of what no file
keeps are not drawn: `ladder.py`, `calibration.py`, `shapes.py --only gallery` make those.
"""

import argparse
import importlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]
RESULTS = HERE.parents[1] / "notebooks" / "results"

# Scripts whose `draw` takes the rows, and those whose `draw` takes the whole report.
ROWS = ("adapt", "beside", "design", "device", "growth", "install", "rubs", "shared")
ROWS += ("slots", "speed", "start", "step")
WHOLE = ("physics", "reconstruction", "recordings", "shapes", "solvers")


def benchmark(name: str) -> Any:
    return importlib.import_module(f"benchmarks.{name}")


def calibration(told: dict, path: Path) -> None:
    benchmark("calibration").draw(told["rows"], told["switched_off"], path)


def check(told: dict, path: Path) -> None:
    benchmark("check").picture(told["rows"]).savefig(path, dpi=110)


def contacts(told: dict, path: Path) -> None:
    rows = told["rows"]
    benchmark("contacts").draw([r for r in rows if r["scene"] != "separation"], path)


def doubt(told: dict, path: Path) -> None:
    benchmark("doubt").plot(told["rows"], told["signs"], path)


def electrodes(told: dict, path: Path) -> None:
    """The maps are computed anew from the electrodes' places."""
    made = benchmark("electrodes")
    made.draw(told["rows"], made.maps_of(told["rows"]), path)


def frontier(told: dict, path: Path) -> None:
    from bench.frontier import report

    report.chart(told["rows"]).savefig(path, dpi=110)


def live(told: dict, path: Path) -> None:
    benchmark("live").draw(told["rows"][0], path)


def rigs(told: dict, path: Path) -> None:
    benchmark("rigs").plot(told["rows"], path)


def sensors(told: dict, path: Path) -> None:
    benchmark("sensors").plot(told["rows"], path)


def stability(told: dict, path: Path) -> None:
    from bench.stability import report

    limits, more = told["rows"], told["summary"]
    report.chart(more["values"], limits).savefig(path, dpi=100)
    picture = report.numbers_chart(more["numbers"], limits)
    picture.savefig(path.with_name("stability_numbers.png"), dpi=100)


OWN = (calibration, check, contacts, doubt, electrodes, frontier, live, rigs, sensors)
OWN += (stability,)
DRAWN: dict[str, Callable[[dict, Path], Any]] = {f.__name__: f for f in OWN}
for _name in ROWS:
    DRAWN[_name] = lambda told, path, n=_name: benchmark(n).draw(told["rows"], path)
for _name in WHOLE:
    module = "shapes_drawn" if _name == "shapes" else _name
    DRAWN[_name] = lambda told, path, n=module: benchmark(n).draw(told, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[[], *sorted(DRAWN)])
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    for name in options.names or sorted(DRAWN):
        told = json.loads((options.out / f"{name}.json").read_text())
        DRAWN[name](told, options.out / f"{name}.png")
        print(options.out / f"{name}.png", flush=True)


if __name__ == "__main__":
    main()
