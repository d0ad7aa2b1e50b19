"""`tomojax frontier`: shows which method, pattern, mesh and precision to take."""

import json
import sys
from pathlib import Path

import click

from bench.cli._study import begin, named, study_options
from tomojax._whole import whole, write_text
from tomojax.cli.entry import Command


@click.command(cls=Command)
@click.option(
    "--quick", is_flag=True, help="Take few scenes and methods, in under two minutes."
)
@click.option("--only", multiple=True, help="Measure this method alone; may be repeated.")
@study_options("frontier", "rows and a summary", "Of each kind. [default: 20; quick: 6]")
def frontier(
    quick: bool,
    only: tuple[str, ...],
    out: Path,
    json_path: Path,
    scenes: int | None,
    seed: int,
    like: Path | None,
) -> None:
    """Measure speed and accuracy of every method, on this machine.

    Peers are measured as well: the code that a lab would write with NumPy, SciPy,
    scikit-fem and pyEIT. Another model makes the scenes' voltages: a resistor network with
    a rig's errors.
    """
    from bench.frontier import jobs, KINDS, mark_front, report, run
    from tomojax._environment import environment

    _peers_there()
    sensor = begin(json_path, scenes, 2, seed, like)
    every = jobs(quick)
    names = list(dict.fromkeys(job.method for job in every))
    for name in only:
        if name not in names:
            raise ValueError(f"--only: got {name!r}, expected one of {', '.join(names)}")
    steps = sum(not only or job.method in only for job in every) + 1
    with click.progressbar(
        length=steps, label="frontier", file=sys.stderr, item_show_func=named
    ) as bar:
        rows = run(
            sensor,
            out,
            quick,
            scenes,
            seed,
            lambda done: bar.update(1, done),  # pyright: ignore
            only,
        )
    failed = [row for row in rows if row.get("failed")]
    rows = [row for row in rows if row["scene"] in KINDS]
    mark_front(rows)
    print(report.text(rows))
    for row in failed:
        print(f"failed: {row['method']}, {row['dtype']}: {row['failed']}")
    told = {"rows": rows, "summary": report.summary(rows) | {"failed": failed}}
    told["environment"] = environment()
    write_text(json_path, json.dumps(told, indent=1) + "\n")
    with whole(out / "frontier.png") as part:
        report.chart(rows).savefig(part, dpi=110)
    print(f"picture: {out / 'frontier.png'}")


def _peers_there() -> None:
    """Checks before the work that the peers are installed."""
    from importlib.util import find_spec

    for module in ("pyeit", "skfem"):
        if find_spec(module) is None:
            raise ValueError(
                f"{module} is not installed; pip install 'tomojax[app,peers]' brings it"
            )
