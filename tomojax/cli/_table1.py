"""`tomojax table1`: predicts the paper's Table I."""

import json
import sys
from pathlib import Path

import click

from tomojax._whole import whole, write_text
from tomojax.cli.entry import Command, OutputFile, OutputFolder

_PICTURES = tuple(f"table1_{name}.png" for name in ("table", "dependence", "images"))


@click.command(cls=Command)
@click.option(
    "--json",
    "json_path",
    type=OutputFile("report", makes=True),
    help="Write the rows and a summary here; replaces an earlier report.",
)
@click.option(
    "--out",
    type=OutputFolder(*_PICTURES),
    help="Folder for three pictures; without it, none is drawn.",
)
def table1(json_path: Path | None, out: Path | None) -> None:
    """Predict the paper's Table I, beside the paper's own numbers."""
    from tomojax._environment import environment
    from tomojax.paper.table1 import PAPER, report, run

    # Known before the work that it is for: a mistyped path costs a second.
    for folder in (out, json_path and json_path.parent):
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
    steps = len(PAPER) + 2
    with click.progressbar(length=steps, label="table1", file=sys.stderr) as bar:
        study = run(lambda step: bar.update(1))
    print(report.text(study))
    if json_path:
        told = {
            "rows": report.rows(study),
            "summary": report.summary(study),
            "environment": environment(),
        }
        write_text(json_path, json.dumps(told, indent=1) + "\n")
    if out:
        from tomojax.paper.table1 import plots

        for draw in (plots.table, plots.dependence, plots.images):
            path = out / f"table1_{draw.__name__}.png"
            with whole(path) as part:
                draw(study).savefig(part, dpi=110)
            print(f"picture: {path}")
