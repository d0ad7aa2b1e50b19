"""Commands of `tomojax`, on click."""

import sys
from pathlib import Path

import click

from tomojax import _demo


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="tomojax")
def app() -> None:
    """Differentiable reconstruction for tomographic tactile sensors."""


@app.command()
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("tomojax-demo"),
    show_default=True,
    help="Folder for the pictures.",
)
def demo(out: Path) -> None:
    """Simulate two contacts on the paper's sensor and show what its electrodes read."""
    _demo.run(out)


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
