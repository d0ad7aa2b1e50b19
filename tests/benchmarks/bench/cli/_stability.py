"""`tomojax stability`: finds where methods fail, and what they say then."""

import json
import sys
from pathlib import Path

import click

from bench.cli._study import begin, named, study_options
from tomojax._whole import whole, write_text
from tomojax.cli.entry import Command


@click.command(cls=Command)
@click.option(
    "--quick", is_flag=True, help="Run four methods on few scenes, in some minutes."
)
@click.option("--only", multiple=True, help="Run this sweep alone; may be repeated.")
@study_options(
    "stability", "limits and a summary", "At each value. [default: 10; quick: 4]"
)
def stability(
    quick: bool,
    only: tuple[str, ...],
    out: Path,
    json_path: Path,
    scenes: int | None,
    seed: int,
    like: Path | None,
) -> None:
    """Sweep noise, faults and scenes until each method fails.

    The command prints each method's limit, and what the method says beyond the limit.
    Another model makes the scenes' voltages: a resistor network with a rig's errors.
    """
    from bench.stability import (
        limits as stability_limits,
        numbers as stability_numbers,
        report,
        run,
        SWEEPS,
    )
    from tomojax._environment import environment

    names = SWEEPS
    for name in only:
        if name not in names:
            raise ValueError(f"--only: got {name!r}, expected one of {', '.join(names)}")
    sensor = begin(json_path, scenes, 1, seed, like)
    with click.progressbar(
        length=len(only) or len(names) + 1,
        label="stability",
        file=sys.stderr,
        item_show_func=named,
    ) as bar:
        rows = run(
            sensor,
            out,
            quick,
            only,
            scenes,
            seed,
            lambda done: bar.update(1, done),  # pyright: ignore
        )
        numbers = None
        if not only:
            numbers = stability_numbers(out, quick)
            bar.update(1)
    limits = stability_limits(rows)
    print(report.text(limits))
    flagged = report.flagged(limits)
    print(report.flagged_text(flagged))
    summary = {"flagged": flagged, "values": rows, "numbers": numbers}
    told = {"rows": limits, "summary": summary, "environment": environment()}
    write_text(json_path, json.dumps(told, indent=1) + "\n")
    picture = out / "stability.png"
    with whole(picture) as part:
        report.chart(rows, limits).savefig(part, dpi=100)
    print(f"picture: {picture}")
    if numbers:
        print(report.numbers_text(numbers))
        picture = out / "stability_numbers.png"
        with whole(picture) as part:
            report.numbers_chart(numbers, limits).savefig(part, dpi=100)
        print(f"picture: {picture}")
