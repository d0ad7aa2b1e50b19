"""`tomojax table1`: the paper's Table I, predicted."""

import json
import sys
from pathlib import Path

import click

_FILE = click.Path(dir_okay=False, path_type=Path)
_FOLDER = click.Path(file_okay=False, path_type=Path)


@click.command()
@click.option("--json", "json_path", type=_FILE, help="Write the rows and a summary here.")
@click.option(
    "--out", type=_FOLDER, help="Folder for three pictures; without it, none is drawn."
)
def table1(json_path: Path | None, out: Path | None) -> None:
    """Predict the paper's Table I and set it beside the paper's numbers."""
    from tomojax._environment import environment
    from tomojax.studies.table1 import PAPER, report, run as table1_run

    # Known before the work that it is for: a mistyped path costs a second.
    for folder in (out, json_path and json_path.parent):
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
    steps = len(PAPER) + 2
    with click.progressbar(length=steps, label="table1", file=sys.stderr) as bar:
        study = table1_run(progress=lambda step: bar.update(1))
    print(report.text(study))
    if json_path:
        told = {
            "rows": report.rows(study),
            "summary": report.summary(study),
            "environment": environment(),
        }
        json_path.write_text(json.dumps(told, indent=1) + "\n")
    if out:
        from tomojax.studies.table1 import plots

        for draw in (plots.table, plots.dependence, plots.images):
            path = out / f"table1_{draw.__name__}.png"
            draw(study).savefig(path, dpi=110)
            print(f"picture: {path}")
