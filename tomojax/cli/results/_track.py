"""`tomojax track`: follows contacts over time."""

from pathlib import Path
from typing import Any

import click

from tomojax._require import naming
from tomojax.cli import entry

_DRIFT = entry.Pair(float, "M,LN_G", "auto or M,LN_G, 0 or more", words={"auto": None})


@click.command(cls=entry.Command)
@click.argument("results", type=entry.InputFile())
@entry.out_option(
    entry.OutputFile("results", lambda given: given["results"].with_suffix(".track.h5")),
    "Write the tracks here. [default: RESULTS.track.h5]",
)
@click.option(
    "--smooth/--filter",
    default=True,
    help="Use later rows as well as earlier rows, or earlier rows alone.",
)
@click.option(
    "--hold",
    default=3,
    help="Keep a contact that is missing from up to this many rows.",
)
@click.option(
    "--least",
    default=3,
    help="Drop a contact that fewer rows than this show.",
)
@click.option(
    "--drift",
    type=_DRIFT,
    default="auto",
    help="How much place (m) and ln g (conductance) change per row, as standard "
    "deviations M,LN_G, or auto. 0,0 stands still.",
)
@click.option("--overwrite", is_flag=True, help="Replace results that are there.")
@entry.picture_option("the contacts' paths")
@entry.json_option("the contacts")
@entry.stretch_options
def track(results: Path, out: Path, **options: Any) -> None:
    """Follow the contacts of RESULTS over time.

    RESULTS come from `reconstruct --method points` or auto, best with --rate slot, or from
    a recording of pairs. A contact's place and conductance, or a press's strength, are
    found from all rows that show the contact. Each contact gets a number. The command
    prints when each contact began and ended.
    """
    _check_stretch(results, options["since"], options["until"])

    from tomojax.results import track_file as work

    names = ("overwrite", "smooth", "hold", "least", "drift", "since", "until")
    _, found = work.track_results(results, out, **{name: options[name] for name in names})
    print(work.text(found, out))
    print(f"tracks: {out}")
    rows = [touch._asdict() for touch in found]
    entry.write_report(options["json_path"], rows=rows, summary={"contacts": len(found)})
    if options["picture"]:
        entry.save_picture(work.picture(results, out), options["picture"])


def _check_stretch(results: Path, since: float | None, until: float | None) -> None:
    """**Raises:** `ValueError` for a file of no results, or without that stretch.

    The work itself looks again, once JAX is imported.
    """
    from tomojax._stretch import stretch_of
    from tomojax.results.loading import LoadedResults

    with LoadedResults(results) as file, naming(results):
        stretch_of(file.read("t"), since, until)
