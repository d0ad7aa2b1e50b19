"""`tomojax track`."""

import json
import math
from pathlib import Path
from typing import Any

import click

_FILE = click.Path(dir_okay=False, path_type=Path)


def _drift(context: click.Context, parameter: Any, value: str) -> tuple | None:
    if value == "auto":
        return None
    try:
        place, height = (float(part) for part in value.split(","))
        if not all(0 <= part < math.inf for part in (place, height)):
            raise ValueError
    except ValueError:
        raise click.BadParameter(
            f"got {value!r}, expected auto or M,LN_G, 0 or more"
        ) from None
    return place, height


@click.command()
@click.argument("results", type=_FILE)
@click.option("-o", "--out", type=_FILE, help="[default: RESULTS.track.h5]")
@click.option(
    "--smooth/--filter", default=True, show_default=True, help="Later rows count."
)
@click.option(
    "--hold", type=int, default=3, show_default=True, help="Rows it may be missing."
)
@click.option("--least", type=int, default=3, show_default=True, help="Rows that show it.")
@click.option(
    "--drift",
    default="auto",
    show_default=True,
    callback=_drift,
    help="M,LN_G: by how much a row changes places and ln g; 0,0 stands still.",
)
@click.option("--overwrite", is_flag=True, help="Over what is there.")
@click.option("--picture", type=_FILE, help="Draw the paths here (PNG).")
@click.option("--json", "json_path", type=_FILE, help="Write the contacts here.")
def track(results: Path, out: Path | None, **options: Any) -> None:
    """Follow the contacts of RESULTS (of `reconstruct --method points` or auto) over time.

    A contact's place and conductance come from all rows that show it, and it has a number:
    when it began and ended is printed. Best with --rate slot.
    """
    from tomojax._environment import environment
    from tomojax.results import track_file as work

    out = out or results.with_name(results.stem + ".track.h5")
    for path in (options["picture"], options["json_path"]):
        if path and not path.parent.is_dir():
            raise ValueError(f"{path}: no such folder; make it, or give another")
    names = ("overwrite", "smooth", "hold", "least", "drift")
    _, found = work.track_results(results, out, **{name: options[name] for name in names})
    print(work.text(found))
    print(f"tracks: {out}")
    if options["json_path"]:
        report = {
            "rows": [touch._asdict() for touch in found],
            "summary": {"contacts": len(found)},
            "environment": environment(),
        }
        options["json_path"].write_text(json.dumps(report, indent=1) + "\n")
    if options["picture"]:
        work.picture(results, out).savefig(options["picture"], dpi=110)
        print(f"picture: {options['picture']}")
