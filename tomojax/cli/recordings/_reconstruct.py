"""`tomojax reconstruct`: finds contacts and images in recordings."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from tomojax._require import require
from tomojax.cli import entry
from tomojax.cli.recordings._many import reconstruct_all
from tomojax.cli.recordings._one import reconstruct_one
from tomojax.cli.recordings._opened import layout_option
from tomojax.cli.recordings._pairs import is_pairs, reconstruct_pairs

# Where results of several recordings go.
_FOLDER = Path("tomojax-results")


def _lam(context: click.Context, parameter: Any, value: str) -> float | None:
    if value == "auto":
        return None
    return entry.NUMBER.convert(value, parameter, context)


@click.command(cls=entry.Command)
@click.argument("rec", type=entry.InputFile(empty=True), nargs=-1, required=True)
@entry.out_option(
    entry.OutputFile(
        "results",
        lambda given: given["rec"][0].with_suffix(".results.h5"),
        unless=lambda given: _several(given["rec"]),
    ),
    "Write the results to this file, or to this folder for several recordings. "
    "[default: REC.results.h5; tomojax-results]",
)
@click.option(
    "--rate",
    type=click.Choice(["scan", "slot"]),
    help="Make a row for each scan or for each slot. [default: scan; slot with --method "
    "follow]",
)
@click.option(
    "--method",
    help="Reconstruct by auto, points, shape, source, linear or follow. The method follow "
    "carries contacts on from slot to slot. [default: auto; source with --rate slot]",
)
@click.option(
    "--images/--no-images",
    default=None,
    help="Keep an image of each row. [default: only with --rate scan]",
)
@click.option(
    "--lam",
    default="auto",
    callback=_lam,
    help="Regularisation weight λ, or auto.",
)
@click.option(
    "--grid", type=int, help="Pixels along a side. [default: 32; 24 with --rate slot]"
)
@click.option("--contacts", default=4, help="Find this many contacts per row at most.")
@click.option(
    "--threshold",
    type=entry.NUMBER,
    help="Report no contact if all voltages are below this, V. [default: the method's]",
)
@entry.calibration_option
@click.option(
    "--tare/--no-tare",
    default=True,
    help="Take channels' zeros from contact-free slots, if there are any.",
)
@click.option(
    "--adapt",
    is_flag=True,
    help="Follow zeros and gains that drift slowly; the results log them.",
)
@click.option(
    "--policy",
    type=entry.InputFile(),
    help="Use only the slots that this table chooses in each scan, and its λ. `tomojax "
    "design --policy` writes the table.",
)
@click.option(
    "--chunk", type=int, help="Scans to work on at once. [default: by memory and time]"
)
@click.option("--resume", is_flag=True, help="Go on with a run that ended early.")
@click.option("--overwrite", is_flag=True, help="Begin anew over results that are there.")
@entry.picture_option("the contacts over time")
@click.option(
    "--outlines",
    type=entry.OutputFile("outlines"),
    help="Write outlines of what touches to this .geojson or .svg file; needs --method "
    "shape. Replaces earlier outlines.",
)
@entry.json_option("the printed summary")
@click.option(
    "--verbose", is_flag=True, help="Print each compiled program, and how long it took, s."
)
@click.option(
    "--cluster",
    metavar="ADDRESS",
    help="Share the work among the workers of a Dask cluster: tcp://HOST:8786 of its "
    "scheduler, or the scheduler's file.",
)
@layout_option
@entry.stretch_options
def reconstruct(rec: Sequence[Path], out: Path | None, **options: Any) -> None:
    """Find contacts and images in the recording REC.

    Each scan or slot of REC gives one row of results. Several recordings, or a folder, give
    one results file each in the folder OUT. OUT/table.csv has a line for each recording. A
    recording that cannot be read gives a line on standard error, and the exit status is 2.

    Ctrl-C, a crash or a full disk leave OUT.partial. --resume goes on with OUT.partial, and
    makes the same file as an unbroken run. With --cluster, the workers of a Dask cluster
    compute the rows, and this command writes them. The workers read REC by the same path.

    Each frame of a recording of kind conductivity gives the place of one press: by the
    response that `tomojax calibrate` learned, or by the nominal sheet. --contacts 2 finds
    up to two presses of such a frame by the nominal sheet.
    """
    both = options["resume"] and options["overwrite"]
    require(not both, "--resume", "--overwrite too", "one of them")
    if not _several(rec) and is_pairs(rec[0]):
        assert out is not None
        return reconstruct_pairs(rec[0], out, options)
    method = options["method"]
    entry.check_name("--method", method or entry.METHODS[0], (*entry.METHODS, "follow"))
    if _several(rec):
        reconstruct_all(rec, out or _FOLDER, options)
    else:
        assert out is not None
        reconstruct_one(rec[0], out, options)


def _several(rec: Sequence[Path]) -> bool:
    return len(rec) > 1 or rec[0].is_dir()
