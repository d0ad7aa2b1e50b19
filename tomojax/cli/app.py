"""Commands of `tomojax`, on click."""

import json
import sys
from pathlib import Path

import click

from tomojax._environment import environment
from tomojax.cli._demo import run as demo_run
from tomojax.cli._design import design
from tomojax.cli._frontier import frontier
from tomojax.cli._live import live, record
from tomojax.cli._recordings import calibrate, info, reconstruct
from tomojax.cli._stability import stability
from tomojax.cli._track import track

_FILE = click.Path(dir_okay=False, path_type=Path)
_FOLDER = click.Path(file_okay=False, path_type=Path)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="tomojax")
def app() -> None:
    """Differentiable reconstruction for tomographic tactile sensors."""


@app.command()
@click.option(
    "--out",
    type=_FOLDER,
    default=Path("tomojax-demo"),
    show_default=True,
    help="Folder for the pictures and the results.",
)
def demo(out: Path) -> None:
    """Reconstruct a small recording that comes with the package; pictures and a clip."""
    demo_run(out)


@app.command()
@click.option("--json", "json_path", type=_FILE, help="Write the rows and a summary here.")
@click.option(
    "--out", type=_FOLDER, help="Folder for three pictures; without it, none is drawn."
)
def table1(json_path: Path | None, out: Path | None) -> None:
    """Predict the paper's Table I and set it beside the paper's numbers."""
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

        for draw in (
            plots.table,
            plots.dependence,
            plots.images,
        ):
            path = out / f"table1_{draw.__name__}.png"
            draw(study).savefig(path, dpi=110)
            print(f"picture: {path}")


app.add_command(reconstruct)
app.add_command(info)
app.add_command(calibrate)
app.add_command(track)
app.add_command(record)
app.add_command(live)
app.add_command(design)
app.add_command(frontier)
app.add_command(stability)


def run() -> None:
    """`app` with the exit status and the one line of the file's first sentence."""
    try:
        status = app(standalone_mode=False)
    except click.exceptions.Abort:
        raise SystemExit(130) from None
    except click.ClickException as error:
        print(f"tomojax: {error.format_message()}", file=sys.stderr)
        raise SystemExit(2) from None
    except (OSError, ValueError) as error:
        print(f"tomojax: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    raise SystemExit(status or 0)
