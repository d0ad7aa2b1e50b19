"""`tomojax table1`: predicts the paper's Table I."""

from pathlib import Path

import click

from tomojax.cli import entry

_PICTURES = tuple(f"table1_{name}.png" for name in ("table", "dependence", "images"))


@click.command(cls=entry.Command)
@entry.json_option("the rows and a summary", makes=True)
@click.option(
    "--out",
    type=entry.OutputFolder(*_PICTURES),
    help="Folder for three pictures; without it, none is drawn.",
)
def table1(json_path: Path | None, out: Path | None) -> None:
    """Predict the paper's Table I, beside the paper's own numbers."""
    from tomojax.paper.table1 import report, run

    # Known before the work that it is for: a mistyped path costs a second.
    for folder in (out, json_path and json_path.parent):
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
    with entry.Progress("table1:") as progress:
        study = run(progress.say)
    print(report.text(study))
    entry.write_report(json_path, rows=report.rows(study), summary=report.summary(study))
    if out:
        from tomojax.paper.table1 import plots

        for draw in (plots.table, plots.dependence, plots.images):
            entry.save_picture(draw(study), out / f"table1_{draw.__name__}.png")
