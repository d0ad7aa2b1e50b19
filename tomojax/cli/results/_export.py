"""`tomojax export`: writes results for other tools."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from tomojax._require import require
from tomojax.cli import entry


def _to(context: click.Context, parameter: Any, values: tuple[str, ...]) -> dict:
    """Returns a kind, or the time where the stretch ends; no kind is a number."""
    from tomojax.exports import KINDS

    found: dict[str, Any] = {"kind": None, "until": None}
    for value in values:
        name = "kind" if value in KINDS else "until"
        try:
            known = (
                value if name == "kind" else entry.NUMBER.convert(value, parameter, context)
            )
        except click.BadParameter:
            expected = f"{', '.join(KINDS)}, or a time in s"
            raise click.BadParameter(f"got {value!r}, expected {expected}") from None
        if found[name] is not None:
            raise click.BadParameter(f"got {value!r} after {found[name]!r}, expected one")
        found[name] = known
    return found


@click.command(cls=entry.Command)
@click.argument("results", type=entry.InputFile(), nargs=-1, required=True)
@click.option(
    "--to",
    multiple=True,
    callback=_to,
    metavar="KIND|S",
    help="Write this kind: csv, parquet, netcdf, mcap, svg, lerobot or film. A number "
    "ends the stretch instead, s after the first row. [default: by the ending of "
    "-o; the end]",
)
@entry.since_option
@entry.out_option(
    entry.OutputFile("", unless=lambda given: True),  # checked once the kind is known
    "Write this file, or files in this folder for several RESULTS. [default: beside "
    "RESULTS]",
)
@click.option(
    "--rate",
    type=entry.COUNT,
    help="Frames a second of lerobot, or pictures a second of a film. [default: 50]",
)
@click.option(
    "--task",
    default="touch",
    help="Say in words what lerobot's episodes show.",
)
@click.option(
    "--slow", type=entry.AMOUNT, help="Slow a film down this many times. [default: 1]"
)
@click.option(
    "--film",
    type=entry.OutputFile("", unless=lambda given: True),
    help="Write a film here, short for --to film -o FILM.",
)
@click.option("--overwrite", is_flag=True, help="Replace files that are there.")
def export(results: Sequence[Path], to: dict, **options: Any) -> None:
    """Write RESULTS of `reconstruct` or `track` for other tools.

    The kinds csv and parquet have a row for each row of RESULTS. A file of events beside
    them says when contacts begin and end. The kind netcdf is for xarray, mcap for ROS 2 and
    Foxglove, svg for papers. A film is .mp4 where ffmpeg is installed, and .gif elsewhere.
    The kind lerobot is a folder with an episode for each of RESULTS. Every other kind makes
    a file for each of RESULTS.
    """
    from tomojax.exports import check_kind, export, KINDS

    out: Path | None = options["out"]
    kind: Any = to["kind"]
    if options["film"]:
        require(kind in (None, "film") and out is None, "--film", "--to or -o too", "one")
        out, kind = options["film"], "film"
    if kind is None:
        ending = "" if out is None else out.suffix
        kind = next((n for n, k in KINDS.items() if ending and ending in k.endings), None)
        require(kind, "--to", "none", f"a kind: {', '.join(KINDS)}")
    check_kind(kind)
    together = kind == "lerobot"
    if len(results) > 1 and out is not None and not together:
        one = out.suffix in KINDS[kind].endings
        require(not one, "--out", f"{out}", "a folder, as each of RESULTS has its file")
    work = {r: _place(r, out, kind, len(results) > 1 and not together) for r in results}
    if together:
        work = {tuple(results): work[results[0]]}
    _check(results, list(work.values()), kind, options["overwrite"])
    given = {n: options[n] for n in ("since", "rate", "task", "slow")}
    wrong = 0
    with entry.interrupts():
        for number, (one, place) in enumerate(work.items()):
            try:
                with entry.Progress(place.name, "rows") as progress:
                    export(one, place, kind, until=to["until"], **given, progress=progress)
            except KeyboardInterrupt:
                print(
                    f"\ntomojax: stopped; {number} of {len(work)} written", file=sys.stderr
                )
                raise SystemExit(entry.STOPPED) from None
            except (OSError, ValueError) as error:
                if len(work) == 1:
                    raise
                print(f"tomojax: {' '.join(str(error).splitlines())}", file=sys.stderr)
                wrong += 1
                continue
            print(place)
    if wrong:
        print(f"tomojax: {len(work) - wrong} of {len(work)} written", file=sys.stderr)
        raise SystemExit(2)


def _place(results: Path, out: Path | None, kind: str, many: bool) -> Path:
    """Returns the path of one results file's export."""
    from tomojax.exports import ending

    suffix = ending(kind)
    stem = results.name.removesuffix(".h5")
    name = f"{stem}{suffix}" if suffix else f"{stem}.{kind}"
    if out is None:
        return results.with_name(name)
    return out / name if suffix and (many or out.is_dir()) else out


def _check(results: Any, places: list[Path], kind: str, overwrite: bool) -> None:
    """Checks all paths.

    **Raises:** `ValueError` before any work.
    """
    from tomojax.exports import beside, KINDS

    endings = KINDS[kind].endings
    for place in places:
        expected = f"a name with {' or '.join(endings)}"
        named = not endings or place.suffix in endings
        require(named, f"--out: {place}", repr(place.suffix), expected)
    written = [
        entry.Written(path, "--out", kind, kind != "film" and len(places) > 1, ())
        for place in places
        for path in (place, *beside(place, kind))
    ]
    if len(places) > 1:
        places[0].parent.mkdir(exist_ok=True)
    for one in written:
        there = one.path.exists() and not overwrite
        require(not there, f"{one.path}", "a file", "a new name, or --overwrite")
    entry.check_paths(list(results), written, overwrite)
